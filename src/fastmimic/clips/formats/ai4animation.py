"""AI4AnimationPy's motions (facebookresearch/ai4animationpy, `Motion.SaveToNPZ`): positions (t, k, 3) in the world, m,
y up, with names and parents of the bones, and the frame rate. Objects in the file are not read, as that can run
anything; nothing of what is needed is one."""

import io
import zipfile
from typing import Final

import numpy as np

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.format import Content
from fastmimic.clips.formats.tracked_points import Tracks, tracks_format

_MEMBERS: Final = {"bone_names.npy", "positions.npy", "framerate.npy"}


def read(data: bytes) -> Tracks:
    """Reads such a file; raises `ClipError` for other shapes."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        names = [str(name) for name in file["bone_names"]]
        parents = [int(i) for i in file["parent_indices"]] if "parent_indices" in file else []
        positions, rate = np.asarray(file["positions"], dtype=float), float(file["framerate"])
    if positions.shape[1:] != (len(names), 3) or len(parents) not in (0, len(names)):
        raise ClipError(f"positions of shape {positions.shape} for {len(names)} bones; expected (frames, bones, 3)")
    return Tracks(names, positions, rate, parents=parents)


def _detect(content: Content) -> bool:
    try:
        with zipfile.ZipFile(io.BytesIO(content.data)) as archive:
            return set(archive.namelist()) >= _MEMBERS
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
        return False


FORMAT: Final = tracks_format("ai4animation", "motion of AI4AnimationPy (.npz)", (".npz",), _detect, read, binary=True)
