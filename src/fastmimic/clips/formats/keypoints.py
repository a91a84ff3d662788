"""Tables of points, one frame a line: keypoints by column or by name, as text; triangulated points, as DeepLabCut,
Lightning Pose, Anipose and SLEAP write them, in text and in HDF5; and markers. Of those programs none says its frame
rate, the unit is that of the calibration board, and the axes are those of the first camera.

- Dog motion capture: 81 columns, 27 points × (x, y, z) in metres. Peng et al. (2020) distribute the dog motions of
  Zhang et al. (2018) like this: y up, right-handed, 60 frames a second.
- Points by name: a header with three columns a point, NAME_x (or `NAME.x`, `NAME:X`, `NAME x`, `NameX`), NAME_y and
  NAME_z, as tracking programs export them, also from C3D; an empty field or NaN is a gap. A column `time` gives the
  frame rate; others are ignored, whatever is in them.
- DeepLabCut, and Lightning Pose in the same form: columns are named in lines of their own, `scorer`, `bodyparts` and
  `coords`, with several animals also `individuals`. Points of a picture have x, y and likelihood: they are refused.
- Anipose: for each point NAME_x, NAME_y, NAME_z, NAME_error, NAME_ncams and NAME_score; then the rotation M_00 to M_22
  and the centre of the axes that its settings name, if they do, and the frame's number `fnum`. An error, in pixels,
  that is far above the others is an outlier's. Columns of nothing that is known are not looked at, as in DeepLabCut's.
- HDF5: DeepLabCut's data frame, and the tracks of SLEAP and sleap-anipose. h5py reads them all; pandas and PyTables,
  which wrote the first, would read that alone.
- C3D, the markers of motion capture (c3d.org): labels, unit and rate are in the file; a marker that was not seen has a
  negative residual. It is read with the library c3d.
"""

import io
import pickle
import re
import warnings
from collections.abc import Sequence
from typing import Any, Final, NoReturn

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError
from fastmimic.clips.clip import DOG, DOG_KEYPOINTS, Clip
from fastmimic.clips.formats.format import FLAT, Content
from fastmimic.clips.formats.gaps import Part
from fastmimic.clips.formats.points import Tracks, extra_module, most_complete
from fastmimic.clips.formats.text_table import Row, Table, read_table, to_array

COLUMNS: Final = 81
DEFAULT_RATE_HZ: Final = 60.0

_COLUMN: Final = re.compile(r"(.+?)(?:[\s._:/\-]([xyzXYZ])|(?<=[a-zA-Z])([XYZ]))")
_TIMES: Final = ("time", "time_s", "t")
_FEWEST: Final = 6  # points: the spine's two and four feet


def parse(text: str, *, fps: float | None = None, up: str | None = None, frames: Part | None = None) -> Clip:
    """Reads the text of a keypoint file; `fps` is 60 if None, and `up` the axis along which the hips are above the
    toes. Raises `ClipError`: malformed (says which line and column), or not an upright, right-handed animal."""
    rows = read_table(text).rows
    notes = [] if fps is not None else [f"{DEFAULT_RATE_HZ:g} frames a second: the file does not say"]
    titles = [f"point {k} {axis}" for k in range(DOG.points) for axis in "xyz"]
    values = to_array(rows, titles, "dog keypoints", gaps=range(COLUMNS), unread=notes)
    names = [str(i) for i in range(DOG.points)]
    tracks = Tracks(names, values.reshape(-1, DOG.points, 3), DEFAULT_RATE_HZ, notes=tuple(notes), skeleton=DOG)
    return tracks.clip(fps=fps, up=up, frames=frames, point_map={name: names[i] for name, i in DOG_KEYPOINTS.items()})


def read_named(text: str) -> Tracks:
    """Reads the text of such a table; raises `ClipError`: malformed (says which line and column)."""
    table = read_table(text)
    assert table.header is not None
    header = [name.strip().strip('"') for name in table.header]
    points = _named_points(header)
    gaps = {column for columns in points.values() for column in columns}
    time = next((column for column, name in enumerate(header) if name.lower() in _TIMES), None)
    unused, unread = set(range(len(header))) - gaps - {time}, list[str]()
    values = to_array(table.rows, header, "keypoints by name", gaps=gaps, unread=unread, unused=unused)
    positions = np.stack([values[:, columns] for columns in points.values()], axis=1)
    times = None if time is None else (header[time], values[:, time])
    return Tracks(list(points), positions, times=times, notes=tuple(unread))


def names_points(content: Content) -> bool:
    """Whether a text's header has enough points by name."""
    return len(_named_points(content.table.header or ())) >= _FEWEST


def _named_points(header: Sequence[str]) -> dict[str, list[int]]:
    """Columns x, y and z of each complete point, in file order."""
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(header):
        match = _COLUMN.fullmatch(name.strip().strip('"'))
        if match is not None:
            found.setdefault(match[1].strip(), {})[(match[2] or match[3]).lower()] = column
    return {name: [axes[a] for a in "xyz"] for name, axes in found.items() if len(axes) == 3}


