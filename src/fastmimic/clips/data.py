"""Public motion capture of a dog: the datasets, their folder, and verified downloads. The data is not part of this
package. Each clip keeps its licence (CC BY-NC 4.0)."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import DataError
from fastmimic.base.registry import Registry

DEFAULT_BASE_URL: Final = (
    "https://raw.githubusercontent.com/erwincoumans/motion_imitation/d0e7b963c5a301984352d25a3ee0820266fa4218"
)
FOLDER_VARIABLE: Final = "FASTMIMIC_DATA"
URL_VARIABLE: Final = "FASTMIMIC_DATA_URL"
LICENCE: Final = "CC BY-NC 4.0 (https://creativecommons.org/licenses/by-nc/4.0/legalcode)"
CREDIT: Final = (
    "AI4Animation, Zhang et al. 2018 (mode-adaptive neural networks for quadruped motion control),"
    " as distributed with motion_imitation, Peng et al. 2020"
)
TIMEOUT_S: Final = 30.0

Progress = Callable[[str, int, int], None]  # file name, bytes received, and total bytes (0 if unknown)


@dataclass(frozen=True)
class Dataset:
    """A group of public files: file names → SHA-256. `name` is also its folder in the data folder, `origin` its folder
    below the base URL; licence and credit are shown with the data."""

    name: str
    about: str
    origin: str
    files: dict[str, str]
    licence: str = LICENCE
    credit: str = CREDIT


DATASETS: Final = Registry(
    "dataset",
    [
        Dataset(
            name="dog_keypoints",
            about="motion capture of a dog, 27 keypoints at 60 Hz",
            origin="retarget_motion/data",
            files={
                "LICENSE.txt": "8784f6f1cb8488fc8e2e8af2556e24578df6ccf22d5060dbe640d9f98a6fb28e",
                "dog_pace_joint_pos.txt": "e56c9b0c90873038f1fa22f447013f09fddd2c768742f873d09852af74010224",
                "dog_run00_joint_pos.txt": "2a0d09de7d19fd3929dc84dc7ffe195d9c55c46465b8fd15ec2332b120461d96",
                "dog_trot_joint_pos.txt": "6bc27204d248457cec64104969e6d8c6b93cadcfb7d2d391b45748860b3d9745",
                "dog_turn00_joint_pos.txt": "91b071b0085f00af3507a3e44559018818e6b5ecdfb83e6e161f32cfef83f25b",
                "dog_walk00_joint_pos.txt": "1fdedeb3419a545a5090c200edf8d0076ccfe723ecc0eacfe4fa24a0849736dc",
                "dog_walk03_joint_pos.txt": "c5db797262ae63a131a8a956a75b2697ff7c3b318ebbc0e18f02ad05d2743a3f",
                "dog_walk09_joint_pos.txt": "8a75d08a3e4ac879c0d9ad8e39a8867d481af4e6c89ab66fa22e60a2174e35d3",
            },
        ),
        Dataset(
            name="deepmimic_motions",
            about="the dog and an animator's motions on a Laikago, DeepMimic-style JSON",
            origin="motion_imitation/data/motions",
            files={
                "dog_pace.txt": "2ebff49cc4991eae4ddd9f8b37514956ffcb7dc194a16dba15c5240857e6ed66",
                "dog_spin.txt": "fce7b861b34103ddffccd0fc31bd078d58ad0240a2740f56780d46a93308fe1f",
                "dog_trot.txt": "ec304dbbc4e5bfbfc4955074e27a7e0b3038485952ea9847e9ca42594c9e87a6",
                "inplace_steps.txt": "a9900d6617d22f7a41e314eb9fab204571999468f4a0932c8caf000cf5535454",
                "sidesteps.txt": "4ec842bceb11df0c887c6ca17e0f5ec29cc9cd37c2544fb67949f092fd7cea4f",
                "turn.txt": "da0f6b04bc026f350f9f7ab2bdb50dea3d7fe9ed9d0c8f5ad492d615a5109efd",
            },
        ),
    ],
    error=DataError,
)


def data_folder(folder: str | Path | None = None) -> Path:
    """The data folder: `folder`, else $FASTMIMIC_DATA, else the user's cache folder."""
    chosen = folder or os.environ.get(FOLDER_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    import pooch

    return Path(pooch.os_cache("fastmimic"))


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

    Args:
        base_url: a server with the original's folders or the data folder's; else $FASTMIMIC_DATA_URL or the original.
        progress: called while each file is downloaded.

    Returns the files' paths, all verified. Raises `DataError`: unknown dataset, server not reached, download
    incomplete, wrong content, or a folder that cannot be written. Existing files stay, and no partial file is left.
    """
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
    """Tries the original folder on the server, then ours, since a mirror may have either."""
    local = f"{dataset.name}/{name}"
    urls = (f"{base_url}/{dataset.origin}/{name}", f"{base_url}/{local}")
    for url in urls:
        found = _download(root, local, dataset.files[name], url, progress)
        if found is not None:
            return found
    raise DataError(f"{urls[0]}: the server has no such file (404), nor {urls[1]}; check the base URL")


def _download(root: Path, local: str, digest: str, url: str, progress: Progress | None) -> Path | None:
    """The verified file, or None if the URL does not exist on the server."""
    import pooch
    import requests

    # Uncompressed, so that the announced length is the file's.
    downloader = pooch.HTTPDownloader(
        progressbar=_ProgressBar(local, progress) if progress else False,
        timeout=TIMEOUT_S,
        headers={"Accept-Encoding": "identity"},
    )
    # `progress` and the exceptions report what pooch would log.
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel("WARNING")
    try:
        registry = pooch.create(path=root, base_url="", registry={local: digest}, urls={local: url})
        return Path(registry.fetch(local, downloader=downloader))
    except requests.exceptions.HTTPError as error:
        response: Any = error.response
        if response.status_code == requests.codes.not_found:
            return None
        raise DataError(f"{url}: the server answered {response.status_code} ({response.reason})") from None
    except requests.exceptions.Timeout:
        raise DataError(f"{url}: no answer within {TIMEOUT_S:g} s; try again later") from None
    except requests.exceptions.ChunkedEncodingError:
        raise DataError(f"{url}: the download broke off; nothing was kept, try again") from None
    except requests.exceptions.ConnectionError:
        raise DataError(f"{url}: the server cannot be reached; check the network or the base URL") from None
    except requests.exceptions.RequestException as error:
        raise DataError(f"{url}: cannot be fetched ({' '.join(str(error).split())[:200]})") from None
    except ValueError:  # from pooch: the hash differs
        raise DataError(f"{url}: the content is not the one expected (SHA-256 differs); nothing was kept") from None
    except OSError as error:
        raise DataError(f"{root / local}: cannot be written ({error.strerror or error})") from None
    finally:
        logger.setLevel(level)


class _ProgressBar:
    """A progress bar for pooch that calls `Progress`."""

    def __init__(self, name: str, progress: Progress) -> None:
        self.total = 0
        self._name, self._progress, self._done = name, progress, 0

    def update(self, n: int) -> None:
        self._done = min(self._done + n, self.total) if self.total else self._done + n
        self._progress(self._name, self._done, self.total)

    def reset(self) -> None:
        self._done = 0

    def close(self) -> None: ...
