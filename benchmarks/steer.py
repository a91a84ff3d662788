"""Steers robots by random velocities, with sensors: on flat ground, with pushes, and on rough ground.

    python benchmarks/steer.py --json steer.json

Each episode lasts 30 s from standing in the middle of the ground, or until the robot is 25 m away. Velocities of 0 to
1.5 m/s forwards, ± 0.4 m/s sideways and ± 2 rad/s are wanted for 1 to 4 s each; pushes have a random direction and come
every 10 s. A robot that falls gets up and goes on.
"""

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.catalogue import open_clip
from fastmimic.play.session import LiveSession
from fastmimic.simulation.conditions import Conditions
from fastmimic.steering.gait_field import GaitField, gait_field

EPISODE_S = 30.0
FAR_M = 25.0
PUSH_EVERY_S = 10.0
CASES: dict[str, dict[str, Any]] = {
    "flat": {},
    "pushes of 0.5 m/s": {"push": 0.5},
    "rough, 2 cm": {"terrain": "rough=0.02"},
}


_MEAN_S: Final = 1.0  # at the end of a command, over which its velocity is measured
_STRIDE_S: Final = 0.5  # over which the velocity of a response is averaged
_REACHED: Final = 0.63  # share of a change, of which the time is the response
_CHANGE: Final = (0.5, 0.2, 1.0)  # least change whose response is measured, m/s, m/s, rad/s


@dataclass(frozen=True)
class Command:
    """A velocity wanted from a time on, s: forwards and to the left, m/s, turning to the left, rad/s."""

    time_s: float
    velocity: tuple[float, float, float]


@dataclass
class SteeringFigures:
    """What came of commands: `seconds` simulated, `falls`, and of each command in which the robot did not fall the
    error of the mean velocity in its last second, m/s, and of the turn rate, rad/s; the response times, s, until 63 %
    of a greater change; the number of commands beyond the gaits, which the nearest velocity was taken for."""

    seconds: float = 0.0
    falls: int = 0
    velocity_error: list[float] = field(default_factory=list)
    yaw_rate_error: list[float] = field(default_factory=list)
    response_s: list[float] = field(default_factory=list)
    beyond: int = 0

    def as_dict(self) -> dict[str, Any]:
        """JSON-serialisable; medians, None without values."""

        def median(values: list[float]) -> float | None:
            return float(np.median(values)) if values else None

        response = median(self.response_s)
        return {
            "minutes": self.seconds / 60.0,
            "commands": len(self.velocity_error),
            "commands_beyond_the_gaits": self.beyond,
            "falls": self.falls,
            "velocity_error_m_s": median(self.velocity_error),
            "yaw_rate_error_rad_s": median(self.yaw_rate_error),
            "response_ms": None if response is None else 1e3 * response,
        }


def follow(
    session: LiveSession,
    commands: Sequence[Command],
    seconds: float,
    found: SteeringFigures,
    go_on: Callable[[], bool] = lambda: True,
) -> SteeringFigures:
    """Runs a steered session through a script for so many simulated seconds, or while `go_on`, asked after each control
    step, says so; adds what came of it to the figures. The errors are from the script's velocities, whether the gaits
    have them or not."""

    ends = [command.time_s for command in commands[1:]] + [seconds]
    begins, rows = session.time_s, [_velocity(session)]
    parts: list[tuple[Command, int, int]] = []  # the commands in which the robot did not fall, their first and last row
    for command, end in zip(commands, ends, strict=True):
        taken = session.steer(command.velocity)
        found.beyond += bool(np.abs(taken - command.velocity).max() > 1e-6)
        falls, first, going = session.falls, len(rows), True
        while going and session.time_s - begins < min(end, seconds) - 1e-9:
            session.step()
            rows.append(_velocity(session))
            going = go_on()
        found.falls += session.falls - falls
        if session.falls == falls and len(rows) > first:
            parts.append((command, first, len(rows)))
        if not going:
            break
    found.seconds += session.time_s - begins
    _measure(np.array(rows), parts, session.dt, found)
    return found


def _velocity(session: LiveSession) -> Array:
    """The robot's true velocity (3,), heading frame."""
    obs = session.observation
    planar = rotate_planar(-float(yaw_from_quat(obs["root_quat"])), obs["lin_vel"][:2])
    return np.array([*planar, obs["ang_vel"][2]])


def _measure(rows: Array, parts: list[tuple[Command, int, int]], dt: float, found: SteeringFigures) -> None:
    smooth = uniform_filter1d(rows, max(1, round(_STRIDE_S / dt)), axis=0, mode="nearest")
    for command, first, last in parts:
        wanted = np.array(command.velocity)
        error = rows[max(first, last - round(_MEAN_S / dt)) : last].mean(axis=0) - wanted
        found.velocity_error.append(float(np.hypot(*error[:2])))
        found.yaw_rate_error.append(abs(float(error[2])))
        change = wanted - smooth[first]
        for axis in np.flatnonzero(np.abs(change) > _CHANGE):
            share = (smooth[first:last, axis] - smooth[first, axis]) / change[axis]
            if (share >= _REACHED).any():
                found.response_s.append(float(np.argmax(share >= _REACHED)) * dt)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=["a1", "go2"])
    parser.add_argument("--minutes", type=float, default=30.0, help="of each case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--gait", help="one period of an animal, by name or file")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = []
    for robot in given.robots:
        gaits = gait_field(robot, None if given.gait is None else open_clip(given.gait), workers=None)
        for name, case in CASES.items():
            found = run(gaits, 60.0 * given.minutes, given.seed, **case)
            rows.append({"robot": gaits.robot.name, "gait": given.gait or "built-in", "case": name, **found})
            print(json.dumps(rows[-1]), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps({"rows": rows}, indent=1) + "\n")


def run(gaits: GaitField, seconds: float, seed: int, push: float = 0.0, terrain: str | None = None) -> dict[str, Any]:
    figures, rng, episode, control = SteeringFigures(), np.random.default_rng(seed), 0, []
    while figures.seconds < seconds - 1e-6:
        ground: Any = terrain  # as a text
        conditions = Conditions(observe="sensors", seed=seed + episode, terrain=ground)
        session = LiveSession(gaits.robot, {}, gaits=gaits, conditions=conditions)

        def go_on(session: LiveSession = session) -> bool:
            if push and session.steps % round(PUSH_EVERY_S / session.dt) == round(0.5 * PUSH_EVERY_S / session.dt):
                session.push(push * gaits.robot.mass, float(rng.uniform(-math.pi, math.pi)))
            return float(np.hypot(*session.observation["root_pos"][:2])) < FAR_M

        follow(session, commands(rng), min(EPISODE_S, seconds - figures.seconds), figures, go_on)
        control.append(session.control_us)
        episode += 1
    median, p99 = np.median(control, axis=0)
    return figures.as_dict() | {"control_us": {"median": float(median), "p99": float(p99)}}


def commands(rng: np.random.Generator) -> list[Command]:
    found, at = [], 0.0
    while at < EPISODE_S:
        velocity = rng.uniform(0.0, 1.5), rng.uniform(-0.4, 0.4), rng.uniform(-2.0, 2.0)
        found.append(Command(at, velocity))
        at += rng.uniform(1.0, 4.0)
    return found


if __name__ == "__main__":
    main()