Column = tuple[str, str, str]
"""Individual (empty if the file names none), point, and coordinate: x, y, z or likelihood."""
_ROTATION: Final = [f"M_{i}{j}" for i in range(3) for j in range(3)]
ANIPOSE: Final = {"fnum", *_ROTATION}  # among its columns
_READ: Final = ("x", "y", "z", "likelihood", "error")
_LARGEST_ERROR_PX: Final = 25.0  # between views of one point; but with a poor calibration, all are large
_TIMES_THE_USUAL: Final = 5.0


def tracks_of(columns: Sequence[Column], values: Array, *, is_level: bool = False, notes: Sequence[str] = ()) -> Tracks:
    """The points in a table (t, columns); raises `ClipError` if they lie in a picture."""
    names = list(dict.fromkeys(name for _, name, coordinate in columns if coordinate == "z"))
    if not names:
        raise ClipError(FLAT)
    individuals = list(dict.fromkeys(column[0] for column in columns))
    place = {column: i for i, column in enumerate(columns)}
    padded = np.column_stack([values, np.full(len(values), np.nan)])  # the last is that of a column that is not there
    at = [[[place.get((who, name, what), -1) for what in _READ] for name in names] for who in individuals]
    found = np.moveaxis(padded[:, np.array(at)], 0, 1)  # (individuals, t, points, 5)
    best, several = most_complete(individuals, found[..., :3])
    positions, likelihood, error = found[best, ..., :3], found[best, ..., 3], found[best, ..., 4]
    confidence = None if np.isnan(likelihood).all() else likelihood
    known = error[np.isfinite(error)]
    largest = max(_LARGEST_ERROR_PX, _TIMES_THE_USUAL * float(np.median(known))) if len(known) else np.inf
    if (astray := error > largest).any():
        positions = np.where(astray[..., None], np.nan, positions)
        several = (*several, f"{astray.sum()} points with a reprojection error above {largest:.0f} px are left out")
    return Tracks(names, positions, confidence=confidence, is_level=is_level, notes=(*notes, *several))


def read_deeplabcut(text: str) -> Tracks:
    """Reads DeepLabCut's table; raises `ClipError`: malformed (says which line and column), or points of a picture."""
    rows = _rows(read_table(text))
    end = next(i for i, row in enumerate(rows) if row.fields[0] == "coords") + 1
    labels = {row.fields[0]: row.fields[1:] for row in rows[:end]}
    individuals = labels.get("individuals", [""] * len(labels["bodyparts"]))
    if len({len(fields) for fields in labels.values()}) > 1:
        raise ClipError(f"its first {end} lines, which name the columns, have different numbers of columns")
    columns = list(zip(individuals, labels["bodyparts"], labels["coords"], strict=True))
    shown = ["frame", *(" ".join(column).strip() for column in columns)]
    unread: list[str] = []
    unused = [i for i, coordinate in enumerate(["", *labels["coords"]]) if coordinate not in _READ]
    values = to_array(rows[end:], shown, "DeepLabCut", gaps=range(1, len(shown)), unread=unread, unused=unused)
    return tracks_of(columns, values[:, 1:], notes=unread)


def read_anipose(text: str) -> Tracks:
    """Reads Anipose's table; raises `ClipError`: malformed (says which line and column)."""
    table = read_table(text)
    header = table.header or []
    columns = [("", *name.rpartition("_")[::2]) for name in header]
    gaps = [i for i, (_, _, what) in enumerate(columns) if what in (*_READ, "score")]
    largest = [np.inf if what == "error" else 1e6 for _, _, what in columns]
    unused = set(range(len(columns))) - {*gaps, *map(header.index, ANIPOSE)}
    unread: list[str] = []
    values = to_array(table.rows, header, "Anipose", largest, gaps, unread, unused)
    frame = np.rint(values[:, header.index("fnum")]).astype(int)
    if (np.diff(frame) < 1).any() or frame[-1] - frame[0] >= 2 * len(frame):
        raise ClipError("the frames' numbers (fnum) do not grow, or more than half of the frames are missing")
    every = np.full((frame[-1] - frame[0] + 1, len(header)), np.nan)  # rows that are not there are gaps
    every[frame - frame[0]] = values
    scored = [(who, name, "likelihood" if what == "score" else what) for who, name, what in columns]
    rotation = values[0, [header.index(name) for name in _ROTATION]].reshape(3, 3)
    return tracks_of(scored, every, is_level=not np.allclose(rotation, np.eye(3)), notes=unread)


def _rows(table: Table) -> list[Row]:
    """All rows, with the one that was taken for the header."""
    return table.rows if table.header is None else [Row(1, table.header), *table.rows]


def is_anipose(content: Content) -> bool:
    """Whether a table has Anipose's own columns."""
    return set(content.table.header or ()) >= ANIPOSE


