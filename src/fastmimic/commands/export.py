"""`fastmimic export`: writes a robot motion as a tracking reference for other trainers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, put

ExportFormat = Annotated[str, opt.option("NAME", lambda: f"Format: {opt.one_of('motion.export', 'EXPORTS')}.")]


@dataclass(frozen=True, kw_only=True)
class Export:
    """Writes a robot motion in a format that other trainers read.

    mjlab: .npz of joints and bodies as mjlab and BeyondMimic track them. deepmimic: JSON text, 19 numbers a frame. csv:
    the same numbers, one line a frame. An optimised motion is written as optimised.
    """

    motion: Annotated[Positional[str], opt.option("MOTION")]
    """A robot motion (.npz), a clip, a name from 'fastmimic motions', or the folder of a run."""
    format: ExportFormat
    out: Annotated[Path, opt.option("FILE")]
    """File to write: .npz for mjlab, .txt or .json for deepmimic, .csv for csv."""
    rate: Annotated[float, opt.option("HZ")] = 50.0
    """Frames per second; for a cycle, the nearest rate that divides it evenly."""
    duration: opt.Seconds = None
    """Length. Default: one cycle for deepmimic, which loops; else 10 s, or the whole of a non-periodic motion."""
    robot: opt.RobotChoice = None
    clip: opt.ClipReading

    def run(self) -> int:
        """Writes the file; returns the exit status."""
        from fastmimic.motion.export import EXPORTS, export_motion

        if self.format not in EXPORTS:
            known = f"{', '.join(EXPORTS)}{did_you_mean(self.format, EXPORTS)}"
            raise ConfigError(f"unknown format '{self.format}'; there are {known}")
        endings = (".txt", ".json") if self.format == "deepmimic" else (EXPORTS[self.format],)
        out = opt.check_writable(self.out, *endings)
        opt.check_duration(self.duration)
        robot, motion = self.clip.load(self.motion, self.robot)
        frames = export_motion(motion, robot, out, self.format, fps=self.rate, duration_s=self.duration)
        if motion.provenance.licence:
            note(f"licence of the motion: {motion.provenance.licence}")
        put(f"{frames.n} frames at {frames.fps:g} per second for {robot.name} in {out}")
        return 0
