"""Few velocities for the gaits of a steered robot, whose solutions for the A1 are in the package."""

from typing import Any

from fastmimic.steering.gait_field import Grid


def slow(speed: float) -> Grid:
    return Grid((0.0, speed), (-speed / 3.0, speed / 3.0), (1.0, 0.6))


def fast(speed: float) -> Grid:
    return Grid((0.8 * speed, speed), (0.0, 0.1 * speed), (0.8, 0.6))


FEW: dict[str, Any] = {"grid": Grid((0.0, 1.5), (-0.4, 0.0, 0.4), (2.0, 0.9)), "slow": slow, "fast": fast}
"""Arguments of `gait_field`."""
