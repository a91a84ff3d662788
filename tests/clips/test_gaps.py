"""Imperfect tracks: short gaps and outliers are filled and said, long gaps split the take."""

import json
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ClipError
from fastmimic.cli import main
from fastmimic.clips.catalogue import open_clip, open_parts
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats import ReadOptions, read_clip
from fastmimic.clips.formats.gaps import fill_gaps, outliers
from fastmimic.clips.formats.points import swapped_pairs
from fastmimic.clips.synthesis import GAITS, generate
from fastmimic.dataset.excerpts import DatasetSource, survey

RATE = 120.0
TOE = POINT_NAMES.index("FR_toe")


def walk(cycles: int = 3) -> np.ndarray:
    clip = generate("walk")
    step = (clip.points_w[-1] - clip.points_w[0])[:2].mean(axis=0) * clip.n_frames / (clip.n_frames - 1)
    return np.concatenate([clip.points_w + k * step for k in range(cycles)])


def table_text(points: np.ndarray) -> str:
    """A table by name; a point that is NaN is empty."""
    header = ",".join(["time", *(f"{name}_{axis}" for name in POINT_NAMES for axis in "xyz")])
    rows = [
        ",".join([f"{i / RATE:.6f}", *("" if np.isnan(v) else f"{v:.7f}" for v in frame.ravel())])
        for i, frame in enumerate(points)
    ]
    return "\n".join([header, *rows]) + "\n"


def test_a_whole_take_is_left_as_it_is() -> None:
    points = walk()
    filled = fill_gaps(points, RATE)
    np.testing.assert_array_equal(filled.points, points)
    assert (filled.parts, filled.notes) == ([(0, len(points))], [])


@pytest.mark.parametrize("name", sorted(GAITS))
def test_no_gait_has_outliers(name: str) -> None:
    assert not outliers(generate(name).points_w, RATE).any()


def test_no_frame_of_the_recorded_dogs_is_an_outlier(data_folder: Path) -> None:
    for path in sorted((data_folder / "dog_keypoints").glob("dog_*.txt")):
        clip = read_clip(path)
        for every in (1, 2):
            assert not outliers(clip.points_w[::every], clip.rate_hz / every).any(), path.name


@pytest.mark.parametrize("swapped", [["FR_toe"], ["RR_hip"], ["FR_toe", "RR_toe"]])
def test_a_pair_whose_names_are_swapped_is_swapped_back_and_said(swapped: list[str], tmp_path: Path) -> None:
    points = walk()
    for name in swapped:
        right = POINT_NAMES.index(name)
        points[:, [right, right + 1]] = points[:, [right + 1, right]]
    (tmp_path / "points.csv").write_text(table_text(points))
    clip = read_clip(tmp_path / "points.csv")
    np.testing.assert_allclose(clip.points_w, walk(), atol=1e-6)
    said = [sentence for sentence in clip.origin.assumed if "swapped" in sentence]
    assert [sentence.split(" ")[0] for sentence in said] == swapped


def test_a_neck_above_the_pelvis_has_no_heading() -> None:
    points = generate("trot").points_w.copy()
    points[3, 1, :2] = points[3, 0, :2]
    with pytest.raises(ClipError, match="above one another in frame 3"):
        swapped_pairs(points)


def test_no_recorded_dog_and_no_gait_has_a_swapped_pair(data_folder: Path) -> None:
    for path in sorted((data_folder / "dog_keypoints").glob("dog_*.txt")):
        assert not swapped_pairs(read_clip(path).points_w), path.name
    for name in GAITS:
        assert not swapped_pairs(generate(name).points_w), name


def test_a_short_gap_is_filled_close_to_the_path_and_said(tmp_path: Path) -> None:
    whole = walk()
    points = whole.copy()
    points[100:112, TOE] = np.nan  # 0.1 s
    points[150:155, POINT_NAMES.index("neck")] = np.nan
    (tmp_path / "points.csv").write_text(table_text(points))
    clip = read_clip(tmp_path / "points.csv")
    assert np.abs(clip.points_w - whole).max() < 0.02
    (said,) = (sentence for sentence in clip.origin.assumed if "filled" in sentence)
    assert said == "gaps of up to 0.2 s are filled: FR_toe 12 frames, neck 5 (17 missing)"


