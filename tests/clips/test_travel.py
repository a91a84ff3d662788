"""The way that standing feet show, where a recording's trunk does not travel."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ClipError
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar
from fastmimic.clips.catalogue import motion_names, open_clip
from fastmimic.clips.clip import KEYPOINTS, Clip
from fastmimic.clips.formats import ReadOptions, read_clip
from fastmimic.clips.segment import find_segments
from fastmimic.clips.travel import with_travel
from fastmimic.imitation.evaluate import evaluate
from fastmimic.robot import load_robot
from fastmimic.runs.loading import find_motion

DOG = "dog_keypoints/dog_{}_joint_pos.txt"
BELT = np.array([-1.2, 0.0, 0.0])  # m/s


def heading(clip: Clip) -> np.ndarray:
    ahead = clip.point("neck") - clip.point("pelvis")
    return np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))


def speed(clip: Clip) -> float:
    """Mean along the way, sampled every 0.2 s, m/s."""
    step = round(0.2 * clip.rate_hz)
    middle = 0.5 * (clip.point("neck") + clip.point("pelvis"))[::step, :2]
    return float(np.linalg.norm(np.diff(middle, axis=0), axis=1).mean() / 0.2)


def yaw_rate(clip: Clip) -> float:
    """Mean, degrees a second."""
    return float(np.degrees(heading(clip)[-1] - heading(clip)[0])) * clip.rate_hz / clip.n_frames


def on_the_spot(clip: Clip, *, without_heading: bool = False) -> Clip:
    """The clip seen from above its pelvis, and turning with it."""
    points = clip.points_w.copy()
    points[..., :2] -= clip.points_w[:, :1, :2]
    quat = clip.root_quat_wxyz
    if without_heading:
        points[..., :2] = rotate_planar(-heading(clip)[:, None], points[..., :2])
        quat = None if quat is None else quat_multiply(quat_from_yaw(-heading(clip)), quat)
    return replace(clip, points_w=points, body_w=None, skeleton=KEYPOINTS, root_quat_wxyz=quat)


STRAIGHT = ("trot", "pace", "walk", "side-step", "bound", "canter", "backward-trot")


@pytest.mark.parametrize(
    ("name", "without_heading"), [("turn", True), *((name, without) for name in STRAIGHT for without in (False, True))]
)
def test_the_way_of_built_in_gaits_is_found_again(name: str, without_heading: bool) -> None:
    clip = open_clip(name)
    found = with_travel(on_the_spot(clip, without_heading=without_heading))
    assert speed(found) == pytest.approx(speed(clip), rel=0.03)  # their trunks' speed is even, whatever the feet push
    assert yaw_rate(found) == pytest.approx(yaw_rate(clip), abs=2.0)
    (sentence,) = (said for said in found.origin.assumed if "recovered from the standing feet" in said)
    assert ("heading" in sentence) == (without_heading or heading(clip).std() < 0.01)


def test_a_curve_about_the_pelvis_is_recovered_when_asked() -> None:
    clip = open_clip("turn")
    found = with_travel(on_the_spot(clip), "recover")
    assert speed(found) == pytest.approx(speed(clip), rel=0.02)
    assert yaw_rate(found) == pytest.approx(yaw_rate(clip), abs=1e-9)


def test_clips_that_travel_or_stand_stay_as_they_are() -> None:
    recorded = bool(os.environ.get("FASTMIMIC_DATA"))
    names = [name for name in motion_names() if recorded or ":" not in name]
    for name in names:
        clip = open_clip(name)
        assert with_travel(clip) is clip, name
        assert with_travel(clip, "as-is") is clip
    still = Clip(np.repeat(open_clip("walk").points_w[:1], 50, axis=0), 60.0)
    assert with_travel(still) is still


def test_a_belt_may_run_in_any_direction_and_the_trunk_may_sway_on_it() -> None:
    clip = open_clip("walk", speed=0.99)  # at the A1's size: 1.2 m/s in the dog's
    time = np.arange(clip.n_frames) / clip.rate_hz
    points = clip.points_w + time[:, None, None] * BELT
    points[..., :2] = rotate_planar(np.radians(130.0), points[..., :2])
    found = with_travel(Clip(points, clip.rate_hz))
    assert speed(found) == pytest.approx(speed(clip), rel=0.03)
    step = found.point("pelvis")[-1] - found.point("pelvis")[0]
    assert np.degrees(np.arctan2(step[1], step[0])) == pytest.approx(130.0, abs=2.0)


def test_the_option_is_read_and_an_unknown_word_refused(tmp_path: Path) -> None:
    clip = on_the_spot(open_clip("walk"))
    header = ",".join(f"{name}_{a}" for name in ("pelvis", "neck") for a in "xyz")
    header += "," + ",".join(
        f"{leg}_{part}_{a}" for part in ("hip", "toe") for leg in ("FR", "FL", "RR", "RL") for a in "xyz"
    )
    rows = "\n".join(",".join(f"{v:.5f}" for v in frame.ravel()) for frame in clip.points_w)
    path = tmp_path / "walk.csv"
    path.write_text(f"{header}\n{rows}\n")
    assert speed(read_clip(path, ReadOptions(fps=120.0))) > 0.7
    assert speed(read_clip(path, ReadOptions(fps=120.0, travel="as-is"))) < 0.05
    with pytest.raises(ClipError, match=r"travel 'asis'; there are auto, recover, as-is.* did you mean 'as-is'"):
        open_clip(path, fps=120.0, travel="asis")
    with pytest.raises(ClipError, match="travel cannot be set for 'walk'"):
        open_clip("walk", travel="recover")


@pytest.fixture(scope="module")
def data() -> Path:
    folder = os.environ.get("FASTMIMIC_DATA")
    if not folder or not (Path(folder) / DOG.format("walk00")).exists():
        pytest.skip("set FASTMIMIC_DATA to the folder of the recordings ('fastmimic data fetch')")
    return Path(folder)


@pytest.mark.parametrize(
    ("file", "cuts", "heading_deg_per_s"),
    [
        (DOG.format("walk00"), [(162, 201), (101, 580)], 2.0),
        (DOG.format("walk03"), [(448, 481), (177, 545)], 2.0),
        (DOG.format("walk09"), [], 2.0),
        (DOG.format("pace"), [], 3.0),
        (DOG.format("trot"), [], 2.0),  # whose trunk is a third faster in flight than over the feet
        (DOG.format("run00"), [(399, 535), (427, 454)], 2.0),
        (DOG.format("turn00"), [], 3.0),
        ("kine2go/circle_walk.txt", [], 2.0),
        ("kine2go/ellipse_walk.txt", [], 3.0),  # put together from others: its paws slide
        ("kine2go/tight_strafe.txt", [], 3.0),
    ],
)
def test_the_way_of_the_dog_is_found_again(
    file: str, cuts: list[tuple[int, int]], heading_deg_per_s: float, data: Path
) -> None:
    clip = open_clip(data / file)
    found = with_travel(on_the_spot(clip), "recover")
    turned = with_travel(on_the_spot(clip, without_heading=True), "recover")
    for cut in [(0, clip.n_frames), *cuts]:
        true = speed(clip.cut(*cut))
        assert speed(found.cut(*cut)) == pytest.approx(true, rel=0.05)
        assert speed(turned.cut(*cut)) == pytest.approx(true, rel=0.065 if "ellipse" in file else 0.05)
        assert yaw_rate(found.cut(*cut)) == pytest.approx(yaw_rate(clip.cut(*cut)), abs=0.1)
    assert yaw_rate(turned) == pytest.approx(yaw_rate(clip), abs=heading_deg_per_s)


@pytest.mark.parametrize("file", [DOG.format("trot"), DOG.format("run00"), "kine2go/circle_walk.txt"])
def test_a_dog_on_the_spot_is_recognised(file: str, data: Path) -> None:
    clip = open_clip(data / file)
    for without_heading in (False, True):
        on_spot = on_the_spot(clip, without_heading=without_heading)
        assert speed(with_travel(on_spot)) == speed(with_travel(on_spot, "recover"))


@pytest.mark.parametrize("without_heading", [False, True])
def test_the_robot_follows_the_recovered_way_as_it_does_the_recorded_one(without_heading: bool, data: Path) -> None:
    take = open_clip(data / DOG.format("walk00"))
    go2 = load_robot("go2")

    def reward(clip: Clip) -> float:
        result = evaluate(find_motion(clip.cut(162, 201)).load(go2), go2, duration_s=3.0, episodes=2)
        assert result.as_dict()["fell"] == 0
        return float(result.as_dict()["reward_animal"])

    found = with_travel(on_the_spot(take, without_heading=without_heading))
    assert reward(found) == pytest.approx(reward(take), abs=0.02)


@pytest.mark.parametrize(("gait", "slowest", "fastest"), [("walk", 1.4, 1.8), ("trot", 2.7, 4.0)])
def test_the_horse_walks_and_trots_at_its_speed(gait: str, slowest: float, fastest: float, data: Path) -> None:
    takes = sorted((data / "kine2go").glob(f"Horse1_M1_{gait}*.csv"))
    if not takes:
        pytest.skip("kine2go/Horse1_M1_*.csv (Vienna Horse Data Collection) is not in FASTMIMIC_DATA")
    for path in takes:
        (found,) = find_segments(read_clip(path))
        assert found.gait == gait
        assert slowest < found.speed_m_per_s < fastest
        assert abs(found.yaw_rate_rad_per_s) < 0.02
