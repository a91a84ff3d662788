"""A comparison small enough for a test."""

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def short_episodes() -> Iterator[None]:
    """Short evaluations and validations, for runs in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastmimic.optimize.cma_es.VALIDATION_S", 0.4)
        patch.setattr("fastmimic.optimize.cma_es.VALIDATION_EPISODES", 2)
        patch.setattr("fastmimic.optimize.cma_es.VALIDATED", 2)
        yield
