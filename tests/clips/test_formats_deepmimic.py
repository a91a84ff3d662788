"""DeepMimic-style JSON: the Laikago's feet, the loop, and what is wrong with a bad file."""

import json

import numpy as np
import pytest
from sample_files import deepmimic_document, deepmimic_text

from fastmimic.base.errors import ClipError
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.clips.formats import deepmimic, read_clip

MIRROR = np.array([1.0, -1.0, 1.0])
FILES = ("dog_pace", "dog_trot", "dog_spin", "inplace_steps", "sidesteps", "turn")


def test_feet_at_zero_angles_are_the_sum_of_the_link_vectors():
    feet = deepmimic.laikago_feet(np.zeros(12))
    # x: 0.1991 - 0.1422 - 0.022; y: 0.0817 + 0.055855 - 0.02069; z: -0.03 - 0.20833 - 0.25
    np.testing.assert_allclose(feet[1], [0.0349, 0.116865, -0.48833], atol=1e-12)
    np.testing.assert_allclose(feet[2], [-0.4024, -0.114575, -0.48833], atol=1e-12)


def test_feet_of_equal_angles_mirror_each_other():
    """Left and right differ only by the model's 2.3 mm in the lateral hip offset."""
    angles = np.tile([0.2, 0.4, -1.1], 4)
    feet = deepmimic.laikago_feet(angles)
    np.testing.assert_allclose(feet[[0, 2]], feet[[1, 3]] * MIRROR, atol=0.0023)


def test_positive_abduction_moves_both_feet_outwards():
    out = deepmimic.laikago_feet(np.tile([0.3, 0.3, -0.9], 4)) - deepmimic.laikago_feet(np.tile([0, 0.3, -0.9], 4))
    assert np.all(out[:, 1] * [-1, 1, -1, 1] > 0.1)


def test_legs_keep_their_length_at_any_angle():
    angles = np.random.default_rng(0).uniform(-1, 1, (50, 4, 3))
    angles[..., 1:] = 0.3, -0.9  # only abduction moves: the distance to its origin cannot change
    feet = deepmimic.laikago_feet(angles.reshape(50, 12))
    distance = np.linalg.norm(feet - deepmimic._ABDUCTION_ORIGIN_B, axis=-1)
    np.testing.assert_allclose(distance, np.broadcast_to(distance[0], distance.shape), atol=1e-12)


def test_a_level_forward_body_has_the_identity_orientation():
    clip = deepmimic.parse(deepmimic_text())
    np.testing.assert_allclose(np.abs(clip.root_quat_wxyz), np.tile([1.0, 0, 0, 0], (8, 1)), atol=1e-12)
    np.testing.assert_allclose(clip.point("neck")[0], [0.1991, 0, 0.438 - 0.03], atol=1e-12)
    np.testing.assert_allclose(clip.point("RL_hip")[0], [-0.2382, 0.0817, 0.408], atol=1e-12)


def test_wrap_drops_the_repeated_frame_and_is_a_cycle():
    clip = deepmimic.parse(deepmimic_text(9))
    assert clip.n_frames == 8
    assert clip.is_cycle is True
    assert clip.rate_hz == pytest.approx(50)


def test_clamp_keeps_all_frames_and_is_no_cycle():
    clip = deepmimic.parse(json.dumps(deepmimic_document(9) | {"LoopMode": "Clamp"}))
    assert clip.n_frames == 9
    assert clip.is_cycle is False


def test_a_loop_that_does_not_close_is_said():
    document = deepmimic_document()
    document["Frames"][-1][7] += 0.25
    assert any("differ by 0.25 rad" in s for s in deepmimic.parse(json.dumps(document)).origin.assumed)
    assert not any("close" in s for s in deepmimic.parse(deepmimic_text()).origin.assumed)


def test_given_rate_replaces_frame_duration():
    document = deepmimic_document()
    assert deepmimic.parse(json.dumps(document), fps=25).rate_hz == 25
    del document["FrameDuration"]
    assert deepmimic.parse(json.dumps(document), fps=25).rate_hz == 25
    with pytest.raises(ClipError, match="without 'FrameDuration'"):
        deepmimic.parse(json.dumps(document))


