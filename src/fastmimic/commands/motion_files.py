"""Verbs without simulation: `motions`, `robots`, `data` (what there is), `inspect`, `segment`, `retarget`, `export`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from tyro.conf import Positional

from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
from fastmimic.base.errors import ConfigError, MotionError, did_you_mean, unknown
from fastmimic.base.progress import note, slow_start
from fastmimic.clips.catalogue import describe, open_parts
from fastmimic.clips.clip import Clip
from fastmimic.clips.data import DATASETS, data_folder, fetch, list_datasets
from fastmimic.clips.formats import FORMATS
from fastmimic.clips.segment import DISCRETE, Segment, find_segments
from fastmimic.commands import options as opt
from fastmimic.commands.console import put, put_json, put_table
from fastmimic.commands.show import describe_robot, note_origin, provenance
from fastmimic.imitation.methods import controller_for
from fastmimic.motion.export import EXPORTS, export_motion
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import DmpRecord
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.runs.loading import find_motion

FIGURES: Final = (".png", ".pdf", ".svg")
LEROBOT: Final = "lerobot"  # the format of executed runs
ExportFormat = Annotated[str, opt.option("NAME", lambda: f"Format: {', '.join(EXPORTS)}.")]
_SEGMENT: Final = ("frames", "gait", "footfall", "period", "best cycle", "confidence", "speed, m/s", "yaw, rad/s")
ACTIONS: Final = ("list", "fetch")
RecordingsFolder = Annotated[Path | None, opt.shared("FOLDER", "recordings")]


@opt.command
class Motions:
    """Lists the named motions: built-in gaits and recordings of a dog."""

    folder: RecordingsFolder = None

    def run(self) -> None:
        rows = describe(self.folder)
        cells = [(r.name, r.speed, "yes" if r.available else "no", r.about, r.source) for r in rows]
        put_table([("name", "speed", "here", "description", "source"), *cells])
        note("speeds of dogs are the animals'; the other motions are of a robot of the A1's size")
        for licence in dict.fromkeys(r.licence for r in rows if r.source != "built in"):
            note(f"licence of the recordings: {licence}")
        if not all(r.available for r in rows):
            note("'fastmimic data fetch' downloads what is missing here")


@opt.command
class Robots:
    """Lists the built-in robots, or says what an MJCF or URDF is taken for, which --robot takes as well."""

    robot: Annotated[Positional[str | None], opt.option("[NAME|FILE]")] = None

    def run(self) -> None:
        if self.robot is not None:
            put(*describe_robot(load_robot(self.robot)))
            return
        rows = [("name", "mass kg", "leg m", "torque N·m", "joint speed rad/s")]
        for name in ROBOT_NAMES:
            robot = load_robot(name)
            limits = robot.torque_limit, robot.joint_speed_limit
            torque, speed = (" ".join(f"{v:g}" for v in limit[:3]) for limit in limits)
            rows.append((name, f"{robot.mass:.2f}", f"{robot.leg_length:.3f}", torque, speed))
        put_table(rows)
        note("your own: --robot FILE, an MJCF or URDF with abduction, hip and knee joints in each of four legs")


@opt.command
class Data:
    """Lists or downloads the public recordings of a dog; verifies each file by its hash."""

    action: Annotated[Positional[str], opt.option("list|fetch")]
    datasets: Annotated[Positional[tuple[str, ...]], opt.option("[DATASET ...]")] = ()
    folder: RecordingsFolder = None
    base_url: Annotated[str | None, opt.option("URL")] = None

    def run(self) -> None:
        if self.action not in ACTIONS:
            raise ConfigError(f"data takes list or fetch, found '{self.action}'{did_you_mean(self.action, ACTIONS)}")
        (self._list if self.action == "list" else self._fetch)()

    def _list(self) -> None:
        if self.datasets or self.base_url:
            raise ConfigError("data list takes no dataset and no --base-url: it lists everything")
        found = list_datasets(self.folder)
        rows = [(d.name, f"{len(here)} of {len(d.files)}", d.about) for d, here in found]
        put_table([("dataset", "files here", "description"), *rows])
        put(f"folder: {data_folder(self.folder)}")
        self._put_licence([d.name for d, _ in found])

    def _fetch(self) -> None:
        started = set()

        def progress(name: str, done: int, total: int) -> None:
            if name not in started:
                started.add(name)
                note(f"{name}  {total / 1e6:.2f} MB" if total else name)

        names = list(self.datasets) or None
        paths = fetch(names, folder=self.folder, base_url=self.base_url, progress=progress)
        put(f"{len(paths)} files, verified, in {data_folder(self.folder)}")
        self._put_licence(names)

    def _put_licence(self, names: list[str] | None) -> None:
        chosen = [DATASETS[name] for name in (DATASETS if names is None else names)]
        for licence, credit in dict.fromkeys((d.licence, d.credit) for d in chosen):
            put(f"licence: {licence}", f"credit: {credit}")


@opt.command
class Inspect:
    """Shows information about a file or a named motion: format, assumptions, frames, rate, period, speed, duty factor,
    swing clearance, joint limits, source and licence, and the parameters of an optimised motion. A clip is retargeted
    first."""

    source: Annotated[Positional[str], opt.option("FILE|NAME")]
    figure: Annotated[Path | None, opt.option("FILE.png")] = None
    robot: opt.RobotChoice = None
    clip: opt.ClipReading

    def run(self) -> None:
        figure = None if self.figure is None else opt.check_writable(self.figure, *FIGURES)
        robot, motion, lines = self._read()
        put(*lines)
        if figure is not None:
            from fastmimic.render.figure_style import save
            from fastmimic.report.figures import motion_figure

            save(motion_figure(motion, robot), figure)
            put(f"figure in {figure}")

    def _read(self) -> tuple[Robot, Motion, list[str]]:
        """The robot, its motion, and lines about them, those first that are of the clip itself."""
        overrides = self.clip.overrides()
        source = find_motion(self.source)
        robot = opt.choose_robot(self.robot, source)
        if source.motion is not None:
            motion = source.load(robot, **overrides)
            return robot, motion, ["format     FastMimic robot motion", *describe_motion(motion, robot)]
        executable = bool(overrides.pop("executable", True))
        clip = source.open_clip(robot, **overrides)
        told = [*_describe_clip(clip), *(f"assumed    {sentence}" for sentence in clip.origin.assumed)]
        refused = []
        with slow_start("looking for the nearest motion that the robot can execute"):
            try:
                motion, report = find_motion(clip).retarget(robot, executable=executable)
            except MotionError as error:
                motion, report = find_motion(clip).retarget(robot, executable=False)
                refused = [f"NOT EXECUTABLE {error}; all else is said of the kinematic motion"]
        others = [line for line in describe_motion(motion, robot) if line not in told]
        return robot, motion, [*told, f"retargeted to {robot.name}:", *report.lines(), *refused, *others]


def describe_motion(motion: Motion, robot: Robot) -> list[str]:
    """A robot motion in words: travel, contacts, joint margins, assumptions, segments and optimised parameters."""
    from fastmimic.episode.metrics import swing_clearance

    def legs(values: np.ndarray, form: str) -> str:
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
    name = clip.origin.format or "unknown"
    cycle = {None: "unknown", True: "yes", False: "no"}[clip.is_cycle]
    lines = [
        f"format     {FORMATS[name].about if name in FORMATS else name}",
        f"frames     {clip.n_frames} at {clip.rate_hz:g} Hz, {clip.n_frames / clip.rate_hz:.3f} s",
        f"one cycle  {cycle}",
    ]
    if clip.origin.credit:
        lines.append(f"credit     {clip.origin.credit}")
    return lines


def _travel(motion: Motion) -> str:
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


@opt.command
class SegmentTake:
    """Finds the cycles in a take of any length. Prints first frame and end, gait, period, speed and yaw rate of each
    segment, and its cycle that closes best, for 'imitate --frames A:B'. Standing and non-periodic movement are listed
    too; 'imitate --frames A:B --discrete' runs such a movement once. Speeds are the animal's."""

    take: Annotated[Positional[str], opt.option("FILE|NAME")]
    json: opt.JsonFlag = False
    figure: Annotated[Path | None, opt.option("FILE.png")] = None
    file: opt.FileReading

    def run(self) -> None:
        figure = None if self.figure is None else opt.check_writable(self.figure, *FIGURES)
        if find_motion(self.take).clip is None:
            raise ConfigError(f"{self.take}: already a robot motion; a clip is needed")
        parts = open_parts(self.take, **self.file.overrides())
        rate_hz, segments = parts[0][1].rate_hz, [s.later(first) for first, clip in parts for s in find_segments(clip)]
        if self.json:
            put_json({"segments": [asdict(segment) for segment in segments]})
        else:
            put_table([_SEGMENT, *(_segment_row(segment, rate_hz) for segment in segments)])
            command = f"fastmimic imitate {self.take}{self.file.words()} --frames"
            periodic = [segment for segment in segments if segment.cycle is not None]
            if periodic:
                first, end = max(periodic, key=lambda s: s.confidence).cycle or (0, 0)
                note(f"to imitate a cycle: {command} {first}:{end}")
            once = next((segment for segment in segments if segment.gait == DISCRETE), None)
            if once is not None:
                note(f"to imitate a non-periodic movement: {command} {once.start}:{once.end} --discrete")
        if figure is not None:
            from fastmimic.render.figure_style import save
            from fastmimic.report.figures import segments_figure

            first, clip = max(parts, key=lambda part: part[1].n_frames)
            own = [s.later(-first) for s in segments if first <= s.start < first + clip.n_frames]
            save(segments_figure(clip, own, Path(self.take).stem), figure)
            if not self.json:
                put(f"figure in {figure}")