def is_deeplabcut(content: Content) -> bool:
    """Whether the first lines name the columns as DeepLabCut does."""
    firsts = [row.fields[0] for row in _rows(content.table)[:4]]
    before = firsts[: firsts.index("coords")] if "coords" in firsts else []
    return before[:1] == ["scorer"] and "bodyparts" in before


def read_hdf5(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no h5py, or points of a picture."""
    with extra_module("h5py").File(io.BytesIO(data), "r") as file:
        if "instances" in file:  # a project of SLEAP, .slp
            raise ClipError(FLAT)
        return _sleap(file) if "tracks" in file else _deeplabcut(next(iter(file.values())))


def _sleap(file: Any) -> Tracks:
    """`tracks` is (tracks, 2, nodes, frames) in SLEAP's analysis files, and (frames, tracks, nodes, 3) in those of
    sleap-anipose, which do not name the nodes."""
    tracks = np.asarray(file["tracks"], dtype=float)
    if tracks.ndim == 4 and tracks.shape[1] == 3 != tracks.shape[3]:
        tracks = tracks.transpose(3, 0, 2, 1)
    if tracks.ndim != 4 or tracks.shape[3] != 3:
        raise ClipError(FLAT)
    names = [name.decode() for name in file["node_names"]] if "node_names" in file else []
    notes: tuple[str, ...] = ()
    if len(names) != tracks.shape[2]:
        names = [f"node_{i}" for i in range(tracks.shape[2])]
        notes = ("the file does not name its points: node_0, node_1, … are in the order of SLEAP's skeleton",)
    positions = np.moveaxis(tracks, 1, 0)
    best, several = most_complete([f"track {i}" for i in range(len(positions))], positions)
    return Tracks(names, positions[best], is_level=False, notes=notes + several)


def _deeplabcut(group: Any) -> Tracks:
    """A data frame as pandas writes it, with `format="table"` or "fixed": columns of one type are a block."""
    if "table" not in group:
        return _fixed(group)
    table = group["table"]
    blocks = [name for name in table.dtype.names if name.startswith("values_block")]
    labels = [label for block in blocks for label in _Labels(io.BytesIO(bytes(table.attrs[f"{block}_kind"]))).load()]
    return _framed(labels, [table[block] for block in blocks])


def _fixed(group: Any) -> Tracks:
    """A level of the columns' labels is a list of texts, and each column's place in it."""
    blocks = [name.removesuffix("_values") for name in group if name.endswith("_values")]
    labels: list[Sequence[str]] = []
    for block in blocks:
        levels = sum(name.startswith(f"{block}_items_level") for name in group)
        for_level = [f"{block}_items_{{}}{i}".format for i in range(levels)]
        labels += zip(*(group[of("level")].asstr()[()][group[of("label")][()]] for of in for_level), strict=True)
    return _framed(labels, [group[f"{block}_values"] for block in blocks])


def _framed(labels: Sequence[Sequence[str]], blocks: Sequence[Any]) -> Tracks:
    """From labels of scorer, individual if there are several, point and coordinate."""
    columns = [(label[-3] if len(label) > 3 else "", label[-2], label[-1]) for label in labels]
    return tracks_of(columns, np.concatenate([np.asarray(block, dtype=float) for block in blocks], axis=1))


class _Labels(pickle.Unpickler):
    """Reads the columns' labels, which pandas pickles: lists, tuples and texts. What could run is not looked up."""

    def find_class(self, module: str, name: str) -> NoReturn:
        raise pickle.UnpicklingError(f"{module}.{name} among the columns' names")


_KEY: Final = 0x50  # second byte of every C3D
_BLOCK: Final = 512
_PROCESSORS: Final = (84, 85, 86)  # that a C3D may be of
_UNITS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def read_c3d(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no library, or truncated."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of channels that are not read, and of the end that is checked below
        file = extra_module("c3d").Reader(io.BytesIO(data))
        points = np.array([frame for _, frame, _ in file.read_frames()])
    if len(points) < file.frame_count:
        raise ClipError(f"the file says that it has {file.frame_count} frames; it has {len(points)}: it is truncated")
    labels = [file.get(f"POINT:{name}") for name in ("LABELS", "LABELS2")]
    names = [label.rpartition(":")[2].strip() for part in labels if part is not None for label in part.string_array]
    unit = file.get("POINT:UNITS").string_value.strip().lower()
    positions = np.where(points[..., 3:4] < 0, np.nan, points[..., :3]).astype(float)
    return Tracks(names[: points.shape[1]], positions, float(file.point_rate), unit_m=_UNITS.get(unit))


def is_c3d(content: Content) -> bool:
    """Whether a binary file begins like a C3D, and its parameters name a processor."""
    data = content.data
    parameters = _BLOCK * (data[0] - 1) + 3 if len(data) > 1 else 0
    return not content.text and 0 < parameters < len(data) and data[1] == _KEY and data[parameters] in _PROCESSORS
