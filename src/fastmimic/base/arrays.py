"""The array types of the package, stretches of True, and fingerprints of content."""

import hashlib
import json
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
Records: TypeAlias = Any  # an array of a type with fields, which mypy does not know, such as in `fastmimic.robot.state`


def stretches(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and end of each stretch of True in (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def fingerprint(*content: bytes | NDArray[Any] | dict[str, Any]) -> str:
    """16 hexadecimal digits of texts, of the values of arrays, and of JSON objects, by their keys in order."""
    found = hashlib.sha256()
    for part in content:
        given = json.dumps(part, sort_keys=True).encode() if isinstance(part, dict) else part
        found.update(given if isinstance(given, bytes) else given.tobytes())
    return found.hexdigest()[:16]
