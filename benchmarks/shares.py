"""Shares of episodes, with how certain they are."""

import math

import numpy as np


def interval(held: np.ndarray) -> tuple[float, float]:
    """Wilson's interval of a share, 95 %, from whether each episode (n,) held."""
    z, n, share = 1.96, len(held), float(held.mean())
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return middle - half, middle + half


def shown(share: float, bounds: tuple[float, float]) -> str:
    """A share with its interval."""
    return f"{share:.0%} ({bounds[0]:.0%} to {bounds[1]:.0%})"
