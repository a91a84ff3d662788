"""A linear-quadratic regulator along a reference motion: feedback of trunk and footholds, from one cost.

The state are deviations from the reference, in its heading frame: of the trunk, position e and orientation θ (a
rotation vector) with their velocities, and of each foot its horizontal place s on the ground and how fast it moves.
About the reference the robot is one body on massless legs, whose feet push back when they are moved (m_l in the air):

    m ë = Σ δf − Σ m_l s̈,    I θ̈ = Σ r × δf + Σ (s − e) × f̄ − Σ r_l × m_l s̈

with the forces f̄ of the reference, their change δf on the feet that stand, and s̈ of those that swing; a foot that
stands keeps its place. So the regulator knows by the contact schedule which forces there will be, which way a robot on
two feet can only fall, and where the next foothold has to be: the capture point is its special case (Pratt et al.
2006). The gains are those of the Riccati equation backwards along the motion (Anderson & Moore 1990, ch. 2), for a
cycle until they repeat. The forces that the QP cannot give are weighed by the cost of what follows from them: its
weight is Bᵀ P B with the cost-to-go P (Kuindersma et al. 2014).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import floats, record_dtype
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, quat_rotate, turned_about_z, yaw_from_quat
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.table import GAIN_SAMPLES, once, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.robot import mass_ratio

STATES: Final = 28  # of the trunk: position, rotation, their velocities; of the feet: x and y of four, their velocities
_FOOT: Final = np.arange(8)  # x and y of each
FEET, RATES = 12, 20  # where the places and the velocities of the feet begin
_LOOK_S: Final = 3.0  # a cycle is followed for at least so long, until its gains repeat
_LEAST_LOAD: Final = 0.1  # what a foot counts at least
_END: Final = 0.3  # share of the cost at the end of a motion that does not repeat, s

GAINS: Final = record_dtype(floats(trunk=(6, STATES), weight=(6, 6), feet=(8, STATES), landing=(), side=()))
"""Gains in the heading frame: desired acceleration of the trunk (m/s², rad/s²) and of the swinging feet (m/s²), each
minus the gain times the state; the weight of what is missing of the former, relative to `linear_cost`; the time until
feet touch down next, s, 0 if none does, and their side: from −1, all on the right, to 1."""


@once
def motion_gains(motion: Motion, robot: Robot, config: RegulatorConfig) -> Records:
    """`regulator_gains` (g,) of a motion's demonstration."""
    turn = None if motion.cycle is None else float(motion.cycle[2])
    return regulator_gains(reference_table(motion, robot), robot, config, motion.dt, turn)


def regulator_gains(table: Records, robot: Robot, config: RegulatorConfig, dt: float, turn: float | None) -> Records:
    """Gains (g,) of `GAINS` along a table (t,) of `SAMPLE` with samples `dt` s apart, one for each `GAIN_SAMPLES` of
    them; `turn` is the turn of a period, rad, None if the motion does not repeat."""
    model = _Model(table, robot, config, dt, turn)
    n = len(model.step)
    gains = np.zeros(n, GAINS)
    stands, side = table[::GAIN_SAMPLES]["contact"] == 1, np.sign(robot.hip_pos_b[:, 1])
    gains["landing"], gains["side"] = _until_landing(stands, model.step, turn is not None, side)
    end = _state_cost(config)
    value, rounds = _END * end, 1
    if turn is not None:
        rounds = 1 + int(np.ceil(_LOOK_S / model.step.sum()))
    linear = np.diag([config.linear_cost] * 3 + [config.angular_cost] * 3)
    for last in (*[False] * (rounds - 1), True):
        for k in range(n - 1, -1, -1):
            h, a, b = model.step[k], model.state[k], model.control[k]
            ahead = value @ b
            gain = np.linalg.solve(model.cost[k] + b.T @ ahead, ahead.T @ a)
            closed = a - b @ gain
            if last:
                by_trunk = _turns(model.turn[k : k + 1])[0] @ _by_trunk(h)
                weight = linear + by_trunk.T @ value @ by_trunk / h
                then = a - b[:, 12:] @ gain[12:]
                gains[k]["trunk"] = np.linalg.solve(weight, by_trunk.T @ value @ then / h)
                gains[k]["weight"], gains[k]["feet"] = weight / config.linear_cost, gain[12:]
            value = h * end + closed.T @ value @ closed + gain.T @ model.cost[k] @ gain
            value = 0.5 * (value + value.T)
            value[RATES + _FOOT, RATES + _FOOT] += model.landing[k]
    return gains


