"""Names of motions: what they open, what they say about it, and what happens when they cannot."""

from pathlib import Path

import numpy as np
import pytest
from sample_files import keypoint_text, save_motion

from fastmimic.base.errors import ClipError
from fastmimic.clips.catalogue import RECORDED, describe, motion_names, open_clip
from fastmimic.clips.synthesis import GAITS

# name: frames, rate (Hz), speed (m/s, from pelvis to pelvis over one period), yaw over one period (deg)
CUTS = {
    "dog:pace": (39, 60, 1.08, -2),
    "dog:trot": (33, 60, 1.78, -2),
    "dog:canter": (29, 60, 3.21, 4),
    "dog:right-turn": (39, 60, 0.83, -38.8),
    "dog:left-turn": (46, 60, 0.36, 99.4),
}
PERIODS_S = {"dog:spin": 0.750, "anim:side-steps": 6.042, "anim:turn": 4.583, "anim:in-place": 6.21}


def heading(clip) -> np.ndarray:
    spine = clip.point("neck") - clip.point("pelvis")
    return np.unwrap(np.arctan2(spine[:, 1], spine[:, 0]))


def test_names():
    assert {"trot", "pace", "turn", "side-step", "walk", "bound", "backward-trot", "spin"} <= set(motion_names())
    assert {*CUTS, *PERIODS_S} == set(RECORDED)


@pytest.mark.parametrize("name", CUTS)
def test_cuts_are_the_known_cycles(data_folder: Path, name: str):
    """Speed and turn within what the missing last step of a cycle (about 1/35 of it) can change."""
    frames, rate, speed, yaw = CUTS[name]
    clip = open_clip(name)
    assert (clip.n_frames, clip.rate_hz, clip.is_cycle) == (frames, rate, True)
    pelvis = clip.point("pelvis")
    travelled = np.linalg.norm(pelvis[-1, :2] - pelvis[0, :2])
    assert travelled / ((frames - 1) / rate) == pytest.approx(speed, rel=0.05)
    assert np.degrees(heading(clip)[-1] - heading(clip)[0]) == pytest.approx(yaw, abs=4)


@pytest.mark.parametrize("name", PERIODS_S)
def test_loops_on_the_laikago_last_one_period(data_folder: Path, name: str):
    clip = open_clip(name)
    assert clip.n_frames / clip.rate_hz == pytest.approx(PERIODS_S[name], abs=0.001)
    assert clip.is_cycle is True


@pytest.mark.parametrize("name", RECORDED)
def test_the_licence_travels(data_folder: Path, name: str):
    origin = open_clip(name).origin
    assert origin.name == name
    assert "CC BY-NC 4.0" in str(origin.licence)
    assert "AI4Animation" in str(origin.credit)
    assert str(origin.source).startswith(("dog_keypoints/", "deepmimic_motions/"))


def test_the_licence_travels_with_a_file_given_by_path(data_folder: Path, tmp_path: Path):
    copy = tmp_path / "mine.dat"
    copy.write_bytes((data_folder / "dog_keypoints" / "dog_pace_joint_pos.txt").read_bytes())
    assert "CC BY-NC 4.0" in str(open_clip(copy).origin.licence)
    copy.write_text(keypoint_text())
    assert open_clip(copy).origin.licence is None


def test_a_file_that_is_not_the_published_one_is_said(data_folder: Path, tmp_path: Path):
    (tmp_path / "dog_keypoints").mkdir()
    (tmp_path / "dog_keypoints" / "dog_walk00_joint_pos.txt").write_text(keypoint_text(300))
    assert any("SHA-256 differs" in s for s in open_clip("dog:pace", folder=tmp_path).origin.assumed)
    assert not any("SHA-256" in s for s in open_clip("dog:pace").origin.assumed)


