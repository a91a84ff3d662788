"""Files of the programs that track animals: each read back gives the points that were written."""

import io
import pickle
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pose_files
import pytest
from test_gaps import RATE, walk

from fastmimic.base.errors import ClipError
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats import ReadOptions, detect_format, read_clip
from fastmimic.clips.formats.gaps import LEAST_CONFIDENCE
from fastmimic.clips.formats.keypoints import _Labels
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import load_robot

TOE = POINT_NAMES.index("FR_toe")
NODES = {name: f"node_{i}" for i, name in enumerate(POINT_NAMES)}
NEEDS = {"h5": ["h5py"], "c3d": ["c3d", "ezc3d"], "glb": ["pygltflib"]}

Writer = Callable[[Path, np.ndarray], ReadOptions | None]


def needs(name: str) -> None:
    for library in NEEDS.get(name.rpartition(".")[2], []):
        pytest.importorskip(library, reason=f"{library} is not installed: pip install 'fastmimic[formats]'")


def text(write: Callable[[np.ndarray], str]) -> Writer:
    return lambda path, points: path.write_text(write(points)) and ReadOptions(fps=RATE)


def sleap_anipose(path: Path, points: np.ndarray) -> ReadOptions:
    pose_files.sleap_anipose_h5(path, [points])
    return ReadOptions(fps=RATE, point_map=NODES)


def sleap_named(path: Path, points: np.ndarray) -> ReadOptions:
    pose_files.sleap_anipose_h5(path, [points], names=True)
    return ReadOptions(fps=RATE)


FILES: dict[str, tuple[str, Writer]] = {
    "deeplabcut.csv": ("deeplabcut", text(lambda points: pose_files.deeplabcut_csv({"": points}))),
    "lightning_pose.csv": (
        "deeplabcut",
        text(lambda p: pose_files.deeplabcut_csv({"": p}, likelihood=0.99, scorer="heatmap_mhcrnn_tracker")),
    ),
    "anipose.csv": ("anipose", text(pose_files.anipose_csv)),
    "deeplabcut.h5": ("hdf5", lambda path, p: pose_files.deeplabcut_h5(path, p) and ReadOptions(fps=RATE)),
    "deeplabcut_fixed.h5": (
        "hdf5",
        lambda path, p: pose_files.deeplabcut_fixed_h5(path, p) and ReadOptions(fps=RATE),
    ),
    "sleap_anipose.h5": ("hdf5", sleap_anipose),
    "sleap_named.h5": (
        "hdf5",
        lambda path, p: pose_files.sleap_anipose_h5(path, [p], names=True) and ReadOptions(fps=RATE),
    ),
    "mm.c3d": ("c3d", lambda path, p: pose_files.c3d(path, p, RATE) and None),
    "m.c3d": ("c3d", lambda path, p: pose_files.c3d(path, p, RATE, "m") and None),
    "linear.glb": ("glb", lambda path, p: pose_files.glb(path, p, RATE) and None),
    "step.glb": ("glb", lambda path, p: pose_files.glb(path, p, RATE, "STEP") and None),
    "spline.glb": ("glb", lambda path, p: pose_files.glb(path, p, RATE, "CUBICSPLINE", 2) and None),
    "dog.npz": ("ai4animation", lambda path, p: pose_files.ai4animation_npz(path, p, RATE) and None),
}
"""What is written, with its format; the options that the file leaves open."""


@pytest.mark.parametrize("name", FILES)
def test_a_file_gives_the_points_and_the_robot_motion_of_its_take(name: str, tmp_path: Path) -> None:
    needs(name)
    form, write = FILES[name]
    points = walk(1)
    options = write(tmp_path / name, points)
    assert detect_format(tmp_path / name) == form
    clip = read_clip(tmp_path / name, options)
    assert clip.rate_hz == pytest.approx(RATE, rel=1e-4)
    np.testing.assert_allclose(clip.points_w, points, atol=1e-3)
    robot = load_robot("a1")
    ours, _ = retarget(Clip(points, RATE), robot, executable=False)
    theirs, _ = retarget(clip, robot, executable=False)
    np.testing.assert_allclose(theirs.root_pos_w, ours.root_pos_w, atol=1e-3)
    np.testing.assert_allclose(theirs.foot_pos_b, ours.foot_pos_b, atol=1e-3)
    np.testing.assert_allclose(theirs.joint_pos, ours.joint_pos, atol=np.radians(0.1))


