"""The constraints and the cost of one node, with exact first and second derivatives."""

from collections import namedtuple
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numba import config as numba_config
from numpy.typing import NDArray

from fastmimic.base.conventions import GRAVITY
from fastmimic.robot import Robot
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.solved import Remembered
from fastmimic.trajectory.symbolic import Expression, feet_in_world, instant, rotation
from fastmimic.trajectory.tape import Tape, tape_of


def _slices(sizes: dict[str, int]) -> dict[str, slice]:
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(ends[i], ends[i + 1]) for i, name in enumerate(sizes)}


VARIABLES: Final = _slices(
    {"before": 18, "here": 18, "after": 18, "force": 12, "duration_before": 1, "duration": 1, "holds": 8, "stride": 1}
)
"""Variables of a node: coordinates before, here and after; forces in multiples of the weight; durations of the modes of
the two intervals, s; the feet's footholds (x, y), m; the distance that a cycle covers, share of the animal's."""

GIVEN: Final = _slices(
    {
        "share_before": 1,
        "share": 1,
        "lap_before": 5,
        "lap_after": 5,
        "lap_holds": 16,
        "loaded": 4,
        "capture": 4,
        "calf": 4,
        "origin": 2,
        "position": 3,
        "angles": 3,
        "joints": 12,
        "velocity": 3,
        "angle_rates": 3,
        "joint_rates": 12,
        "feet": 12,
        "weight": 1,
    }
)
"""Parameters of a node: shares of the modes' durations; for neighbours in another period and for footholds cosine, sine
and displacement of these periods (for coordinates yaw as well); 1 for feet that may push; the capture point's
margins, m; each calf's mean angle, from which its foot's rolling counts, rad; where the stride counts from, and the
animal's motion (its x and y from there; feet from the base in the heading frame, their z in the world); the node's
weight in the cost: its share of the motion's duration."""

ROWS: Final = _slices(
    {
        "dynamics": 6,
        "feet": 12,
        "torque": 12,
        "driving": 24,
        "speed": 12,
        "friction": 16,
        "knees": 4,
        "apart": 4,
        "turning": 3,
    }
)
"""Constraint rows of a node, each about 1 at its limit: missing wrench; feet against their footholds, m × 10 (z above
the ground); torque, and torque and speed together, share of the limits; speed; friction pyramid; heights of the knees
and distances of legs, m × 10; accelerations of roll, pitch and yaw."""

N_VARIABLES: Final = VARIABLES["stride"].stop
N_GIVEN: Final = GIVEN["weight"].stop
N_ROWS: Final = ROWS["turning"].stop
METRES: Final = 10.0  # scale of rows in metres


@dataclass(frozen=True, eq=False)
class NodeFunctions:
    """Functions of a node's variables (77,) and parameters: CasADi's, and tapes of the derivatives. The entries of the
    sparse ones are dense vectors, whose places are in `jacobian_at` and `hessian_at` (upper triangle): rows and
    columns, (2, k)."""

    rows: Any
    cost: Any
    gradient: Any
    jacobian: Any
    hessian: Any
    jacobian_at: NDArray[np.int_]
    hessian_at: NDArray[np.int_]


_Used = namedtuple(
    "_Used",
    "torque_share friction turn_rad_per_s2 capture_weight force_weight vertical_weight acceleration_weight"
    " angular_acceleration_weight joint_acceleration_weight foot_acceleration_weight",
)
"""What the functions depend on of the configuration."""
_TAPES: Final = ("gradient", "jacobian", "hessian")


def node_functions(robot: Robot, config: TrajectoryConfig) -> NodeFunctions:
    """The functions for a robot. Making them takes two seconds: they are kept in the user's cache folder. Without the
    JIT the derivatives are CasADi's."""
    return _kept(robot, _Used(*(getattr(config, name) for name in _Used._fields)))


