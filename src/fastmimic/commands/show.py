"""What verbs share: results and provenance as they print them, with the figures of `metrics.json` and of
`evaluate --json`; and the log of a deployment as their argument."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
from fastmimic.base.errors import ConfigError
from fastmimic.base.files import remove_file
from fastmimic.base.progress import count_progress, note, slow_start
from fastmimic.base.text import number
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import FORMATS
from fastmimic.commands import options as opt
from fastmimic.commands.console import EXIT_INTERRUPTED, put, put_table
from fastmimic.deploy.log import DeploymentLog, load_ground_truth
from fastmimic.motion.motion import Motion
from fastmimic.report.run_table import FIGURES, figure_key, figure_of, run_columns
from fastmimic.robot import Robot
from fastmimic.runs.work_folder import RESULTS, RunFolder

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.imitation.imitate import Imitation


def yes_no(value: Any) -> str:
    """A truth value in words."""
    return "yes" if value else "no"


def figure_rows(figures: dict[str, Any], reward: str, fell: str, clearance: tuple[str, str]) -> list[tuple[str, str]]:
    """Name and value of each figure of an episode, for a table."""
    components = [(f"  {name.replace('_', ' ')}", number(value)) for name, value in figures["components"].items()]
    animal = figures.get("reward_animal")
    against = [] if animal is None else [("reward against the animal", number(animal))]
    others = [(label, number(figures[name], digits, scale)) for label, name, digits, scale in FIGURES]
    return [*against, ("reward", reward), *components, ("fell", fell), clearance, *others]


def _column(metrics: Mapping[str, Any], column: str) -> dict[str, str]:
    """The figures of one episode of a run, as they are printed; `column` is one of `run_columns`."""
    others = ("reward_mean", "reward_animal", "components", "fell", "swing_clearance_m")
    names = (*others, *(name for _, name, _, _ in FIGURES))
    figures = {name: figure_of(metrics, figure_key(name, column)) for name in names}
    swings = zip(figures["swing_clearance_m"], metrics["swing_clearance_m"]["demonstration"], strict=True)
    shares = [realised / wanted for realised, wanted in swings if realised is not None and wanted]
    cells = figure_rows(
        figures,
        reward=f"{figures['reward_mean']:.3f}",
        fell=yes_no(figures["fell"]),
        clearance=("swing clearance, % of reference", number(min(shares, default=None), 0, 100)),
    )
    return dict(cells)


def write_run(result: "Imitation", folder: RunFolder, config: Mapping[str, Any]) -> None:
    """Writes everything but the video, in place of an earlier run; raises `OutputError`."""
    from fastmimic.report.figures import draw_run
    from fastmimic.report.html import REPORT

    for name in (*RESULTS, REPORT):
        remove_file(folder.path / name)
    draw_run(result, folder)
    folder.write_run(result.motion, config, result.metrics(), searched=result.history is not None)


def put_result(
    result: "Imitation", folder: RunFolder, iterations: int | None, *, video: str | None, clip: Clip | None = None
) -> int:
    """Prints the figures of the motion as retargeted, executable and optimised, and adds the video, of this quality or
    None for none, to the folder, with the animal of `clip`; returns the exit status. `iterations` is the number that
    was asked for, None for no number."""
    from fastmimic.report.figures import write_video

    metrics = result.metrics()
    if result.demonstration.runs_once:
        metrics["drift_m_per_s"] = metrics.get("kinematic", {})["drift_m_per_s"] = None
    columns = run_columns(metrics)
    cells = [_column(metrics, column) for column in columns]
    rows = [(name, *(values[name] for values in cells)) for name in cells[0]]
    put(f"{result.motion.name} on {result.robot.name}, {result.duration_s:g} s")
    put_table([("", *columns.values()), *rows], right=range(1, len(cells) + 1))
    effort = f"{metrics['simulated_s']:.0f} s simulated in {metrics['wall_s']:.1f} s"
    if metrics["evaluations"]:
        effort = f"{metrics['evaluations']} episodes in {metrics['iterations']} iterations, {effort}"
    put(effort)
    if result.nothing_gained:
        put("the search found nothing better: the result is the motion as fitted by DMPs")
    if video is not None:
        try:
            with count_progress("video, frame") as progress:
                write_video(result, folder, clip, progress=progress, quality=video)
        except KeyboardInterrupt:
            note(f"the video was not written; everything else is in {folder.path}")
            raise
    put(f"results in {folder.path}")
    if not result.interrupted:
        note(f"to look closer: fastmimic view {folder.path}")
        return 0
    said = f"interrupted after {result.iterations} of {iterations or 'at most 200'} iterations"
    note(f"fastmimic: {said}; the result is the best so far, and --out {folder.path} --resume continues")
    return EXIT_INTERRUPTED


def note_origin(robot: Robot, motion: Motion) -> None:
    """Prints where a motion comes from and what was assumed."""
    note(provenance(motion))
    for sentence in (*motion.provenance.assumed, *robot.assumed):
        note(f"assumed: {sentence}")


def provenance(motion: Motion) -> str:
    """One line: name, source, scale, period, licence."""
    origin, scale = motion.provenance.origin, motion.provenance.retargeted.scale
    parts = [source := origin.source or "unknown source"]
    cut = None if origin.frames is None else "frames {}:{}".format(*origin.frames)
    if cut is not None and not source.endswith(cut):  # a named recording has them in its source
        parts.append(cut)
    if origin.format is not None and origin.format in FORMATS:
        parts.append(FORMATS[origin.format].about.split(",")[0])
    if scale is not None:
        parts.append(f"scale {scale:.3f}")
    held = motion.provenance.held_s
    once = "run once, " + (f"the last {held:.2g} s at rest" if held else "ends in mid-stride")
    once = "not periodic" if motion.target.parts else once
    parts.append(f"{motion.period_s:.3f} s" + (" per cycle" if motion.cycle is not None else f", {once}"))
    licence = motion.provenance.licence
    return f"{motion.name}: {', '.join(parts)}" + (f"; licence: {licence}" if licence else "")


def describe_robot(robot: Robot) -> list[str]:
    """A robot in ten lines: what its legs, feet and joints are taken for, its limits and mass, what was assumed."""

    def joints(values: Iterable[object]) -> str:
        return ", ".join(f"{name} {v}" for name, v in zip(JOINTS_PER_LEG, values, strict=False))

    ranges = [f"{low:.2f}…{high:.2f}" for low, high in zip(robot.joint_lower, robot.joint_upper, strict=True)]
    hips = [f"{leg} at ({x:+.3f}, {y:+.3f}) m" for leg, (x, y, _) in zip(LEGS, robot.hip_pos_b, strict=True)]
    bends = ["back" if sign < 0 else "forward" for sign in robot.knee_sign[[0, 2]]]
    model = robot.model()
    feet = [model.body(int(model.geom(name).bodyid[0])).name for name in robot.foot_geoms]
    turned = [name for name, sign in zip(robot.joint_names, robot.joint_sign, strict=True) if sign < 0]
    return [
        f"robot      {robot.name}, {robot.mass:.2f} kg, its trunk {robot.trunk_mass:.2f} kg",
        f"legs       {', '.join(hips)}; thigh {robot.thigh_length:.3f}, calf {robot.calf_length:.3f} m",
        f"feet       {', '.join(feet)}: spheres of {1e3 * robot.foot_radius:.0f} mm",
        f"order      {', '.join(robot.joint_names)}",
        f"ranges     {joints(ranges)} rad in front; {joints(ranges[6:])} behind",
        f"torque     {joints(map('{:g}'.format, robot.torque_limit))} N·m",
        f"speed      {joints(map('{:g}'.format, robot.joint_speed_limit))} rad/s",
        f"stands     {robot.home_height:.3f} m high, front knees point {bends[0]}, hind ones {bends[1]}",
        f"turned     {', '.join(turned) or 'none'} (joints about the opposite axis in the file)",
        f"assumed    {'; '.join(robot.assumed) or 'nothing'}",
    ]


def open_log(command: Any, reading: opt.ClipReading, *taken: str) -> tuple[Robot, DeploymentLog]:
    """The robot and the log that a command's `motion` names, by its `robot` and its `truth` if they are given. Raises
    `ConfigError` if an option of a clip's `reading` is given, or another one than those and the ones `taken`."""
    from fastmimic.deploy.deployment import true_states
    from fastmimic.deploy.summary import robot_of, with_result

    path, truth, taken = command.motion, command.truth, ("motion", "robot", "truth", *taken)
    names = [field.name for field in dataclasses.fields(command) if field.name not in taken]
    for name in (*opt.given(command, *names), *opt.given(reading)):
        raise ConfigError(f"{path} is the log of a deployment, which is not simulated: drop {name}")
    log = DeploymentLog.load(path)
    if truth is not None:
        found = load_ground_truth(truth)
        log = dataclasses.replace(log, truth=true_states(log, found["observation"], found["tick"]))
    robot = robot_of(log, command.robot)
    with slow_start():
        log = with_result(robot, log)
    is_whole(log.facts.result.get("log_ends"))
    return robot, log


def check_truth(path: str, truth: Path | None) -> None:
    """Raises `ConfigError` if true states are given for anything but a log."""
    if truth is not None:
        raise ConfigError(f"--truth is for the log of a deployment, which {path} is not")


def is_whole(ends: str | None) -> bool:
    """Whether a log has all rows; says when and why it ends if not."""
    if ends is not None:
        note(f"fastmimic: the log ends {ends}")
    return ends is None
