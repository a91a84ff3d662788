"""Reading, observation, memory and command of a robot, as arrays that kernels, sensors and drivers share."""

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.jit import record_dtype

if TYPE_CHECKING:
    from fastmimic.robot import Robot

READING: Final = record_dtype(
    [
        ("quat", "f8", (4,)),
        ("gyro", "f8", (3,)),
        ("accel", "f8", (3,)),
        ("joint_pos", "f8", (12,)),
        ("joint_vel", "f8", (12,)),
        ("torque", "f8", (12,)),
        ("foot_force", "f8", (4,)),
    ]
)
"""One robot's latest readings: the IMU's orientation (body → a world of its own heading), angular velocity, rad/s, and
specific force, m/s², both in the body frame at its origin; joint angles, speeds and motor torques, rad, rad/s and N·m;
the force along the vertical on each foot, N."""

OBSERVATION: Final = record_dtype(
    [
        ("root_pos", "f8", (3,)),
        ("root_quat", "f8", (4,)),
        ("lin_vel", "f8", (3,)),
        ("ang_vel", "f8", (3,)),
        ("joint_pos", "f8", (12,)),
        ("joint_vel", "f8", (12,)),
        ("foot_force", "f8", (4, 3)),
        ("other_contact", "f8"),
    ]
)
"""State of one robot: base pose and velocities in the world frame, joints, ground force on each foot (world frame, N),
and the number of ground contacts other than feet."""

COMMAND: Final = record_dtype(
    [
        ("joint_pos", "f8", (12,)),
        ("joint_vel", "f8", (12,)),
        ("stiffness", "f8", (12,)),
        ("damping", "f8", (12,)),
        ("torque", "f8", (12,)),
    ]
)
"""One robot's command: the motors apply torque + stiffness (joint_pos − q) + damping (joint_vel − dq)."""

MEMORY: Final = record_dtype(
    [
        ("stance", "i8", (4,)),
        ("early", "i8", (4,)),
        ("was_loaded", "i8", (4,)),
        ("since_switch", "f8", (4,)),
        ("unloaded_time", "f8", (4,)),
        ("liftoff_offset", "f8", (4, 3)),
        ("force", "f8", (4, 3)),
        ("qp_failures", "i8"),
        ("failed_in_a_row", "i8"),
        ("horizon_failures", "i8"),
        ("solve_time", "f8"),
        ("early_touchdowns", "i8"),
    ]
)
"""Controller memory of one robot: leg states (stance 1, swing 0), timers, last forces (heading frame), and the time of
the last horizon plan, s, 0 without one."""

MODEL: Final = record_dtype(
    [
        ("geometry", "f8", (4, 12)),
        ("mass", "f8"),
        ("inertia", "f8", (3, 3)),
        ("trunk_moment", "f8", (3,)),
        ("link_mass", "f8", (4, 3)),
        ("link_com", "f8", (4, 3, 3)),
        ("link_inertia", "f8", (4, 3, 3, 3)),
        ("armature", "f8", (12,)),
        ("joint_damping", "f8", (12,)),
        ("joint_friction", "f8", (12,)),
        ("lower", "f8", (12,)),
        ("upper", "f8", (12,)),
        ("torque_limit", "f8", (12,)),
        ("foot_radius", "f8"),
    ]
)


def pack_model(robot: "Robot") -> NDArray[Any]:
    """Packs a robot as an array of one `MODEL` record."""
    record = np.zeros(1, MODEL)
    given = {
        "inertia": robot.inertia_b,
        "trunk_moment": robot.trunk_mass * robot.trunk_com_b,
        "lower": robot.joint_lower,
        "upper": robot.joint_upper,
    }
    for name in MODEL.names or ():
        record[name] = given[name] if name in given else getattr(robot, name)
    return record
