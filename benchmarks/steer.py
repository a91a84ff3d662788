"""Steers robots by random velocities, with sensors: on flat ground, with pushes, and on rough ground.

    python benchmarks/steer.py [a1 go2] [--minutes 30] [--forwards 1.5] [--gait CLIP …] [--json steer.json]

Each episode lasts 30 s from standing in the middle of the ground, or until the robot is 25 m away. Velocities of 0 to
`--forwards` m/s forwards, ± 0.4 m/s sideways and ± 2 rad/s are wanted for 1 to 4 s each; pushes have a random direction
and come every 10 s. A robot that falls gets up and goes on.

`style_distance` compares the robot's feet with those of the gait at its present velocity, without what steering shifts
them by, period by period; a median. `jerk_at_changes` is the joints' jerk, RMS, in the 0.3 s after a change of gait, or
into or out of a passage, as a share of that in all other strides. `search_us` is the time in which the reference finds
its gait and row and goes on, in each control step; `share_of_takes_used` is that of the field's gaits in which the
robot went.
"""

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.clips.catalogue import open_clip
from fastmimic.episode.metrics import style_distance
from fastmimic.play.follow import SteeringFigures, follow
from fastmimic.play.session import LiveSession
from fastmimic.robot.kinematics import foot_positions
from fastmimic.simulation.conditions import Conditions
from fastmimic.steering.gait_field import RATE_HZ, GaitField, gait_field, gaits_of

EPISODE_S = 30.0
FAR_M = 25.0
PUSH_EVERY_S = 10.0
CHANGE_S = 0.3
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
    figures, rng, episode, control, looks = SteeringFigures(), np.random.default_rng(seed), 0, [], Looks(gaits)
    search_us: list[float] = []
    while figures.seconds < seconds - 1e-6:
        ground: Any = terrain  # as a text
        conditions = Conditions(observe="sensors", seed=seed + episode, terrain=ground)
        session = LiveSession(gaits.robot, {}, gaits=gaits, conditions=conditions)
        reference: Any = session.reference
        reference.advance = timed(reference.advance, search_us)

        def go_on(session: LiveSession = session) -> bool:
            if push and session.steps % round(PUSH_EVERY_S / session.dt) == round(0.5 * PUSH_EVERY_S / session.dt):
                session.push(push * gaits.robot.mass, float(rng.uniform(-math.pi, math.pi)))
            looks.add(session)
            return float(np.hypot(*session.observation["root_pos"][:2])) < FAR_M

        follow(session, commands(rng, forwards), min(EPISODE_S, seconds - figures.seconds), figures, go_on)
        looks.end()
        control.append(session.control_us)
        episode += 1
    took = {"search_us": np.percentile(search_us, (50, 99)), "control_us": np.median(control, axis=0)}
    used = {"share_of_takes_used": float(np.mean([figures.gaits_s.get(name, 0.0) > 0.0 for name in looks.names]))}
    took_us = {name: {"median": float(each[0]), "p99": float(each[1])} for name, each in took.items()}
    return figures.as_dict() | looks.as_dict() | used | took_us


def timed(work: Callable[..., None], took_us: list[float]) -> Callable[..., None]:
    """The same work, which adds how long it took each time, µs."""

    def run(*given: Any) -> None:
        begins = time.perf_counter()
        work(*given)
        took_us.append(1e6 * (time.perf_counter() - begins))

    return run


class Looks:
    """Whether a steered robot moves as its gaits do."""

    def __init__(self, gaits: GaitField) -> None:
        self.robot, self.names = gaits.robot, {gait.name: gait.rows.shape[1] for gait in gaits.chain()}
        passages = [passage.field.name for gait in gaits.chain() for passage in gait.passages or ()]
        self.moving = [*self.names, *passages]
        self.style: list[float] = []
        self.jerk_sq: dict[bool, list[Array]] = {True: [], False: []}  # after a change of gait, and not
        self.states: list[str] = []
        self.joints: list[Array] = []
        self.feet: list[Array] = []

    def add(self, session: LiveSession) -> None:
        place = session.reference.place[0]
        self.states.append(session.state)
        self.joints.append(session.observation["joint_pos"].copy())
        self.feet.append(place["feet"] - place["away"])  # both as good as level

    def end(self) -> None:
        """Adds an episode's periods, each in one gait, and the jerk of its joints."""
        states, joints, feet = np.array(self.states), np.array(self.joints), np.array(self.feet)
        is_, dt = foot_positions(self.robot, joints), 1.0 / RATE_HZ
        jerk_sq = np.square(np.diff(joints, 3, axis=0) / dt**3)
        changed = np.zeros(len(states), bool)
        for k in np.flatnonzero(states[1:] != states[:-1]) + 1:
            if states[k] in self.moving and states[k - 1] in self.moving:
                changed[k : k + round(CHANGE_S / dt)] = True
        begin = 0
        while begin < len(states):
            n = self.names.get(states[begin], 0)
            if n and (states[begin : begin + n] == states[begin]).all() and begin + n <= len(states):
                self.style.append(style_distance(is_[begin : begin + n], feet[begin : begin + n]))
                begin += n
            else:
                begin += 1
        strides = np.isin(states, self.moving)[3:]
        for after in (True, False):
            self.jerk_sq[after].append(jerk_sq[strides & (changed[3:] == after)].ravel())
        self.states, self.joints, self.feet = [], [], []

    def as_dict(self) -> dict[str, Any]:
        after, others = (float(np.mean(np.concatenate(self.jerk_sq[which]))) for which in (True, False))
        return {
            "style_distance": float(np.median(self.style)),
            "jerk_at_changes": math.sqrt(after / others) if others else math.nan,
        }


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
