"""Stitched motions: DMP parameters of all segments together, scored over the whole episode (paper, "Motion stitching").

Each occurrence of a motion has its own parameters. A candidate adds its cycles' difference from the retargeted cycles
to the demonstration. A foot changes to the next segment's modulation in the stance in which it changes segment, the
trunk over the transition.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import (
    quat_conjugate,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    rotvec_from_quat,
    turned_about_z,
    yaw_from_quat,
)
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.contacts import swing_tops
from fastmimic.motion.motion import Motion
from fastmimic.optimize.parameters import FOOT_HEIGHT, needed_group
from fastmimic.optimize.problem import ImitationProblem, Objective, Problem, clearance_penalty
from fastmimic.primitive import MotionDmp
from fastmimic.primitive.motion_dmp import foot_table, rate_of
from fastmimic.reference.table import reference_table
from fastmimic.robot import Robot
from fastmimic.stitching.transition import Layout


class StitchedProblem(Problem):
    """All parameters of a stitched motion's segments, scored in episodes of the whole motion."""

    def __init__(
        self,
        robot: Robot,
        demonstration: Motion,
        *,
        start: Mapping[str, float] | Sequence[Mapping[str, float]] | None = None,
        objective: Objective = Objective(),
        config: ControllerConfig = ControllerConfig(),
        group: str = FOOT_HEIGHT,
        workers: int | None = None,
        n_basis: int | None = None,
    ) -> None:
        """`demonstration` is from `stitch_motions`; `start` that of the search by parameter, or per segment, clipped to
        the bounds, unmodulated where it has no value; of `objective` the clearance rule holds per segment, and the
        duration is ignored; `group` is each segment's, one of `PARAMETER_GROUPS`. Raises `ConfigError` for fewer than
        one worker, no such group, or a start with other parameters, `MotionError` if the motion is not stitched."""
        self.layout = Layout.of(demonstration)
        self.steps = demonstration.n_samples - 1
        objective = replace(objective, duration_s=(demonstration.n_samples - 1) / demonstration.rate_hz)
        fits = [MotionDmp.fit(part, robot, n_basis) for part in demonstration.parts]
        self.segments = [
            ImitationProblem(robot, demonstration.parts[s.part], fits[s.part], group=group, config=config, workers=1)
            for s in self.layout.segments
        ]
        labels = [f"{i}:{s.name}/" for i, s in enumerate(self.layout.segments, start=1)]
        labelled = zip(labels, self.segments, strict=True)
        parameters = [replace(p, name=label + p.name) for label, problem in labelled for p in problem.parameters]
        super().__init__(robot, demonstration, parameters, objective=objective, config=config, workers=workers)
        if start is not None and not isinstance(start, Mapping):
            if len(start) != len(self.segments):
                raise ConfigError(f"the start is of {len(start)} segments; the motion has {len(self.segments)}")
            start = {label + name: v for label, own in zip(labels, start, strict=True) for name, v in own.items()}
        given = start or {}
        unknown = sorted(given.keys() - {p.name for p in parameters})
        if unknown:
            raise ConfigError(f"the start names {', '.join(unknown)}, which is not optimised here")
        values = np.array([float(given.get(p.name, p.initial)) for p in parameters])
        self.start = np.clip(values, *self.bounds)
        self.divisions = tuple(s.first for s in self.layout.segments[1:])
        self._table = reference_table(demonstration, robot)
        self._parts = [reference_table(part, robot) for part in demonstration.parts]
        self._trunk, self._feet = self.layout.trunk_weights(), self.layout.foot_weights()
        self._share = np.diff([0, *self.divisions, self.steps]) / self.steps
        self._clearance = segment_clearance(demonstration, robot.foot_radius, self.layout)

    def of_segments(self, x: Array) -> list[Array]:
        """Parameters (..., k) split by segment, (..., k_i)."""
        ends = np.cumsum([len(p.parameters) for p in self.segments])
        return np.split(x, ends[:-1], axis=-1)

    def motion(self, x: Array) -> Motion:
        """The reference motion of one candidate (k,); `provenance.stitch` holds its parameters."""
        table, demo = self.tables(x[None])[0], self.demonstration
        yaw = float(yaw_from_quat(demo.root_quat_wxyz[0]))
        own = zip(self.segments, self.of_segments(x), strict=True)
        stitch = replace(
            demo.provenance.stitched,
            parameters={p.name: float(v) for p, v in zip(self.parameters, x, strict=True)},
            dmp=tuple(problem.motion(part).provenance.dmp for problem, part in own),
        )
        return Motion(
            rate_hz=demo.rate_hz,
            root_pos_w=turned_about_z(table["root_pos"], yaw) + np.array([*demo.root_pos_w[0, :2], 0.0]),
            root_quat_wxyz=quat_multiply(quat_from_yaw(yaw)[None], table["root_quat"]),
            joint_pos=table["joint_pos"],
            joint_vel=table["joint_vel"],
            foot_pos_b=table["foot_pos"],
            contact=demo.contact,
            root_lin_vel_w=turned_about_z(table["lin_vel"], yaw),
            root_ang_vel_w=turned_about_z(table["ang_vel"], yaw),
            cycle=None,
            provenance=replace(demo.provenance, stitch=stitch),
            demonstration=demo,
        )

    def tables(self, x: Array) -> Records:
        tables = np.repeat(self._table[None], len(x), axis=0)
        feet = np.array(tables["foot_pos"])
        heading = yaw_from_quat(self._table["root_quat"])
        turn = np.zeros((*feet.shape[:2], 3))
        for i, (segment, own) in enumerate(zip(self.layout.segments, self.of_segments(x), strict=True)):
            problem, cycle = self.segments[i], self._parts[segment.part]
            at = (np.arange(self.layout.n) - segment.shift) % len(cycle)
            candidate = problem.tables(own)
            feet += self._feet[i][..., None] * (candidate["foot_pos"] - cycle["foot_pos"])[:, at]
            share = self._trunk[i][:, None]
            angle = heading - yaw_from_quat(cycle["root_quat"])[at]
            for name in ("root_pos", "lin_vel", "ang_vel"):
                tables[name] += share * turned_about_z((candidate[name] - cycle[name])[:, at], angle)
            change = quat_multiply(quat_conjugate(cycle["root_quat"])[None], candidate["root_quat"])
            turn += share * rotvec_from_quat(change)[:, at]
        tables["root_quat"] = quat_multiply(tables["root_quat"], quat_from_rotvec(turn))
        rate_hz = self.demonstration.rate_hz
        reached = foot_table(self.robot, feet, rate_hz, periodic=False)
        tables["foot_pos"], tables["joint_pos"], tables["joint_vel"] = reached[:3]
        for name, velocity in (("joint_acc", "joint_vel"), ("lin_acc", "lin_vel"), ("ang_acc", "ang_vel")):
            tables[name] = rate_of(tables[velocity], rate_hz, periodic=False)
        return tables

    def score(self, rollout: Rollout) -> Array:
        """Objective of each episode, (n,): mean over the segments, weighted by length."""
        total = np.zeros(len(rollout.reward))
        for part, share, wanted in zip(rollout.parts, self._share, self._clearance, strict=True):
            # an earlier fall leaves no clearance either
            fallen = replace(part, fell=part.fell | (rollout.fell & (part.steps == 0)))
            total += share * (part.reward - clearance_penalty(self.objective, fallen, wanted))
        return total


