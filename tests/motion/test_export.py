"""Motions for other trainers: what is written is the motion, and reads back as it."""

import dataclasses
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from control.motions import gait, turned
from fastmimic.base.conventions import JOINT_NAMES
from fastmimic.base.errors import ClipError, ConfigError, MotionError
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar
from fastmimic.cli import main
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import ReadOptions, detect_format, read_clip
from fastmimic.clips.formats.points import robot_points
from fastmimic.motion.export import DECIMALS, EXPORTS, export_motion, sample
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions

PRECISION = 0.5 * 10.0**-DECIMALS


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return turned(gait(robot, (0.4, 0.1), 0.6), 0.7, (1.0, -2.0))


def points(robot: Robot, root: np.ndarray, quat: np.ndarray, joints: np.ndarray) -> np.ndarray:
    return robot_points(root, quat, robot.hip_pos_b, foot_positions(robot, joints))


class TestSampling:
    def test_frames_are_the_motions_samples(self, motion: Motion) -> None:
        frames = sample(motion, 50.0)
        assert frames.fps == pytest.approx(50.0)
        assert frames.n == 501  # 10 s and the frame at its end
        for name in ("root_pos_w", "joint_pos", "joint_vel", "root_lin_vel_w", "root_ang_vel_w"):
            assert getattr(frames, name)[:25] == pytest.approx(getattr(motion, name)[::10])

    def test_a_cycle_goes_on_where_it_ended(self, motion: Motion) -> None:
        frames = sample(motion, 50.0)
        period = 25
        turn = motion.cycle[2]
        assert frames.joint_pos[period:] == pytest.approx(frames.joint_pos[:-period])
        moved = quat_multiply(quat_from_yaw(np.array(turn)), frames.root_quat_wxyz[:-period])
        assert np.abs(np.sum(moved * frames.root_quat_wxyz[period:], axis=1)) == pytest.approx(1.0)
        assert frames.root_lin_vel_w[period:, :2] == pytest.approx(
            rotate_planar(np.array(turn), frames.root_lin_vel_w[:-period, :2])
        )
        # the body is on a constant twist: positions are the velocity's integral across the wrap
        step = np.diff(frames.root_pos_w[:, :2], axis=0) * frames.fps
        middle = 0.5 * (frames.root_lin_vel_w[1:, :2] + frames.root_lin_vel_w[:-1, :2])
        assert step == pytest.approx(middle, abs=1e-3)

    def test_between_samples_there_is_a_line(self, motion: Motion) -> None:
        frames = sample(motion, 60.0, 0.4)
        times = np.arange(frames.n) / frames.fps
        exact = np.array([np.interp(times, np.arange(250) / 500, motion.joint_pos[:, j]) for j in range(12)]).T
        assert frames.joint_pos == pytest.approx(exact, abs=1e-9)
        assert np.linalg.norm(frames.root_quat_wxyz, axis=1) == pytest.approx(1.0)

    def test_a_motion_that_ends_is_not_repeated(self, motion: Motion) -> None:
        ends = dataclasses.replace(motion, cycle=None)
        frames = sample(ends, 50.0)
        assert frames.root_pos_w == pytest.approx(motion.root_pos_w[::10])
        with pytest.raises(ConfigError, match=r"does not repeat and lasts 0\.498 s"):
            sample(ends, 50.0, 3.0)

    @pytest.mark.parametrize("fps", [0.0, -1.0, 501.0, np.nan])
    def test_rates_that_cannot_be_are_refused(self, motion: Motion, fps: float) -> None:
        with pytest.raises(ConfigError, match="frames a second must be above 0 and at most the motion's 500"):
            sample(motion, fps)


