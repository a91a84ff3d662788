"""One moment of a live session, for history and page."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The present moment. Arrays are copies.

    Attributes:
        time_s: simulated since the start.
        pose, reference: (19,) of the robot and of what it is scored against: position (world, m), quaternion, joints.
        force, asked: (4, 3) the ground's and the commanded force on each foot, world, N.
        wanted, measured, stance: (4,) schedule, loaded feet, gait planner.
        terms, reward: (k,) the reward's terms of this step, 0 while the robot gets up; the reward of this step.
        velocity_b, turn_rate: (3,) of the base, heading frame, m/s; about the vertical, rad/s.
        push: (3,) force that pushes, world, N.
    """

    time_s: float
    pose: Array
    reference: Array
    force: Array
    asked: Array
    wanted: NDArray[np.bool_]
    measured: NDArray[np.bool_]
    stance: NDArray[np.bool_]
    terms: Array
    reward: float
    velocity_b: Array
    turn_rate: float
    push: Array


def take_snapshot(
    time_s: float,
    observation: Any,
    demonstration: Any,
    origin: Array,
    memory: Any,
    lying: Array,
    loaded: float,
    terms: Array,
    reward: float,
    push: Array,
    *,
    up: bool,
) -> Snapshot:
    """The present moment.

    Args:
        time_s: simulated since the start.
        observation: one of `OBSERVATION`.
        demonstration: one of `SAMPLE`.
        origin: (3,) place and heading of the demonstration, world, m and rad.
        memory: the controller's.
        lying: (12,) joints to show where the state is not finite, rad.
        loaded: force above which a foot is loaded, N.
        terms, reward: of this step.
        push: (3,) force that pushes, world, N.
        up: whether the controller is active: the robot has not fallen.
    """
    yaw = float(yaw_from_quat(observation["root_quat"]))
    pose = np.concatenate([observation["root_pos"], observation["root_quat"], observation["joint_pos"]])
    if not np.isfinite(pose).all():
        pose = np.concatenate([[0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0], lying])
    reference = np.concatenate(
        [
            [origin[0], origin[1], demonstration["root_pos"][2]],
            quat_multiply(quat_from_yaw(origin[2]), demonstration["root_quat"]),
            demonstration["joint_pos"],
        ]
    )
    force, asked = np.nan_to_num(observation["foot_force"]), np.array(memory["force"])
    asked[:, :2] = rotate_planar(yaw, asked[:, :2])
    velocity = np.array(observation["lin_vel"])
    velocity[:2] = rotate_planar(-yaw, velocity[:2])
    return Snapshot(
        time_s=time_s,
        pose=pose,
        reference=reference,
        force=force,
        asked=asked if up else np.zeros((4, 3)),
        wanted=demonstration["contact"].astype(bool),
        measured=force[:, 2] > loaded,
        stance=memory["stance"].astype(bool),
        terms=terms,
        reward=reward,
        velocity_b=velocity,
        turn_rate=float(observation["ang_vel"][2]),
        push=push.copy(),
    )
