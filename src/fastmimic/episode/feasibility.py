"""What a motion asks of a robot, and why the robot fell, by one rule for every motion.

`demands` looks at the demonstration alone: inverse dynamics of the whole robot, with the ground reaction forces that
give it within the friction of the ground at the least joint torques. `describe_fall` looks at an episode's log up to
its fall. `reasons` compares both with the robot's limits.
"""

from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, stretches
from fastmimic.base.conventions import GRAVITY, GROUND_FRICTION
from fastmimic.base.rotations import quat_rotate, roll_pitch_from_quat, rotate_planar, yaw_from_quat
from fastmimic.episode.reward import MAX_ANGLE, MAX_DISTANCE
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.limits import use_of_limits
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import commanded_torque
from fastmimic.simulation.mujoco_sim import FLOOR, build_model

SAMPLE_S: Final = 0.004  # time between the examined instants of a motion
BEFORE_S: Final = 0.3  # examined time before a fall
HIGH: Final = 95  # percentile that stands for a greatest value; the very greatest belongs to single samples

MAX_LIMITED: Final = 0.2  # share of the time with a joint at its limit; more than tracked motions ask, as is the next
MAX_LACKING: Final = 0.5  # acceleration that the standing feet cannot give, g RMS
MAX_FLIGHT: Final = 0.1  # share of the time without a foot on the ground
MAX_SLIDE_M: Final = 5e-3
MAX_SLIP_M: Final = 0.03
MAX_SATURATED: Final = 0.05


@dataclass(frozen=True)
class Demands:
    """What a demonstration asks of a robot. In flight, the difference from free fall counts as lacking."""

    joint_speed: float  # greatest, share of the limit
    torque: float  # of the most loaded joint, share of the limit, at the given percentile of the instants
    # the same of the mean of torque and twice the speed in its direction, shares of their limits: 1 on the line from
    # full torque at half of the speed limit to none at all of it
    torque_at_speed: float
    # horizontal over vertical ground reaction force at that percentile of the instants with a foot down
    friction: float
    flight: float  # share of the time without any foot on the ground
    lacking: float  # RMS of the linear acceleration that the standing feet cannot give, g
    lacking_angular: float  # the same of the rotation about the centre of mass, rad/s²
    joint_limited: float  # share of the samples with a joint within 0.03 rad of its limit
    slide_m: float  # furthest that a foot slides in a stance; its sphere may roll
    body_clearance_m: float  # least distance of anything but the feet from the ground; negative below it


@dataclass(frozen=True)
class Fall:
    """An episode's early end: the bodies other than feet on the ground, by name; 'touched the ground', 'tipped over',
    'left its place' or 'simulation failed'; and of the last 0.3 s, the share of the motor commands that exceed their
    torque limit, and the longest path of a loaded foot's centre in scheduled stance (a few mm of it are rolling)."""

    time_s: float
    touched: tuple[str, ...]
    how: str
    saturated: float
    slip_m: float


@dataclass(frozen=True)
class Reason:
    """An exceeded limit: its `kind`, 'reach', 'joint speed', 'torque', 'friction', 'flight', 'support' or 'feedback',
    and the finding in a `text` with figures."""

    kind: str
    text: str


def demands(robot: Robot, motion: Motion, *, sample_s: float = SAMPLE_S, percentile: float = HIGH) -> Demands:
    """What a motion asks of a robot, whether or not the robot can, at instants `sample_s` apart."""
    sample = np.arange(0, motion.n_samples, max(1, round(sample_s * motion.rate_hz)))
    use = use_of_limits(robot, motion, sample)
    friction, lacking = use.friction[np.isfinite(use.friction)], use.lacking
    q, margin = motion.joint_pos, 0.03
    limited = (q < robot.joint_lower + margin) | (q > robot.joint_upper - margin)
    return Demands(
        joint_speed=float((np.abs(motion.joint_vel) / robot.joint_speed_limit).max()),
        torque=float(np.percentile(use.torque, percentile)),
        torque_at_speed=float(np.percentile(use.torque_at_speed, percentile)),
        friction=float(np.percentile(friction, percentile)) if len(friction) else 0.0,
        flight=float(np.mean(~motion.contact.any(axis=1))),
        lacking=float(np.sqrt((lacking[:, :3] ** 2).sum(axis=1).mean()) / GRAVITY),
        lacking_angular=float(np.sqrt((lacking[:, 3:] ** 2).sum(axis=1).mean())),
        joint_limited=float(limited.any(axis=1).mean()),
        slide_m=_slide(robot, motion),
        body_clearance_m=_body_clearance(robot, motion, sample),
    )


