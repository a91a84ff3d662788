"""Files that are replaced whole or not at all."""

import json
import math
import os
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeVar

import msgspec
import numpy as np
import platformdirs
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError, FastMimicError, OutputError
from fastmimic.base.text import plain

MOST_BYTES: Final = 500_000_000  # that a file of arrays may unpack to: a bomb of some megabytes, to gigabytes
UNREADABLE: Final = (
    *(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error),
    RuntimeError,  # zipfile: encrypted, or compressed in a way that it does not know
    TypeError,  # a lone .npy
    *(SyntaxError, tokenize.TokenError, OverflowError),  # NumPy: a header that is no Python, or no size
)
"""Errors of NumPy and zipfile for a damaged archive."""


_Kind = TypeVar("_Kind")


def packaged(room: str, name: str, kind: type[_Kind]) -> _Kind:
    """A table that a room keeps as a JSON file, such as `gaits.json` of `fastmimic.clips`, as typed records."""
    return msgspec.json.decode(resources.files(room).joinpath(name).read_bytes(), type=kind)


def user_cache() -> Path:
    """The folder in which this user's programs keep what they can make again, ours within it."""
    return Path(platformdirs.user_cache_dir("fastmimic"))


def replace_file(path: str | Path, write: Callable[[BinaryIO], Any]) -> None:
    """Calls `write` with a temporary file in the same folder, then moves it to `path`; raises `OutputError`, with
    `path` unchanged, if the folder cannot be created or the file not written."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Gives an empty temporary file in the same folder, and moves it to `path` at the end; raises `OutputError`, with
    `path` unchanged, if the folder cannot be created or the file not written."""
    path, temporary = Path(path), None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
        temporary = Path(name)
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except BaseException as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from None
        raise


def write_text(path: str | Path, text: str) -> None:
    """Replaces a file by a text; raises `OutputError`."""
    replace_file(path, lambda file: file.write(text.encode(errors="replace")))  # half a character is none


def write_json(path: str | Path, value: Any) -> None:
    """Replaces a file by a value as JSON (`fastmimic.base.text.plain`); raises `OutputError`."""
    write_text(path, json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def from_json(text: str) -> Any:
    """The value of a JSON text; a whole number of more than 64 bits, which no array holds, is read as a float. Raises
    `ValueError`, also for brackets that nest too deeply, and for NaN, infinity and half a character."""

    def finite(digits: str) -> float:
        if not math.isfinite(value := float(digits)):
            raise ValueError(f"{digits[:20]} is no finite number")
        return value

    hooks: dict[str, Any] = {"parse_float": finite, "parse_constant": finite}
    try:
        found = json.loads(text, parse_int=lambda d: int(d) if len(d) < 19 else finite(d), **hooks)
    except RecursionError:
        raise ValueError("its brackets nest too deeply") from None
    json.dumps(found, ensure_ascii=False).encode()  # raises for half a character
    return found


def read_json(path: str | Path, error: type[FastMimicError] = ConfigError) -> dict[str, Any]:
    """The object in a JSON file; raises `error` if there is no such file, no object in it, or it cannot be read."""
    try:
        value = from_json(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, ValueError) as problem:
        raise error(f"{path}: cannot be read ({problem})") from None
    if not isinstance(value, dict):
        raise error(f"{path}: does not hold a JSON object")
    return value


def read_arrays(path: str | Path | BinaryIO, error: type[FastMimicError], what: str) -> dict[str, NDArray[Any]]:
    """The arrays of an `.npz` without pickles; raises `error` if there is no such file, or it is no readable `what`."""
    try:
        with open_arrays(path) as file:
            return {key: file[key] for key in file.files}
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except UNREADABLE as problem:
        raise error(f"{path}: not a readable {what} ({problem})") from None


def open_arrays(path: str | Path | BinaryIO) -> Any:
    """What `numpy.load` makes of an `.npz` or `.npy`, without pickles, if it announces no more than it holds, and at
    most `MOST_BYTES`; an `.npy` is not read yet. Raises one of `UNREADABLE`."""
    if zipfile.is_zipfile(path):
        _check_archive(path)
    elif not _begins(path).startswith(np.lib.format.MAGIC_PREFIX):
        raise ValueError("neither an .npz nor an .npy")
    if not isinstance(path, str | Path):
        path.seek(0)
    return np.load(path, mmap_mode="r", allow_pickle=False)


def _begins(path: str | Path | BinaryIO) -> bytes:
    if not isinstance(path, str | Path):
        path.seek(0)
        return path.read(8)
    with Path(path).open("rb") as file:
        return file.read(8)


def _check_archive(path: str | Path | BinaryIO) -> None:
    form, announced = np.lib.format, 0
    headers = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            announced += member.file_size
            if announced > MOST_BYTES:
                raise ValueError(f"it unpacks to more than {MOST_BYTES / 1e6:.0f} MB")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"'{member.filename}' is compressed as NumPy does not")  # others unpack without bound
            with archive.open(member) as data:
                shape, _, dtype = headers[form.read_magic(data)](data)
            if not dtype.hasobject and math.prod((max(dtype.itemsize, 1), *shape)) > member.file_size:
                raise ValueError(f"'{member.filename}' announces an array of {str(shape)[:80]}, more than it holds")


def check_folder(folder: str | Path) -> None:
    """Makes a folder if need be and checks that files can be written in it, before long work; raises `OutputError`."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to ({error.strerror or error})") from None


def remove_file(path: Path) -> bool:
    """Removes a file; returns whether there was one. Raises `OutputError` if it cannot."""
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    except OSError as error:
        raise OutputError(f"{path}: cannot be removed ({error.strerror or error})") from None
    return True
