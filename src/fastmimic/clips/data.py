"""Public motion capture of a dog (CC BY-NC 4.0), which is not part of this package: folder and verified downloads."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

from fastmimic.base.errors import DataError, OutputError
from fastmimic.base.files import packaged, replace_file, user_cache
from fastmimic.base.registry import Registry

DEFAULT_BASE_URL: Final = (
    "https://raw.githubusercontent.com/erwincoumans/motion_imitation/d0e7b963c5a301984352d25a3ee0820266fa4218"
)
FOLDER_VARIABLE: Final = "FASTMIMIC_DATA"
URL_VARIABLE: Final = "FASTMIMIC_DATA_URL"
TIMEOUT_S: Final = 30.0
_CHUNK: Final = 65536  # bytes between two reports

Progress = Callable[[str, int, int], None]  # file name, bytes received, and total bytes (0 if unknown)


@dataclass(frozen=True)
class Dataset:
    """A group of public files: file names → SHA-256. `name` is also its folder in the data folder, `origin` its folder
    below the base URL; licence and credit are shown with the data."""

    name: str
    about: str
    origin: str
    files: dict[str, str]
    licence: str
    credit: str


@dataclass(frozen=True)
class RecordedMotion:
    """A motion in the public data: `file` of `dataset`, with its approximate speed at the source's size, and the
    `frames` (first, end) of the cycle, 0-based, end exclusive; None for the whole file."""

    about: str
    speed: str
    dataset: str
    file: str
    frames: tuple[int, int] | None = None

    @property
    def source(self) -> str:
        cut = "" if self.frames is None else f" frames {self.frames[0]}:{self.frames[1]}"
        return f"{self.dataset}/{self.file}{cut}"


DATASETS: Final = Registry("dataset", packaged("fastmimic.clips", "datasets.json", list[Dataset]), error=DataError)
RECORDED: Final = packaged("fastmimic.clips", "recordings.json", dict[str, RecordedMotion])


def data_folder(folder: str | Path | None = None) -> Path:
    """The data folder: `folder`, else $FASTMIMIC_DATA, else the user's cache folder."""
    chosen = folder or os.environ.get(FOLDER_VARIABLE)
    return Path(chosen).expanduser() if chosen else user_cache()


def list_datasets(folder: str | Path | None = None) -> list[tuple[Dataset, list[str]]]:
    """All datasets, each with those of its files that are there, by name; `fetch` checks the content."""
    return [(d, [name for name in d.files if find_file(d.name, name, folder) is not None]) for d in DATASETS.values()]


def fetch(
    names: Iterable[str] | None = None,
    *,
    folder: str | Path | None = None,
    base_url: str | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Downloads datasets (all if `names` is None) to the data folder, except files that are there and unchanged.
    `base_url` is a server with the original's folders, else $FASTMIMIC_DATA_URL or the original; `progress` is called
    while each file is downloaded. Returns the files' paths, all verified. Raises `DataError`: unknown dataset, server
    not reached, download incomplete, wrong content, or a folder that cannot be written; existing files stay whole."""
    root = data_folder(folder)
    url = (base_url or os.environ.get(URL_VARIABLE) or DEFAULT_BASE_URL).rstrip("/")
    datasets = [DATASETS[name] for name in (DATASETS if names is None else names)]
    return [_fetch_file(root, dataset, name, url, progress) for dataset in datasets for name in dataset.files]


def find_file(dataset: str, name: str, folder: str | Path | None = None) -> Path | None:
    """Path of a file in the data folder, or None if it has not been fetched."""
    path = data_folder(folder) / dataset / name
    return path if os.path.isfile(path) else None


def dataset_of(path: str | Path) -> Dataset | None:
    """The public dataset that contains the same file content, or None."""
    try:
        digest = sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return None
    return next((d for d in DATASETS.values() if digest in d.files.values()), None)


def _fetch_file(root: Path, dataset: Dataset, name: str, base_url: str, progress: Progress | None) -> Path:
    import requests

    local, url, digest = f"{dataset.name}/{name}", f"{base_url}/{dataset.origin}/{name}", dataset.files[name]
    path, content = root / local, bytearray()
    if path.is_file() and sha256(path.read_bytes()).hexdigest() == digest:
        return path
    whole = {"Accept-Encoding": "identity"}  # uncompressed, so that the announced length is the file's
    try:
        with requests.get(url, headers=whole, timeout=TIMEOUT_S, stream=True) as reply:
            if reply.status_code == requests.codes.not_found:
                raise DataError(f"{url}: the server has no such file (404); check the base URL")
            if not reply.ok:
                raise DataError(f"{url}: the server answered {reply.status_code} ({reply.reason})")
            total = int(reply.headers.get("Content-Length", 0))
            for part in reply.iter_content(_CHUNK):
                content += part
                if progress is not None:
                    progress(local, len(content), total)
    except requests.exceptions.Timeout:
        raise DataError(f"{url}: no answer within {TIMEOUT_S:g} s; try again later") from None
    except requests.exceptions.ChunkedEncodingError:
        raise DataError(f"{url}: the download broke off; nothing was kept, try again") from None
    except requests.exceptions.ConnectionError:
        raise DataError(f"{url}: the server cannot be reached; check the network or the base URL") from None
    except requests.exceptions.RequestException as error:
        raise DataError(f"{url}: cannot be fetched ({' '.join(str(error).split())[:200]})") from None
    if sha256(content).hexdigest() != digest:
        raise DataError(f"{url}: the content is not the one expected (SHA-256 differs); nothing was kept")
    try:
        replace_file(path, lambda file: file.write(content))
    except OutputError as error:
        raise DataError(str(error)) from None
    return path
