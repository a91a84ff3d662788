"""Motions for AMP trainers and motion libraries, read back as their own loaders read them (names, shapes, order)."""

import json
from pathlib import Path

import numpy as np
import pytest

from control.motions import gait, turned
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.motion.export import export_motion
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

RATE_HZ = 250.0


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return turned(gait(robot, (0.4, 0.1), 0.6), 0.7, (1.0, -2.0))


def derivative(values: np.ndarray) -> np.ndarray:
    """Central differences of (t, …), without the first and the last."""
    return (values[2:] - values[:-2]) * RATE_HZ / 2


class IsaacLabLoader:
    """What `MotionLoader` of Isaac Lab's `direct/humanoid_amp/motions/motion_loader.py` takes from a file."""

    NEEDED = (
        *("dof_positions", "dof_velocities", "body_positions", "body_rotations"),
        *("body_linear_velocities", "body_angular_velocities"),
    )

    def __init__(self, path: Path) -> None:
        data = np.load(path)  # as it does: without pickles
        self.dof_names, self.body_names = data["dof_names"].tolist(), data["body_names"].tolist()
        self.arrays = {name: data[name] for name in self.NEEDED}
        self.dt = 1.0 / data["fps"]
        self.duration = self.dt * (len(self.arrays["dof_positions"]) - 1)


def test_isaac_labs_loader_finds_bodies_and_joints(motion: Motion, robot: Robot, tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    frames = export_motion(motion, robot, path, "isaaclab", fps=RATE_HZ, duration_s=0.4)
    loader = IsaacLabLoader(path)
    assert loader.dof_names == list(robot.joint_names)
    assert len(loader.body_names) == 13
    assert np.shape(loader.dt) == ()
    assert loader.duration == pytest.approx(0.4)
    t = frames.n
    assert [loader.arrays[name].shape for name in loader.NEEDED] == [
        *((t, 12), (t, 12), (t, 13, 3), (t, 13, 4)),
        *((t, 13, 3), (t, 13, 3)),
    ]
    root = loader.body_names.index("trunk")
    assert loader.arrays["body_positions"][:, root] == pytest.approx(frames.root_pos_w, abs=1e-6)
    assert loader.arrays["body_rotations"][:, root] == pytest.approx(frames.root_quat_wxyz, abs=1e-6)
    assert loader.arrays["dof_positions"] == pytest.approx(frames.joint_pos, abs=1e-6)
    calf = loader.body_names.index("FR_calf")
    moved = derivative(loader.arrays["body_positions"][:, calf].astype(float))
    assert moved == pytest.approx(loader.arrays["body_linear_velocities"][1:-1, calf], abs=0.1)


SIZES = {"root_pos": 3, "root_rot": 4, "joint_pose": 12, "tar_toe_pos_local": 12}
SIZES |= {"linear_vel": 3, "angular_vel": 3, "joint_vel": 12, "tar_toe_vel_local": 12}


class AmpLoader:
    """What AMP_for_hardware's `rsl_rl/datasets/motion_loader.py` takes from a frame; the files' legs are FR, FL, RR,
    RL, which it reorders."""

    def __init__(self, path: Path) -> None:
        motion = json.loads(path.read_text())
        frames = np.array(motion["Frames"])
        assert frames.shape[1] == sum(SIZES.values()) == 61
        at = np.cumsum([0, *SIZES.values()])
        self.parts = {name: frames[:, a:b] for name, a, b in zip(SIZES, at[:-1], at[1:], strict=True)}
        self.weight = float(motion["MotionWeight"])
        self.frame_duration = float(motion["FrameDuration"])


def test_the_61_numbers_are_what_amp_for_hardwares_loader_takes_them_for(
    motion: Motion, robot: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "walk.txt"
    frames = export_motion(motion, robot, path, "amp", fps=RATE_HZ, duration_s=0.4)
    loader = AmpLoader(path)
    assert (loader.weight, loader.frame_duration) == (1.0, pytest.approx(1 / RATE_HZ))
    found = loader.parts
    assert found["root_pos"] == pytest.approx(frames.root_pos_w, abs=1e-6)
    rotation = matrix_from_quat(found["root_rot"][:, [3, 0, 1, 2]])  # x, y, z, w
    assert rotation == pytest.approx(matrix_from_quat(frames.root_quat_wxyz), abs=1e-5)
    assert found["joint_pose"] == pytest.approx(frames.joint_pos, abs=1e-6)
    toes = found["tar_toe_pos_local"].reshape(-1, 4, 3)
    assert toes == pytest.approx(foot_positions(robot, frames.joint_pos), abs=1e-6)
    assert np.sign(toes[0, :, 1]).tolist() == [-1, 1, -1, 1]  # right before left, as in its own files
    assert np.sign(toes[0, :, 0]).tolist() == [1, 1, -1, -1]

    # rates are those of the columns before them, in the body frame
    world = derivative(found["root_pos"])
    assert np.einsum("tji,tj->ti", rotation[1:-1], world) == pytest.approx(found["linear_vel"][1:-1], abs=0.01)
    spin = np.einsum("tji,tjk->tik", rotation[1:-1], derivative(rotation))
    turning = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    assert turning == pytest.approx(found["angular_vel"][1:-1], abs=0.01)
    assert derivative(found["joint_pose"]) == pytest.approx(found["joint_vel"][1:-1], abs=0.15)
    assert derivative(found["tar_toe_pos_local"]) == pytest.approx(found["tar_toe_vel_local"][1:-1], abs=0.05)


def test_a_motion_library_takes_root_and_joints(motion: Motion, robot: Robot, tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    frames = export_motion(motion, robot, path, "motion-lib", duration_s=1.0)
    entry = dict(np.load(path))
    assert entry["root_trans_offset"] == pytest.approx(frames.root_pos_w, abs=1e-6)
    assert entry["root_rot"][:, [3, 0, 1, 2]] == pytest.approx(frames.root_quat_wxyz, abs=1e-6)
    assert entry["dof"] == pytest.approx(frames.joint_pos, abs=1e-6)
    assert entry["dof_names"].tolist() == list(robot.joint_names)
    assert float(entry["fps"]) == pytest.approx(50.0)


def test_joints_are_about_the_axes_of_the_robots_own_file(robot: Robot, motion: Motion, tmp_path: Path) -> None:
    from dataclasses import replace

    mirrored = replace(robot, joint_sign=np.where(np.arange(12) == 4, -1.0, 1.0))
    for form, name in (("amp", "walk.txt"), ("motion-lib", "walk.npz")):
        once = export_motion(motion, mirrored, tmp_path / name, form, duration_s=0.4)
        path = tmp_path / name
        joints = AmpLoader(path).parts["joint_pose"] if form == "amp" else np.load(path)["dof"]
        assert joints[:, 4] == pytest.approx(-once.joint_pos[:, 4], abs=1e-6)
        assert joints[:, 5] == pytest.approx(once.joint_pos[:, 5], abs=1e-6)
