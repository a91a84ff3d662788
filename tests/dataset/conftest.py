"""Libraries small enough for a test."""

from pathlib import Path

from cli.conftest import in_folder, run, start
from fastmimic.dataset import BuildRequest, BuildSettings, DatasetSource, MotionDataset
from fastmimic.dataset.index import COSTS, Record
from made_once import made_once
from searches import QUICK_CHOICE

__all__ = ["in_folder", "made_once", "run", "start"]

RECIPE = BuildSettings(
    iterations=3,
    population=4,
    duration_s=0.6,
    evaluation_s=0.6,
    perturbed=1,
    others=2,
    second_simulator=False,
    choice=QUICK_CHOICE,
)


def of(*names: str, **options: object) -> BuildRequest:
    """The named motions, on the A1."""
    sources = [DatasetSource(name) for name in names]
    return BuildRequest(sources, RECIPE, ("a1",), **options)  # type: ignore[arg-type]


def contents(folder: Path) -> dict[str, bytes]:
    """The motions of a library, by the names of their files."""
    return {path.name: path.read_bytes() for path in (folder / "motions").iterdir()}


def reproducible(record: Record) -> Record:
    """The part of a record that every repetition reproduces, at any time and on any machine."""
    return {name: value for name, value in record.items() if name not in COSTS}


def same(one: Path, other: Path) -> None:
    """Fails unless two libraries hold the same, bit for bit."""
    assert contents(one) == contents(other)
    rows = [[reproducible(row) for row in MotionDataset.open(folder).index()] for folder in (one, other)]
    assert rows[0] == rows[1]
