"""Files: the format is found by content, options apply or are refused, and errors name the file."""

from pathlib import Path

import numpy as np
import pytest
from sample_files import csv_text, deepmimic_text, keypoint_text, save_motion

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats import ReadOptions, detect_format, read_clip

TEXTS = {"keypoints": keypoint_text(), "deepmimic": deepmimic_text(), "csv": csv_text()}


@pytest.fixture
def file(tmp_path: Path):
    """Writes a file with a name that says nothing about its content."""

    def write(content: str | bytes, name: str = "motion.dat") -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


@pytest.fixture(scope="module")
def a1():
    from fastmimic.robot import load_robot

    return load_robot("a1")


@pytest.fixture
def npz(tmp_path: Path) -> Path:
    return save_motion(tmp_path / "motion.npz").rename(tmp_path / "motion.txt")


@pytest.mark.parametrize("expected", TEXTS)
@pytest.mark.parametrize("name", ["a.txt", "a.csv", "a.json", "a.npz", "a"])
def test_format_is_found_by_content_whatever_the_name(file, name: str, expected: str):
    assert detect_format(file(TEXTS[expected], name)) == expected


def test_npz_is_recognised_and_not_read_as_a_clip(npz: Path):
    assert detect_format(npz) == "npz"
    with pytest.raises(ClipError, match="robot motion"):
        read_clip(npz)


def test_csv_with_header_is_recognised(file):
    assert detect_format(file(csv_text(header=True))) == "csv"


def test_a_byte_order_mark_is_no_obstacle(file):
    path = file(b"\xef\xbb\xbf" + keypoint_text().encode())
    assert read_clip(path).n_frames == 12


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "empty"),
        (b"\n \n", "empty"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "binary"),
        (b"1,2\x00,3", "binary"),
        (b"hello world\nhow are you\n", "neither numbers nor names of joints"),
        (b"1,2,3\n4,5,6\n", "line 1 has 3 columns"),
        (b"# nothing\n", "no numbers"),
        (b"PK\x05\x06" + 18 * b"\0", "zip archive without arrays"),
    ],
)
def test_anything_else_is_refused_with_what_was_expected(file, content: bytes, problem: str):
    path = file(content)
    with pytest.raises(ClipError, match=rf"motion\.dat: .*{problem}.*(81 columns|expected)"):
        read_clip(path)


def test_missing_file_and_folder(tmp_path: Path):
    with pytest.raises(ClipError, match=r"nowhere\.txt: no such file"):
        read_clip(tmp_path / "nowhere.txt")
    with pytest.raises(ClipError, match="is a folder"):
        detect_format(tmp_path)


def test_first_line_with_a_lost_column_is_reported_as_such(file):
    lines = keypoint_text().splitlines()
    lines[0] = lines[0].rsplit(",", 1)[0]
    assert any(
        "line 1 has 80 columns; expected 81" in said for said in read_clip(file("\n".join(lines))).origin.assumed
    )


def test_provenance(file):
    clip = read_clip(file(keypoint_text(), "rex.txt"))
    assert clip.origin.name == "rex"
    assert clip.origin.source == "rex.txt"
    assert clip.origin.format == "keypoints"
    assert clip.origin.licence is None


@pytest.mark.parametrize("name", TEXTS)
def test_overrides_apply_to_every_format(file, a1, name: str):
    path = file(TEXTS[name])
    whole = read_clip(path, ReadOptions(robot=a1))
    clip = read_clip(path, ReadOptions(robot=a1, fps=25, scale=0.5, frames=(1, 4)))
    assert (clip.rate_hz, clip.scale, clip.n_frames) == (25, 0.5, 3)
    np.testing.assert_array_equal(clip.points_w, whole.points_w[1:4])
    assert clip.origin.frames == (1, 4)


@pytest.mark.parametrize("name", ["deepmimic", "csv"])
def test_y_up_does_not_apply_to_robot_formats(file, a1, name: str):
    with pytest.raises(ClipError, match="y up does not apply"):
        read_clip(file(TEXTS[name]), ReadOptions(robot=a1, up="y"))
    plain, z_up = (read_clip(file(TEXTS[name]), ReadOptions(robot=a1, up=up)) for up in (None, "z"))
    assert z_up.n_frames == plain.n_frames


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("fps", [0, -30, float("nan"), float("inf"), 1e-9, 1e9])
def test_a_rate_that_no_motion_has_is_refused(file, a1, name: str, fps: float):
    with pytest.raises(ClipError, match=r"motion\.dat: the frame rate"):
        read_clip(file(TEXTS[name]), ReadOptions(robot=a1, fps=fps))


@pytest.mark.parametrize("scale", [0, -1, float("nan")])
def test_a_scale_that_is_not_positive_is_refused(file, scale: float):
    with pytest.raises(ClipError, match="scale must be positive"):
        read_clip(file(keypoint_text()), ReadOptions(scale=scale))


def test_an_unknown_axis_is_refused(file):
    with pytest.raises(ClipError, match="must be one of y, z, x, -y, -z, -x, found 'w'"):
        read_clip(file(keypoint_text()), ReadOptions(up="w"))


@pytest.mark.parametrize("frames", [(0, 13), (-1, 5), (5, 5), (7, 3), (20, 30)])
def test_frames_out_of_range_say_how_many_there_are(file, frames: tuple[int, int]):
    with pytest.raises(ClipError, match=rf"motion\.dat: frames {frames[0]}:{frames[1]} are not in this clip of 12"):
        read_clip(file(keypoint_text()), ReadOptions(frames=frames))


def test_a_csv_needs_its_robot(file):
    with pytest.raises(ClipError, match="robot"):
        read_clip(file(csv_text()))


def test_a_cut_is_no_longer_said_to_be_a_cycle(file):
    path = file(deepmimic_text(9))
    assert read_clip(path).is_cycle is True
    assert read_clip(path, ReadOptions(frames=(0, 8))).is_cycle is True
    assert read_clip(path, ReadOptions(frames=(0, 7))).is_cycle is None
