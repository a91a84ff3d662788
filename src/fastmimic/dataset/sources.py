"""Sources of a library: files in a folder, or a list of files and names."""

import csv
import fnmatch
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import LibraryError
from fastmimic.clips.catalogue import check_name
from fastmimic.clips.formats import suffixes

NO_CLIPS: Final = ("license*", "licence*", "copying*", "notice*", "readme*", "changelog*", "requirements*.txt", ".*")
"""Files of a folder that are never clips, with any suffix."""
_LICENCES: Final = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "LICENCE.txt", "COPYING")
_COLUMNS: Final = ("source", "frames", "fps", "up", "scale", "point_map", "licence", "credit")


@dataclass(frozen=True)
class DatasetSource:
    """A clip, a take, or a robot motion.

    Attributes:
        place: path, or a name of `fastmimic motions`.
        frames: (first, end) of one motion; None to search all of it for motions.
        fps, up, scale, point_map: as in `fastmimic.clips.catalogue.open_clip`.
        licence, credit: of the recording, if the source itself has none.
    """

    place: str
    frames: tuple[int, int] | None = None
    fps: float | None = None
    up: str | None = None
    scale: float | None = None
    point_map: str | None = None
    licence: str | None = None
    credit: str | None = None

    @property
    def overrides(self) -> dict[str, Any]:
        """Arguments of `open_clip` besides the place and the frames."""
        names = ("fps", "up", "scale", "point_map")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @property
    def name(self) -> str:
        """A file's name without its suffix, or the motion's name."""
        path = Path(self.place)
        return path.stem if path.suffix else self.place

    @property
    def key(self) -> str:
        """12 hexadecimal digits that identify the source, independent of its content."""
        return fingerprint(json.dumps(asdict(self), sort_keys=True).encode())[:12]

    def __str__(self) -> str:
        return self.place if self.frames is None else f"{self.place} {self.frames[0]}:{self.frames[1]}"


def find_sources(
    place: str | Path, *, exclude: Sequence[str] = (), licence: str | None = None, credit: str | None = None
) -> list[DatasetSource]:
    """The sources of a folder, of a list, or a single one.

    Args:
        place: a folder, searched at any depth; a list: `.csv` with a header that has `source` and optionally frames,
            fps, up, scale, point_map, licence and credit, or `.list` with one source per line; else one file or name.
            Paths in a list are relative to it.
        exclude: patterns of files in a folder to leave out, such as `*_raw.txt`.
        licence, credit: of sources without their own.

    Raises `LibraryError` if nothing is there, or a line of the list cannot be read, and `ClipError` for an unknown or
    unfetched name outside a list.
    """
    path = Path(place)
    if path.is_dir():
        found = _in_folder(path, exclude, licence, credit)
        if not found:
            raise LibraryError(f"{path}: no clips in this folder; files that may be end in {', '.join(suffixes())}")
        return found
    if path.suffix == ".list" or (path.suffix == ".csv" and _is_list(path)):
        return _of_list(path, licence, credit)
    if not path.exists() and (path.suffix or "/" in str(place)):
        raise LibraryError(f"{place}: no such file or folder")
    if not path.exists():
        check_name(str(place))
    return [DatasetSource(str(path.resolve()) if path.is_file() else str(place), licence=licence, credit=credit)]


def _in_folder(folder: Path, exclude: Sequence[str], licence: str | None, credit: str | None) -> list[DatasetSource]:
    found = []
    for path in sorted(folder.rglob("*")):
        name = path.name.lower()
        left_out = any(fnmatch.fnmatch(name, pattern) for pattern in NO_CLIPS) or any(
            fnmatch.fnmatch(path.name, p) or fnmatch.fnmatch(str(path.relative_to(folder)), p) for p in exclude
        )
        if path.is_file() and path.suffix.lower() in suffixes() and not left_out:
            found.append(DatasetSource(str(path.resolve()), licence=licence or _beside(path, folder), credit=credit))
    return found


def _beside(path: Path, top: Path) -> str | None:
    """The first line of the licence file next to a file, or above it within the folder."""
    for folder in path.parents:
        for name in _LICENCES:
            try:
                lines = (folder / name).read_text(encoding="utf-8", errors="replace").splitlines()
            except OSError:
                continue
            first = next((line.strip() for line in lines if line.strip()), None)
            if first is not None:
                return first[:200]
        if folder == top:
            return None
    return None


def _is_list(path: Path) -> bool:
    if not path.is_file():
        return True  # a missing list, rather than a motion of that name
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = next(csv.reader(file), [])
    except (OSError, UnicodeDecodeError, csv.Error):
        return False
    return "source" in [cell.strip() for cell in header]


def _of_list(path: Path, licence: str | None, credit: str | None) -> list[DatasetSource]:
    try:
        text = path.read_text(encoding="utf-8-sig")  # with a byte-order mark, as spreadsheets write it
    except FileNotFoundError:
        raise LibraryError(f"{path}: no such list") from None
    except (OSError, UnicodeDecodeError) as error:
        raise LibraryError(f"{path}: not a readable list of sources ({error})") from None
    rows: list[tuple[int, Mapping[str, str]]]
    if path.suffix == ".csv":
        reader = csv.DictReader(io.StringIO(text), skipinitialspace=True)
        unknown = sorted(set(reader.fieldnames or ()) - set(_COLUMNS))
        if unknown:
            raise LibraryError(f"{path}: unknown column '{unknown[0]}'; there are {', '.join(_COLUMNS)}")
        rows = [(reader.line_num, row) for row in reader]
    else:
        lines = (line.split("#", 1)[0].strip() for line in text.splitlines())
        rows = [(number, {"source": line}) for number, line in enumerate(lines, 1) if line]
    found = [_of_row(path, number, row, licence, credit) for number, row in rows]
    if not found:
        raise LibraryError(f"{path}: the list is empty")
    return found


def _of_row(
    path: Path, number: int, row: Mapping[str, str | None], licence: str | None, credit: str | None
) -> DatasetSource:
    given = {name: value.strip() for name, value in row.items() if name and value and value.strip()}
    if "source" not in given:
        raise LibraryError(f"{path}, line {number}: no source")
    place = given.pop("source")
    beside = path.parent / place
    kinds: dict[str, Callable[[str], Any]] = {"frames": _frames, "fps": float, "scale": float}
    kinds["point_map"] = lambda text: str((path.parent / text).resolve())
    try:
        values = {name: kinds.get(name, str)(text) for name, text in given.items()}
        known = {"licence": licence, "credit": credit} | values
        return DatasetSource(str(beside.resolve()) if beside.exists() else place, **known)
    except ValueError as error:
        raise LibraryError(f"{path}, line {number}: {error}") from None


def _frames(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)\s*:\s*(\d+)", text)
    if found is None:
        raise ValueError(f"frames are FIRST:END, such as 162:201, found '{text}'")
    return int(found[1]), int(found[2])
