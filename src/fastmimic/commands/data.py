"""`fastmimic data`: the public recordings of a dog."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, put, put_table

ACTIONS = ("list", "fetch")


@dataclass(frozen=True, kw_only=True)
class Data:
    """Lists or downloads the public recordings of a dog; verifies each file by its hash."""

    action: Annotated[Positional[str], opt.option("list|fetch")]
    """List the datasets, or download them."""
    datasets: Annotated[Positional[tuple[str, ...]], opt.option("[DATASET ...]")] = ()
    """Datasets to download. Default: all."""
    folder: Annotated[Path | None, opt.option("FOLDER")] = None
    """Folder of the recordings. Default: $FASTMIMIC_DATA, else the user's cache."""
    base_url: Annotated[str | None, opt.option("URL")] = None
    """Server of the recordings. Default: $FASTMIMIC_DATA_URL, else the public original."""

    def run(self) -> int:
        """Lists or downloads; returns the exit status."""
        if self.action not in ACTIONS:
            raise ConfigError(f"data takes list or fetch, found '{self.action}'{did_you_mean(self.action, ACTIONS)}")
        return self._list() if self.action == "list" else self._fetch()

    def _list(self) -> int:
        if self.datasets or self.base_url:
            raise ConfigError("data list takes no dataset and no --base-url: it lists everything")
        from fastmimic.clips.data import list_datasets

        found = list_datasets(self.folder)
        rows = [(s.dataset.name, f"{len(s.present)} of {len(s.dataset.files)}", s.dataset.about) for s in found]
        put_table([("dataset", "files here", "description"), *rows])
        put(f"folder: {found[0].folder}")
        self._put_licence([s.dataset.name for s in found])
        return 0

    def _fetch(self) -> int:
        from fastmimic.clips.data import data_folder, fetch

        started = set()

        def progress(name: str, done: int, total: int) -> None:
            if name not in started:
                started.add(name)
                note(f"{name}  {total / 1e6:.2f} MB" if total else name)

        names = list(self.datasets) or None
        paths = fetch(names, folder=self.folder, base_url=self.base_url, progress=progress)
        put(f"{len(paths)} files, verified, in {data_folder(self.folder)}")
        self._put_licence(names)
        return 0

    def _put_licence(self, names: list[str] | None) -> None:
        from fastmimic.clips.data import DATASETS

        chosen = [d for d in DATASETS if names is None or d.name in names]
        for licence, credit in dict.fromkeys((d.licence, d.credit) for d in chosen):
            put(f"licence: {licence}", f"credit: {credit}")
