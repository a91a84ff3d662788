"""How far each motion can be sped up, turned and lifted while it runs: what the limits of `fastmimic play` come from.

    python benchmarks/play.py trot pace dog:trot            # one line for each motion and value
    python benchmarks/play.py --corners                     # all limits at once, as they are set
    python benchmarks/play.py --switches                    # from every motion to every other
    python benchmarks/play.py --pushes                      # the motions themselves, pushed ever harder

Each value is held for eight seconds in which the trunk is pushed sideways twice, by --impulse N·s; a value stands if
the robot does.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from fastmimic.play.session import DEFAULTS, LiveSession, load_motions
from fastmimic.reference.modulation import Limits
from fastmimic.reference.motion_set import IN_PLACE, MotionSet
from fastmimic.reference.standing import STAND
from fastmimic.robot import Robot, load_robot

VALUES = {
    "speed": (0.5, 0.6, 0.75, 0.9, 1.1, 1.25, 1.4, 1.6),
    "turn": (-1.6, -1.2, -0.8, -0.4, 0.4, 0.8, 1.2, 1.6),
    "lift": (0.3, 0.6, 0.8, 1.25, 1.5, 1.8, 2.2),
}
PUSHES = {4.0: math.pi / 2, 6.0: -math.pi / 2}
"""When, s, and in which direction, rad."""
NEUTRAL = {"speed": 1.0, "turn": 0.0, "lift": 1.0}
WIDE = Limits(turn=(-3.0, 3.0), lift=(0.1, 3.0))
SECONDS = 8.0


def tried(robot: Robot, library: MotionSet, name: str, asked: dict[str, float], impulse: float) -> tuple[bool, float]:
    """Whether a motion stands with a modulation, and its mean reward."""
    session = LiveSession(robot, library, start=name)
    session.want("speed", asked["speed"])
    session.want("turn", asked["turn"])
    session.want("lift", asked["lift"])
    rewards = []
    for step in range(round(SECONDS * session.rate_hz)):
        if impulse and step * session.dt in PUSHES:
            session.push(impulse, PUSHES[step * session.dt])
        session.step()
        if session.falls:
            return False, 0.0
        if step % 5 == 0 and step * session.dt > 2.0:
            rewards.append(session.snapshot().reward)
    return True, float(np.mean(rewards))


def widened(library: MotionSet, speed: float) -> None:
    """Lets all motions be modulated further than they may, executable at a speed."""
    limits = replace(WIDE, speed=(min(speed, 1.0), max(speed, 1.0)))
    library.tempos.clear()
    for name, entry in library.entries.items():
        library.entries[name] = replace(entry, limits=limits)


def ranges(robot: Robot, library: MotionSet, names: list[str], impulse: float) -> Iterator[str]:
    """A line for each motion and quantity: the mean reward at each value, or a fall."""
    for name, (quantity, values) in product(names, VALUES.items()):
        cells = []
        for value in values:
            widened(library, value if quantity == "speed" else 1.0)
            stood, reward = tried(robot, library, name, NEUTRAL | {quantity: value}, impulse)
            cells.append(f"{value:g}: " + (f"{reward:.2f}" if stood else "fell"))
        yield f"{name:14} {quantity:5}  " + "  ".join(cells)


def corners(robot: Robot, library: MotionSet, names: list[str], impulse: float) -> Iterator[str]:
    """All combinations of a motion's limits."""
    for name in names:
        limits = library.entry(name).limits
        fell, worst = 0, 1.0
        for speed, turn, lift in product(limits.speed, limits.turn, limits.lift):
            stood, reward = tried(robot, library, name, {"speed": speed, "turn": turn, "lift": lift}, impulse)
            fell, worst = fell + (not stood), min(worst, reward)
        ends = f"speed to {limits.speed[1]:.2f}, turn ±{limits.turn[1]:.2f} rad/s, lift to {limits.lift[1]:.2f}"
        yield f"{name:14} fell in {fell} of 8, least reward {worst:.2f}; {ends}"


def pushes(robot: Robot, library: MotionSet, names: list[str], impulse: float) -> Iterator[str]:
    """The motions as they are, pushed by multiples of an impulse."""
    for name in names:
        cells = []
        for times in range(1, 6):
            stood, reward = tried(robot, library, name, NEUTRAL, times * impulse)
            cells.append(f"{times * impulse:g}: " + (f"{reward:.2f}" if stood else "fell"))
        yield f"{name:14} N·s  " + "  ".join(cells)


def switches(robot: Robot, library: MotionSet, names: list[str], impulse: float) -> Iterator[str]:
    """From each motion to each other, one after the other."""
    for before, after in product(names, names):
        if before == after:
            continue
        session = LiveSession(robot, library, start=before)
        session.run(1.0)
        session.switch(after)
        steps, least = 0, 1.0
        while session.motion != after and not session.falls and steps < 20 * session.rate_hz:
            session.step()
            steps += 1
            least = min(least, session.snapshot().reward) if steps % 10 == 0 else least
        session.run(2.0)
        said = "fell" if session.falls else "there" if session.motion == after else session.state
        yield f"{before:14} → {after:14} {said:6} after {steps * session.dt:.1f} s, least reward {least:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("motions", nargs="*", default=[name for name in DEFAULTS if name not in (STAND, IN_PLACE)])
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--impulse", type=float, default=2.0, help="of the pushes, N·s")
    parser.add_argument("--corners", action="store_true", help="all limits at once, as they are set")
    parser.add_argument("--switches", action="store_true", help="from every motion to every other")
    parser.add_argument("--pushes", action="store_true", help="the motions themselves, pushed ever harder")
    given = parser.parse_args()
    robot = load_robot(given.robot)
    library = MotionSet(robot, load_motions(given.motions, robot))
    moving = [name for name in library.names if name != STAND]
    what = switches if given.switches else corners if given.corners else pushes if given.pushes else ranges
    for line in what(robot, library, list(library.names) if given.switches else moving, given.impulse):
        print(line, flush=True)


if __name__ == "__main__":
    main()
