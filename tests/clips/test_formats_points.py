"""Skeletons and points that say what they are: BVH, and tables by name."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fastmimic.base.errors import ClipError
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats import ReadOptions, detect_format, read_clip
from fastmimic.clips.formats.point_names import BUILT_IN
from fastmimic.clips.segment import find_segments
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import load_robot

CM = 100.0


def dog_bvh(clip: Clip, *, root_order: str = "ZYX", unit: float = CM, names: dict[str, str] | None = None) -> str:
    """A clip as a BVH of AI4Animation's joints, y up: legs swing from shoulders and hips, each leg one bone that also
    changes length by a position channel."""
    names = dict(BUILT_IN["AI4Animation's dog"]) if names is None else names
    points = clip.points_w[..., [1, 2, 0]] * unit  # x left, y up, z forward
    n = len(points)
    pelvis, neck = points[:, 0], points[:, 1]
    ahead = neck - pelvis
    yaw, pitch = np.arctan2(ahead[:, 0], ahead[:, 2]), -np.arctan2(ahead[:, 1], np.hypot(ahead[:, 0], ahead[:, 2]))
    trunk = Rotation.from_euler("YX", np.stack([yaw, pitch], axis=1))
    angles = trunk.as_euler(root_order, degrees=True)
    lines = ["HIERARCHY", f"ROOT {names['pelvis']}", "{", "OFFSET 0 0 0"]
    lines.append("CHANNELS 6 Xposition Yposition Zposition " + " ".join(f"{axis}rotation" for axis in root_order))
    columns = [pelvis, angles]

    def to_trunk(vectors: np.ndarray) -> np.ndarray:
        return trunk.inv().apply(vectors)

    def joint(name: str, at: np.ndarray, end: np.ndarray | None) -> None:
        """A joint that is where a position channel says; its end site turns with it."""
        lines.extend([f"JOINT {name} {{", "OFFSET 1 2 3"])
        if end is None:
            lines.extend(["CHANNELS 3 Xposition Yposition Zposition", "End Site {", "OFFSET 0 0 1", "}", "}"])
            columns.append(at)
            return
        along = end - at
        length = np.linalg.norm(along, axis=1).mean()
        turn = Rotation.concatenate([Rotation.align_vectors(v[None], [[0.0, -1.0, 0.0]])[0] for v in along])
        lines.append("CHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation Zrotation")
        lines.extend(["End Site", "{", f"OFFSET 0 {-length:.6f} 0", "}", "}"])
        columns.extend([at, turn.as_euler("YXZ", degrees=True)])

    joint(names["neck"], to_trunk(neck - pelvis), None)
    for leg in range(4):
        hip, toe = POINT_NAMES[2 + leg], names[POINT_NAMES[6 + leg]].removesuffix(".end")
        shoulder, foot = points[:, 2 + leg] - pelvis, points[:, 6 + leg] - pelvis
        lines.extend([f"JOINT {names[hip]} {{", "OFFSET 0 0 0", "CHANNELS 3 Xposition Yposition Zposition"])
        columns.append(to_trunk(shoulder))
        joint(toe, np.zeros((n, 3)), to_trunk(foot - shoulder))
        lines.append("}")
    lines += ["}", "MOTION", f"Frames: {n}", f"Frame Time: {1 / clip.rate_hz:.8f}"]
    values = np.concatenate(columns, axis=1)
    return "\n".join([*lines, *(" ".join(f"{v:.6f}" for v in row) for row in values)]) + "\n"


def walk(cycles: int = 3) -> Clip:
    clip = open_clip("walk")
    step = (clip.points_w[-1] - clip.points_w[0])[:2].mean(axis=0) * clip.n_frames / (clip.n_frames - 1)
    return Clip(np.concatenate([clip.points_w + k * step for k in range(cycles)]), clip.rate_hz)


@pytest.mark.parametrize("order", ["ZYX", "YXZ", "XYZ"])
def test_a_bvh_gives_the_points_in_the_world_whatever_its_order_of_rotations(order: str, tmp_path: Path) -> None:
    clip = walk(1)
    (tmp_path / "dog.bvh").write_text(dog_bvh(clip, root_order=order))
    assert detect_format(tmp_path / "dog.bvh") == "bvh"
    read = read_clip(tmp_path / "dog.bvh")
    assert read.rate_hz == pytest.approx(clip.rate_hz, rel=1e-5)
    np.testing.assert_allclose(read.points_w[:, :6], clip.points_w[:, :6], atol=1e-6)
    leg = np.linalg.norm(clip.toes_w - clip.hips_w, axis=-1)
    error = np.linalg.norm(read.toes_w - clip.toes_w, axis=-1)
    np.testing.assert_allclose(error, np.abs(leg - leg.mean(axis=0)), atol=1e-6)  # its legs keep their mean length
    assert any("centimetres" in sentence for sentence in read.origin.assumed)
    assert read.skeleton.points == 15  # ten joints and five end sites


def test_a_bvh_goes_the_whole_way_to_a_robot_motion(tmp_path: Path) -> None:
    (tmp_path / "take.bvh").write_text(dog_bvh(walk()))
    take = read_clip(tmp_path / "take.bvh")
    (found,) = find_segments(take)
    assert found.gait == "walk"
    assert found.cycle is not None
    motion, _ = retarget(take.cut(*found.cycle), load_robot("a1"))
    assert motion.cycle is not None
    assert motion.cycle[0] / motion.period_s == pytest.approx(0.6, abs=0.05)


def test_a_point_map_names_the_joints_of_another_skeleton(tmp_path: Path) -> None:
    names = {name: f"bone_{i}{'.end' if 'toe' in name else ''}" for i, name in enumerate(POINT_NAMES)}
    path = tmp_path / "horse.bvh"
    path.write_text(dog_bvh(walk(1), names=names))
    with pytest.raises(ClipError, match=r"bone_0, bone_1, .*--point-map FILE.json"):
        read_clip(path)
    (tmp_path / "map.json").write_text(json.dumps(names))
    read = read_clip(path, ReadOptions(point_map=tmp_path / "map.json"))
    np.testing.assert_allclose(read.points_w[:, :6], walk(1).points_w[:, :6], atol=1e-6)
    wrong = names | {"neck": "bone_11"}
    with pytest.raises(ClipError, match="'bone_11', which the file does not have; did you mean"):
        read_clip(path, ReadOptions(point_map=wrong))
    with pytest.raises(ClipError, match="the point map names 'bone_1' as pelvis and neck; each point is one of them"):
        read_clip(path, ReadOptions(point_map=names | {"pelvis": "bone_1"}))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "cannot be read (Expecting property name"),
        ("[1]", "does not hold a JSON object"),
        (json.dumps({"pelvis": 3}), "is a JSON object of names"),
        (json.dumps({"pelvs": "Hips"}), "does not know 'pelvs'; did you mean 'pelvis'"),
        (json.dumps({"pelvis": "Hips"}), "lacks neck, FR_hip"),
    ],
)
def test_a_point_map_that_is_none_is_refused(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "dog.bvh").write_text(dog_bvh(walk(1)))
    (tmp_path / "map.json").write_text(content)
    with pytest.raises(ClipError, match=r"map\.json") as caught:
        read_clip(tmp_path / "dog.bvh", ReadOptions(point_map=tmp_path / "map.json"))
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("MOTION", "MOTIO", "line 62: 'MOTIO' is not expected"),
        ("OFFSET 1 2 3", "OFFSET 1 2", "'OFFSET 1 2' is not expected"),
        (
            "CHANNELS 3 Xposition",
            "CHANNELS 1 Zposition CHANNELS 3 Xposition",
            "'CHANNELS 3 Xposition Yposition Zposition' is",
        ),
        ("CHANNELS 3 Xposition", "CHANNELS 3 Wposition", "expected 3 different channels"),
        ("Frames: 96", "Frames: 90", "says that it has 90 frames; it has 96"),
        ("Frames: 96", "Frames: x", "expected 'Frames: N'"),
        ("Frame Time: 0.008", "Frame Time: -0.008", "S > 0"),
        ("JOINT Neck", "ROOT Neck", "ROOT Neck is not where one belongs"),
    ],
)
def test_a_damaged_bvh_is_refused_with_its_line(old: str, new: str, words: str, tmp_path: Path) -> None:
    text = dog_bvh(walk(1))
    assert old in text
    (tmp_path / "dog.bvh").write_text(text.replace(old, new, 1))
    with pytest.raises(ClipError, match=r"dog\.bvh") as caught:
        read_clip(tmp_path / "dog.bvh")
    assert words in str(caught.value)


def test_a_bvh_that_ends_early_is_refused(tmp_path: Path) -> None:
    text = dog_bvh(walk(1))
    for length in (20, 300, text.index("MOTION") + 8, len(text) - 400):
        (tmp_path / "dog.bvh").write_text(text[:length])
        with pytest.raises(ClipError, match=r"dog\.bvh"):
            read_clip(tmp_path / "dog.bvh")


def table_of(clip: Clip, *, names: dict[str, str] | None = None, form: str = "{}_{}", time: bool = True) -> str:
    """A clip as a table by name, z up."""
    names = names or {name: name for name in POINT_NAMES}
    header = [form.format(names[name], axis) for name in POINT_NAMES for axis in "xyz"]
    rows = clip.points_w.reshape(clip.n_frames, -1)
    if time:
        header.insert(0, "time")
        rows = np.column_stack([np.arange(clip.n_frames) / clip.rate_hz, rows])
    return "\n".join([",".join(header), *(",".join(f"{v:.7f}" for v in row) for row in rows)]) + "\n"


def test_a_column_of_quoted_words_may_have_commas(tmp_path: Path) -> None:
    clip = walk(1)
    header, *rows = table_of(clip).splitlines()
    lines = [f'{header},"said, by whom"', *(f'{row},"walks, fast"' for row in rows)]
    (tmp_path / "points.csv").write_text("\n".join(lines))
    np.testing.assert_allclose(read_clip(tmp_path / "points.csv").points_w, clip.points_w, atol=1e-6)


@pytest.mark.parametrize("form", ["{}_{}", "{}.{}", "{}:{}", "{} {}"])
def test_a_table_by_name_is_read_with_the_rate_of_its_times(form: str, tmp_path: Path) -> None:
    clip = walk(1)
    (tmp_path / "points.csv").write_text(table_of(clip, form=form))
    assert detect_format(tmp_path / "points.csv") == "points"
    read = read_clip(tmp_path / "points.csv")
    assert read.rate_hz == pytest.approx(clip.rate_hz, rel=1e-4)
    np.testing.assert_allclose(read.points_w, clip.points_w, atol=1e-6)


def test_a_table_without_times_wants_a_rate_and_one_of_other_names_a_map(tmp_path: Path) -> None:
    clip, path = walk(1), tmp_path / "points.csv"
    path.write_text(table_of(clip, time=False))
    with pytest.raises(ClipError, match="give the frame rate"):
        read_clip(path)
    assert read_clip(path, ReadOptions(fps=120)).rate_hz == 120
    names = {name: f"marker {i}" for i, name in enumerate(POINT_NAMES)}
    path.write_text(table_of(clip, names=names))
    with pytest.raises(ClipError, match="marker 3"):
        read_clip(path)
    np.testing.assert_allclose(read_clip(path, ReadOptions(point_map=names)).points_w, clip.points_w, atol=1e-6)


def test_uneven_times_are_refused(tmp_path: Path) -> None:
    lines = table_of(walk(1)).splitlines()
    (tmp_path / "points.csv").write_text("\n".join(lines[:40] + lines[50:]))
    with pytest.raises(ClipError, match="does not rise by equal steps"):
        read_clip(tmp_path / "points.csv")


def test_a_map_for_a_format_that_knows_its_points_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="its points are known"):
        open_clip("trot", point_map={})
