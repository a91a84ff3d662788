"""The imitation reward, termination, and counters (Peng et al. 2020; paper, §IV-A).

The reward compares the robot with the demonstration, never with the modulated reference that the controller follows.
Per step it lies in [0, 1]; the steps after a fall count 0.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError, check_positive
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.registry import Registry
from fastmimic.base.rotations import turned_about_z
from fastmimic.base.vectors import quat_to_matrix, turn_rows, turned
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.tracking_errors import TRACKING_SUMS, count_tracking
from fastmimic.reference.table import in_world, world_root
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import leg_forward

TermFunction = Callable[[Records, Records], Array]
"""From the due demonstration (n,) of `SAMPLE`, in the world frame, and the states (n,) of `OBSERVATION` of n robots:
the term (n,), each in [0, 1]. Called once per control step."""


@dataclass(frozen=True)
class RewardTerm:
    """A term of the reward: 1 where the robot does exactly what the demonstration does."""

    name: str
    weight: float  # positive; all weights are divided by their sum, so that the reward lies in [0, 1]
    about: str = ""  # what it compares
    color: str = "#999999"  # of its line in charts
    dash: tuple[int, ...] = (1, 2)  # of that line: lengths of dashes and gaps, in pixels
    function: TermFunction | None = None  # computes it; None for the compiled built-in ones

    def __post_init__(self) -> None:
        check_positive(self.weight, f"reward term '{self.name}': the weight")

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
_NO_SWING, _WHOLE_SWING, _CUT_SWING = range(3)  # what a foot was in; the episode began in a swing that is cut

TALLY: Final = record_dtype(
    [
        *integers(steps=(), fallen=()),  # steps until the fall
        *floats(terms=N_TERMS, reward_sum=(), reward=N_TERMS),  # sums of the reward's terms; the last step's terms
        *floats(foot_error_sq=(4, 3)),  # body frame, sums, m²
        # greatest height of the foot in the swing under way, m, and sums of it
        *floats(peak=4, clearance_sum=4),
        *integers(swings=4, was_swing=4),
        *floats(slip=4),  # path that the contact points of loaded feet slide in stance, sum, m
        *integers(stances=4),
        *floats(foot_xy=(4, 2)),  # world, last step
        *floats(jump=()),  # sum of the distances hidden by the synchronisation until the fall, m
        *integers(early_touchdowns=(), qp_failures=()),  # until the fall
        *TRACKING_SUMS,
    ]
)  # running sums of one robot's episode


class ScoringContext(NamedTuple):
    """Inputs of the scoring besides the robots' states: the demonstration's `table` (t,) of `SAMPLE`, the legs'
    `geometry` (4, 12), the feet's radius, m, the vertical force above which one is loaded, N, the control step, s, and
    scratch memory (3, 3, 3)."""

    table: Records
    geometry: Array
    foot_radius: float
    threshold: float
    dt: float
    work: Array


@kernel
def score_step(
    context: ScoringContext, clocks: Any, observations: Any, truths: Any, memories: Any, tallies: Any
) -> None:
    """Scores the present state of all robots (records (n,)) against the demonstration and adds to their tallies.
    `observations` are as seen from the ground (`GroundPlane.seen`), `truths` in the world: the same on level ground."""
    for i in range(observations.shape[0]):
        if tallies[i].fallen == 0:
            tally, clock = tallies[i], clocks[i]
            # counters elsewhere keep counting after a fall
            tally.jump = clock.jump
            tally.early_touchdowns = memories[i].early_touchdowns
            tally.qp_failures = memories[i].qp_failures
            _score_robot(context, context.table[clock.sample], clock, observations[i], truths[i], tally)


@kernel
def _score_robot(context: ScoringContext, ref: Any, clock: Any, obs: Any, truth: Any, tally: Any) -> None:
    rotation, reference = context.work[0], context.work[1]
    quat_to_matrix(obs.root_quat, rotation)
    quat_to_matrix(ref.root_quat, reference)
    c, s = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    turn_rows(c, s, reference)

    pose = velocity = 0.0
    for j in range(12):
        d = ref.joint_pos[j] - obs.joint_pos[j]
        pose += d * d
        d = ref.joint_vel[j] - obs.joint_vel[j]
        velocity += d * d

    x, y = in_world(clock, ref.root_pos)
    x, y, z = x - obs.root_pos[0], y - obs.root_pos[1], ref.root_pos[2] - obs.root_pos[2]
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
    count_tracking(context, ref, clock, obs, tally, (x, y, z, angle, velocity))
    feet = _score_feet(context, ref, obs, truth, tally)
    tally.reward[0] = np.exp(-5.0 * pose)
    tally.reward[1] = np.exp(-0.1 * velocity)
    tally.reward[2] = np.exp(-40.0 * feet)
    tally.reward[3] = np.exp(-20.0 * distance_sq - 10.0 * angle * angle)
    tally.reward[4] = np.exp(-2.0 * linear_sq - angular_sq)
    for k in range(N_TERMS):
        tally.terms[k] += tally.reward[k]
        tally.reward_sum += WEIGHTS[k] * tally.reward[k]
    tally.steps += 1


@inlined
def _score_feet(context: ScoringContext, ref: Any, obs: Any, truth: Any, tally: Any) -> float:
    """Squared end-effector error, relative to the root in each one's heading frame, height over the ground, m²."""
    total, foot_radius, dt = 0.0, context.foot_radius, context.dt
    rotation, reference, world = context.work[0], context.work[1], context.work[2]
    quat_to_matrix(truth.root_quat, world)
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
        wx, wy, wz = turned(rotation, px, py, pz)
        ux, uy, uz = turned(reference, rx, ry, rz)
        height = wz + obs.root_pos[2]
        dx = (c * wx + s * wy) - (cr * ux + sr * uy)
        dy = (-s * wx + c * wy) - (-sr * ux + cr * uy)
        dz = height - (uz + ref.root_pos[2])
        total += dx * dx + dy * dy + _HEIGHT_WEIGHT * dz * dz
        # the sphere rolls: its centre moves on by ω × r without any slip
        pitching = obs.joint_vel[3 * leg + 1] + obs.joint_vel[3 * leg + 2]
        ex, ey, ez = obs.joint_vel[3 * leg], pitching * np.cos(q[0]), pitching * np.sin(q[0])
        turn_x = truth.ang_vel[0] + world[0, 0] * ex + world[0, 1] * ey + world[0, 2] * ez
        turn_y = truth.ang_vel[1] + world[1, 0] * ex + world[1, 1] * ey + world[1, 2] * ez
        loaded = obs.foot_force[leg, 2] > context.threshold
        x, y, _ = turned(world, px, py, pz)
        x, y = truth.root_pos[0] + x, truth.root_pos[1] + y
        roll_x, roll_y = foot_radius * turn_y * dt, -foot_radius * turn_x * dt
        _count_foot(tally, leg, ref.contact[leg] == 1, loaded, height - foot_radius, x, y, roll_x, roll_y)
    return total