def describe_fall(robot: Robot, rollout: Rollout, episode: int = 0) -> Fall | None:
    """The fall of an episode; None if the robot did not fall. Raises `ValueError` if the rollout has no log."""
    if rollout.log is None:
        raise ValueError("a fall can only be described from a rollout with its log")
    if not rollout.fell[episode]:
        return None
    log = rollout.log
    last = min(int(rollout.steps[episode]), log.observation.shape[1] - 1)
    first = max(0, last - round(BEFORE_S * log.rate_hz))
    before, state = log.observation[episode, first : last + 1], log.observation[episode, last]
    command = log.command[episode, first + 1 : last + 1]
    torque = commanded_torque(command, before["joint_pos"][:-1], before["joint_vel"][:-1])
    saturated = float(np.mean(np.abs(torque) >= robot.torque_limit)) if len(torque) else 0.0
    return Fall(
        time_s=last / log.rate_hz,
        touched=_touching(robot, state),
        how=_how(state, log.demonstration[episode, last]),
        saturated=saturated,
        slip_m=_slip(robot, before, log.wanted[episode, first : last + 1]),
    )


def reasons(needs: Demands, fall: Fall | None = None) -> tuple[Reason, ...]:
    """The limits that a motion exceeds, those of the demonstration first, in the order of cause and effect: a leg at
    the end of its reach jumps out of it, and what it then asks of motors and ground follows from that. If the
    demonstration keeps every limit and the robot fell without saturated motors or slipping feet, the only reason is
    feedback. Without a fall, only the demonstration's reasons are given."""
    n, sunk = needs, -needs.body_clearance_m
    asked = [
        (sunk > 0.0, "reach", f"a leg would be {1e3 * sunk:.0f} mm below the ground"),
        (n.slide_m > MAX_SLIDE_M, "reach", f"a standing foot would slide {1e3 * n.slide_m:.0f} mm"),
        (n.joint_limited > MAX_LIMITED, "reach", f"a joint at its limit in {100 * n.joint_limited:.0f} % of the time"),
        (n.joint_speed > 1.0, "joint speed", f"joints at {n.joint_speed:.2f} of their speed limit"),
        (n.torque > 1.0, "torque", f"joints at {n.torque:.2f} of their torque limit"),
        (n.friction > GROUND_FRICTION, "friction", f"friction {n.friction:.2f} needed, {GROUND_FRICTION:.2f} there"),
        (n.flight > MAX_FLIGHT, "flight", f"no foot on the ground for {100 * n.flight:.0f} % of the time"),
        (n.lacking > MAX_LACKING, "support", f"{n.lacking:.2f} g RMS that the standing feet cannot give"),
    ]
    if fall is not None:
        share, slid = 100 * fall.saturated, 1e3 * fall.slip_m
        asked += [
            (fall.saturated > MAX_SATURATED, "torque", f"motors saturated in {share:.0f} % before the fall"),
            (fall.slip_m > MAX_SLIP_M, "friction", f"a standing foot slipped {slid:.0f} mm before the fall"),
            (True, "feedback", "within all limits; the controller did not hold it"),
        ]
    found = tuple(Reason(kind, text) for exceeded, kind, text in asked if exceeded)
    return found if fall is None or len(found) == 1 else found[:-1]