@pytest.mark.parametrize(("point", "frames"), [("FR_toe", 3), ("neck", 1), ("RL_hip", 2), ("pelvis", 2)])
@pytest.mark.parametrize("jump", [(0.3, 0.2, 0.25), (0.0, 0.2, 0.2)])
def test_a_point_that_jumps_is_found_and_filled(point: str, frames: int, jump: tuple[float, ...]) -> None:
    whole, k = walk(), POINT_NAMES.index(point)
    points = whole.copy()
    points[60 : 60 + frames, k] += jump
    found = outliers(points, RATE)
    assert found[60 : 60 + frames, k].all()
    assert found.sum() == frames
    filled = fill_gaps(points, RATE)
    assert np.abs(filled.points - whole).max() < 0.01
    assert filled.notes == [f"gaps of up to 0.2 s are filled: {point} {frames} frames ({frames} astray)"]


@pytest.mark.parametrize(("frames", "mean_error_m"), [(6, 0.015), (12, 0.04)])
def test_of_a_galloping_dog_filled_toes_are_about_where_they_were(
    frames: int, mean_error_m: float, data_folder: Path
) -> None:
    """0.1 and 0.2 s: what docs/own-animal.md says of them."""
    whole = read_clip(data_folder / "dog_keypoints" / "dog_run00_joint_pos.txt")
    errors = []
    for shift in range(0, 40, 8):
        points = whole.points_w.copy()
        for first in range(20 + shift, 500, 40):
            points[first : first + frames, TOE] = np.nan
        off = np.linalg.norm(fill_gaps(points, 60.0).points - whole.points_w, axis=2)[:, TOE]
        errors += [off[first : first + frames].max() for first in range(20 + shift, 500, 40)]
    assert np.mean(errors) < mean_error_m


def test_a_limb_that_is_too_long_for_a_while_is_the_fault_of_one_point() -> None:
    points = walk()
    points[60:80, POINT_NAMES.index("neck")] += [0.0, 0.0, 0.3]  # longer than any median around a frame
    found = outliers(points, RATE)
    assert found[65:75, POINT_NAMES.index("neck")].all()
    assert found.any(axis=0).sum() == 1


def test_low_confidence_is_a_gap() -> None:
    points, confidence = walk(), np.ones((288, 10))
    confidence[50:60, TOE] = 0.3
    points[50:60, TOE] += 0.02
    filled = fill_gaps(points, RATE, confidence)
    assert np.abs(filled.points - walk()).max() < 0.01
    assert "10 with a confidence below 0.6" in filled.notes[0]


@pytest.fixture
def split(tmp_path: Path) -> Path:
    """A walk of which a toe is missing for half a second, twice."""
    points = walk(6)
    points[80:140, TOE] = np.nan
    points[400:460, TOE] = np.nan
    path = tmp_path / "points.csv"
    path.write_text(table_text(points))
    return path


def test_of_a_take_with_a_long_gap_the_longest_part_is_read(split: Path) -> None:
    clip = read_clip(split)
    np.testing.assert_allclose(clip.points_w, walk(6)[140:400], atol=1e-6)
    assert clip.origin.parts == ((0, 80), (140, 400), (460, 576))
    assert clip.origin.frames == (140, 400)
    assert any("0:140 and 400:576 are left out" in sentence for sentence in clip.origin.assumed)


def test_frames_choose_another_part_and_a_gap_within_them_is_refused(split: Path) -> None:
    clip = open_clip(split, frames=(470, 560))
    np.testing.assert_allclose(clip.points_w, walk(6)[470:560], atol=1e-6)
    with pytest.raises(ClipError, match=r"frames 100:200 hold a gap .* whole parts are 0:80, 140:400, 460:576"):
        read_clip(split, ReadOptions(frames=(100, 200)))
    with pytest.raises(ClipError, match=r"frames 500:900 are not in this clip of 576 frames"):
        read_clip(split, ReadOptions(frames=(500, 900)))


