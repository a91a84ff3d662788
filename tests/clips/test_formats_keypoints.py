"""Dog keypoints: which column is which point, which axis is up, and what is wrong with a bad file."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from sample_files import HIP_HEIGHT, TOE_HEIGHT, keypoint_text, keypoint_values, table_text

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats import keypoints, read_clip


def test_points_are_named_by_leg_and_turned_z_up():
    clip = keypoints.parse(keypoint_text())
    # x forward, y left, z up: the values that the sample gives to each point
    np.testing.assert_allclose(clip.point("neck")[0], [0.4, 0.0, HIP_HEIGHT], atol=1e-5)
    np.testing.assert_allclose(clip.point("FR_hip")[0], [0.4, -0.04, HIP_HEIGHT], atol=1e-5)
    np.testing.assert_allclose(
        clip.toes_w[0],
        [
            [0.42, -0.06, TOE_HEIGHT],
            [0.41, 0.05, TOE_HEIGHT],
            [0.02, -0.08, TOE_HEIGHT],
            [0.01, 0.07, TOE_HEIGHT],
        ],
        atol=1e-5,
    )
    np.testing.assert_allclose(np.diff(clip.point("pelvis"), axis=0), np.tile([0.01, 0, 0], (11, 1)), atol=1e-5)


def test_rate_and_axis_are_assumed_and_said():
    clip = keypoints.parse(keypoint_text())
    assert clip.rate_hz == 60
    said = " / ".join(clip.origin.assumed)
    assert "60 frames a second" in said
    assert "y is up" in said
    assert "metres" in said


def test_given_rate_is_used_and_not_called_assumed():
    clip = keypoints.parse(keypoint_text(), fps=30)
    assert clip.rate_hz == 30
    assert not any("frames a second" in sentence for sentence in clip.origin.assumed)


def test_a_z_up_file_is_recognised_and_gives_the_same_clip():
    y_up = keypoints.parse(keypoint_text())
    z_up_text = table_text(keypoint_values()[..., [2, 0, 1]])
    for clip in (keypoints.parse(z_up_text), keypoints.parse(z_up_text, up="z")):
        np.testing.assert_array_equal(clip.points_w, y_up.points_w)


def test_an_axis_that_is_not_vertical_is_refused():
    with pytest.raises(ClipError, match="hips do not lie above the toes along z"):
        keypoints.parse(keypoint_text(), up="z")


def test_a_mirrored_file_is_refused():
    mirrored = keypoint_values() * np.array([-1.0, 1.0, 1.0])
    with pytest.raises(ClipError, match="left-handed"):
        keypoints.parse(table_text(mirrored))


@pytest.mark.parametrize("separator", [",", ",\t", ";", " ", "\t"])
def test_any_usual_separator_is_read(separator: str):
    clip = keypoints.parse(table_text(keypoint_values(), separator))
    np.testing.assert_array_equal(clip.points_w, keypoints.parse(keypoint_text()).points_w)


@pytest.mark.parametrize("ending", ["\r\n", "\r"])
def test_line_endings_of_other_systems_are_read(ending: str):
    assert keypoints.parse(keypoint_text().replace("\n", ending)).n_frames == 12


def unread(text: str) -> str:
    """What is said of the first line of a clip that cannot be read."""
    (found,) = (said for said in keypoints.parse(text).origin.assumed if "cannot be read" in said)
    return str(found)


def test_wrong_number_of_columns_names_the_line():
    lines = keypoint_text().splitlines()
    lines[4] = lines[4].rsplit(",", 1)[0]
    assert "(the first: line 5 has 80 columns; expected 81 (dog keypoints))" in unread("\n".join(lines))
    lines[:] = [line.rsplit(",", 1)[0] for line in lines]
    with pytest.raises(ClipError, match=r"line 1 has 80 columns; expected 81 \(dog keypoints\)$"):
        keypoints.parse("\n".join(lines))


def test_a_file_cut_off_in_its_last_line_is_called_truncated():
    text = keypoint_text()
    assert "the file may be truncated" in unread(text[: len(text) - 100])
    assert keypoints.parse(text[: len(text) - 100]).n_frames == 11


def test_a_minute_that_was_not_tracked_leaves_the_others(data_folder: Path) -> None:
    lines = (data_folder / "dog_keypoints" / "dog_walk03_joint_pos.txt").read_text().splitlines()
    whole = keypoints.parse("\n".join(lines))
    lines[200:260] = [",".join(["nan"] * 81)] * 60
    lines[300] = lines[300].replace(lines[300].split(",")[31], "", 1)
    rest = keypoints.parse("\n".join(lines))
    assert rest.origin.parts == ((0, 200), (260, len(lines)))
    assert rest.body_w is not None
    assert whole.body_w is not None
    first, end = rest.origin.frames
    np.testing.assert_allclose(rest.points_w, whole.points_w[first:end], atol=0.02)
    np.testing.assert_allclose(rest.body_w, whole.body_w[first:end], atol=0.02)


@pytest.mark.parametrize(
    ("written", "problem"),
    [
        ("-inf", "-inf is not finite"),
        ("1e9", "1e+09 is too large"),
        ("abc", "'abc' is not a number"),
    ],
)
def test_a_bad_value_names_line_column_and_point(written: str, problem: str):
    lines = keypoint_text().splitlines()
    fields = lines[2].split(",")
    fields[31] = written  # 0-based 31 = point 10 (left front toe), y
    lines[2] = ",".join(fields)
    assert f"(the first: line 3, column 32 (point 10 y): {problem})" in unread("\n".join(lines))


def test_line_numbers_count_blank_and_comment_lines():
    text = "# a dog\n\n" + keypoint_text().replace("0.37000", "1e9", 1)
    assert "line 3, column 2" in unread(text)


def test_a_single_frame_is_no_clip():
    with pytest.raises(ClipError, match="at least 2 frames, found 1"):
        keypoints.parse(keypoint_text(1))


def test_real_takes_are_upright_dogs(data_folder):
    """Known of these takes: 567 frames at 60 Hz, toes within 2 cm of the ground, left and right as named."""
    clip = read_clip(data_folder / "dog_keypoints" / "dog_run00_joint_pos.txt")
    assert (clip.n_frames, clip.rate_hz) == (567, 60)
    assert np.all(np.abs(np.percentile(clip.toes_w[..., 2], 1, axis=0)) < 0.025)
    forward = clip.point("neck") - clip.point("pelvis")
    left = np.cross([0, 0, 1], forward)
    assert np.all(np.sum(left * (clip.point("RL_hip") - clip.point("RR_hip")), axis=1) > 0)


def test_all_points_are_kept_for_pictures_and_cut_with_the_others():
    clip = keypoints.parse(keypoint_text())
    assert clip.drawn_w.shape == (clip.n_frames, 27, 3)
    np.testing.assert_array_equal(clip.drawn_w[:, [0, 3, 11, 6, 20, 16, 15, 10, 23, 19]], clip.points_w)
    assert clip.cut(2, 7).drawn_w.tobytes() == clip.drawn_w[2:7].tobytes()
    with pytest.raises(ClipError, match=r"the skeleton's points have shape \(2, 27, 3\); expected \(12, 27, 3\)"):
        dataclasses.replace(clip, body_w=clip.body_w[:2])
