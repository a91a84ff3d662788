"""A log written by hand: a standing robot whose feet hold and slide in turns."""

from collections.abc import Callable

import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import leg_torques
from fastmimic.robot.kinematics import foot_jacobians
from fastmimic.robot.state import COMMAND, OBSERVATION, READING, RunLog

STEPS, RATE = 1000, 500.0
SPEED = 0.4  # m/s
MakeLog = Callable[..., RunLog]


@pytest.fixture(scope="session")
def make_log(robot: Robot) -> MakeLog:
    def make(friction: float = 0.4, payload: float = 0.0, *, slides: bool = True, noise: float = 0.0) -> RunLog:
        """Slides 50 of each 100 steps at `friction`; in the others feet hold at half of it."""
        reading, command = np.zeros(STEPS, READING), np.zeros(STEPS, COMMAND)
        estimate = np.zeros(STEPS, OBSERVATION)
        moving = (np.arange(STEPS) // 50 % 2 == 1) & slides
        q = np.tile(robot.home_joint_pos, (STEPS, 1))
        normal = 0.25 * (robot.mass + payload) * GRAVITY
        force = np.zeros((STEPS, 4, 3))
        force[..., 2] = normal
        force[..., 0] = -np.where(moving, friction, 0.5 * friction)[:, None] * normal
        jacobian = foot_jacobians(robot, q)
        below = np.array([0.0, 0.0, -robot.foot_radius])
        roll = q.reshape(-1, 4, 3)[..., 0]
        pitch_axis = np.stack([np.zeros_like(roll), np.cos(roll), np.sin(roll)], axis=-1)
        jacobian[..., 0] += np.cross([1.0, 0.0, 0.0], below)
        jacobian[..., 1] += np.cross(pitch_axis, below)
        jacobian[..., 2] += np.cross(pitch_axis, below)
        zero = np.zeros((STEPS, 12))
        up = np.tile([0.0, 0.0, GRAVITY], (STEPS, 1))
        torque = leg_torques(robot, q, zero, zero, np.zeros((STEPS, 3)), up)
        torque -= np.einsum("tlij,tli->tlj", jacobian, force).reshape(STEPS, 12)
        rng = np.random.default_rng(3)
        reading["quat"][:, 0] = estimate["root_quat"][:, 0] = 1.0
        reading["accel"], reading["joint_pos"] = up, q
        reading["torque"] = torque + noise * rng.standard_normal(torque.shape)
        reading["foot_force"] = normal + 10 * noise * rng.standard_normal((STEPS, 4))
        command["torque"] = torque
        estimate["lin_vel"][:, 0] = SPEED * moving
        estimate["joint_pos"] = q
        return RunLog(robot.name, "by hand", RATE, 0.0, reading, command, estimate, np.ones((STEPS, 4), np.bool_))

    return make