def test_options_apply_to_recorded_motions(data_folder: Path):
    clip = open_clip("dog:pace", fps=30, scale=0.5, frames=(3, 20))
    np.testing.assert_array_equal(clip.points_w, open_clip("dog:pace").points_w[3:20])
    assert (clip.rate_hz, clip.scale, clip.is_cycle) == (30, 0.5, None)
    with pytest.raises(ClipError, match="dog:pace: frames 3:40 are not in this clip of 39"):
        open_clip("dog:pace", frames=(3, 40))


@pytest.mark.parametrize("name", GAITS)
def test_built_in_gaits_open_without_any_data(name: str, tmp_path: Path):
    clip = open_clip(name, folder=tmp_path)
    assert clip.origin.name == name
    assert clip.origin.source == "built in"
    assert clip.origin.licence
    assert clip.is_cycle is True


def test_options_apply_to_built_in_gaits():
    slow, fast = (open_clip("trot", speed=v).point("pelvis") for v in (0.6, 1.2))
    assert fast[-1, 0] - fast[0, 0] > 1.5 * (slow[-1, 0] - slow[0, 0])
    whole = open_clip("trot")
    clip = open_clip("trot", scale=0.7, frames=(2, 9))
    np.testing.assert_array_equal(clip.points_w, whole.points_w[2:9])
    assert clip.scale == 0.7


@pytest.mark.parametrize("option", [{"fps": 30.0}, {"up": "z"}])
def test_options_of_files_do_not_apply_to_built_in_gaits(option: dict):
    with pytest.raises(ClipError, match="cannot be set for 'trot': it is generated"):
        open_clip("trot", **option)


@pytest.mark.parametrize("option", [{"speed": 1.0}, {"yaw_rate": 1.0}, {"duty": 0.5}])
def test_options_of_built_in_gaits_do_not_apply_to_others(option: dict, tmp_path: Path):
    path = tmp_path / "rex.txt"
    path.write_text(keypoint_text())
    for name in ("dog:pace", path):
        with pytest.raises(ClipError, match=r"cannot be set for .* only the built-in gaits can be varied"):
            open_clip(name, **option)


def test_a_name_without_its_data_says_what_to_run(tmp_path: Path):
    with pytest.raises(ClipError, match=r"dog_walk00_joint_pos\.txt, which is not in .*run 'fastmimic data fetch'"):
        open_clip("dog:pace", folder=tmp_path)


def test_an_unknown_name_offers_the_closest():
    with pytest.raises(ClipError, match=r"'dog:pase' is neither .* did you mean 'dog:pace'"):
        open_clip("dog:pase")
    with pytest.raises(ClipError, match=r"the names are .*trot.*dog:pace"):
        open_clip("qqqqqqqq")


def test_a_path_that_is_not_there_is_called_so(tmp_path: Path):
    with pytest.raises(ClipError, match=r"rex\.txt: no such file"):
        open_clip(tmp_path / "rex.txt")
    with pytest.raises(ClipError, match="no such file"):
        open_clip("trot.csv")


@pytest.mark.parametrize("name", ["", "a" * 5000, "nul\0"])
def test_names_that_cannot_be_paths_are_unknown_names(name: str):
    with pytest.raises(ClipError, match=r"neither the name of a motion nor a file|folder"):
        open_clip(name)


def test_a_robot_motion_is_no_clip(tmp_path: Path):
    with pytest.raises(ClipError, match="robot motion"):
        open_clip(save_motion(tmp_path / "motion.npz"))


def test_every_name_has_a_row(tmp_path: Path):
    rows = {row.name: row for row in describe(tmp_path)}
    assert tuple(rows) == motion_names()
    assert all(rows[name].available for name in GAITS)
    assert not any(rows[name].available for name in RECORDED)
    assert all("CC BY-NC" in rows[name].licence for name in RECORDED)
    assert all(row.about and row.speed and row.source for row in rows.values())


def test_rows_say_what_is_there(data_folder: Path):
    assert all(row.available for row in describe(data_folder))
