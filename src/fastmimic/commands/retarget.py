"""`fastmimic retarget`: from an animal's clip to a robot motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from fastmimic.commands.console import note, put
from fastmimic.commands.options import MotionOptions, check_writable


@dataclass(frozen=True, kw_only=True)
class Retarget(MotionOptions):
    """Turns an animal's clip into a consistent robot motion, not optimised, and says what that changed."""

    clip: Annotated[Positional[str], arg(metavar="CLIP")]
    """A clip file, or a name of 'fastmimic motions'."""
    out: Annotated[Path, arg(metavar="FILE.npz")]
    """Where to write the motion."""

    def run(self) -> int:
        """Writes the motion and prints the report; returns the exit status."""
        out = check_writable(self.out, ".npz")
        from fastmimic.commands.provenance import assumed, provenance
        from fastmimic.retargeting.retarget import retarget
        from fastmimic.runs.loading import find_motion

        overrides = self.overrides()
        source = find_motion(self.clip)
        robot = self.load_robot(source)
        motion, report = retarget(source.open_clip(robot, **overrides), robot)
        motion.save(out)
        note(provenance(motion))
        for sentence in (*assumed(motion), *robot.assumed):
            note(f"assumed: {sentence}")
        for line in report.lines():
            put(line)
        put(f"{motion.n_samples} samples at {motion.rate_hz:g} Hz for {robot.name} in {out}")
        return 0
