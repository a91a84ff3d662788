"""`fastmimic library`: datasets of motions that a robot can execute."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, OmitSubcommandPrefixes, Positional, subcommand

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.commands import options as opt
from fastmimic.commands.console import EXIT_SOME_FAILED, note, put, share_progress, slow_start
from fastmimic.commands.library_content import LibraryExport, ListMotions, Show, Verify, put_summary
from fastmimic.executors import make_executor
from fastmimic.optimize.parameters import FinalChoice
from fastmimic.robot import ROBOT_CHOICES

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.dataset.build import BuildRequest, BuildStep


@dataclass(frozen=True, kw_only=True)
class Build:
    """Builds a library of motions from folders, lists, files and names: finds the cycles in long takes, retargets and
    optimises them, tests each motion from perturbed starts, on other robots and in a second simulator, grades it, and
    keeps a record.

    Finished motions are kept: the same command continues after Ctrl-C, a crash or a full disk, and adds what is new.
    The exit status is 3 if some sources or motions failed; all others are built.
    """

    sources: Annotated[Positional[tuple[str, ...]], opt.option("FOLDER|LIST|MOTION ...")]
    """Folders of clips, lists (.csv with a column 'source', or .list with one source a line), files, or names from
    'fastmimic motions'."""
    out: Annotated[Path, opt.option("LIBRARY")]
    """Folder of the library."""
    robots: Annotated[tuple[str, ...], opt.option("NAME|FILE.xml ...", f"{ROBOT_CHOICES}.")] = (opt.DEFAULT_ROBOT,)
    seeds: int = 1
    """Searches for each motion and robot."""
    method: opt.MethodName = "mbc-dmp"
    config: opt.ConfigName = "default"
    duration: Annotated[float, opt.option("S")] = 5.0
    """Length of the search's episodes."""
    trial: Annotated[float, opt.option("S")] = 10.0
    """Length of the test episodes."""
    perturbed: int = 8
    """Number of test episodes with perturbed starts."""
    others: int = 16
    """Number of other robots to test on: random ground, payload and motors from the usual ranges."""
    no_second_simulator: opt.Flag = False
    """Do not test in PyBullet, even if it is installed."""
    confidence: Annotated[float, opt.option("SHARE")] = 0.5
    """Least confidence at which a cycle found in a take is imitated."""
    discrete: opt.Flag = False
    """Also imitate non-periodic movements in takes, such as turns, starts and stops; each runs once."""
    warm_start: Annotated[Path | None, opt.option("LIBRARY")] = None
    """Start each search from the most similar motion of a finished library."""
    exclude: Annotated[tuple[str, ...], opt.option("PATTERN ...")] = ()
    """Files of the folders to skip, such as '*_raw.txt'."""
    licence: Annotated[str | None, opt.option("TEXT")] = None
    """Licence of sources that state none."""
    credit: Annotated[str | None, opt.option("TEXT")] = None
    """Credit of sources that state none."""
    executor: Annotated[str, opt.option("local|ray")] = "local"
    """Where the jobs run: in processes here, or on a Ray cluster that has sources and library under the same paths."""
    address: Annotated[str | None, opt.option("HOST:PORT")] = None
    """Address of a running Ray cluster. Default: one is started here."""
    workers: opt.Workers = None
    update: opt.Flag = False
    """Rebuild a library that was built with other settings."""
    search: opt.Searching
    choice: opt.Choice = FinalChoice()

    def run(self) -> int:
        from fastmimic.dataset import build_dataset

        building = self._building()
        executor = make_executor(self.executor, workers=self.workers, address=self.address)
        said = f"{len(building.sources)} sources, {len(building.robots)} robots, {building.seeds} seeds, in {self.out}"
        with _progress(said) as progress:
            built = build_dataset(building, self.out, executor, update=self.update, progress=progress)
        put(f"{built.jobs} motions, {built.done} of them new")
        put_summary(built.library)
        for line in built.left_out:
            note(f"skipped: {line}")
        failed = len(built.failures)
        if failed:
            put(f"{failed} failed: 'fastmimic library list {self.out} --grade failed' lists them with the reason")
        put(f"library in {self.out}")
        return EXIT_SOME_FAILED if failed else 0

    def _building(self) -> "BuildRequest":
        from fastmimic.dataset import BuildRequest, BuildSettings, MotionDataset, find_sources

        if not self.sources:
            raise ConfigError("no sources given; name folders, lists, clips or motions")
        sources = [
            source
            for place in self.sources
            for source in find_sources(place, exclude=self.exclude, licence=self.licence, credit=self.credit)
        ]
        recipe = BuildSettings(
            method=self.method,
            config=self.config,
            duration_s=self.duration,
            iterations=self.search.iterations,
            population=self.search.population,
            evaluation_s=self.trial,
            choice=self.choice,
            perturbed=self.perturbed,
            others=self.others,
            second_simulator=not self.no_second_simulator and _second_simulator(self.robots),
        )
        warm = None if self.warm_start is None else MotionDataset.open(self.warm_start)
        folders = [path.resolve() for place in self.sources if (path := Path(place)).is_dir()]
        return BuildRequest(sources, recipe, self.robots, self.seeds, self.confidence, self.discrete, warm, folders)


@dataclass(frozen=True, kw_only=True)
class Libraries:
    """Builds, lists and checks libraries: datasets of motions that a robot can execute."""

    action: OmitArgPrefixes[
        OmitSubcommandPrefixes[
            Annotated[Build, subcommand("build")]
            | Annotated[ListMotions, subcommand("list")]
            | Annotated[Show, subcommand("show")]
            | Annotated[LibraryExport, subcommand("export")]
            | Annotated[Verify, subcommand("verify")]
        ]
    ]

    def run(self) -> int:
        return self.action.run()


def _second_simulator(robots: Sequence[str]) -> bool:
    """Whether PyBullet is installed; prints a note if it is missing and has one of the robots."""
    from fastmimic.simulation.pybullet_sim import DESCRIPTIONS, require_pybullet  # it loads the compiler

    try:
        require_pybullet()
    except ConfigError:
        if any(name.lower() in DESCRIPTIONS for name in robots):
            note("PyBullet is not installed: motions are not tested in a second simulator")
        return False
    return True


@contextmanager
def _progress(said: str) -> "Iterator[Callable[[BuildStep], None]]":
    """Prints what is built at the start, a line for each finished motion and each failure, and how to continue after an
    interruption; on a terminal also a bar."""
    from fastmimic.dataset.build import describe_failure
    from fastmimic.dataset.records import FAILED, grade

    started_building = False
    with slow_start() as started, share_progress("building") as bar:

        def report(step: "BuildStep") -> None:
            nonlocal started_building
            if not started_building:
                note(said)
                started_building = True
            if step.survey is not None and step.survey.failed is not None:
                note(f"failed: {step.survey.problem}")
            if step.record is not None and step.record["status"] == FAILED:
                note(f"failed: {describe_failure(step.record)}")
            elif step.record is not None:
                started()
                r = step.record
                what = f"reward {r['reward']:.3f}, {grade(r)[0]}"
                note(f"{step.done}/{step.total} {r['name']} on {r['robot']} seed {r['seed']}: {what}")
            if bar is not None:
                bar(step.share, f"{step.what} {step.done}/{step.total}")

        try:
            yield report
        except (KeyboardInterrupt, FastMimicError):
            if started_building:
                note("finished motions are kept; the same command continues")
            raise
