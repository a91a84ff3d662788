"""Sensor readings of a legged robot, in the form that simulated sensors, drivers and the estimator share."""

from typing import Final

from fastmimic.base.jit import record_dtype

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
