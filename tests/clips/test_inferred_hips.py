"""Animals of which only spine and feet were recorded: the Vienna Horse Data Collection's form, and point maps."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ClipError
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats import ReadOptions, detect_format, read_clip
from fastmimic.clips.formats.point_names import BUILT_IN

MM = 1000.0
MARKERS = {source: name for name, source in BUILT_IN["Vienna's horses"].items()}


def vienna(clip: Clip, *, size: float = 1.0, drop: int | None = None) -> str:
    """A clip as the collection writes it: a quoted header, times rounded to milliseconds, mm, z up, no hips."""
    names = ("Head", "Withers", "Sacrum", "HFL", "HFR", "HHL", "HHR")
    columns = ",".join(f'"{name}{axis}"' for name in names for axis in "XYZ")
    lines = [f'"Frame#","Time",{columns}']
    for i, points in enumerate(clip.points_w * size * MM):
        if i == drop:
            continue
        row = [points[1] + [900.0, 0.0, 100.0], *(points[POINT_NAMES.index(MARKERS[name])] for name in names[1:])]
        lines.append(f"{i + 1},{i / clip.rate_hz:.3f}," + ",".join(f"{v:.5f}" for v in np.ravel(row)))
    return "\n".join(lines) + "\n"


def test_shoulders_and_hips_are_where_the_animal_has_them(tmp_path: Path) -> None:
    clip = open_clip("walk")
    (tmp_path / "walk.csv").write_text(vienna(clip, size=3.0))
    assert detect_format(tmp_path / "walk.csv") == "points"
    read = read_clip(tmp_path / "walk.csv")
    assert read.rate_hz == pytest.approx(clip.rate_hz, rel=1e-3)  # times are rounded to a tenth of a frame
    np.testing.assert_allclose(read.points_w[:, :2], 3.0 * clip.points_w[:, :2], atol=1e-5)
    np.testing.assert_allclose(read.toes_w, 3.0 * clip.toes_w, atol=1e-5)
    assert np.abs(read.hips_w - 3.0 * clip.hips_w).max() < 0.12  # of an animal of 1.3 m at the withers
    assert read.leg_length_m == pytest.approx(3.0 * 0.4 / 0.825, rel=0.03)
    assert any("shoulders and hips are not in the file" in sentence for sentence in read.origin.assumed)


def test_a_mirrored_animal_without_hips_is_refused(tmp_path: Path) -> None:
    clip = open_clip("walk")
    mirrored = Clip(clip.points_w * np.array([1.0, -1.0, 1.0]), clip.rate_hz)
    (tmp_path / "walk.csv").write_text(vienna(mirrored))
    with pytest.raises(ClipError, match="left-handed or the points swapped"):
        read_clip(tmp_path / "walk.csv")


def test_a_dropped_frame_is_found_among_rounded_times(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(vienna(open_clip("walk"), drop=40))
    with pytest.raises(ClipError, match="'Time' does not rise by equal steps"):
        read_clip(tmp_path / "walk.csv")
    assert read_clip(tmp_path / "walk.csv", ReadOptions(fps=120.0)).rate_hz == 120.0


def test_a_point_map_may_leave_out_all_hips_but_not_one(tmp_path: Path) -> None:
    clip = open_clip("walk")
    header = ",".join(f"p{i}_{axis}" for i in range(10) for axis in "xyz")
    rows = "\n".join(",".join(f"{v:.5f}" for v in frame.ravel()) for frame in clip.points_w)
    (tmp_path / "walk.csv").write_text(f"{header}\n{rows}\n")
    names = {name: f"p{i}" for i, name in enumerate(POINT_NAMES) if not name.endswith("_hip")}
    (tmp_path / "map.json").write_text(json.dumps(names))
    read = read_clip(tmp_path / "walk.csv", ReadOptions(point_map=tmp_path / "map.json", fps=120.0))
    assert np.abs(read.hips_w - clip.hips_w).max() < 0.04
    (tmp_path / "map.json").write_text(json.dumps(names | {"FR_hip": "p2"}))
    with pytest.raises(ClipError, match="lacks FL_hip, RR_hip, RL_hip"):
        read_clip(tmp_path / "walk.csv", ReadOptions(point_map=tmp_path / "map.json", fps=120.0))


@pytest.fixture(scope="module")
def horses() -> Path:
    folder = Path(os.environ.get("FASTMIMIC_DATA", "")) / "kine2go"
    if not os.environ.get("FASTMIMIC_DATA") or not list(folder.glob("Horse1_M1_*.csv")):
        pytest.skip("set FASTMIMIC_DATA to a folder with kine2go/Horse1_M1_*.csv (Vienna Horse Data Collection)")
    return folder


def test_the_horse_is_read_at_its_size(horses: Path) -> None:
    for gait in ("walk", "trot"):
        clip = read_clip(horses / f"Horse1_M1_{gait}1_kinematics.csv")
        assert clip.rate_hz == pytest.approx(60.0, rel=1e-3)
        assert clip.n_frames == 600
        assert np.mean(clip.point("neck")[:, 2]) == pytest.approx(1.28, abs=0.02)  # m, at the withers
        assert 1.0 < np.mean(clip.hips_w[..., 2]) < 1.2
        assert clip.leg_length_m == pytest.approx(1.45, abs=0.03)