@lru_cache(maxsize=8)
def _kept(robot: Robot, used: _Used) -> NodeFunctions:
    import casadi as ca

    if numba_config.DISABLE_JIT:  # type: ignore[attr-defined]
        return casadi_functions(robot, used)
    known = Remembered(f"a node of {robot.said}", [np.array(used)])
    found: dict[str, Any] | None = known.read()
    if found is None:
        made = casadi_functions(robot, used)
        found = {name: np.array(getattr(made, name).serialize()) for name in ("rows", "cost")}
        found |= {name: getattr(made, name) for name in ("jacobian_at", "hessian_at")}
        for name in _TAPES:
            found |= {f"{name} {part}": np.array(a) for part, a in tape_of(getattr(made, name))._asdict().items()}
        known.keep(found, packaged=False)
    rows, cost = (ca.Function.deserialize(str(found[name])) for name in ("rows", "cost"))
    gradient, jacobian, hessian = (Tape(*(found[f"{name} {part}"] for part in Tape._fields)) for name in _TAPES)
    return NodeFunctions(rows, cost, gradient, jacobian, hessian, found["jacobian_at"], found["hessian_at"])


def casadi_functions(robot: Robot, used: _Used | TrajectoryConfig) -> NodeFunctions:
    """All functions as CasADi makes them."""
    import casadi as ca

    z, p = ca.SX.sym("z", N_VARIABLES), ca.SX.sym("p", N_GIVEN)
    rows, cost = _expressions(robot, used, z, p)
    multipliers, factor = ca.SX.sym("multipliers", N_ROWS), ca.SX.sym("factor")
    jacobian = ca.jacobian(rows, z)
    hessian = ca.triu(ca.hessian(factor * cost + ca.dot(multipliers, rows), z)[0])

    def entries(matrix: Expression) -> Expression:
        return ca.densify(ca.vertcat(*matrix.nonzeros()))

    def places(matrix: Expression) -> NDArray[np.int_]:
        return np.array([matrix.sparsity().row(), matrix.sparsity().get_col()])

    return NodeFunctions(
        rows=ca.Function("rows", [z, p], [rows]),
        cost=ca.Function("cost", [z, p], [cost]),
        gradient=ca.Function("gradient", [z, p], [ca.densify(ca.gradient(cost, z))]),
        jacobian=ca.Function("jacobian", [z, p], [entries(jacobian)]),
        hessian=ca.Function("hessian", [z, p, factor, multipliers], [entries(hessian)]),
        jacobian_at=places(jacobian),
        hessian_at=places(hessian),
    )


