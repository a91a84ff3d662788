"""The data of a run's page: its files, and its two nominal episodes, simulated again.

Episodes are not stored, since they follow exactly from `motion.npz` and `config.json`; the rewards in `metrics.json`
check this.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import CheckpointError, ConfigError, FastMimicError
from fastmimic.base.files import read_json
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.rollout import Log, Rollout
from fastmimic.motion.motion import Motion
from fastmimic.optimize.checkpoint import Checkpoint
from fastmimic.report.html_plots import AFTER, BEFORE, ONLY, Key, rule
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.work_folder import CONFIG, METRICS, MOTION, VIDEO, RunFolder

CYCLES: Final = 2  # shown at first
TRANSITION_S: Final = 2.0  # of a stitched motion, shown at first


@dataclass(frozen=True, eq=False)
class RerunEpisodes:
    """The run's nominal episodes, simulated again with their logs."""

    robot: Robot
    motion: Motion
    config: ControllerConfig
    before: Rollout  # with the demonstration
    after: Rollout | None  # with the optimised motion; None without optimisation
    differences: tuple[str, ...]  # sentences about rewards that differ from `metrics.json`

    @property
    def done_once(self) -> bool:
        """Whether the motion has no cycle for synchronising the reference with the robot."""
        target = self.motion.target
        return target.cycle is None and len(target.cycle_starts) == 1

    @cached_property
    def series(self) -> tuple[tuple[Rollout, Log, Key], ...]:
        if self.after is None:
            return ((self.before, self.before.course, ONLY),)
        return ((self.before, self.before.course, BEFORE), (self.after, self.after.course, AFTER))

    @property
    def keys(self) -> tuple[Key, ...]:
        return tuple(key for *_, key in self.series)

    @property
    def log(self) -> Log:
        """Of the first episode: schedule and demonstration are those of both."""
        return self.series[0][1]

    @property
    def times(self) -> Array:
        """(t,) s, of the states after each step."""
        return np.arange(1, self.log.wanted.shape[1] + 1) / self.log.rate_hz

    @property
    def whole_episode(self) -> tuple[float, float]:
        """From 0 to the end of the episodes, s."""
        return 0.0, self.log.wanted.shape[1] / self.log.rate_hz

    @property
    def first_window(self) -> tuple[float, float]:
        """The times shown at first, s."""
        return shown_window(self.motion.target, [rollout for rollout, *_ in self.series])

    @property
    def segment_lines(self) -> list[dict[str, Any]]:
        """Lines between the segments of a stitched motion."""
        border = Key("", "var(--muted)", "dash")
        return [rule(border, x=s / self.log.rate_hz, width=1) for s in self.motion.target.segment_starts if s]


def shown_window(target: Motion, rollouts: Sequence[Rollout]) -> tuple[float, float]:
    """The last cycles that a rollout with a log completed, or the first transition of a stitched motion, s."""
    rate_hz, starts = rollouts[0].course.rate_hz, target.segment_starts
    if len(starts) > 1:
        start = max(0.0, starts[1] / rate_hz - TRANSITION_S / 2)
        return start, min(rollouts[0].course.wanted.shape[1] / rate_hz, start + TRANSITION_S)
    alive = max(int(rollout.steps[0]) for rollout in rollouts) / rate_hz
    start = max(0.0, alive - CYCLES * target.period_s)
    return start, max(alive, start + 0.1)


@dataclass(frozen=True, eq=False)
class RunData:
    metrics: dict[str, Any]
    config: dict[str, Any]
    search: Checkpoint | None  # None if nothing was optimised or it is missing
    episodes: RerunEpisodes | None  # None if they cannot be simulated again
    video: Path | None
    missing: tuple[str, ...]  # a sentence for each missing thing and what is left out


def read_run(path: Path) -> RunData:
    """Reads a run's folder and simulates its episodes again; raises `ConfigError` if `metrics.json` is unusable."""
    metrics = read_json(path / METRICS)
    lacking = [key for key in ("motion", "robot", "reward", "fell", "parameters", "duration_s") if key not in metrics]
    if lacking:
        raise ConfigError(f"{path / METRICS}: not the figures of a run ({', '.join(lacking)} missing)")
    missing: list[str] = []
    config: dict[str, Any] = {}
    try:
        config = read_json(path / CONFIG)
    except ConfigError as error:
        missing.append(f"{error}: without arguments and controller, and without the plots of the episodes")
    search = None
    if metrics["parameters"]:
        try:
            search = _search(RunFolder(path).checkpoint, len(metrics["parameters"]))
        except ConfigError as error:
            missing.append(f"{error}: without the plot of the optimisation")
    episodes = None
    if config:
        try:
            episodes = _run_again(path, metrics, config)
        except FastMimicError as error:
            missing.append(f"{error}: without the plots of the episodes")
    video = path / VIDEO if (path / VIDEO).is_file() else None
    if video is None and not config.get("arguments", {}).get("no_video"):
        missing.append(f"{path / VIDEO} is missing: without the video")
    return RunData(metrics, config, search, episodes, video, tuple(missing))


def _run_again(path: Path, metrics: dict[str, Any], config: dict[str, Any]) -> RerunEpisodes:
    if not (path / MOTION).is_file():
        raise ConfigError(f"{path / MOTION} is missing")
    try:
        controller = ControllerConfig.from_dict(config.get("controller"))
    except ConfigError as error:
        raise ConfigError(f"{path / CONFIG}: {error}") from None
    arguments = config.get("arguments", {})
    robot = load_robot(arguments.get("robot") or metrics["robot"])
    motion = Motion.load(path / MOTION)
    seconds = float(metrics["duration_s"])
    before = run_episodes(robot, motion.target, duration_s=seconds, config=controller, log=True)
    after = None
    if metrics["parameters"]:
        after = run_episodes(robot, motion, duration_s=seconds, config=controller, log=True)
    differences = []
    for name, rollout in (("before", before), ("after", after)):
        if rollout is not None and float(rollout.reward[0]) != metrics["reward"][name]:
            differences.append(
                f"{name}: the episode run again has reward {rollout.reward[0]:.6f}, the run recorded"
                f" {metrics['reward'][name]:.6f}"
            )
    return RerunEpisodes(robot, motion, controller, before, after, tuple(differences))


def _search(path: Path, parameters: int) -> Checkpoint:
    try:
        found = Checkpoint.load(path)
    except CheckpointError as error:
        raise ConfigError(str(error).partition(";")[0]) from None  # its advice is for who resumes
    if found.candidates.shape[2] != parameters:
        raise ConfigError(f"{path} is of another run")
    return found
