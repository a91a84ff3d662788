"""Makes the built-in motions executable for the built-in robots, and keeps the solutions in the package.

    python benchmarks/keep_solutions.py

To be run after every change of `src/fastmimic/trajectory/` or of what it is given; a test says when.
"""

import os
import tempfile

from fastmimic.clips.synthesis import GAITS, JUMPS
from fastmimic.reference.motion_set import in_place
from fastmimic.reference.standing import standing
from fastmimic.robot import ROBOT_NAMES, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.trajectory import solved


def main() -> None:
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()  # no solution is remembered from before
    solved.PACKAGED.unlink(missing_ok=True)
    solved.recorded = []
    for robot in map(load_robot, ROBOT_NAMES):
        for name in (*GAITS, *JUMPS):
            _, report = find_motion(name).retarget(robot)
            assert report.executable is not None
            print(
                f"{robot.name} {name}: {report.executable.lines()[0]}; falls {report.executable.fell:.0%}", flush=True
            )
        in_place(robot)
        standing(robot)
    solved.write_recorded(solved.PACKAGED)
    print(f"{len(solved.recorded)} answers in {solved.PACKAGED}, {solved.PACKAGED.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
