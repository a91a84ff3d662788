"""Products and solutions that do not depend on how many threads BLAS has."""

import os
import subprocess
import sys

import numpy as np
import pytest

from fastmimic.primitive.rhythmic import in_band, product, solve_banded


@pytest.mark.nojit
def test_products_are_numpys() -> None:
    generator = np.random.default_rng(0)
    a, b = generator.normal(size=(3, 5, 7)), generator.normal(size=(7, 2))
    np.testing.assert_allclose(product(a, b), a @ b, atol=1e-13)
    np.testing.assert_allclose(product(b.T, a[0].T), b.T @ a[0].T, atol=1e-13)
    assert product(a[0, 0], b).shape == (2,)


@pytest.mark.nojit
def test_solutions_are_numpys() -> None:
    generator = np.random.default_rng(1)
    root, b = generator.normal(size=(8, 8)), generator.normal(size=(8, 3))
    a = root @ root.T + np.eye(8)
    np.testing.assert_allclose(solve_banded(in_band(a), b), np.linalg.solve(a, b), atol=1e-12)
    a[np.abs(np.subtract.outer(np.arange(8), np.arange(8))) > 2] = 0.0
    a += 8.0 * np.eye(8)
    np.testing.assert_allclose(solve_banded(in_band(a)[:, -3:], b), np.linalg.solve(a, b), atol=1e-12)


FIT = """
import hashlib, numpy as np
from fastmimic.primitive import RhythmicDmp
y = np.random.default_rng(2).normal(size=(400, 24))
dmp = RhythmicDmp.fit(y, 0.8)
made = dmp.position(2 * np.pi * np.arange(400) / 400)
print(hashlib.sha256(dmp.weights.tobytes() + made.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_a_fit_has_the_same_bits_whatever_the_number_of_threads() -> None:
    digests = set()
    for threads in ("1", "2"):
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        run = subprocess.run([sys.executable, "-c", FIT], env=environment, capture_output=True, text=True, check=True)
        digests.add(run.stdout)
    assert len(digests) == 1
