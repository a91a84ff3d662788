"""Formats of a user's own: registered like the built-in ones, and read wherever clips are."""

import runpy
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ClipError
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import FORMATS, Content, Format, ReadOptions, detect_format, read_clip, suffixes
from fastmimic.dataset.excerpts import find_sources

EXAMPLE = Path(__file__).parents[2] / "examples" / "extend" / "motion_format.py"


@pytest.fixture
def bare() -> Iterator[Format]:
    """A binary format: little-endian floats, ten points a frame."""

    def parse(data: bytes) -> Clip:
        return Clip(points_w=np.frombuffer(data[4:], "<f8").reshape(-1, 10, 3), rate_hz=50.0)

    def detect(content: Content) -> bool:
        return content.data.startswith(b"BARE")

    form = Format("bare", "bare floats", (".bare",), detect, parse, takes=(), binary=True)
    yield FORMATS.register(form)
    FORMATS.pop("bare")


def test_a_registered_format_is_read_listed_and_named_in_errors(bare: Format, tmp_path: Path) -> None:
    points = open_clip("walk").points_w
    path = tmp_path / "walk.bare"
    path.write_bytes(b"BARE" + points.astype("<f8").tobytes())
    assert detect_format(path) == "bare"
    clip = open_clip(path)
    np.testing.assert_array_equal(clip.points_w, points)
    assert (clip.origin.format, clip.origin.assumed, clip.origin.licence) == ("bare", (), None)
    assert ".bare" in suffixes()
    assert [Path(source.place).name for source in find_sources(tmp_path)] == ["walk.bare"]
    with pytest.raises(ClipError, match="y up does not apply to bare floats"):
        read_clip(path, ReadOptions(up="y"))
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ClipError, match=r"walk\.bare: a binary file.*bare floats"):
        read_clip(path)


def test_a_users_format_goes_before_the_built_in_ones(tmp_path: Path) -> None:
    path = tmp_path / "walk.json"
    path.write_text('{"keypoints": []}')
    assert detect_format(path) == "deepmimic"
    runpy.run_path(str(EXAMPLE))
    try:
        assert detect_format(path) == "keypoint-lines"
    finally:
        FORMATS.pop("keypoint-lines")


def test_every_format_is_complete() -> None:
    for name, form in FORMATS.items():
        assert form.name == name
        assert form.about
        assert form.suffixes
