"""Checks the samples that a primitive is fitted to."""

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError, MotionError

LEAST_SAMPLES = 4


def checked_samples(samples: NDArray[np.float64], what: str, **settings: float) -> NDArray[np.float64]:
    """A copy of the samples (t, d); `what` names them in messages. Raises `MotionError` for fewer than 4 samples or a
    value that is not finite, and `ConfigError` for a setting that is not positive."""
    for name, value in settings.items():
        if not (np.isfinite(value) and value > 0):
            raise ConfigError(f"{name} must be positive, found {value}")
    y = np.array(samples, dtype=np.float64)
    if y.ndim != 2 or len(y) < LEAST_SAMPLES:
        raise MotionError(f"a DMP of {what} needs at least {LEAST_SAMPLES} samples, found shape {y.shape}")
    if not np.all(np.isfinite(y)):
        raise MotionError(f"sample {int(np.argwhere(~np.isfinite(y))[0][0])} of {what} is not finite")
    return y