@inlined
def _count_foot(
    tally: Any, leg: int, wanted: bool, loaded: bool, height: float, x: float, y: float, roll_x: float, roll_y: float
) -> None:
    """Swing clearance by the demonstration's schedule, and the sliding of loaded feet in scheduled stance. A swing that
    the episode's start cuts off does not count: its top may have been before."""
    if wanted:
        if tally.was_swing[leg] == _WHOLE_SWING:
            tally.clearance_sum[leg] += tally.peak[leg]
            tally.swings[leg] += 1
        if tally.was_swing[leg] != _NO_SWING:
            tally.stances[leg] += 1
        if loaded and tally.steps > 0:
            tally.slip[leg] += np.hypot(x - tally.foot_xy[leg, 0] - roll_x, y - tally.foot_xy[leg, 1] - roll_y)
        tally.was_swing[leg] = _NO_SWING
    else:
        if tally.was_swing[leg] == _NO_SWING:
            tally.peak[leg] = height
            tally.was_swing[leg] = _WHOLE_SWING if tally.steps > 0 else _CUT_SWING
        tally.peak[leg] = max(tally.peak[leg], height)
    tally.foot_xy[leg, 0], tally.foot_xy[leg, 1] = x, y


class Counted(NamedTuple):
    """Counters of n episodes so far, (n,) of `TALLY`, and the sums (n, k) of the user's `own` terms."""

    tallies: Records
    own: Array

    def since(self, before: "Counted") -> "Counted":
        """Counters since an earlier moment of the same episodes."""
        between = self.tallies.copy()
        for name in between.dtype.names or ():
            between[name] = self.tallies[name] - before.tallies[name]
        return Counted(between, self.own - before.own)


