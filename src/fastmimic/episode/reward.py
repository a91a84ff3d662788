"""The imitation reward, termination, and counters (Peng et al. 2020; paper, §IV-A).

The reward compares the robot with the demonstration, never with the modulated reference that the controller follows.
Per step it lies in [0, 1]; the steps after a fall count 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import inlined, kernel, record_dtype
from fastmimic.base.registry import Registry
from fastmimic.base.vectors import quat_to_matrix
from fastmimic.robot.kinematics import leg_forward

TermFunction = Callable[[NDArray[Any], NDArray[Any]], Array]
"""From the due demonstration (n,) of `SAMPLE`, in the world frame, and the states (n,) of `OBSERVATION` of n robots:
the term (n,), each in [0, 1]. Called once per control step."""


@dataclass(frozen=True)
class RewardTerm:
    """A term of the reward: 1 where the robot does exactly what the demonstration does.

    Attributes:
        weight: positive. All weights are divided by their sum, so that the reward lies in [0, 1].
        about: what it compares.
        color, dash: of its line in charts; the lengths of dashes and gaps, in pixels.
        function: computes it; None for the compiled built-in ones.
    """

    name: str
    weight: float
    about: str = ""
    color: str = "#999999"
    dash: tuple[int, ...] = (1, 2)
    function: TermFunction | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.weight) and self.weight > 0):
            raise ConfigError(f"reward term '{self.name}': the weight must be positive, found {self.weight}")

    @property
    def label(self) -> str:
        return self.name.replace("_", " ")


_BUILT_IN = (  # colours of Okabe and Ito
    RewardTerm("pose", 0.25, "joint angles", "#0072b2", ()),
    RewardTerm("velocity", 0.05, "joint speeds", "#e69f00", (2, 3)),
    RewardTerm("end_effector", 0.1, "feet relative to the trunk", "#009e73", (8, 3)),
    RewardTerm("root_pose", 0.3, "position and orientation of the trunk", "#cc79a7", (8, 3, 2, 3)),
    RewardTerm("root_velocity", 0.3, "linear and angular velocity of the trunk", "#d55e00", (4, 3)),
)
TERMS: Final = tuple(term.name for term in _BUILT_IN)
WEIGHTS: Final = tuple(term.weight for term in _BUILT_IN)
N_TERMS: Final = len(TERMS)
REWARD_TERMS: Final = Registry("reward term", _BUILT_IN)
"""The paper's terms and the user's: `REWARD_TERMS.register(RewardTerm(…))`, before an episode begins."""


def reward_weights() -> Array:
    """(k,) weights of all terms, in the order of `REWARD_TERMS`; they sum to 1."""
    if len(REWARD_TERMS) == N_TERMS:
        return np.array(WEIGHTS)
    weights = np.array([term.weight for term in REWARD_TERMS.values()])
    return weights / weights.sum()


_HEIGHT_WEIGHT: Final = 3.0  # of the end-effector term's height, from the implementation the paper names
MAX_DISTANCE: Final = 1.0  # m from the reference
MAX_ANGLE: Final = np.pi / 2  # rad from the reference

TALLY: Final = record_dtype(
    [
        ("steps", "i8"),  # until the fall
        ("fallen", "i8"),
        ("terms", "f8", (N_TERMS,)),  # sums of the reward's terms
        ("reward_sum", "f8"),
        ("reward", "f8", (N_TERMS,)),  # the last step's terms
        ("foot_error_sq", "f8", (4, 3)),  # body frame, sums, m²
        ("peak", "f8", (4,)),  # greatest height of the foot in the swing under way, m
        ("clearance_sum", "f8", (4,)),
        ("swings", "i8", (4,)),
        ("was_swing", "i8", (4,)),
        ("slip", "f8", (4,)),  # path that the contact points of loaded feet slide in stance, sum, m
        ("stances", "i8", (4,)),
        ("foot_xy", "f8", (4, 2)),  # world, last step
        ("jump", "f8"),  # sum of the distances hidden by the synchronisation until the fall, m
        ("early_touchdowns", "i8"),  # until the fall
        ("qp_failures", "i8"),  # until the fall
    ]
)  # running sums of one robot's episode


@inlined
def _gaussian(scale: float, squared: float) -> float:
    return np.exp(-scale * squared)


class ScoringContext(NamedTuple):
    """Inputs of the scoring besides the robots' states.

    Attributes:
        table: (t,) of `SAMPLE`, the demonstration.
        geometry: (4, 12) leg geometry rows.
        foot_radius: m.
        threshold: vertical force above which a foot is loaded, N.
        dt: control step, s.
        work: (2, 3, 3) scratch.
    """

    table: NDArray[Any]
    geometry: Array
    foot_radius: float
    threshold: float
    dt: float
    work: Array


@kernel
def score_step(context: ScoringContext, clocks: Any, observations: Any, memories: Any, tallies: Any) -> None:
    """Scores the present state of all robots (records (n,)) against the demonstration and adds to their tallies."""
    for i in range(observations.shape[0]):
        if tallies[i].fallen == 0:
            tally, clock = tallies[i], clocks[i]
            # counters elsewhere keep counting after a fall
            tally.jump = clock.jump
            tally.early_touchdowns = memories[i].early_touchdowns
            tally.qp_failures = memories[i].qp_failures
            _score_robot(context, context.table[clock.sample], clock, observations[i], tally)


@kernel
def _score_robot(context: ScoringContext, ref: Any, clock: Any, obs: Any, tally: Any) -> None:
    rotation, reference = context.work[0], context.work[1]
    quat_to_matrix(obs.root_quat, rotation)
    quat_to_matrix(ref.root_quat, reference)
    c, s = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    for j in range(3):
        r0, r1 = reference[0, j], reference[1, j]
        reference[0, j], reference[1, j] = c * r0 - s * r1, s * r0 + c * r1

    pose = velocity = 0.0
    for j in range(12):
        d = ref.joint_pos[j] - obs.joint_pos[j]
        pose += d * d
        d = ref.joint_vel[j] - obs.joint_vel[j]
        velocity += d * d

    x = clock.origin[0] + c * ref.root_pos[0] - s * ref.root_pos[1] - obs.root_pos[0]
    y = clock.origin[1] + s * ref.root_pos[0] + c * ref.root_pos[1] - obs.root_pos[1]
    z = ref.root_pos[2] - obs.root_pos[2]
    trace = 0.0
    for a in range(3):
        for b in range(3):
            trace += rotation[a, b] * reference[a, b]
    angle = np.arccos(min(max(0.5 * (trace - 1.0), -1.0), 1.0))
    distance_sq = x * x + y * y + z * z
    vx = c * ref.lin_vel[0] - s * ref.lin_vel[1] - obs.lin_vel[0]
    vy = s * ref.lin_vel[0] + c * ref.lin_vel[1] - obs.lin_vel[1]
    vz = ref.lin_vel[2] - obs.lin_vel[2]
    wx = c * ref.ang_vel[0] - s * ref.ang_vel[1] - obs.ang_vel[0]
    wy = s * ref.ang_vel[0] + c * ref.ang_vel[1] - obs.ang_vel[1]
    wz = ref.ang_vel[2] - obs.ang_vel[2]

    linear_sq, angular_sq = vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz

    valid = np.isfinite(pose + velocity + distance_sq + trace + linear_sq + angular_sq)
    upright = distance_sq < MAX_DISTANCE * MAX_DISTANCE and angle < MAX_ANGLE
    if not valid or not upright or obs.other_contact > 0.5:
        tally.fallen = 1
        return
    feet = _score_feet(context, ref, obs, tally, rotation, reference)
    tally.reward[0] = _gaussian(5.0, pose)
    tally.reward[1] = _gaussian(0.1, velocity)
    tally.reward[2] = _gaussian(40.0, feet)
    tally.reward[3] = np.exp(-20.0 * distance_sq - 10.0 * angle * angle)
    tally.reward[4] = np.exp(-2.0 * linear_sq - angular_sq)
    for k in range(N_TERMS):
        tally.terms[k] += tally.reward[k]
        tally.reward_sum += WEIGHTS[k] * tally.reward[k]
    tally.steps += 1


@inlined
def _score_feet(context: ScoringContext, ref: Any, obs: Any, tally: Any, rotation: Array, reference: Array) -> float:
    """Squared end-effector error, relative to the root in each one's heading frame, height in the world, m²."""
    total, foot_radius, dt = 0.0, context.foot_radius, context.dt
    yaw, yaw_ref = np.arctan2(rotation[1, 0], rotation[0, 0]), np.arctan2(reference[1, 0], reference[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    cr, sr = np.cos(yaw_ref), np.sin(yaw_ref)
    for leg in range(4):
        q = obs.joint_pos[3 * leg : 3 * leg + 3]
        px, py, pz = leg_forward(context.geometry[leg], q[0], q[1], q[2])
        rx, ry, rz = ref.foot_pos[leg, 0], ref.foot_pos[leg, 1], ref.foot_pos[leg, 2]
        tally.foot_error_sq[leg, 0] += (px - rx) ** 2
        tally.foot_error_sq[leg, 1] += (py - ry) ** 2
        tally.foot_error_sq[leg, 2] += (pz - rz) ** 2
        wx = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz
        wy = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz
        height = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + obs.root_pos[2]
        ux = reference[0, 0] * rx + reference[0, 1] * ry + reference[0, 2] * rz
        uy = reference[1, 0] * rx + reference[1, 1] * ry + reference[1, 2] * rz
        height_ref = reference[2, 0] * rx + reference[2, 1] * ry + reference[2, 2] * rz + ref.root_pos[2]
        dx = (c * wx + s * wy) - (cr * ux + sr * uy)
        dy = (-s * wx + c * wy) - (-sr * ux + cr * uy)
        dz = height - height_ref
        total += dx * dx + dy * dy + _HEIGHT_WEIGHT * dz * dz
        # the sphere rolls: its centre moves on by ω × r without any slip
        pitching = obs.joint_vel[3 * leg + 1] + obs.joint_vel[3 * leg + 2]
        ex, ey, ez = obs.joint_vel[3 * leg], pitching * np.cos(q[0]), pitching * np.sin(q[0])
        turn_x = obs.ang_vel[0] + rotation[0, 0] * ex + rotation[0, 1] * ey + rotation[0, 2] * ez
        turn_y = obs.ang_vel[1] + rotation[1, 0] * ex + rotation[1, 1] * ey + rotation[1, 2] * ez
        loaded = obs.foot_force[leg, 2] > context.threshold
        x, y = obs.root_pos[0] + wx, obs.root_pos[1] + wy
        roll_x, roll_y = foot_radius * turn_y * dt, -foot_radius * turn_x * dt
        _count_foot(tally, leg, ref.contact[leg] == 1, loaded, height - foot_radius, x, y, roll_x, roll_y)
    return total


@inlined
def _count_foot(
    tally: Any, leg: int, wanted: bool, loaded: bool, height: float, x: float, y: float, roll_x: float, roll_y: float
) -> None:
    """Swing clearance by the demonstration's schedule, and the sliding of loaded feet in scheduled stance."""
    if wanted:
        if tally.was_swing[leg] == 1:
            tally.clearance_sum[leg] += tally.peak[leg]
            tally.swings[leg] += 1
            tally.stances[leg] += 1
        if loaded and tally.steps > 0:
            tally.slip[leg] += np.hypot(x - tally.foot_xy[leg, 0] - roll_x, y - tally.foot_xy[leg, 1] - roll_y)
        tally.was_swing[leg] = 0
    else:
        if tally.was_swing[leg] == 0:
            tally.peak[leg] = height
        tally.was_swing[leg] = 1
        tally.peak[leg] = max(tally.peak[leg], height)
    tally.foot_xy[leg, 0], tally.foot_xy[leg, 1] = x, y
