"""Makes the built-in motions, and the gaits to steer with, executable, and keeps the solutions in the package.

    python benchmarks/keep_solutions.py

To be run after every change of `src/fastmimic/trajectory/` or of what it is given; a test says when.
"""

import os
import tempfile
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.files import replace_file
from fastmimic.clips.synthesis import GAITS, JUMPS
from fastmimic.reference.motion_set import in_place
from fastmimic.reference.standing import standing
from fastmimic.robot import ROBOT_NAMES, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.steering.gait_field import gait_field
from fastmimic.trajectory import solved

STEERED = ("a1", "go2")


def main() -> None:
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()  # no solution is remembered from before
    solved.PACKAGED.unlink(missing_ok=True)
    with ProcessPoolExecutor() as pool:
        names = sorted(ROBOT_NAMES, key=STEERED.__contains__, reverse=True)  # the longest first
        answers = [answer for found in pool.map(answers_for, names) for answer in found]
    arrays = {f"{key} {i} {name}": array for i, (key, known) in enumerate(answers) for name, array in known.items()}
    replace_file(solved.PACKAGED, lambda stream: np.savez_compressed(stream, **arrays))  # type: ignore[arg-type]
    print(f"{len(answers)} answers in {solved.PACKAGED}, {solved.PACKAGED.stat().st_size / 1e3:.0f} kB")


def answers_for(name: str) -> list[tuple[str, dict[str, Array]]]:
    """All that is recorded for a robot."""
    robot, solved.recorded = load_robot(name), []
    for motion in (*GAITS, *JUMPS):
        _, report = find_motion(motion).retarget(robot)
        assert report.executable is not None
        print(f"{name} {motion}: {report.executable.lines()[0]}; falls {report.executable.fell:.0%}", flush=True)
    in_place(robot)
    standing(robot)
    if name in STEERED:
        gait_field(name)
    return solved.recorded


if __name__ == "__main__":
    main()