def test_few_frames_a_second_are_said(tmp_path: Path) -> None:
    (tmp_path / "slow.csv").write_text(pose_files.deeplabcut_csv({"": walk()[::10]}))
    said = "12 frames a second are enough to see feet touch down; 30 or more are advised"
    for rate_hz in (12.0, 24.0):
        assert (said in read_clip(tmp_path / "slow.csv", ReadOptions(fps=rate_hz)).origin.assumed) == (rate_hz == 12.0)


@pytest.mark.parametrize("name", ["deeplabcut.csv", "anipose.csv", "deeplabcut.h5", "sleap_named.h5", "mm.c3d"])
def test_points_that_were_not_seen_are_gaps(name: str, tmp_path: Path) -> None:
    needs(name)
    points = walk()
    points[100:110, TOE] = np.nan
    clip = read_clip(tmp_path / name, FILES[name][1](tmp_path / name, points))
    assert np.abs(clip.points_w - walk()).max() < 0.02
    assert any("FR_toe 10 frames (10 missing)" in sentence for sentence in clip.origin.assumed)


def test_a_recorded_dog_survives_every_format(data_folder: Path, tmp_path: Path) -> None:
    clip = read_clip(data_folder / "dog_keypoints" / "dog_walk03_joint_pos.txt")
    for name, (_, write) in FILES.items():
        if name == "spline.glb":
            continue  # keys at every other of 60 frames a second are not the whole of its paths
        needs(name)
        options = write(tmp_path / name, clip.points_w)
        read = read_clip(tmp_path / name, options)
        np.testing.assert_allclose(read.points_w, clip.points_w, atol=1e-3, err_msg=name)


def test_how_many_blocks_a_table_has_is_counted_and_not_believed(tmp_path: Path) -> None:
    """A damaged count asked for all memory."""
    name = "deeplabcut_fixed.h5"
    needs(name)
    import h5py

    options = FILES[name][1](tmp_path / name, walk())
    with h5py.File(tmp_path / name, "a") as file:
        file["df_with_missing"].attrs.update(nblocks=1_000_000, block0_items_nlevels=1_000_000)
    np.testing.assert_allclose(read_clip(tmp_path / name, options).points_w, walk(), atol=1e-3)


@pytest.mark.parametrize("name", ["deeplabcut.csv", "anipose.csv"])
def test_tracks_without_a_rate_ask_for_one(name: str, tmp_path: Path) -> None:
    FILES[name][1](tmp_path / name, walk(1))
    with pytest.raises(ClipError, match=r"give the frame rate \(--fps\)"):
        read_clip(tmp_path / name)


def test_points_in_a_picture_are_refused_with_what_makes_them_spatial(tmp_path: Path) -> None:
    path = tmp_path / "view.csv"
    path.write_text(pose_files.deeplabcut_csv({"": walk(1)}, "xy", likelihood=0.9))
    with pytest.raises(ClipError, match=r"lie in a picture .* Anipose, sleap-anipose or DeepLabCut's 3D mode"):
        read_clip(path)
    path = tmp_path / "sleap.csv"
    path.write_text("track,frame_idx,instance.score,paw.x,paw.y,paw.score\n,0,1.0,2.5,3.5,0.9\n")
    with pytest.raises(ClipError, match="lie in a picture"):
        read_clip(path)
    needs("view.h5")
    with pytest.raises(ClipError, match="lie in a picture"):
        read_clip(pose_files.sleap_analysis_h5(tmp_path / "view.h5", walk(1)))
    with pytest.raises(ClipError, match="lie in a picture"):
        read_clip(pose_files.sleap_project(tmp_path / "project.slp"))


