"""Libraries small enough for a test."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from cli.conftest import in_folder, run, start
from fastmimic.library import Building, Library, Recipe, Source
from fastmimic.library.folder import reproducible

__all__ = ["in_folder", "run", "start"]

RECIPE = Recipe(
    iterations=3, population=4, duration_s=0.6, evaluation_s=0.6, perturbed=1, others=2, second_simulator=False
)


@pytest.fixture(scope="module", autouse=True)
def short_validation() -> Iterator[None]:
    """Short validations, for jobs in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastmimic.optimize.cma_es.VALIDATION_S", 0.4)
        patch.setattr("fastmimic.optimize.cma_es.VALIDATION_EPISODES", 2)
        patch.setattr("fastmimic.optimize.cma_es.VALIDATED", 2)
        yield


def of(*names: str, **options: object) -> Building:
    """The named motions, on the A1."""
    sources = [Source(name) for name in names]
    return Building(sources, RECIPE, ("a1",), **options)  # type: ignore[arg-type]


def contents(folder: Path) -> dict[str, bytes]:
    """The motions of a library, by the names of their files."""
    return {path.name: path.read_bytes() for path in (folder / "motions").iterdir()}


def same(one: Path, other: Path) -> None:
    """Fails unless two libraries hold the same, bit for bit."""
    assert contents(one) == contents(other)
    rows = [[reproducible(row) for row in Library.open(folder).index()] for folder in (one, other)]
    assert rows[0] == rows[1]
