"""Margins that a robot needs and an optimum does not: feet touch down early or late, and errors grow."""

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.robot import Robot
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.contact_modes import ContactModes, runs_of


def heaviest(modes: ContactModes, step_s: Array, config: TrajectoryConfig) -> Array:
    """(N, 4) greatest vertical forces that `loading` allows, multiples of the weight.

    A half sine over a stance of T s that carries 1/n of the weight, for n standing feet, has the slope π²/(2 n T) at
    touch-down and lift-off. `step_s` (N,) are the intervals after the nodes.
    """
    time, period = np.cumsum(step_s) - step_s, float(step_s.sum())
    force = np.full((modes.n_nodes, 4), np.inf)
    for k, hold in enumerate(modes.footholds):
        if modes.contact[:, hold.leg].all():
            continue
        node = np.flatnonzero((modes.foothold[:, hold.leg] == k) & modes.stands[:, hold.leg])
        at = time[node] + period * modes.laps[node, hold.leg]
        first, last = float(at.min()), float(at.max())
        near = np.full(len(node), np.inf)
        if modes.periodic or first > 0:
            near = np.minimum(near, at - first)
        if modes.periodic or last < time[-1]:
            near = np.minimum(near, last - at)
        feet = modes.contact[modes.mode[node]].sum(axis=1).mean()
        force[node, hold.leg] = config.loading * np.pi**2 / (2 * feet * max(last - first, 1e-9)) * near
    return np.clip(force, config.least_force, config.most_force)


def capture_margins(modes: ContactModes, step_s: Array, robot: Robot, height: float, config: TrajectoryConfig) -> Array:
    """(N, 4) distances by which the capture point stays inside each foot, m; −1 where none is asked.

    While one side alone carries the trunk, a robot cannot but fall to the other side, and an error grows as that of a
    linear inverted pendulum of this height, m (Pratt et al. 2006). Where it grows `capture_growth` times, a margin is
    asked for as long as both feet of that side stand.
    """
    margin = np.full((modes.n_nodes, 4), -1.0)
    left = robot.hip_pos_b[:, 1] > 0
    for side in (left, ~left):
        alone = np.zeros(modes.n_nodes)
        both = np.asarray(modes.loaded[:, side].all(axis=1))
        for run in runs_of(both & ~modes.loaded[:, ~side].any(axis=1), modes.periodic):
            alone[run] = step_s[run].sum()
        for run in runs_of(both, modes.periodic):
            if np.exp(np.sqrt(GRAVITY / height) * alone[run].max()) > config.capture_growth:
                margin[np.ix_(run, np.flatnonzero(side))] = config.capture_m * robot.leg_length / 0.4
    return margin
