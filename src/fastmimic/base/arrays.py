"""The array type of the package, and stretches of True."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def stretches(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and end of each stretch of True in (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
