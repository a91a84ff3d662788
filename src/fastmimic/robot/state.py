"""Reading, observation, memory and command of a robot, as arrays that kernels, sensors and drivers share; and the log
of a run, which has only what a robot's computer knows of it."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Records
from fastmimic.base.jit import floats, integers, record_dtype
from fastmimic.robot.robot import Robot

READING: Final = record_dtype(floats(quat=4, gyro=3, accel=3, joint_pos=12, joint_vel=12, torque=12, foot_force=4))
"""One robot's latest readings: the IMU's orientation (body → a world of its own heading), angular velocity, rad/s, and
specific force, m/s², both in the body frame at its origin; joint angles, speeds and motor torques, rad, rad/s and N·m;
the force along the vertical on each foot, N."""

OBSERVATION: Final = record_dtype(
    floats(
        root_pos=3, root_quat=4, lin_vel=3, ang_vel=3, joint_pos=12, joint_vel=12, foot_force=(4, 3), other_contact=()
    )
)
"""State of one robot: base pose and velocities in the world frame, joints, ground force on each foot (world frame, N),
and the number of ground contacts other than feet, on terrain of the trunk."""

COMMAND: Final = record_dtype(floats(joint_pos=12, joint_vel=12, stiffness=12, damping=12, torque=12))
"""One robot's command: the motors apply torque + stiffness (joint_pos − q) + damping (joint_vel − dq)."""


def commanded_torque(command: Any, q: NDArray[np.float64], dq: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the motors apply (..., 12), N·m, with commands (...) at joint angles and speeds (..., 12), without limit."""
    torque = command["torque"] + command["stiffness"] * (command["joint_pos"] - q)
    return np.asarray(torque + command["damping"] * (command["joint_vel"] - dq))


MEMORY: Final = record_dtype(
    [
        *integers(stance=4, early=4, was_loaded=4, began=(), recovering=(), taken_up=(), grounded=()),
        *floats(since_switch=4, unloaded_time=4, missed_time=4, liftoff_offset=(4, 3), force=(4, 3)),
        *floats(foot_shift=(4, 2), foot_shift_rate=(4, 2), haste=(), lag=(4, 2), velocity=6, expected=6, disturbance=6),
        *floats(urgency=(), since_recovery=(), calm=()),
        *floats(foothold=(4, 3), slope=2, ground=(), ground_at=2, roughness=(), raised=4),
        *integers(qp_failures=(), failed_in_a_row=(), horizon_failures=()),
        *floats(solve_time=(), friction=(), slid=4),
        *integers(early_touchdowns=()),
    ]
)
"""Controller memory of one robot: leg states (stance 1, swing 0), timers, last forces (heading frame), and the time of
the last horizon plan, s, 0 without one. A foot has been without load for `unloaded_time`, and for `missed_time` though
it was asked to bear some. `foot_shift` is where a foot is, or is to be, from the reference's, both from
their trunks, heading frame, m, and its rate in the world, m/s. `haste` are the samples that the reference advances
beyond one in a control step (or `taken_up_at`), and `lag` is by how far a standing foot of the reference that got ahead
by it does not count yet, m. `urgency`, `recovering` and what follows it are those of `control.recovery`. The trunk's
`velocity` (in the ground's frame) and `expected` acceleration (heading frame) of the last step, linear and angular,
tell the `disturbance`. The `foothold` of each foot (world, m) gives the ground's `slope`, its height where the robot is
(`ground`) and its `roughness`, m; `raised` is how far swinging feet are that caught on it, m. `friction` is the
coefficient assumed at present, 0 before the first step, and `slid` how far each foot has slid without a pause, m."""

MODEL: Final = record_dtype(
    [
        *floats(geometry=(4, 12), mass=(), inertia=(3, 3), trunk_moment=3),
        *floats(link_mass=(4, 3), link_com=(4, 3, 3), link_inertia=(4, 3, 3, 3)),
        *floats(armature=12, joint_damping=12, joint_friction=12, lower=12, upper=12, torque_limit=12),
        *floats(foot_radius=()),
    ]
)


def pack_model(robot: Robot) -> Records:
    """Packs a robot as an array of one `MODEL` record."""
    record = np.zeros(1, MODEL)
    given = {"inertia": robot.inertia_b, "lower": robot.joint_lower, "upper": robot.joint_upper}
    given["trunk_moment"] = robot.trunk_mass * robot.trunk_com_b
    for name in MODEL.names or ():
        record[name] = given[name] if name in given else getattr(robot, name)
    return record


@dataclass(frozen=True, eq=False)
class RunLog:
    """One run over t control steps, as the robot's computer saw it. There is no field for the truth."""

    robot: str
    motion: str
    rate_hz: float  # control steps a second
    latency_s: float  # age of the readings of IMU and joints on arrival
    reading: Records  # (t,) of `READING`, the latest at the end of each step
    command: Records  # (t,) of `COMMAND`, the motors' commands for the step
    estimate: Records  # (t,) of `OBSERVATION`, the estimator's result
    stance: NDArray[np.bool_]  # (t, 4) legs that the gait planner let stand in the step

    @property
    def duration_s(self) -> float:
        """Length, s."""
        return len(self.reading) / self.rate_hz