def _segment_row(segment: Segment, rate_hz: float) -> tuple[str, ...]:
    return (
        f"{segment.start}:{segment.end}",
        segment.gait,
        segment.footfall or "",
        f"{segment.period_frames:g} ({segment.period_frames / rate_hz:.2f} s)" if segment.period_frames else "",
        "{}:{}".format(*segment.cycle) if segment.cycle else "",
        f"{segment.confidence:.2f}",
        f"{segment.speed_m_per_s:.2f}",
        f"{segment.yaw_rate_rad_per_s:+.2f}",
    )


@opt.command
class Retarget:
    """Turns an animal's clip into a motion that the robot can execute, and prints what changed."""

    clip: Annotated[Positional[str], opt.option("CLIP")]
    out: Annotated[Path, opt.option("FILE.npz")]
    robot: opt.RobotChoice = None
    reading: opt.ClipReading

    def run(self) -> None:
        out = opt.check_writable(self.out, ".npz")
        overrides = self.reading.overrides()
        source = find_motion(self.clip)
        robot = opt.choose_robot(self.robot, source)
        motion, report = source.retarget(robot, **overrides)
        motion.save(out)
        note_origin(robot, motion)
        put(*report.lines())
        put(f"{motion.n_samples} samples at {motion.rate_hz:g} Hz for {robot.name} in {out}")