def _expressions(robot: Robot, config: Any, z: Expression, p: Expression) -> tuple[Expression, Expression]:
    """Constraint rows and cost."""
    import casadi as ca

    v = {name: z[part] for name, part in VARIABLES.items()}
    g = {name: p[part] for name, part in GIVEN.items()}
    here, force, stride = v["here"], v["force"], v["stride"]
    before = _moved(v["before"], g["lap_before"], stride)
    after = _moved(v["after"], g["lap_after"], stride)
    dt_before, dt = v["duration_before"] * g["share_before"], v["duration"] * g["share"]
    arriving, leaving = (here - before) / dt_before, (after - here) / dt
    velocity = (dt * arriving + dt_before * leaving) / (dt_before + dt)
    acceleration = 2 * (leaving - arriving) / (dt_before + dt)
    weight = robot.mass * GRAVITY
    pushing = weight * force * ca.vertcat(*(g["loaded"][leg] for leg in range(4) for _ in range(3)))
    now = instant(robot, here, velocity, acceleration, pushing)

    scale = ca.DM([1 / weight] * 3 + (0.1 / (GRAVITY * robot.inertia_b.diagonal())).tolist())
    feet = []
    for leg in range(4):
        hold = _planar(v["holds"][2 * leg : 2 * leg + 2], g["lap_holds"][4 * leg : 4 * leg + 4], stride)
        foot = now.feet[3 * leg : 3 * leg + 3]
        joint = here[6 + 3 * leg : 9 + 3 * leg]
        turned = ca.vertcat(here[4] + joint[1] + joint[2] - g["calf"][leg], -here[3] - joint[0])
        rolled = robot.foot_radius * (rotation(2, here[5])[:2, :2] @ turned)
        feet += [foot[:2] - rolled - hold, foot[2] - robot.foot_radius]
    torque = now.torque / ca.DM(config.torque_share * robot.torque_limit)
    before_and_after = [rate[6:] / ca.DM(robot.joint_speed_limit) for rate in (arriving, leaving)]
    pyramid = []
    for leg in range(4):
        x, y, up = (force[3 * leg + j] for j in range(3))
        pyramid += [config.friction * up - x, config.friction * up + x]
        pyramid += [config.friction * up - y, config.friction * up + y]
    rows = ca.vertcat(
        now.wrench * scale,
        METRES * ca.vertcat(*feet),
        torque,
        *(torque + 2 * fast for fast in before_and_after),
        before_and_after[1],
        *pyramid,
        METRES * now.knees,
        METRES * now.apart,
        acceleration[3:6] / config.turn_rad_per_s2,
    )

    # the imitation reward's terms for small errors, and what keeps the solution smooth
    animal_xy = g["origin"] + stride * g["position"][:2]
    off = ca.vertcat(here[:2] - animal_xy, here[2] - g["position"][2])
    moving = velocity[:3] - g["velocity"]
    end_effectors = 0
    for leg in range(4):
        level, animal = now.feet_level[3 * leg : 3 * leg + 2], g["feet"][3 * leg : 3 * leg + 3]
        end_effectors += ca.sumsqr(level - animal[:2]) + 3 * (now.feet[3 * leg + 2] - animal[2]) ** 2
    imitation = (
        0.25 * 5 * ca.sumsqr(here[6:] - g["joints"])
        + 0.05 * 0.1 * ca.sumsqr(velocity[6:] - g["joint_rates"])
        + 0.1 * 40 * end_effectors
        + 0.3 * (20 * ca.sumsqr(off) + 10 * ca.sumsqr(here[3:6] - g["angles"]))
        + 0.3 * (2 * ca.sumsqr(moving) + ca.sumsqr(velocity[3:6] - g["angle_rates"]))
    )
    paths = (feet_in_world(robot, q) for q in (before, here, after))
    foot_before, foot_here, foot_after = paths
    foot_acceleration = 2 * ((foot_after - foot_here) / dt - (foot_here - foot_before) / dt_before) / (dt_before + dt)
    sideways = -ca.sin(here[5]) * velocity[0] + ca.cos(here[5]) * velocity[1]
    height = 0.5 * (here[2] + ca.sqrt(here[2] ** 2 + 1e-4))  # positive, wherever the solver looks
    beyond = 0  # squared distance from the margins; smooth over 1 cm, so that it begins before them
    for leg in range(4):
        side = float(np.sign(robot.hip_pos_b[leg, 1]))
        inside = side * (now.feet_level[3 * leg + 1] - sideways * ca.sqrt(height / GRAVITY))
        short = g["capture"][leg] - inside
        beyond += (0.5 * (short + ca.sqrt(short**2 + 0.01**2))) ** 2
    smooth = (
        config.capture_weight * beyond
        + config.force_weight * ca.sumsqr(force)
        + config.vertical_weight * (20 * off[2] ** 2 + 2 * moving[2] ** 2)
        + config.acceleration_weight * ca.sumsqr(acceleration[:3])
        + config.angular_acceleration_weight * ca.sumsqr(acceleration[3:6])
        + config.joint_acceleration_weight * ca.sumsqr(acceleration[6:])
        + config.foot_acceleration_weight * ca.sumsqr(foot_acceleration)
    )
    return rows, g["weight"] * (imitation + smooth)


def _planar(xy: Expression, lap: Expression, stride: Expression) -> Expression:
    """A point (2,) of another period: turned by cosine and sine, moved by the displacement × `stride`."""
    import casadi as ca

    c, s = lap[0], lap[1]
    return ca.vertcat(c * xy[0] - s * xy[1], s * xy[0] + c * xy[1]) + stride * lap[2:4]


def _moved(q: Expression, lap: Expression, stride: Expression) -> Expression:
    import casadi as ca

    return ca.vertcat(_planar(q[:2], lap, stride), q[2:5], q[5] + lap[4], q[6:])