def _until_landing(stands: NDArray[np.bool_], step: Array, periodic: bool, side: Array) -> tuple[Array, Array]:
    """Time (n,) until feet touch down next, s, 0 if none does; and on which side they are (n,): 1 all on the left."""
    n = len(stands)
    lands = np.asarray(np.any(stands & ~np.roll(stands, 1, axis=0), axis=1))
    lands[0] &= periodic
    landings = np.flatnonzero(np.concatenate([lands, lands & periodic]))
    time = np.cumsum(np.concatenate([[0.0], step, step]))
    following = np.searchsorted(landings, np.arange(n), side="right")
    known = following < len(landings)
    found, sides = np.zeros(n), np.zeros(n)
    found[known] = time[landings[following[known]]] - time[:n][known]
    at = landings[following[known]] % n
    swings = ~stands[at - 1] & stands[at]
    sides[known] = (swings * side).sum(axis=1) / swings.sum(axis=1)
    return found, sides


def _state_cost(config: RegulatorConfig) -> Array:
    weights = (config.position_weight, config.rotation_weight, config.velocity_weight, config.turning_weight)
    cost = np.diag(np.concatenate([*weights, np.full(STATES - FEET, 1e-9)]))
    for foot in range(8):
        apart = np.zeros(STATES)
        apart[FEET + foot], apart[foot % 2] = 1.0, -1.0
        cost += config.foothold_weight * np.outer(apart, apart)
    return cost


def _by_trunk(h: float) -> Array:
    """Change (28, 6) of the state after h s by the trunk's acceleration."""
    return np.concatenate([h * h * np.eye(6), h * np.eye(6), np.zeros((STATES - 12, 6))])


