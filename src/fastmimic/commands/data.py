"""`fastmimic data`: the public recordings of a dog."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.commands.console import note, put, table

ACTIONS = ("list", "fetch")


@dataclass(frozen=True, kw_only=True)
class Data:
    """Lists the public recordings of a dog, or fetches them, each file verified by its hash."""

    action: Annotated[Positional[str], arg(metavar="list|fetch")]
    """What to do."""
    datasets: Annotated[Positional[tuple[str, ...]], arg(metavar="[DATASET ...]")] = ()
    """To fetch; all by default."""
    folder: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Where they are kept; by default $FASTMIMIC_DATA, else the user's cache."""
    base_url: Annotated[str | None, arg(metavar="URL")] = None
    """A server that has them; by default $FASTMIMIC_DATA_URL, else the public original."""

    def run(self) -> int:
        """Does it; returns the exit status."""
        if self.action not in ACTIONS:
            raise ConfigError(f"data takes list or fetch, found '{self.action}'{did_you_mean(self.action, ACTIONS)}")
        return self._list() if self.action == "list" else self._fetch()

    def _list(self) -> int:
        if self.datasets or self.base_url:
            raise ConfigError("data list takes no dataset and no --base-url: it lists all that there is")
        from fastmimic.clips.data import list_datasets

        found = list_datasets(self.folder)
        rows = [("dataset", "files here", "what it is")]
        rows += [(s.dataset.name, f"{len(s.present)} of {len(s.dataset.files)}", s.dataset.about) for s in found]
        for line in table(rows):
            put(line)
        put(f"folder: {found[0].folder}")
        self._put_licence([s.dataset.name for s in found])
        return 0

    def _fetch(self) -> int:
        from fastmimic.clips.data import data_folder, fetch

        begun = set()

        def progress(name: str, done: int, total: int) -> None:
            if name not in begun:
                begun.add(name)
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
            put(f"licence: {licence}")
            put(f"credit: {credit}")