def _slide(robot: Robot, motion: Motion) -> float:
    """Furthest that a foot slides within a stance, m: its centre's way, or that without what its sphere rolls, if the
    motion lets it roll. A stance across a cycle's seam counts as two."""
    roll, pitch = roll_pitch_from_quat(motion.root_quat_wxyz)
    joints = motion.joint_pos.reshape(-1, 4, 3)
    turned = np.stack([pitch[:, None] + joints[..., 1] + joints[..., 2], -roll[:, None] - joints[..., 0]], axis=-1)
    steps = rotate_planar(yaw_from_quat(motion.root_quat_wxyz)[1:, None], np.diff(turned, axis=0))
    rolled = robot.foot_radius * np.concatenate([np.zeros((1, 4, 2)), np.cumsum(steps, axis=0)])
    still, worst = motion.foot_pos_w[..., :2], 0.0
    for leg in range(4):
        for start, end in stretches(motion.contact[:, leg]):
            ways = [feet[start:end, leg] - feet[start, leg] for feet in (still, still - rolled)]
            worst = max(worst, float(min(np.linalg.norm(way, axis=1).max() for way in ways)))
    return worst


def _body_clearance(robot: Robot, motion: Motion, sample: NDArray[np.int_]) -> float:
    """Least distance of colliding geoms, except feet, from the ground, m; 0.5 if nothing comes nearer."""
    model = build_model(robot)
    data, floor, least, pair = mujoco.MjData(model), model.geom(FLOOR).id, 0.5, np.zeros(6)
    geoms = [g for g in range(model.ngeom) if model.geom_conaffinity[g] and model.geom(g).name not in robot.foot_geoms]
    for i in sample:
        _pose(robot, model, data, motion.root_pos_w[i], motion.root_quat_wxyz[i], motion.joint_pos[i])
        mujoco.mj_kinematics(model, data)
        least = min([least, *(mujoco.mj_geomDistance(model, data, g, floor, least, pair) for g in geoms)])
    return float(least)


def _touching(robot: Robot, state: Any) -> tuple[str, ...]:
    """Sorted names of the bodies that touch the ground with anything but a foot."""
    if not all(np.isfinite(state[name]).all() for name in ("root_pos", "root_quat", "joint_pos")):
        return ()
    model = build_model(robot)
    data = mujoco.MjData(model)
    _pose(robot, model, data, state["root_pos"], state["root_quat"], state["joint_pos"])
    mujoco.mj_forward(model, data)
    feet = {model.geom(name).id for name in (*robot.foot_geoms, FLOOR)}
    found = {model.body(model.geom_bodyid[g]).name for c in data.contact for g in c.geom if int(g) not in feet}
    return tuple(sorted(found))


def _pose(robot: Robot, model: Any, data: Any, position: Array, quat: Array, joint_pos: Array) -> None:
    index = model.jnt_qposadr[[model.joint(name).id for name in robot.joint_names]]
    data.qpos[:3], data.qpos[3:7], data.qpos[index] = position, quat, joint_pos


def _how(state: Any, reference: Any) -> str:
    """The rule that ended an episode."""
    if not all(np.isfinite(state[name]).all() for name in ("root_pos", "root_quat", "joint_pos", "joint_vel")):
        return "simulation failed"
    if state["other_contact"] > 0.5:
        return "touched the ground"
    half = min(1.0, abs(float(np.dot(state["root_quat"], reference["root_quat"]))))
    if 2 * np.arccos(half) >= MAX_ANGLE:
        return "tipped over"
    away = np.linalg.norm(state["root_pos"] - reference["root_pos"])
    return "left its place" if away >= MAX_DISTANCE else "simulation failed"


def _slip(robot: Robot, states: Any, wanted: NDArray[np.bool_]) -> float:
    """Longest path of a loaded foot's centre in scheduled stance, m."""
    feet_b = foot_positions(robot, states["joint_pos"])
    feet = states["root_pos"][:, None] + quat_rotate(states["root_quat"][:, None], feet_b)
    loaded = wanted & (states["foot_force"][..., 2] > 0.02 * robot.mass * GRAVITY)
    step = np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1) * (loaded[1:] & loaded[:-1])
    return float(step.sum(axis=0).max()) if len(step) else 0.0
