"""Loading a motion: what names one, and what is refused."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from control.motions import gait
from fastmimic.base.errors import ConfigError, FastMimicError, MotionError, OutputError, RobotError
from fastmimic.clips.catalogue import open_clip
from fastmimic.motion.motion import ARRAYS, Motion
from fastmimic.robot import Robot
from fastmimic.runs.loading import MotionSource, find_motion, load_motion


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return gait(robot, (0.3, 0.05), 0.4, n_samples=200)


class TestLoadMotion:
    def test_a_motion_is_returned_as_it_is(self, motion: Motion, robot: Robot) -> None:
        assert load_motion(motion, robot) is motion

    def test_a_saved_motion_comes_back(self, motion: Motion, tmp_path: Path) -> None:
        motion.save(tmp_path / "motion.npz")
        loaded = load_motion(tmp_path / "motion.npz", "a1")
        np.testing.assert_array_equal(loaded.joint_pos, motion.joint_pos)

    def test_what_is_no_source_is_told(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        with pytest.raises(MotionError, match=r"a Clip or a Motion, found ndarray"):
            load_motion(np.zeros(3), robot)  # type: ignore[arg-type]
        with pytest.raises(OutputError, match=r"x.txt: a motion is written to an .npz"):
            motion.save(tmp_path / "x.txt")
        (tmp_path / "a.csv").write_text("a,b\n1,2\n")
        with pytest.raises(MotionError, match=r"a.csv: not a readable .npz motion \(neither an .npz nor an .npy\)"):
            Motion.load(tmp_path / "a.csv")

    @pytest.mark.parametrize("source", ["trot", "clip"])
    def test_a_name_or_a_clip_is_retargeted(self, robot: Robot, source: str) -> None:
        given = open_clip("trot", robot=robot) if source == "clip" else source
        loaded = load_motion(given, robot)  # type: ignore[arg-type]
        assert loaded.provenance.robot == "a1"
        assert loaded.rate_hz == 500
        assert loaded.cycle is not None

    def test_overrides_reach_the_clip(self, robot: Robot) -> None:
        slow, fast = (load_motion("trot", robot, speed=v) for v in (0.6, 1.0))
        speeds = [float(np.hypot(*m.cycle[:2]) / m.period_s) for m in (slow, fast)]  # type: ignore[index]
        np.testing.assert_allclose(speeds, [0.6, 1.0], rtol=0.03)

    def test_overrides_reach_a_clip_that_is_given(self, robot: Robot) -> None:
        clip = open_clip("trot", robot=robot)
        once = find_motion(clip).open_clip(robot, cycle=False, frames=(0, 20), scale=0.7)
        assert (once.is_cycle, once.n_frames, once.scale) == (False, 20, 0.7)
        assert load_motion(clip, robot, cycle=False).cycle is None
        with pytest.raises(ConfigError, match=r"speed: .* is already read"):
            load_motion(clip, robot, speed=0.6)

    def test_a_clip_is_retargeted_once(self, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(source: MotionSource, *_: object, **options: object) -> None:
            raise LookupError(source.name)

        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        made = load_motion("trot", robot, speed=0.83)
        monkeypatch.setattr(MotionSource, "retarget", refuse)
        kept = load_motion("trot", robot, speed=0.83)
        assert kept.provenance == made.provenance
        for one, other in ((made, kept), (made.animal, kept.animal)):
            for name in (*ARRAYS, "cycle"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        for changed in ({"speed": 0.84}, {"speed": 0.83, "executable": False}, {"speed": 0.83, "scale": 0.7}):
            with pytest.raises(LookupError):
                load_motion("trot", robot, **changed)  # type: ignore[arg-type]

    def test_overrides_do_not_apply_to_a_motion(self, motion: Motion, robot: Robot) -> None:
        with pytest.raises(ConfigError, match="scale, speed cannot be applied to 'synthetic'"):
            load_motion(motion, robot, speed=1.0, scale=2.0, duty=None)

    def test_a_motion_of_another_robot_is_refused(self, motion: Motion) -> None:
        with pytest.raises(MotionError, match="'synthetic' is for robot 'a1', not for 'go1': give that robot"):
            load_motion(motion, "go1")

    def test_an_unknown_name_is_refused_with_the_closest_ones(self) -> None:
        with pytest.raises(FastMimicError, match="trot"):
            load_motion("trott")

    def test_an_unknown_robot_is_refused(self, motion: Motion) -> None:
        with pytest.raises(RobotError, match="unknown robot 'a2'"):
            load_motion(motion, "a2")


class TestFolders:
    @pytest.fixture(autouse=True)
    def folders(self, motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        for name in ("trot", "mine"):
            motion.save(tmp_path / name / "motion.npz")
        (tmp_path / "empty").mkdir()

    def test_a_name_goes_before_a_folder(self) -> None:
        assert find_motion("trot").folder is None
        assert find_motion("trot").motion is None

    @pytest.mark.parametrize("folder", ["./trot", "trot/", "mine", Path("mine")])
    def test_a_folder_is_its_motion(self, folder: str | Path, motion: Motion, robot: Robot) -> None:
        np.testing.assert_array_equal(load_motion(folder, robot).joint_pos, motion.joint_pos)

    @pytest.mark.parametrize(
        ("source", "message"),
        [
            ("", "a motion without a name"),
            (" ", "a motion without a name"),
            ("empty", "empty: a folder without motion.npz"),
        ],
    )
    def test_nothing(self, source: str, message: str) -> None:
        with pytest.raises(MotionError, match=message):
            find_motion(source)

    def test_the_robot_is_that_of_the_motion_or_of_its_run(self, motion: Motion) -> None:
        assert find_motion("mine").robot == "a1"
        assert find_motion("trot").robot is None
        provenance = dataclasses.replace(motion.provenance, robot="mine")
        dataclasses.replace(motion, provenance=provenance).save("other/motion.npz")
        assert find_motion("other").robot is None
        Path("other/config.json").write_text(json.dumps({"arguments": {"robot": "mine.xml"}}))
        assert find_motion("other").robot == "mine.xml"

    def test_damaged_settings_are_one_line(self) -> None:
        for content, said in (("[]", "does not hold a JSON object"), ('{"arguments": 3}', "not the settings of a run")):
            Path("mine/config.json").write_text(content)
            with pytest.raises(MotionError, match=f"mine/config.json: {said}"):
                find_motion("mine").run_arguments()

    def test_a_robot_motion_is_read_once(self, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
        found = find_motion("mine")
        Path("mine/motion.npz").unlink()
        assert found.robot == "a1"
        assert found.load(robot) is found.motion