class Scorer:
    """The reward, the falls and the counters (`tallies`, (n,) of `TALLY`) of n robots. One thread at a time."""

    def __init__(self, robot: Robot, table: Records, n: int, config: ControllerConfig, rate_hz: float) -> None:
        """`table` (t,) of `SAMPLE` is the demonstration; `config` tells from which load on a foot has touched down."""
        self.tallies = np.zeros(n, TALLY)
        self.context = ScoringContext(
            table=table,
            geometry=robot.geometry,
            foot_radius=robot.foot_radius,
            threshold=config.gait.contact_threshold * robot.mass * GRAVITY,
            dt=1.0 / rate_hz,
            work=np.zeros((3, 3, 3)),
        )
        self._added: list[RewardTerm] = [term for term in REWARD_TERMS.values() if term.function is not None]
        self._weights = reward_weights()
        self._own, self._own_sums = np.zeros((n, len(self._added))), np.zeros((n, len(self._added)))

    def reset(self, rows: NDArray[np.int64] | slice = slice(None)) -> None:
        """Begins the episodes of some robots, or of all."""
        self.tallies[rows] = np.zeros((), TALLY)
        self._own[rows] = self._own_sums[rows] = 0.0

    def score(self, clocks: Records, truths: Records, memories: Records, seen: Records | None = None) -> None:
        """Scores the robots' states, (n,) of `OBSERVATION`, after a control step. `clocks` (n,) of `CLOCK` give the due
        sample of the demonstration and its place; `memories` (n,) of `MEMORY` are the controller's; `seen` are the
        states as seen from the ground, None if it is level."""
        observations = truths if seen is None else seen
        score_step(self.context, clocks, observations, truths, memories, self.tallies)
        if self._added:
            self._add_own_terms(clocks, observations)

    @property
    def terms(self) -> Array:
        """(n, k) terms of the last step, in the order of `REWARD_TERMS`."""
        return np.hstack([self.tallies["reward"], self._own])

    @property
    def reward(self) -> Array:
        """(n,) reward of the last step."""
        return self.terms @ self._weights

    def counted(self) -> Counted:
        """A copy of the counters."""
        return Counted(self.tallies.copy(), self._own_sums.copy())

    def _add_own_terms(self, clocks: Records, observations: Records) -> None:
        """Adds the user's terms; the weights are scaled so that the reward stays in [0, 1]."""
        demonstration = demonstration_in_world(self.context.table, clocks["sample"], clocks["origin"])
        for k, term in enumerate(self._added):
            self._own[:, k] = _checked(term, demonstration, observations)
        up = self.tallies["fallen"] == 0
        self._own_sums[up] += self._own[up]
        built_in = self.tallies["reward"] @ np.array(WEIGHTS)
        self.tallies["reward_sum"][up] += (self.reward - built_in)[up]


def demonstration_in_world(table: Records, sample: NDArray[np.int64], origin: Array) -> Records:
    """Due samples (…) of a table (t,) of `SAMPLE`, with root, velocities and accelerations in the world frame. `sample`
    (…) are their indices, `origin` (…, 3) x, y and yaw of the table in the world."""
    demonstration = table[sample]
    position, quat = world_root(table, sample, origin)
    demonstration["root_pos"], demonstration["root_quat"] = position, quat
    for name in ("lin_vel", "ang_vel", "lin_acc", "ang_acc"):
        demonstration[name] = turned_about_z(demonstration[name], origin[..., 2])
    return demonstration


def _checked(term: RewardTerm, demonstration: Records, observations: Records) -> Array:
    assert term.function is not None
    values = np.asarray(term.function(demonstration, observations), dtype=float)
    if values.shape != observations.shape:
        said = f"values of shape {values.shape} for {len(observations)} robots"
        raise ConfigError(f"reward term '{term.name}' gave {said}")
    values = np.where(np.isfinite(values), values, 0.0)  # of a robot that is lost
    if values.min() < 0.0 or values.max() > 1.0:
        raise ConfigError(f"reward term '{term.name}' must lie in [0, 1], found {values.min():g} to {values.max():g}")
    return values
