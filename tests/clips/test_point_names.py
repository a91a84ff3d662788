"""Which of a file's points are the ten: known sets of names, guesses, and the map to complete when they fail."""

import json
from pathlib import Path

import numpy as np
import pytest
from test_gaps import RATE, walk

from fastmimic.base.errors import ClipError
from fastmimic.clips.clip import POINT_NAMES
from fastmimic.clips.formats import ReadOptions, read_clip
from fastmimic.clips.formats.point_names import BUILT_IN, UNKNOWN, guess
from fastmimic.clips.formats.points import find_axes

# In the order of POINT_NAMES: pelvis, neck, hips FR FL RR RL, toes FR FL RR RL.
SETS = {
    "AP-10K": "Root of tail,Neck,R_Shoulder,L_Shoulder,R_Hip,L_Hip,R_F_Paw,L_F_Paw,R_B_Paw,L_B_Paw",
    "AcinoSet": "tail_base,neck_base,r_shoulder,l_shoulder,r_hip,l_hip,"
    "r_front_ankle,l_front_ankle,r_back_ankle,l_back_ankle",
    "two letters": "pelvis,withers,RF_shoulder,LF_shoulder,RH_hip,LH_hip,RF_toe,LF_toe,RH_toe,LH_toe",
    "robots": "pelvis,neck,FR_hip,FL_hip,RR_hip,RL_hip,FR_paw,FL_paw,RR_paw,RL_paw",
    "camel case": "tailBase,neckBase,rightShoulder,leftShoulder,rightHip,leftHip,"
    "frontRightPaw,frontLeftPaw,hindRightPaw,hindLeftPaw",
    "words": "tail_base,withers,right_front_shoulder,left_front_shoulder,right_hind_hip,left_hind_hip,"
    "right_front_paw,left_front_paw,right_hind_paw,left_hind_paw",
    "horse": "Sacrum,Withers,RShoulder,LShoulder,RHip,LHip,RFHoof,LFHoof,RHHoof,LHHoof",
    "a rig": "Hips,Neck,RightShoulder,LeftShoulder,RightUpLeg,LeftUpLeg,RightHand,LeftHand,RightFoot,LeftFoot",
}
OTHERS = [
    "nose",
    "tail_tip",
    "tail1",
    "L_eye",
    "r_elbow",
    "left_front_knee",
    "right_hind_knee",
    "Throat",
    "spine",
    "LeftLeg",
]


@pytest.mark.parametrize("title", SETS)
def test_names_that_people_use_are_guessed_among_others(title: str) -> None:
    names = SETS[title].split(",")
    assert guess([*OTHERS, *names]) == dict(zip(POINT_NAMES, names, strict=True))


def test_of_a_front_foot_that_says_nothing_no_hind_foot_is_made() -> None:
    found = guess(["LFoot", "RFoot", "LFootBack", "RFootBack"])  # as in the SMAL model of dogs
    assert (found["RL_toe"], found["RR_toe"], found["FL_toe"]) == ("LFootBack", "RFootBack", UNKNOWN)


def test_two_points_with_the_same_words_are_not_chosen_from() -> None:
    assert guess(["left_hind_toe_1", "left_hind_toe_2"])["RL_toe"] == UNKNOWN


def test_built_in_maps_name_all_ten() -> None:
    for points in BUILT_IN.values():
        assert tuple(points) in (POINT_NAMES, POINT_NAMES[:2] + POINT_NAMES[6:])
        assert len(set(points.values())) == len(points)
    assert BUILT_IN["SuperAnimal-Quadruped"]["RL_hip"] == "back_left_thai"


def named(path: Path, names: list[str]) -> Path:
    points = walk(2)
    header = ",".join(["time", *(f"{name}_{axis}" for name in names for axis in "xyz")])
    rows = np.column_stack([np.arange(len(points)) / RATE, points.reshape(len(points), -1)])
    path.write_text("\n".join([header, *(",".join(f"{v:.7f}" for v in row) for row in rows)]))
    return path