@opt.command
class Export:
    """Writes a robot motion in a format that other trainers read."""

    motion: Annotated[Positional[str], opt.option("MOTION")]
    format: Annotated[str, opt.option("NAME", lambda: f"Format: {', '.join((*EXPORTS, LEROBOT))}.")]
    out: Annotated[Path, opt.option("FILE")]
    rate: Annotated[float, opt.option("HZ")] = 50.0
    duration: opt.Seconds = None
    episodes: int | None = None
    robot: opt.RobotChoice = None
    clip: opt.ClipReading

    def run(self) -> None:
        if self.format not in (*EXPORTS, LEROBOT):
            raise unknown("format", self.format, (*EXPORTS, LEROBOT))
        out = self.out
        if self.format != LEROBOT:
            if self.episodes is not None:
                raise ConfigError(f"--episodes is for the format {LEROBOT}; {self.format} has the motion itself")
            endings = (".txt", ".json") if EXPORTS[self.format] == ".txt" else (EXPORTS[self.format],)
            bare = not out.suffix and out.name not in ("", "..")  # a file's name, and no folder such as "."
            out = opt.check_writable(out.with_name(out.name + endings[0]) if bare else out, *endings)
        opt.check_duration(self.duration)
        robot, motion = self.clip.load(self.motion, self.robot)
        if self.format == LEROBOT:
            said = self._run_and_write(robot, motion)
        else:
            frames = export_motion(motion, robot, out, self.format, fps=self.rate, duration_s=self.duration)
            said = f"{frames.n} frames at {frames.fps:g} per second for {robot.name} in {out}"
        if motion.provenance.licence:
            note(f"licence of the motion: {motion.provenance.licence}")
        put(said)

    def _run_and_write(self, robot: Robot, motion: Motion) -> str:
        """Runs the motion and writes what the robot did; returns it in words."""
        from fastmimic.dataset.lerobot import check_lerobot, write_lerobot
        from fastmimic.imitation.evaluate import evaluate

        check_lerobot(self.out, motion.rate_hz, self.rate)
        episodes = 10 if self.episodes is None else self.episodes
        with slow_start():
            rollout = evaluate(motion, robot, episodes=episodes, duration_s=self.duration, log=True).rollout
        frames = write_lerobot(self.out, rollout, robot, f"{motion.name} on {robot.name}", self.rate)
        fell = int(rollout.fell.sum())
        return f"{episodes} runs, {fell} with a fall, {frames} frames at {self.rate:g} per second in {self.out}"
