"""`fastmimic export`: a robot motion as a tracking reference for other trainers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.commands.console import note, put
from fastmimic.commands.options import MotionOptions, check_duration, check_writable


@dataclass(frozen=True, kw_only=True)
class Export(MotionOptions):
    """Writes a robot motion in a format that other trainers read.

    mjlab: .npz of joints and bodies as mjlab and BeyondMimic track them. deepmimic: JSON text, 19 numbers a frame.
    csv: the same numbers, one line a frame. What is written is the motion itself, as optimised.
    """

    motion: Annotated[Positional[str], arg(metavar="MOTION")]
    """A robot motion (.npz), a clip, a name of 'fastmimic motions', or the folder of a run."""
    format: Annotated[str, arg(metavar="mjlab|deepmimic|csv")]
    """Which."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Where to write it: .npz for mjlab, .txt or .json for deepmimic, .csv."""
    rate: Annotated[float, arg(metavar="HZ")] = 50.0
    """Frames a second; of a cycle as near to it as divides the cycle evenly."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """Length; by default one cycle for deepmimic, which loops, 10 s for the others, or the whole of a motion that does
    not repeat."""

    def run(self) -> int:
        """Writes the file; returns the exit status."""
        from fastmimic.motion.export import EXPORTS, export_motion

        if self.format not in EXPORTS:
            known = f"{', '.join(EXPORTS)}{did_you_mean(self.format, EXPORTS)}"
            raise ConfigError(f"unknown format '{self.format}'; there are {known}")
        endings = (".txt", ".json") if self.format == "deepmimic" else (EXPORTS[self.format],)
        out = check_writable(self.out, *endings)
        if self.duration is not None:
            check_duration(self.duration)
        robot, motion = self.load(self.motion)
        frames = export_motion(motion, robot, out, self.format, fps=self.rate, duration_s=self.duration)
        licence = motion.meta.get("licence")
        if licence:
            note(f"licence of the motion: {licence}")
        put(f"{frames.n} frames at {frames.fps:g} a second for {robot.name} in {out}")
        return 0
