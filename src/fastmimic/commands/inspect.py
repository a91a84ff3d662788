"""`fastmimic inspect`: shows information about a clip or a robot motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from fastmimic.clips.clip import Clip
from fastmimic.commands import options as opt
from fastmimic.commands.console import put
from fastmimic.commands.show import provenance
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import DmpRecord
from fastmimic.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Inspect:
    """Shows information about a file or a named motion: format, assumptions, frames, rate, period, speed, duty factor,
    swing clearance, joint limits, source and licence, and the parameters of an optimised motion. A clip is retargeted
    first.
    """

    source: Annotated[Positional[str], opt.option("FILE|NAME")]
    """A clip, a robot motion (.npz), a name from 'fastmimic motions', or the folder of a run."""
    figure: Annotated[Path | None, opt.option("FILE.png")] = None
    """Also draw gait, trunk and joints."""
    robot: opt.RobotChoice = None
    clip: opt.ClipReading

    def run(self) -> int:
        """Prints the information; returns the exit status."""
        figure = None if self.figure is None else opt.check_writable(self.figure, ".png", ".pdf", ".svg")
        robot, motion, lines = self._read()
        put(*lines, *describe_motion(motion, robot))
        if figure is not None:
            from fastmimic.render.figure_style import save
            from fastmimic.report.inspection import motion_figure

            save(motion_figure(motion, robot), figure)
            put(f"figure in {figure}")
        return 0

    def _read(self) -> tuple[Robot, Motion, list[str]]:
        """The robot, its motion, and lines about the source file."""
        from fastmimic.retargeting.retarget import retarget
        from fastmimic.runs.loading import find_motion

        overrides = self.clip.overrides()
        source = find_motion(self.source)
        robot = opt.choose_robot(source, self.robot)
        if source.motion is not None:
            return robot, source.load(robot, **overrides), ["format     FastMimic robot motion"]
        clip = source.open_clip(robot, **overrides)
        motion, report = retarget(clip, robot)
        return robot, motion, [*_describe_clip(clip), f"retargeted to {robot.name}:", *report.lines()]


def describe_motion(motion: Motion, robot: Robot) -> list[str]:
    """A robot motion in words: travel, contacts, joint margins, assumptions, segments and optimised parameters."""
    import numpy as np

    from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
    from fastmimic.episode.metrics import swing_clearance

    def legs(values: "np.ndarray", form: str) -> str:
        return ", ".join(f"{leg} {format(v, form)}" for leg, v in zip(LEGS, values, strict=True))

    speed = np.abs(motion.joint_vel).reshape(-1, 4, 3).max(axis=(0, 1))
    margin = np.minimum(motion.joint_pos - robot.joint_lower, robot.joint_upper - motion.joint_pos)
    least = margin.reshape(-1, 4, 3).min(axis=(0, 1))
    limits = [
        f"{joint} {margin:.2f} rad, {fast:.1f} of {limit:g} rad/s"
        for joint, margin, fast, limit in zip(JOINTS_PER_LEG, least, speed, robot.joint_speed_limit, strict=False)
    ]
    lines = [
        f"motion     {provenance(motion)}",
        f"robot      {motion.provenance.robot or 'unknown'}",
        f"samples    {motion.n_samples} at {motion.rate_hz:g} Hz, {motion.period_s:.3f} s",
        f"travel     {_travel(motion)}",
        f"duty       {legs(motion.contact.mean(axis=0), '.2f')}",
        f"clearance  {legs(1e3 * swing_clearance(motion, robot.foot_radius), '.0f')} mm",
        f"joints     smallest margin and highest speed: {'; '.join(limits)}",
    ]
    lines += [f"assumed    {sentence}" for sentence in (*motion.provenance.assumed, *robot.assumed)]
    return lines + _segments(motion) + _optimised(motion) + _made_with(motion)


def _describe_clip(clip: Clip) -> list[str]:
    from fastmimic.clips.formats import FORMATS

    name = str(clip.meta.get("format", "unknown"))
    cycle = {None: "unknown", True: "yes", False: "no"}[clip.is_cycle]
    lines = [
        f"format     {FORMATS[name].about if name in FORMATS else name}",
        f"frames     {clip.n_frames} at {clip.rate_hz:g} Hz, {clip.n_frames / clip.rate_hz:.3f} s",
        f"one cycle  {cycle}",
    ]
    if clip.meta.get("credit"):
        lines.append(f"credit     {clip.meta['credit']}")
    return lines


def _travel(motion: Motion) -> str:
    import numpy as np

    if motion.cycle is None:
        mean = np.linalg.norm(motion.root_lin_vel_w[:, :2], axis=1).mean()
        return f"not periodic; mean speed {mean:.2f} m/s"
    dx, dy, dyaw = motion.cycle / motion.period_s
    return f"{dx:+.3f} m/s forward, {dy:+.3f} m/s left, {dyaw:+.3f} rad/s (one cycle of {motion.period_s:.3f} s)"


def _segments(motion: Motion) -> list[str]:
    """The segments of a stitched motion, and the DMP parameters of each that differ from the fitted ones."""
    stitch, lines = motion.provenance.stitch, []
    if stitch is None:
        return []
    for segment, dmp in zip(stitch.segments, stitch.dmp or [None] * len(stitch.segments), strict=True):
        first, last = segment.first / motion.rate_hz, segment.last / motion.rate_hz
        lines.append(f"segment    {segment.name}, {segment.cycles} cycles, {first:.2f} to {last:.2f} s")
        lines += _modulated(dmp) if dmp is not None else []
    return lines


def _optimised(motion: Motion) -> list[str]:
    """The DMP parameters that differ from the fitted ones; empty for a demonstration."""
    dmp = motion.provenance.dmp
    if motion.demonstration is None or dmp is None:
        return []
    lines = _modulated(dmp)
    differ = "these DMP parameters" if lines else "no DMP parameter"
    return [f"optimised  contains its demonstration; {differ} differ{'' if lines else 's'} from it", *lines]


def _made_with(motion: Motion) -> list[str]:
    """The controller with which the motion was optimised; empty if unknown."""
    from fastmimic.imitation.methods import controller_for

    record = motion.provenance.made_with
    if record is None:
        return []
    method, config = controller_for(motion, config="default" if record.config is None else None)
    shown = "with its own parameters" if record.config is None else config.name
    return [f"made with  method {method.name}, controller {shown}"]


def _modulated(dmp: DmpRecord) -> list[str]:
    """A line for each dimension whose parameters differ from the fitted ones."""
    return [
        f"  {name:12} baseline {goal - fitted:+.4f}, amplitude {amplitude:.3f}"
        for name, goal, fitted, amplitude in dmp.modulation()
        if goal != fitted or amplitude != 1.0
    ]
