"""The array types of the package, stretches of True, and fingerprints of content."""

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
Records = NDArray[Any]  # of a type with fields, such as those of `fastmimic.robot.state`


def stretches(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and end of each stretch of True in (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def fingerprint(*content: bytes | NDArray[Any]) -> str:
    """16 hexadecimal digits of texts and of the values of arrays."""
    found = hashlib.sha256()
    for part in content:
        found.update(part if isinstance(part, bytes) else part.tobytes())
    return found.hexdigest()[:16]
