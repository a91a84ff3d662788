"""`fastmimic motions`, `fastmimic robots` and `fastmimic data`: what there is, and downloads."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.clips.catalogue import describe
from fastmimic.clips.data import DATASETS, data_folder, fetch, list_datasets
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, put, put_table
from fastmimic.robot import ROBOT_NAMES, load_robot

ACTIONS: Final = ("list", "fetch")
RecordingsFolder = Annotated[
    Path | None, opt.option("FOLDER", "Folder of the recordings. Default: $FASTMIMIC_DATA, else the user's cache.")
]


@dataclass(frozen=True, kw_only=True)
class Motions:
    """Lists the named motions: built-in gaits and recordings of a dog."""

    folder: RecordingsFolder = None

    def run(self) -> int:
        rows = describe(self.folder)
        cells = [(r.name, r.speed, "yes" if r.available else "no", r.about, r.source) for r in rows]
        put_table([("name", "speed", "here", "description", "source"), *cells])
        for licence in dict.fromkeys(r.licence for r in rows if r.source != "built in"):
            note(f"licence of the recordings: {licence}")
        if not all(r.available for r in rows):
            note("'fastmimic data fetch' downloads what is missing here")
        return 0


@dataclass(frozen=True, kw_only=True)
class Robots:
    """Lists the built-in robots. For your own, give --robot FILE.xml, the MJCF of a quadruped."""

    def run(self) -> int:
        rows = [("name", "mass kg", "leg m", "torque N·m", "joint speed rad/s")]
        for name in ROBOT_NAMES:
            robot = load_robot(name)
            torque, speed = (
                " ".join(f"{v:g}" for v in limit[:3]) for limit in (robot.torque_limit, robot.joint_speed_limit)
            )
            rows.append((name, f"{robot.mass:.2f}", f"{robot.leg_length:.3f}", torque, speed))
        put_table(rows)
        note("your own: --robot FILE.xml, an MJCF with abduction, hip and knee joints in each of four legs")
        return 0


@dataclass(frozen=True, kw_only=True)
class Data:
    """Lists or downloads the public recordings of a dog; verifies each file by its hash."""

    action: Annotated[Positional[str], opt.option("list|fetch")]
    """List the datasets, or download them."""
    datasets: Annotated[Positional[tuple[str, ...]], opt.option("[DATASET ...]")] = ()
    """Datasets to download. Default: all."""
    folder: RecordingsFolder = None
    base_url: Annotated[str | None, opt.option("URL")] = None
    """Server of the recordings. Default: $FASTMIMIC_DATA_URL, else the public original."""

    def run(self) -> int:
        if self.action not in ACTIONS:
            raise ConfigError(f"data takes list or fetch, found '{self.action}'{did_you_mean(self.action, ACTIONS)}")
        return self._list() if self.action == "list" else self._fetch()

    def _list(self) -> int:
        if self.datasets or self.base_url:
            raise ConfigError("data list takes no dataset and no --base-url: it lists everything")
        found = list_datasets(self.folder)
        rows = [(d.name, f"{len(here)} of {len(d.files)}", d.about) for d, here in found]
        put_table([("dataset", "files here", "description"), *rows])
        put(f"folder: {data_folder(self.folder)}")
        self._put_licence([d.name for d, _ in found])
        return 0

    def _fetch(self) -> int:
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
        chosen = [d for d in DATASETS if names is None or d.name in names]
        for licence, credit in dict.fromkeys((d.licence, d.credit) for d in chosen):
            put(f"licence: {licence}", f"credit: {credit}")
