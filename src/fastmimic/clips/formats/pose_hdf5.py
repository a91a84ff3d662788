"""Triangulated points in HDF5: DeepLabCut's data frame, and the tracks of SLEAP and sleap-anipose. h5py reads them all;
pandas and PyTables, which wrote the first, would read that alone."""

import io
import pickle
from typing import Any, Final, NoReturn

import numpy as np

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.pose_table import FLAT, tracks_of
from fastmimic.clips.formats.tracked_points import Tracks, library, most_complete, tracks_format

_MAGIC: Final = b"\x89HDF\r\n\x1a\n"


def read(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no h5py, or points of a picture."""
    with library("h5py").File(io.BytesIO(data), "r") as file:
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
    """A data frame as pandas writes it with `format="table"`: columns of one type are a block."""
    table = group["table"]
    blocks = [name for name in table.dtype.names if name.startswith("values_block")]
    labels = [label for block in blocks for label in _Labels(io.BytesIO(bytes(table.attrs[f"{block}_kind"]))).load()]
    columns = [(label[-3] if len(label) > 3 else "", label[-2], label[-1]) for label in labels]
    return tracks_of(columns, np.concatenate([np.asarray(table[block], dtype=float) for block in blocks], axis=1))


class _Labels(pickle.Unpickler):
    """Reads the columns' labels, which pandas pickles into an attribute. Lists, tuples and texts need nothing to be
    looked up by name; refusing that, nothing can be run."""

    def find_class(self, module: str, name: str) -> NoReturn:
        raise pickle.UnpicklingError(f"{module}.{name} among the columns' names")


FORMAT: Final = tracks_format(
    "hdf5",
    "3D points of DeepLabCut, SLEAP or sleap-anipose, HDF5",
    (".h5",),
    lambda content: content.data.startswith(_MAGIC),
    read,
    binary=True,
)