def test_of_several_animals_the_one_with_most_points_is_read(tmp_path: Path) -> None:
    points = walk(2)
    lost = points + 1.0
    lost[20:] = np.nan
    path = tmp_path / "two.csv"
    path.write_text(pose_files.deeplabcut_csv({"rex": lost, "fido": points}))
    clip = read_clip(path, ReadOptions(fps=RATE))
    np.testing.assert_allclose(clip.points_w, points, atol=1e-6)
    assert "of 2 animals, fido is read: it has the most points" in clip.origin.assumed
    needs("two.h5")
    pose_files.sleap_anipose_h5(tmp_path / "two.h5", [lost, points], names=True)
    clip = read_clip(tmp_path / "two.h5", ReadOptions(fps=RATE))
    np.testing.assert_allclose(clip.points_w, points, atol=1e-6)


def test_a_low_score_of_anipose_is_a_gap(tmp_path: Path) -> None:
    points, score = walk(), np.full((288, 10), 0.95)
    points[50:60, TOE] += 0.02
    score[50:60, TOE] = LEAST_CONFIDENCE - 0.1
    path = tmp_path / "take.csv"
    path.write_text(pose_files.anipose_csv(points, score))
    clip = read_clip(path, ReadOptions(fps=RATE))
    assert np.abs(clip.points_w - walk()).max() < 0.01


@pytest.mark.parametrize(("usual", "found"), [(1.5, True), (15.0, False)])
def test_a_point_on_which_the_views_of_anipose_disagree_is_a_gap(usual: float, found: bool, tmp_path: Path) -> None:
    points, path = walk(), tmp_path / "take.csv"
    points[50:60, TOE] += 0.02
    rows = [line.split(",") for line in pose_files.anipose_csv(points).splitlines()]
    for column in (i for i, title in enumerate(rows[0]) if title.endswith("_error")):
        own = rows[0][column] == f"{pose_files.NAMES[TOE]}_error"
        for number, row in enumerate(rows[1:]):
            row[column] = "60.0" if own and 50 <= number < 60 else str(usual)  # if all are large, it is the calibration
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    clip = read_clip(path, ReadOptions(fps=RATE))
    said = "10 points with a reprojection error above 25 px are left out"
    assert (said in clip.origin.assumed) == found
    assert (np.abs(clip.points_w - walk()).max() < 0.01) == found


@pytest.mark.parametrize("name", ["named.csv", "deeplabcut.csv", "anipose.csv"])
def test_columns_of_words_are_not_looked_at(name: str, tmp_path: Path) -> None:
    points, path = walk(1), tmp_path / name
    if name == "named.csv":
        text = ",".join(f"{point}_{axis}" for point in POINT_NAMES for axis in "xyz") + "\n"
        text += "\n".join(",".join(f"{v:.5f}" for v in frame.ravel()) for frame in points)
    else:
        write = {"anipose.csv": pose_files.anipose_csv, "deeplabcut.csv": lambda p: pose_files.deeplabcut_csv({"": p})}
        text = write[name](points)
    heads = {"deeplabcut.csv": 3}.get(name, 1)
    lines = [f"{line},{'behaviour' if i < heads else 'walks'}" for i, line in enumerate(text.splitlines())]
    path.write_text("\n".join(lines) + "\n")
    np.testing.assert_allclose(read_clip(path, ReadOptions(fps=RATE)).points_w, points, atol=1e-3)


def test_rows_that_anipose_left_out_are_gaps(tmp_path: Path) -> None:
    lines = pose_files.anipose_csv(walk()).splitlines()
    (tmp_path / "take.csv").write_text("\n".join([*lines[:101], *lines[106:]]))
    clip = read_clip(tmp_path / "take.csv", ReadOptions(fps=RATE))
    assert clip.n_frames == len(walk())
    assert np.abs(clip.points_w - walk()).max() < 0.02
    (tmp_path / "take.csv").write_text("\n".join([*lines[:9], lines[4], *lines[9:]]))
    with pytest.raises(ClipError, match="the frames' numbers"):
        read_clip(tmp_path / "take.csv", ReadOptions(fps=RATE))


