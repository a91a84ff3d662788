"""Adds a disturbance: a gusty side wind. It is a function of the simulation, called before each control step.

python examples/extend/disturbance.py --fast

Set FASTMIMIC_EXTENSIONS to this file, and the command line knows it too: `fastmimic evaluate trot --disturb wind=8`.
"""

import argparse
from typing import Any

import numpy as np

import fastmimic as fm
from fastmimic.base.arrays import Array
from fastmimic.simulation.conditions import Disturbance
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, DisturbanceKind


def blow(simulation: Any, force: Array, time_s: float) -> None:
    """Pushes each trunk to its left, between nothing and twice the mean force."""
    simulation.trunk_force[:, 1] += force * (1.0 + np.sin(2.0 * np.pi * time_s))


DISTURBANCES.register(
    DisturbanceKind("wind", unit="N", lower=-100.0, upper=100.0, about="gusts from the side", each_step=blow)
)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--fast", action="store_true", help="half a second of each episode")
    seconds = 0.5 if parser.parse_args().fast else 4.0
    for wind in (0.0, 8.0, 16.0, 24.0):
        conditions = fm.Conditions(disturbances=(Disturbance("wind", (wind,)),))
        found = fm.evaluate("trot", "a1", duration_s=seconds, conditions=conditions)
        print(f"wind {wind:2.0f} N: reward {found.rollout.reward.mean():.3f}, fell: {bool(found.rollout.fell.any())}")