def make_problem(
    robot: Robot,
    motion: Motion,
    *,
    group: str = FOOT_HEIGHT,
    n_basis: int | None = None,
    **settings: Any,
) -> Problem:
    """The problem for a motion: its cycle, the whole of a motion that does not repeat, or all segments of a stitched
    one; `settings` are `objective`, `config` and `workers`. Raises `ConfigError` for no such group, and `MotionError`
    if DMPs cannot be fitted."""
    demonstration = motion.target
    if demonstration.cycle is None and demonstration.parts:
        own = motion.provenance.stitched.parameters or {}
        names = {name.rpartition("/")[2]: value for name, value in own.items()}
        group = needed_group(group, names)
        return StitchedProblem(robot, demonstration, start=own or None, group=group, n_basis=n_basis, **settings)
    dmp = MotionDmp.fit(demonstration, robot, n_basis)
    return ImitationProblem(robot, demonstration, dmp, group=group, **settings)


def parameters_of(motion: Motion) -> dict[str, float]:
    """Changed parameters of an optimised cyclic motion by name; empty for others."""
    dmp = motion.provenance.dmp
    if motion.demonstration is None or dmp is None:
        return {}
    found = {}
    for name, goal, fitted, amplitude in dmp.modulation():
        if goal != fitted:
            found[f"{name}.goal"] = goal
        if amplitude != 1.0:
            found[f"{name}.amplitude"] = amplitude
    return found


def segment_clearance(motion: Motion, foot_radius: float, layout: Layout) -> Array:
    """Mean swing clearance (s, 4) per segment of a stitched motion, m, of the swings that end in it; NaN without."""
    height = motion.foot_pos_w[..., 2] - foot_radius
    bounds = [s.last for s in layout.segments]
    total, count = np.zeros((len(bounds), 4)), np.zeros((len(bounds), 4))
    for leg in range(4):
        for end, top in swing_tops(motion.contact[:, leg], height[:, leg], periodic=False):
            segment = int(np.searchsorted(bounds, end, side="left"))
            total[segment, leg] += top
            count[segment, leg] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
