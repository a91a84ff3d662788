"""Synthetic cyclic motions, exact where the tests need them to be."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Provenance
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics

RATE_HZ = 500.0
SWING_HEIGHT = 0.06


def planar_matrix(x: float, y: float, yaw: float) -> np.ndarray:
    """SE(2) element as a (3, 3) matrix."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


def planar_twist_matrix(cycle: np.ndarray) -> np.ndarray:
    """Logarithm (3, 3) of a cycle's displacement, by solving V t = d with V integrated numerically."""
    dx, dy, yaw = cycle
    nodes, weights = np.polynomial.legendre.leggauss(40)
    angles = yaw * (nodes + 1) / 2
    c, s = weights @ np.cos(angles) / 2, weights @ np.sin(angles) / 2
    vx, vy = np.linalg.solve([[c, -s], [s, c]], [dx, dy])
    return np.array([[0, -yaw, vx], [yaw, 0, vy], [0, 0, 0]])


def cyclic_motion(
    robot: Robot,
    cycle: tuple[float, float, float] = (0.6, 0.05, 0.4),
    n_samples: int = 300,
    origin: tuple[float, float, float] = (1.0, -2.0, 0.7),
    wobble: float = 1.0,
) -> Motion:
    """A trot-like cycle whose root sways, scaled by `wobble`, about the constant-twist motion of `cycle`."""
    pose = root_pose(np.array(cycle), origin, wobble, robot.home_height)
    period = n_samples / RATE_HZ
    phase = 2 * np.pi * np.arange(n_samples) / n_samples
    step = 1e-5
    position, orientation = pose(phase)
    before, turned_before = pose(phase - step)
    after, turned_after = pose(phase + step)
    rate = 2 * np.pi / period / (2 * step)  # phase difference → per second
    feet, contact = trot_feet(robot, phase)
    joints, reachable = inverse_kinematics(robot, feet)
    assert np.all(reachable)
    return Motion(
        rate_hz=RATE_HZ,
        root_pos_w=position,
        root_quat_wxyz=orientation.as_quat()[:, [3, 0, 1, 2]],
        joint_pos=joints,
        joint_vel=(np.roll(joints, -1, axis=0) - np.roll(joints, 1, axis=0)) * RATE_HZ / 2,
        foot_pos_b=feet,
        contact=contact,
        root_lin_vel_w=(after - before) * rate,
        root_ang_vel_w=(turned_after * turned_before.inv()).as_rotvec() * rate,
        cycle=np.array(cycle),
        provenance=Provenance("synthetic", robot.name),
    )


def root_pose(
    cycle: np.ndarray, origin: tuple[float, float, float], wobble: float, height: float
) -> Callable[[np.ndarray], tuple[np.ndarray, Rotation]]:
    """World positions (t, 3) and orientations of the root as a function of the phases (t,)."""
    turns = 2 * np.pi * np.round(cycle[2] / (2 * np.pi)) if abs(cycle[2]) > 1.5 * np.pi else 0.0
    logarithm, start = planar_twist_matrix(cycle - (0, 0, turns)), planar_matrix(*origin)

    def pose(phase: np.ndarray) -> tuple[np.ndarray, Rotation]:
        share = phase / (2 * np.pi)
        sway = [wobble * 0.01 * np.sin(phase), wobble * 0.02 * np.sin(2 * phase), np.ones_like(phase)]
        frame = start @ expm(logarithm * share[:, None, None])
        xy = np.einsum("tij,jt->ti", frame, sway)[:, :2]
        yaw = origin[2] + cycle[2] * share + wobble * 0.05 * np.sin(phase)
        roll, pitch = wobble * 0.06 * np.cos(phase), wobble * 0.08 * np.sin(2 * phase + 0.3)
        position = np.column_stack([xy, height + wobble * 0.01 * np.cos(2 * phase)])
        return position, Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))

    return pose


def trot_feet(robot: Robot, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Feet (t, 4, 3) of a trot, duty 0.6, with corners at take-off and touch-down, and contacts (t, 4)."""
    home = foot_positions(robot, robot.home_joint_pos)
    feet = np.tile(home, (len(phase), 1, 1))
    contact = np.ones((len(phase), 4), dtype=bool)
    for leg, shift in enumerate((0.0, np.pi, np.pi, 0.0)):
        share = ((phase + shift) / (2 * np.pi)) % 1.0
        stance = share < 0.6
        u = np.where(stance, share / 0.6, (share - 0.6) / 0.4)
        feet[:, leg, 0] += np.where(stance, 0.08 - 0.16 * u, -0.08 + 0.16 * u)
        feet[:, leg, 2] += np.where(stance, 0.0, SWING_HEIGHT * np.sin(np.pi * u))
        contact[:, leg] = stance
    return feet, contact