def _cross(v: Array) -> Array:
    """Matrices (…, 3, 3) of v × (.)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


class _Model:
    """The linear model at n nodes: x⁺ = state (n, 28, 28) x + control (n, 28, 20) u, with the changes u of the four
    feet's forces (12), in N, and of their accelerations (8); `step` (n,) in s, `cost` (n, 20, 20) of u, `landing` (n,
    8) of the feet's velocities, `turn` (n,) from the next node's heading to this one's, rad."""

    def __init__(self, table: Records, robot: Robot, config: RegulatorConfig, dt: float, turn: float | None) -> None:
        node = table[::GAIN_SAMPLES]
        n = len(node)
        self.step = np.full(n, GAIN_SAMPLES * dt)
        self.step[-1] = (len(table) - GAIN_SAMPLES * (n - 1)) * dt
        h = self.step[:, None, None]
        yaw = np.unwrap(yaw_from_quat(node["root_quat"]))
        following = np.append(yaw[1:], yaw[-1] if turn is None else yaw[0] + turn)
        level = quat_multiply(quat_from_yaw(-yaw), node["root_quat"])
        stands = node["contact"] == 1
        after = np.concatenate([stands[1:], stands[-1:] if turn is None else stands[:1]])

        rotation = np.stack([quat_rotate(level, np.broadcast_to(axis, (n, 3))) for axis in np.eye(3)], axis=-1)
        inverse = np.linalg.inv(rotation @ robot.inertia_b @ np.swapaxes(rotation, 1, 2))
        arm = quat_rotate(level[:, None], node["foot_pos"] - robot.com_b) - np.array([0.0, 0.0, robot.foot_radius])
        load = _load(stands, turn is not None, self.step[0], config)
        by_force = np.zeros((n, 6, 12))
        for leg in range(4):
            part = slice(3 * leg, 3 * leg + 3)
            by_force[:, :3, part], by_force[:, 3:, part] = np.eye(3) / robot.mass, inverse @ _cross(arm[:, leg])
        share = np.repeat(load * stands, 3, axis=1)
        wanted = [turned_about_z(node[f"{name}_acc"] + node[f"leg_{name}_acc"], -yaw) for name in ("lin", "ang")]
        wanted[0][:, 2] += GRAVITY
        # the reference's forces: the least, for feet that are loaded
        by_wanted = np.linalg.pinv(by_force * share[:, None], rcond=1e-4)
        force = np.einsum("nfr,nr->nf", by_wanted, np.concatenate(wanted, axis=1))
        force = _cross((share * force).reshape(n, 4, 3))
        by_force *= np.repeat(stands, 3, axis=1)[:, None]

        by_feet = np.zeros((n, 6, 8))
        mass = config.leg_mass * mass_ratio(robot)
        half = arm * np.array([1.0, 1.0, 0.5])
        drift = np.zeros((n, 6, STATES))  # accelerations by the state
        for leg in range(4):
            swings = (mass * ~stands[:, leg])[:, None, None]
            part = slice(2 * leg, 2 * leg + 2)
            by_feet[:, :3, part] = -swings / robot.mass * np.eye(3)[:, :2]
            by_feet[:, 3:, part] = -swings * (inverse @ _cross(half[:, leg]))[..., :2]
            moment = inverse @ force[:, leg]
            drift[:, 3:, :3] += moment
            drift[:, 3:, FEET + 2 * leg : FEET + 2 * leg + 2] -= moment[..., :2]

        a = np.tile(np.eye(STATES), (n, 1, 1))
        a[:, 6:12] += h * drift
        a[:, :6] += h * a[:, 6:12]
        a[:, 3:6, 3:6] += h * _cross(turned_about_z(node["ang_vel"], -yaw))
        by_trunk = np.stack([_by_trunk(step) for step in self.step])
        b = by_trunk @ np.concatenate([by_force, by_feet], axis=2)
        moves, lands = np.repeat(~stands, 2, axis=1), np.repeat(~stands & after, 2, axis=1)
        a[:, FEET + _FOOT, RATES + _FOOT] = self.step[:, None] * moves
        a[:, RATES + _FOOT, RATES + _FOOT] = moves & ~lands
        b[:, FEET + _FOOT, 12 + _FOOT] = self.step[:, None] ** 2 * moves
        b[:, RATES + _FOOT, 12 + _FOOT] = self.step[:, None] * (moves & ~lands)
        self.turn = yaw - following
        self.state, self.control = _turns(self.turn) @ a, _turns(self.turn) @ b

        self.landing = config.landing_weight * lands
        acceleration = np.diag([config.linear_cost] * 3 + [config.angular_cost] * 3)
        each = config.force_cost / (robot.mass * GRAVITY) ** 2 / np.repeat(load, 3, axis=1) ** 2
        self.cost = np.zeros((n, 20, 20))
        self.cost[:, :12, :12] = np.swapaxes(by_force, 1, 2) @ acceleration @ by_force + each[:, None] * np.eye(12)
        self.cost[:, 12:, 12:] = config.foot_cost * np.eye(8)
        self.cost *= h


def _turns(angle: Array) -> Array:
    """Matrices (n, 28, 28) that turn the state by angles (n,) about z."""
    out = np.tile(np.eye(STATES), (len(angle), 1, 1))
    c, s = np.cos(angle), np.sin(angle)
    for at in (0, 3, 6, 9, *range(FEET, STATES, 2)):
        out[:, at, at], out[:, at, at + 1], out[:, at + 1, at], out[:, at + 1, at + 1] = c, -s, s, c
    return out


def _load(stands: NDArray[np.bool_], periodic: bool, step: float, config: RegulatorConfig) -> Array:
    """How much each foot counts (n, 4): less just after it lands and before it lifts off."""
    n = len(stands)
    wide = np.concatenate([stands] * 3) if periodic else stands
    index = np.arange(len(wide))[:, None]
    before = np.maximum.accumulate(np.where(wide, -len(wide), index))
    after = np.minimum.accumulate(np.where(wide, 2 * len(wide), index)[::-1])[::-1]
    nodes = np.minimum(index - before, after - index)
    return np.clip((nodes[n : 2 * n] if periodic else nodes) * step / config.loading_s, _LEAST_LOAD, 1.0)