class TestText:
    def read(self, path: Path, robot: Robot) -> Clip:
        return read_clip(path, ReadOptions(robot=robot))

    def test_deepmimic_reads_back_within_its_decimals(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        path = tmp_path / "walk.txt"
        frames = export_motion(motion, robot, path, "deepmimic")
        document = json.loads(path.read_text())
        rows = np.array(document["Frames"])
        assert document["LoopMode"] == "Wrap"
        assert document["Robot"] == "a1"
        assert document["Joints"] == list(JOINT_NAMES)
        assert rows.shape == (26, 19)
        assert rows[:, :3] == pytest.approx(frames.root_pos_w, abs=1.01 * PRECISION)
        assert rows[:, [6, 3, 4, 5]] == pytest.approx(frames.root_quat_wxyz, abs=1.01 * PRECISION)
        assert rows[:, 7:] == pytest.approx(frames.joint_pos, abs=1.01 * PRECISION)

        clip = self.read(path, robot)
        assert detect_format(path) == "deepmimic"
        assert clip.is_cycle is True
        assert clip.rate_hz == pytest.approx(50.0)
        assert clip.n_frames == 25
        samples = slice(None, None, 10)
        expected = points(robot, motion.root_pos_w[samples], motion.root_quat_wxyz[samples], motion.joint_pos[samples])
        assert clip.points_w == pytest.approx(expected, abs=10 * PRECISION)  # a lever of a metre, some angles

    def test_it_is_the_named_robots(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        path = tmp_path / "walk.txt"
        export_motion(motion, robot, path, "deepmimic")
        assert np.array_equal(read_clip(path).points_w, read_clip(path, ReadOptions(robot=robot)).points_w)
        with pytest.raises(ClipError, match="those of robot \"a1\", not 'go1'"):
            read_clip(path, ReadOptions(robot=load_robot("go1")))
        path.write_text(path.read_text().replace('"a1"', '"zebra"'))
        with pytest.raises(ClipError, match='those of robot "zebra"'):
            read_clip(path)

    def test_csv_reads_back_within_its_decimals(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        path = tmp_path / "walk.csv"
        frames = export_motion(motion, robot, path, "csv", duration_s=2.0)
        clip = self.read(path, robot)
        assert detect_format(path) == "csv"
        assert clip.rate_hz == pytest.approx(50.0, rel=1e-5)
        expected = points(robot, frames.root_pos_w, frames.root_quat_wxyz, frames.joint_pos)
        assert clip.points_w == pytest.approx(expected, abs=10 * PRECISION)

    def test_a_gait_of_a_file_is_the_gait(
        self, robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """From the command line and back: the retargeted motion again."""
        path = tmp_path / "pace.txt"
        assert main(["export", "pace", "--format", "deepmimic", "--rate", "500", "--out", str(path)]) == 0
        assert "301 frames at 500 per second for a1" in capsys.readouterr().out
        assert main(["retarget", str(path), "--out", str(tmp_path / "again.npz")]) == 0
        assert main(["retarget", "pace", "--out", str(tmp_path / "pace.npz")]) == 0
        again, once = (Motion.load(tmp_path / f"{name}.npz") for name in ("again", "pace"))
        assert again.cycle == pytest.approx(once.cycle, abs=2e-3)
        assert again.n_samples == once.n_samples


class TestMjlab:
    def test_bodies_are_where_mujoco_has_them(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        path = tmp_path / "walk.npz"
        frames = export_motion(motion, robot, path, "mjlab", duration_s=1.0)
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        t, b = 51, 13
        assert {name: arrays[name].shape for name in arrays} == {
            "fps": (1,),
            "joint_pos": (t, 12),
            "joint_vel": (t, 12),
            "joint_names": (12,),
            "body_names": (b,),
            "body_pos_w": (t, b, 3),
            "body_quat_w": (t, b, 4),
            "body_lin_vel_w": (t, b, 3),
            "body_ang_vel_w": (t, b, 3),
        }
        assert arrays["fps"][0] == pytest.approx(50.0)
        assert arrays["joint_names"].tolist() == list(robot.joint_names)
        assert arrays["joint_pos"] == pytest.approx(frames.joint_pos, abs=1e-6)
        # the base comes first
        assert arrays["body_pos_w"][:, 0] == pytest.approx(frames.root_pos_w, abs=1e-6)
        assert arrays["body_quat_w"][:, 0] == pytest.approx(frames.root_quat_wxyz, abs=1e-6)
        assert arrays["body_lin_vel_w"][:, 0] == pytest.approx(frames.root_lin_vel_w, abs=1e-6)
        assert arrays["body_ang_vel_w"][:, 0] == pytest.approx(frames.root_ang_vel_w, abs=1e-6)
        # and every body is named: its pose as MuJoCo computes it
        model = robot.spec().compile()
        data = mujoco.MjData(model)
        data.qpos[:3], data.qpos[3:7] = frames.root_pos_w[7], frames.root_quat_wxyz[7]
        for name, angle in zip(robot.joint_names, frames.joint_pos[7], strict=True):
            data.joint(name).qpos = angle
        mujoco.mj_kinematics(model, data)
        for k, name in enumerate(arrays["body_names"]):
            assert arrays["body_pos_w"][7, k] == pytest.approx(data.body(str(name)).xpos, abs=1e-6)

    def test_velocities_are_the_positions_derivatives(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        path = tmp_path / "walk.npz"
        export_motion(motion, robot, path, "mjlab", fps=500.0, duration_s=0.6)
        with np.load(path) as file:
            arrays = dict(file)
        moved = (arrays["body_pos_w"][2:].astype(float) - arrays["body_pos_w"][:-2]) * 250.0
        assert np.abs(moved - arrays["body_lin_vel_w"][1:-1]).max() < 0.05  # m/s, of float32 positions
        before, after = arrays["body_quat_w"][:-2].astype(float), arrays["body_quat_w"][2:].astype(float)
        conjugate = before * [1, -1, -1, -1]
        turn = quat_multiply(after, conjugate)
        turn *= np.sign(turn[..., :1])
        assert np.abs(2 * turn[..., 1:] * 250.0 - arrays["body_ang_vel_w"][1:-1]).max() < 0.3  # rad/s


@pytest.mark.parametrize(("form", "suffix"), list(EXPORTS.items()))
def test_a_name_without_an_ending_gets_that_of_the_format(
    form: str, suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "trot", "--format", form, "--out", str(tmp_path / "trot")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == [f"trot{suffix}"]
    assert f"trot{suffix}" in capsys.readouterr().out


class TestRefusals:
    def test_what_does_not_fit(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match=r"unknown format 'mjalb'.*did you mean 'mjlab'"):
            export_motion(motion, robot, tmp_path / "x.npz", "mjalb")
        with pytest.raises(MotionError, match="for robot 'a1', not for 'go1'"):
            export_motion(motion, load_robot("go1"), tmp_path / "x.csv", "csv")
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("--format", "bvh", "--out", "x.bvh"), "unknown format 'bvh'"),
            (("--format", "mjlab", "--out", "x.csv"), "must end in .npz"),
            (("--format", "mjlab", "--out", "."), "must end in .npz"),
            (("--format", "mjlab", "--out", ".."), "must end in .npz"),
            (("--format", "csv", "--out", "x.csv", "--rate", "1000"), "frames a second must be above 0 and at most"),
        ],
    )
    def test_one_line(
        self,
        arguments: tuple[str, ...],
        message: str,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        monkeypatch.chdir(tmp_path)
        assert main(["export", "trot", *arguments]) == 2
        assert message in capsys.readouterr().err
        assert not list(tmp_path.iterdir())