def test_a_point_that_is_never_there_is_named() -> None:
    points = walk()
    points[:, TOE] = np.nan
    with pytest.raises(ClipError, match="the point for FR_toe is missing in all frames"):
        fill_gaps(points, RATE)
    points = walk()
    points[::50, TOE] = np.nan
    for first in range(0, len(points), 60):
        points[first : first + 30, TOE] = np.nan
    with pytest.raises(ClipError, match=r"no 0\.6 s without a gap of more than 0\.2 s: FR_toe"):
        fill_gaps(points, RATE)
    points[:, TOE] = np.nan
    points[10:12, TOE] = [[0.0] * 3, [9.0] * 3]  # of which one is astray
    with pytest.raises(ClipError, match=r"no 0\.6 s without a gap of more than 0\.2 s: FR_toe"):
        fill_gaps(points, RATE)


def test_lines_that_cannot_be_read_are_missing_frames(tmp_path: Path) -> None:
    path, points = tmp_path / "points.csv", walk(3)
    lines = table_text(points).splitlines()

    def opened(changed: dict[int, str]) -> Clip:
        path.write_text("\n".join(changed.get(k, line) for k, line in enumerate(lines)))
        return read_clip(path)

    without_time, fields = "," + lines[40].split(",", 1)[1], lines[44].split(",")
    fields[3:6] = ["", "lost", ""]
    clip = opened({40: without_time, 44: ",".join(fields), 50: "the camera stopped", len(lines) - 1: lines[-1][:40]})
    assert clip.rate_hz == pytest.approx(RATE)
    np.testing.assert_allclose(clip.points_w, points[:-1], atol=1e-3)
    said = "4 lines that cannot be read: as missing frames (the first: line 41, column 1 (time): '' is not a number)"
    assert said in clip.origin.assumed
    assert any("gaps of up to 0.2 s are filled" in sentence for sentence in clip.origin.assumed)
    clip = opened(dict.fromkeys(range(101, 141), "1,2"))  # longer than a gap that is filled
    assert clip.origin.parts == ((0, 100), (140, len(points)))
    with pytest.raises(ClipError, match=r"line 2, column 2 \(pelvis_x\): 'lost' is not a number"):
        opened(dict.fromkeys(range(1, len(lines) - 20), "0," + ",".join(["lost"] * (len(fields) - 1))))


def test_all_parts_are_opened_with_their_first_frames(split: Path) -> None:
    parts = open_parts(split)
    assert [(first, clip.n_frames) for first, clip in parts] == [(0, 80), (140, 260), (460, 116)]
    for first, clip in parts:
        np.testing.assert_allclose(clip.points_w, walk(6)[first : first + clip.n_frames], atol=1e-6)
    assert [first for first, _ in open_parts(split, frames=(200, 300))] == [0]
    assert [clip.n_frames for _, clip in open_parts("trot")] == [generate("trot").n_frames]


def test_segment_lists_the_cycles_of_all_parts_in_the_frames_of_the_file(
    split: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["segment", str(split), "--json"]) == 0
    segments = json.loads(capsys.readouterr().out)["segments"]
    walks = [s for s in segments if s["gait"] == "walk"]
    assert all(not (s["start"] < 140 and s["end"] > 80) for s in segments)
    assert any(s["start"] >= 140 and s["end"] <= 400 for s in walks)
    for found in walks:
        clip = open_clip(split, frames=tuple(found["cycle"]))
        np.testing.assert_allclose(clip.points_w, walk(6)[slice(*found["cycle"])], atol=1e-6)


def test_a_library_has_excerpts_of_all_parts_and_opens_them_again(split: Path) -> None:
    whole = survey(DatasetSource(place=str(split)), confidence=0.2, cut="whole")
    assert [piece.frames for piece in whole.pieces] == [
        (first, first + part.n_frames) for first, part in open_parts(split)
    ]
    found = survey(DatasetSource(place=str(split)), confidence=0.2)
    assert found.problem is None
    assert {piece.frames[0] >= 460 for piece in found.pieces if piece.frames} == {True, False}
    for piece in found.pieces:
        assert piece.frames is not None
        first, end = piece.frames
        opened = piece.open()
        np.testing.assert_allclose(opened.points_w, walk(6)[first:end], atol=1e-6)


def test_the_command_that_segment_prints_reads_the_file_as_segment_did(
    split: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["segment", str(split), "--fps", "120", "--up", "z"]) == 0
    assert f"fastmimic imitate {split} --fps=120.0 --up=z --frames" in capsys.readouterr().err
