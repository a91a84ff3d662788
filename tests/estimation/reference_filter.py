"""The estimator's filter written plainly: 18 states in one vector, matrices, each leg's measurement at once."""

import numpy as np

from fastmimic.base.conventions import GRAVITY
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_jacobians, foot_positions


class PlainFilter:
    """State (p, v, f_FR, f_FL, f_RR, f_RL) of one robot; orientation and contacts are given."""

    def __init__(self, robot: Robot, config: EstimatorConfig, dt: float, mean: np.ndarray, cov: np.ndarray) -> None:
        self.robot, self.config, self.dt = robot, config, dt
        self.x, self.p = mean.copy(), cov.copy()

    def foot(self, leg: int) -> slice:
        return slice(6 + 3 * leg, 9 + 3 * leg)

    def legs(self, rotation: np.ndarray, reading: np.record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """World, (4, 3) each: feet from the base, velocity of the centres as they roll, base velocity by legs."""
        q, dq = reading["joint_pos"], reading["joint_vel"].reshape(4, 3)
        feet, jacobians = foot_positions(self.robot, q), foot_jacobians(self.robot, q)
        moving = np.cross(reading["gyro"], feet) + np.einsum("lij,lj->li", jacobians, dq)
        calf = np.stack(
            [
                dq[:, 0],
                (dq[:, 1] + dq[:, 2]) * np.cos(q[0::3]),
                (dq[:, 1] + dq[:, 2]) * np.sin(q[0::3]),
            ],
            axis=1,
        )
        roll = np.cross((reading["gyro"] + calf) @ rotation.T, [0.0, 0.0, self.robot.foot_radius])
        return feet @ rotation.T, roll, roll - moving @ rotation.T

    def predict(self, rotation: np.ndarray, reading: np.record, roll: np.ndarray) -> None:
        dt, c = self.dt, self.config
        mean_force = reading["accel"] - 0.5 * dt * np.cross(reading["gyro"], reading["accel"])
        accel = rotation @ mean_force - [0.0, 0.0, GRAVITY]
        f = np.eye(18)
        f[:3, 3:6] = dt * np.eye(3)
        g = np.zeros((18, 3))
        g[:3], g[3:6] = 0.5 * dt**2 * np.eye(3), dt * np.eye(3)
        self.x = f @ self.x + g @ accel
        self.x[6:] += dt * roll.ravel()
        self.p = f @ self.p @ f.T + c.accel_noise**2 * g @ g.T
        self.p[6:, 6:] += c.foot_walk**2 * dt * np.eye(12)

    def anchor(self, leg: int, foot: np.ndarray) -> None:
        """f = p + foot + noise, whatever was known of f before."""
        t = np.eye(18)
        t[self.foot(leg)] = 0.0
        t[self.foot(leg), :3] = np.eye(3)
        self.x = t @ self.x
        self.x[self.foot(leg)] += foot
        self.p = t @ self.p @ t.T
        self.p[self.foot(leg), self.foot(leg)] += self.config.position_noise**2 * np.eye(3)

    def take_in(self, leg: int, foot: np.ndarray, velocity: np.ndarray, stance_time: float) -> bool:
        """One leg's position, velocity and height at once; returns whether it was taken for sliding."""
        c = self.config
        weight = 1.0 / min(stance_time / c.settle_time, 1.0) ** 2 if c.settle_time > 0 else 1.0
        velocity_var = c.velocity_noise**2 * weight
        d = velocity - self.x[3:6]
        excess = float(d @ np.linalg.solve(np.diag(np.diag(self.p)[3:6]) + velocity_var * np.eye(3), d))
        excess /= c.slip_gate**2
        if excess > 1.0:
            self.anchor(leg, foot)
            velocity_var *= excess**2
        h = np.zeros((7, 18))
        h[:3, self.foot(leg)], h[:3, :3] = np.eye(3), -np.eye(3)
        h[3:6, 3:6] = np.eye(3)
        h[6, 8 + 3 * leg] = 1.0
        z = np.concatenate([foot, velocity, [self.robot.foot_radius]])
        r = np.diag([c.position_noise**2 * weight] * 3 + [velocity_var] * 3 + [c.height_noise**2 * weight])
        gain = np.linalg.solve(h @ self.p @ h.T + r, h @ self.p).T
        self.x = self.x + gain @ (z - h @ self.x)
        self.p = (np.eye(18) - gain @ h) @ self.p
        return excess > 1.0
