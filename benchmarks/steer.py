"""Steers robots by random velocities, with sensors: on flat ground, with pushes, and on rough ground.

    python benchmarks/steer.py [a1 go2] [--minutes 30] [--forwards 1.5] [--gait CLIP …] [--json steer.json]

Each episode lasts 30 s from standing in the middle of the ground, or until the robot is 25 m away. Velocities of 0 to
`--forwards` m/s forwards, ± 0.4 m/s sideways and ± 2 rad/s are wanted for 1 to 4 s each; pushes have a random direction
and come every 10 s. A robot that falls gets up and goes on.
"""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.clips.catalogue import open_clip
from fastmimic.play.follow import SteeringFigures, follow
from fastmimic.play.session import LiveSession
from fastmimic.simulation.conditions import Conditions
from fastmimic.steering.gait_field import GaitField, gait_field, gaits_of

EPISODE_S = 30.0
FAR_M = 25.0
PUSH_EVERY_S = 10.0
CASES: dict[str, dict[str, Any]] = {
    "flat": {},
    "pushes of 0.5 m/s": {"push": 0.5},
    "rough, 2 cm": {"terrain": "rough=0.02"},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=["a1", "go2"])
    parser.add_argument("--minutes", type=float, default=30.0, help="of each case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--forwards", type=float, default=1.5, help="the greatest velocity forwards, m/s")
    parser.add_argument("--gait", nargs="*", default=[], help="one period each of an animal's gaits, or takes")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = []
    for robot in given.robots:
        gaits = gait_field(robot, gaits_of([open_clip(gait) for gait in given.gait]), workers=None)
        for name, case in CASES.items():
            found = run(gaits, 60.0 * given.minutes, given.seed, given.forwards, **case)
            by = {"robot": gaits.robot.name, "gait": ", ".join(given.gait) or "built-in", "forwards": given.forwards}
            rows.append({**by, "case": name, **found})
            print(json.dumps(rows[-1]), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps({"rows": rows}, indent=1) + "\n")


def run(
    gaits: GaitField, seconds: float, seed: int, forwards: float, push: float = 0.0, terrain: str | None = None
) -> dict[str, Any]:
    figures, rng, episode, control = SteeringFigures(), np.random.default_rng(seed), 0, []
    while figures.seconds < seconds - 1e-6:
        ground: Any = terrain  # as a text
        conditions = Conditions(observe="sensors", seed=seed + episode, terrain=ground)
        session = LiveSession(gaits.robot, {}, gaits=gaits, conditions=conditions)

        def go_on(session: LiveSession = session) -> bool:
            if push and session.steps % round(PUSH_EVERY_S / session.dt) == round(0.5 * PUSH_EVERY_S / session.dt):
                session.push(push * gaits.robot.mass, float(rng.uniform(-math.pi, math.pi)))
            return float(np.hypot(*session.observation["root_pos"][:2])) < FAR_M

        follow(session, commands(rng, forwards), min(EPISODE_S, seconds - figures.seconds), figures, go_on)
        control.append(session.control_us)
        episode += 1
    median, p99 = np.median(control, axis=0)
    return figures.as_dict() | {"control_us": {"median": float(median), "p99": float(p99)}}


def commands(rng: np.random.Generator, forwards: float) -> Callable[[float], Array]:
    """The velocity wanted at a time, s: forwards and to the left, m/s, turning to the left, rad/s."""
    times, velocities, at = [], [], 0.0
    while at < EPISODE_S:
        velocities.append(np.array([rng.uniform(0.0, forwards), rng.uniform(-0.4, 0.4), rng.uniform(-2.0, 2.0)]))
        times.append(at)
        at += rng.uniform(1.0, 4.0)
    return lambda time_s: velocities[int(np.searchsorted(times, time_s, side="right")) - 1]


if __name__ == "__main__":
    main()