def test_a_guess_is_said(tmp_path: Path) -> None:
    clip = read_clip(named(tmp_path / "dog.csv", SETS["AP-10K"].split(",")))
    np.testing.assert_allclose(clip.points_w, walk(2), atol=1e-6)
    assert any("pelvis Root of tail, neck Neck, FR_hip R_Shoulder" in said for said in clip.origin.assumed)


def test_without_a_guess_the_error_holds_a_map_to_complete(tmp_path: Path) -> None:
    names = ["t0", "withers", "a", "b", "c", "d", *SETS["AP-10K"].split(",")[6:]]
    path = named(tmp_path / "dog.csv", names)
    with pytest.raises(ClipError, match=r"complete this point map .*--point-map FILE\.json") as caught:
        read_clip(path)
    template = json.loads(str(caught.value).split("FILE.json: ")[1])
    assert template["neck"] == "withers"
    assert template["FR_toe"] == "R_F_Paw"
    assert template["FR_hip"] == template["pelvis"] == "?"
    unknown = dict(zip(["pelvis", "FR_hip", "FL_hip", "RR_hip", "RL_hip"], ["t0", *"abcd"], strict=True))
    (tmp_path / "map.json").write_text(json.dumps(template | unknown))
    clip = read_clip(path, ReadOptions(point_map=tmp_path / "map.json"))
    np.testing.assert_allclose(clip.points_w, walk(2), atol=1e-6)


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_any_axis_can_be_up(up: str) -> None:
    points = walk(2)
    turned = {
        "x": points[..., [2, 0, 1]],
        "y": points[..., [1, 2, 0]],
        "z": points,
        "-x": points[..., [2, 0, 1]] * [-1, 1, -1],
        "-y": points[..., [1, 2, 0]] * [-1, -1, 1],
        "-z": points * [1, -1, -1],
    }[up]
    axes = find_axes(100 * turned, RATE, None, None, is_level=True)
    assert axes.up == up
    np.testing.assert_allclose(axes.to_world(100 * turned), points, atol=1e-9)


def test_a_camera_that_looks_down_is_levelled() -> None:
    from scipy.spatial.transform import Rotation

    points = walk(4)
    pitch = Rotation.from_euler("x", 25, degrees=True).as_matrix()
    seen = points[..., [1, 2, 0]] * [-1, -1, 1] @ pitch.T  # x right, y down, z away
    axes = find_axes(1000 * seen, RATE, None, None, is_level=False)
    assert any("tilted by 25°" in note for note in axes.notes)
    levelled = axes.to_world(1000 * seen)
    standing = levelled[:, 6:10, 2].min(axis=1)
    assert np.ptp(standing) < 0.02
    level = find_axes(points, RATE, None, None, is_level=False)
    np.testing.assert_array_equal(level.to_world(points), points)


def test_recorded_dogs_are_levelled_within_two_degrees(data_folder: Path) -> None:
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_euler("xy", [20, -25], degrees=True).as_matrix()
    for path in sorted((data_folder / "dog_keypoints").glob("dog_*.txt")):
        clip = read_clip(path)
        level = find_axes(clip.points_w, clip.rate_hz, "z", None, is_level=False)
        assert level.tilt is None, path.name
        tilt = find_axes(clip.points_w @ turned.T, clip.rate_hz, "z", None, is_level=False).tilt
        assert tilt is not None
        assert np.degrees(np.arccos((tilt @ turned)[2, 2])) < 2, path.name


def test_pixels_are_refused() -> None:
    with pytest.raises(ClipError, match="pixels have no unit of length"):
        find_axes(1e4 * walk(1), RATE, None, None, is_level=True)


def test_the_vertical_axis_can_be_given_with_its_sign(tmp_path: Path) -> None:
    path = named(tmp_path / "dog.csv", SETS["horse"].split(","))
    for up, words in (("-z", "the hips do not lie above the toes along -z"), ("x", "along x")):
        with pytest.raises(ClipError, match=words):
            read_clip(path, ReadOptions(up=up))
    clip = read_clip(path, ReadOptions(up="z"))
    assert not any("is up" in said for said in clip.origin.assumed)
