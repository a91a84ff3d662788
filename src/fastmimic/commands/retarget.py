"""`fastmimic retarget`: from an animal's clip to a robot motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from fastmimic.commands import options as opt
from fastmimic.commands.console import put
from fastmimic.commands.show import note_origin


@dataclass(frozen=True, kw_only=True)
class Retarget:
    """Turns an animal's clip into a consistent robot motion without optimising it, and prints what changed."""

    clip: Annotated[Positional[str], opt.option("CLIP")]
    """A clip file, or a name from 'fastmimic motions'."""
    out: Annotated[Path, opt.option("FILE.npz")]
    """File of the motion."""
    robot: opt.RobotChoice = None
    reading: opt.ClipReading

    def run(self) -> int:
        """Writes the motion and prints the report; returns the exit status."""
        out = opt.check_writable(self.out, ".npz")
        from fastmimic.retargeting.retarget import retarget
        from fastmimic.runs.loading import find_motion

        overrides = self.reading.overrides()
        source = find_motion(self.clip)
        robot = opt.choose_robot(source, self.robot)
        motion, report = retarget(source.open_clip(robot, **overrides), robot)
        motion.save(out)
        note_origin(robot, motion)
        put(*report.lines())
        put(f"{motion.n_samples} samples at {motion.rate_hz:g} Hz for {robot.name} in {out}")
        return 0