@pytest.mark.parametrize(("size", "unit"), [(1000.0, "millimetres"), (650.0, "millimetres"), (100.0, "centimetres")])
def test_the_unit_follows_from_the_legs(size: float, unit: str, tmp_path: Path) -> None:
    (tmp_path / "take.csv").write_text(pose_files.deeplabcut_csv({"": size / 1000 * walk(1)}))
    said = read_clip(tmp_path / "take.csv", ReadOptions(fps=RATE)).origin.assumed
    assert any(f"coordinates are in {unit}" in sentence for sentence in said)


def test_a_damaged_table_names_line_and_point(tmp_path: Path) -> None:
    lines = pose_files.deeplabcut_csv({"": walk(1)}).splitlines()
    fields = lines[8].split(",")
    fields[4] = "lost"
    (tmp_path / "take.csv").write_text("\n".join([*lines[:8], ",".join(fields), *lines[9:]]))
    clip = read_clip(tmp_path / "take.csv", ReadOptions(fps=RATE))
    first = "line 9, column 5 (back_base x): 'lost' is not a number"
    assert f"1 line that cannot be read: as missing frames (the first: {first})" in clip.origin.assumed
    (tmp_path / "take.csv").write_text("\n".join([lines[0], lines[1] + ",tail", *lines[2:]]))
    with pytest.raises(ClipError, match="have different numbers of columns"):
        read_clip(tmp_path / "take.csv", ReadOptions(fps=RATE))


def test_points_farther_than_any_animal_walks_are_refused() -> None:
    points = walk(1)
    points[5:8] = 1e155
    with pytest.raises(ClipError, match="frame 5 holds a value that is not finite, or beyond 100000 m"):
        Clip(points_w=points, rate_hz=RATE)


@pytest.mark.parametrize("name", ["deeplabcut.h5", "mm.c3d", "linear.glb", "dog.npz"])
def test_a_truncated_file_is_refused(name: str, tmp_path: Path) -> None:
    needs(name)
    path = tmp_path / name
    FILES[name][1](path, walk(1))
    data = path.read_bytes()
    for share in (0.3, 0.9):
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(ClipError, match=name):
            read_clip(path, ReadOptions(fps=RATE))


C3D = b"\x02\x50" + b"\xff" * 510 + b"\x01\x50\x02\x54" + b"\xff" * 1500
"""How one begins: its parameters come after 512 bytes, of Intel's kind."""


def test_a_picture_is_no_c3d(tmp_path: Path) -> None:
    """Its second byte is the same, "P"."""
    (tmp_path / "take.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"\xff" * 100_000)
    with pytest.raises(ClipError, match=r"take\.png: a binary file"):
        read_clip(tmp_path / "take.png")


@pytest.mark.parametrize("library", ["h5py", "c3d", "pygltflib"])
def test_a_missing_library_is_one_line_that_names_the_extra(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = {"h5py": b"\x89HDF\r\n\x1a\n", "c3d": C3D, "pygltflib": b"glTF\x02\0\0\0"}
    (tmp_path / "take").write_bytes(starts[library])
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ClipError, match=rf"need {library}, which is not installed: pip install 'fastmimic\[formats\]'"):
        read_clip(tmp_path / "take")


def test_names_of_columns_cannot_run_anything() -> None:
    class Harm:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return print, ("harm",)

    with pytest.raises(pickle.UnpicklingError, match=r"builtins\.print among the columns' names"):
        _Labels(io.BytesIO(pickle.dumps([Harm()]))).load()


def test_a_motion_of_ai4animation_is_no_robot_motion(tmp_path: Path) -> None:
    from fastmimic.clips.formats.format import is_robot_motion

    path = pose_files.ai4animation_npz(tmp_path / "dog.npz", walk(1), RATE)
    assert not is_robot_motion(path)
    clip = read_clip(path)
    assert clip.skeleton.points == 10
    assert (0, 1) in clip.skeleton.bones
