"""A controller at given samples of a motion, and what it is told: for the tests of its laws and of its batches."""

from dataclasses import replace

import numpy as np

from fastmimic.base.rotations import quat_from_rotvec, quat_multiply
from fastmimic.control.config import ControllerConfig
from fastmimic.control.controller import Controller
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import make_clocks, place_clocks
from fastmimic.robot import Robot
from fastmimic.robot.state import OBSERVATION


def on_reference(motion: Motion, samples: np.ndarray) -> np.ndarray:
    """Observations of robots that are exactly where the motion wants them, loaded as it wants."""
    out = np.zeros(len(samples), OBSERVATION)
    out["root_pos"], out["root_quat"] = motion.root_pos_w[samples], motion.root_quat_wxyz[samples]
    out["lin_vel"], out["ang_vel"] = motion.root_lin_vel_w[samples], motion.root_ang_vel_w[samples]
    out["joint_pos"], out["joint_vel"] = motion.joint_pos[samples], motion.joint_vel[samples]
    out["foot_force"][..., 2] = np.where(motion.contact[samples], 60.0, 0.0)
    return out


def disturbed(observation: np.ndarray, rng: np.random.Generator, size: float = 1.0) -> np.ndarray:
    out = observation.copy()
    n = len(out)
    out["root_pos"] += size * rng.normal(size=(n, 3)) * 0.03
    out["root_quat"] = quat_multiply(out["root_quat"], quat_from_rotvec(size * rng.normal(size=(n, 3)) * 0.1))
    for name, scale in (("lin_vel", 0.2), ("ang_vel", 0.5), ("joint_pos", 0.1), ("joint_vel", 2.0)):
        out[name] += size * rng.normal(size=out[name].shape) * scale
    out["foot_force"] += size * rng.normal(size=(n, 4, 3)) * 20
    return out


class Rig:
    """A controller and clocks, robots at given samples of its motion, the reference's origin where the motion is. The
    ground is level for certain: tilted robots are not on a slope."""

    def __init__(self, robot: Robot, motions: list[Motion], samples: np.ndarray, config: ControllerConfig) -> None:
        self.samples = np.asarray(samples)
        config = replace(config, gait=replace(config.gait, follow_ground=False))
        self.controller = Controller(robot, motions, len(self.samples), config)
        self.clocks = make_clocks(motions[0], len(self.samples))
        first = motions[0].root_pos_w[0]
        yaw = 2 * np.arctan2(motions[0].root_quat_wxyz[0, 3], motions[0].root_quat_wxyz[0, 0])
        start = np.tile([first[0], first[1], yaw], (len(self.samples), 1))
        place_clocks(self.clocks, np.zeros(len(self.samples), np.int64), self.controller.tables[0], start)
        self.clocks["sample"] = self.samples
        self.controller.reset(self.samples)

    def step(self, observation: np.ndarray) -> np.ndarray:
        return self.controller.step(observation, self.clocks).copy()