@pytest.mark.parametrize("duration", [0, -0.02, "fast", None, True, 1e-300, 1e300, 10**400])
def test_a_bad_frame_duration_is_refused(duration):
    with pytest.raises(ClipError, match=r"FrameDuration|frame rate"):
        deepmimic.parse(json.dumps(deepmimic_document() | {"FrameDuration": duration}))


def test_wrong_number_of_values_names_line_and_frame():
    text = deepmimic_text().replace(", -0.86]", "]", 1)
    with pytest.raises(ClipError, match=r"line 7 \(frame 0\) has 18 numbers; expected 19"):
        deepmimic.parse(text)


@pytest.mark.parametrize(
    ("written", "problem"),
    [
        ("NaN", "not finite"),
        ("-Infinity", "not finite"),
        ("1e9", "too large"),
        ('"a"', "not a number"),
        ("true", "not a"),
    ],
)
def test_a_bad_value_names_line_frame_and_quantity(written: str, problem: str):
    lines = deepmimic_text().split("\n")
    lines[8] = lines[8].replace("0.438", written)  # the third frame, on line 9
    with pytest.raises(ClipError, match=rf"line 9 \(frame 2\), number 3 \(root z\): .*{problem}"):
        deepmimic.parse("\n".join(lines))


def test_a_quaternion_that_is_not_unit_names_the_frame():
    lines = deepmimic_text().split("\n")
    lines[9] = lines[9].replace("0.5, 0.5, 0.5, 0.5", "0.5, 0.5, 0.5, 0.9")
    with pytest.raises(ClipError, match=r"line 10 \(frame 3\): the root quaternion .* norm 1\.249; expected 1"):
        deepmimic.parse("\n".join(lines))


def test_unknown_loop_mode_lists_the_known_ones():
    with pytest.raises(ClipError, match=r'LoopMode is "Loop"; expected one of Wrap, Clamp'):
        deepmimic.parse(json.dumps(deepmimic_document() | {"LoopMode": "Loop"}))


def test_a_truncated_file_is_called_so():
    text = deepmimic_text().rstrip()
    with pytest.raises(ClipError, match=r"line \d+, column \d+: not valid JSON .* truncated"):
        deepmimic.parse(text[:-1])


@pytest.mark.parametrize("text", ["[1, 2]", '{"Frames": 3}', '{"Frames": [1]}', "{}", "[" * 5000, '{"frames": []}'])
def test_other_json_is_refused(text: str):
    with pytest.raises(ClipError, match=r"JSON|Frames"):
        deepmimic.parse(text)


def test_a_single_frame_is_no_clip():
    with pytest.raises(ClipError, match="at least 2 frames, found 1"):
        deepmimic.parse(deepmimic_text(1))


@pytest.mark.parametrize("name", FILES)
def test_real_files_stand_on_the_ground(data_folder, name: str):
    """The Laikago's foot sphere has a radius of 26 mm; the animal's clips press it in by up to 15 mm."""
    clip = read_clip(data_folder / "deepmimic_motions" / f"{name}.txt")
    lowest = clip.toes_w[..., 2].min(axis=0)
    assert np.all((lowest > 0.010) & (lowest < 0.028))
    assert matrix_from_quat(clip.root_quat_wxyz)[:, 2, 2].min() > 0.98  # level: tilted by less than 11.5°
    assert clip.is_cycle


@pytest.mark.parametrize("name", ["sidesteps", "turn"])
def test_animators_standing_feet_do_not_slide(data_folder, name: str):
    """A standing foot that moves by less than 1 cm/s most of the time: angles and trunk fit together."""
    clip = read_clip(data_folder / "deepmimic_motions" / f"{name}.txt")
    speed = np.linalg.norm(np.diff(clip.toes_w, axis=0), axis=-1) * clip.rate_hz
    standing = clip.toes_w[1:, :, 2] < 0.027
    assert np.median(speed[standing]) < 0.01
