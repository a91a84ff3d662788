"""How motions stand up in `fastmimic play`: to pushes, and to one another.

python benchmarks/play.py trot pace dog:trot            # pushed sideways twice, ever harder, by --impulse N·s
python benchmarks/play.py --switches                    # from every motion to every other
"""

import argparse
import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from fastmimic.play.session import DEFAULTS, LiveSession, load_motions
from fastmimic.reference.motion_set import IN_PLACE, MotionSet
from fastmimic.reference.standing import STAND
from fastmimic.robot import Robot, load_robot

PUSHES = {4.0: math.pi / 2, 6.0: -math.pi / 2}
"""When, s, and in which direction, rad."""
SECONDS = 8.0


def tried(robot: Robot, library: MotionSet, name: str, impulse: float) -> tuple[bool, float]:
    """Whether a motion stands, and its mean reward."""
    session = LiveSession(robot, library, start=name)
    rewards = []
    for step in range(round(SECONDS * session.rate_hz)):
        if step * session.dt in PUSHES:
            session.push(impulse, PUSHES[step * session.dt])
        session.step()
        if session.falls:
            return False, 0.0
        if step % 5 == 0 and step * session.dt > 2.0:
            rewards.append(session.snapshot().reward)
    return True, float(np.mean(rewards))


def pushes(robot: Robot, library: MotionSet, names: list[str], impulse: float) -> Iterator[str]:
    """The motions as they are, pushed by multiples of an impulse."""
    for name in names:
        cells = []
        for times in range(1, 6):
            stood, reward = tried(robot, library, name, times * impulse)
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
    parser.add_argument("--switches", action="store_true", help="from every motion to every other")
    given = parser.parse_args()
    robot = load_robot(given.robot)
    library = MotionSet(robot, load_motions(given.motions, robot))
    moving = [name for name in library.names if name != STAND]
    what = switches if given.switches else pushes
    for line in what(robot, library, list(library.names) if given.switches else moving, given.impulse):
        print(line, flush=True)


if __name__ == "__main__":
    main()
