"""The pages of a run, an experiment and a deployment: their files, and a run's two nominal episodes, simulated again.

Episodes are not stored: they follow exactly from `motion.npz` and `config.json`, which `metrics.json` checks.
"""

import csv
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from markupsafe import Markup

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError, LogError, naming
from fastmimic.base.files import read_json
from fastmimic.base.text import NONE
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.log import RESULT, DeploymentLog
from fastmimic.deploy.summary import robot_of, summary_rows, with_result
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.rollout import Rollout
from fastmimic.experiments import comparison_run as compared
from fastmimic.experiments.measurement import shown_window
from fastmimic.motion.motion import Motion
from fastmimic.report.episode_figures import deployment_figure, episode_figure
from fastmimic.report.figures import motion_figure
from fastmimic.report.html_page import HtmlReport, Picture, leaving_out, render, said_arguments
from fastmimic.report.run_table import FIGURES, figure_key, figure_of, run_columns
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.work_folder import (
    CONFIG,
    CONVERGENCE,
    ENVIRONMENT,
    METRICS,
    MOTION,
    RESULTS_CSV,
    TABLE,
    TRACKING,
    VIDEO,
)


@dataclass(frozen=True, eq=False)
class RerunEpisodes:
    """The run's nominal episodes, simulated again with their logs."""

    robot: Robot
    motion: Motion
    config: ControllerConfig
    rollouts: dict[str, Rollout]  # with the demonstration and, of a search, its result, by their titles
    differences: tuple[str, ...]  # sentences about rewards that differ from `metrics.json`

    @property
    def pictures(self) -> list[Picture]:
        """The motion, and what the robot did."""
        title = f"{self.motion.name} on {self.robot.name}"
        target = self.motion.target
        window = shown_window(target, [*self.rollouts.values()])
        borders = [start / target.rate_hz for start in target.segment_starts if start]
        done = episode_figure(self.robot, self.config, self.rollouts, window, title, borders)
        return [Picture.of(motion_figure(self.motion, self.robot), "motion"), Picture.of(done, "episodes")]


class _Figures(msgspec.Struct):
    """What a page needs of `metrics.json`."""

    motion: str
    robot: str
    reward: dict[str, Any]
    fell: dict[str, Any]
    parameters: list[dict[str, Any]]
    duration_s: float


def run_page(path: Path, replay: Callable[[RerunEpisodes], str] | None) -> HtmlReport:
    """The page of a run's folder, whose episodes are simulated again; `replay` makes an HTML page that plays them.
    Raises `ConfigError`, also if `metrics.json` is unusable."""
    m = read_json(path / METRICS)
    try:
        msgspec.convert(m, _Figures)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path / METRICS}: not the figures of a run ({error})") from None
    missing: list[str] = []
    config: dict[str, Any] = {}
    pictures: dict[str, list[Picture]] = {"optimisation": [], "tracking": [], "episodes": []}
    episodes, played = None, ""
    with leaving_out("arguments and controller, and without the pictures of the episodes", missing):
        config = _config(path)
    for part, name in (("optimisation", CONVERGENCE), ("tracking", TRACKING)):
        if m["parameters"] or part != "optimisation":
            with leaving_out("that picture", missing):
                pictures[part] = [Picture.of(path / name)]
    if config:
        with leaving_out("the pictures of the episodes", missing):
            episodes = _run_again(path, m, config)
            pictures["episodes"] = episodes.pictures
    video = path / VIDEO if (path / VIDEO).is_file() else None
    if video is None and not config.get("arguments", {}).get("no_video"):
        missing.append(f"{path / VIDEO} is missing: without the video")
    if replay is not None and episodes is not None:
        with leaving_out("the replay in 3D", missing):
            played = replay(episodes)
    controller, source, licence = (config.get(name) for name in ("controller", "source", "licence"))
    about = {"motion": m["motion"], "robot": m["robot"]}
    if isinstance(source, dict):
        about |= {k: v for k, v in source.items() if isinstance(v, str | int | float)}
    return render(
        "run.html",
        title=f"{m['motion']} on {m['robot']}",
        missing=missing,
        replay=played,
        m=m,
        e=episodes,
        shown=_Metrics(m),
        columns=run_columns(m),
        figures=FIGURES,
        key_of=figure_key,
        pictures=pictures,
        video=video,
        arguments=said_arguments(config.get("arguments", {})),
        about=about | ({"licence": licence} if licence else {}),
        controller=json.dumps(controller, indent=2, ensure_ascii=False) if controller else "",
        legs=LEGS,
    )


def _config(path: Path) -> dict[str, Any]:
    config = read_json(path / CONFIG)
    if not isinstance(config.get("arguments", {}), dict):
        raise ConfigError(f"{path / CONFIG}: not the settings of a run (arguments: {config['arguments']})")
    return config


def _run_again(path: Path, metrics: dict[str, Any], config: dict[str, Any]) -> RerunEpisodes:
    if not (path / MOTION).is_file():
        raise ConfigError(f"{path / MOTION} is missing")
    with naming(path / CONFIG, ConfigError):
        controller = ControllerConfig.from_dict(config.get("controller"))
    robot = load_robot(config.get("arguments", {}).get("robot") or metrics["robot"])
    motion = Motion.load(path / MOTION)
    seconds = float(metrics["duration_s"])
    references = {"before": motion.target, "after": motion}
    rollouts, differences = {}, []
    for name, title in run_columns(metrics).items():
        if (reference := references.get(name)) is None:
            continue
        rollout = rollouts[title] = run_episodes(robot, reference, duration_s=seconds, config=controller, log=True)
        if float(rollout.reward[0]) != (recorded := metrics["reward"][name]):
            again = f"the episode run again has reward {rollout.reward[0]:.6f}"
            differences.append(f"{title}: {again}, the run recorded {recorded:.6f}")
    return RerunEpisodes(robot, motion, controller, rollouts, tuple(differences))


class _Metrics:
    """The figures of `metrics.json` for the page, with name and exact value as data."""

    def __init__(self, metrics: Mapping[str, Any]) -> None:
        self._metrics = metrics

    def __call__(self, key: str, digits: int, scale: float = 1.0) -> Markup:
        value = figure_of(self._metrics, key)
        if value is None:
            return Markup(NONE)
        text = (
            ("yes" if value else "no")
            if isinstance(value, bool) or key == "kinematic.fell"
            else f"{scale * value:.{digits}f}"
        )
        return Markup('<data data-metric="{}" value="{}">{}</data>').format(key, repr(value), text)

    def least_clearance(self, column: str) -> Markup:
        """The smallest share of the demonstration's swing clearance among the swinging legs."""
        keys = "swing_clearance_m.demonstration", figure_key("swing_clearance_m", column)
        wanted, got = (figure_of(self._metrics, key) or [] for key in keys)
        shares = [g / w for g, w in zip(got, wanted, strict=False) if g is not None and w]
        return Markup("{:.0f} <small>%</small>").format(100 * min(shares)) if shares else Markup(NONE)


def results_page(path: Path) -> HtmlReport:
    """The page of an experiment's folder; raises `ConfigError` if its files cannot be read."""
    about = read_json(path / ENVIRONMENT)
    pictures = [Picture.of(file) for file in sorted(path.glob("*.png"))]
    tables = [_text(path / name) for name in (TABLE, compared.ABLATION_TABLE) if (path / name).is_file()]
    rows = [*csv.reader(_text(path / RESULTS_CSV).splitlines())] if (path / RESULTS_CSV).is_file() else []
    missing = [] if pictures else [f"{path} has no figures: without them"]
    for name, there in ((TABLE, tables), (RESULTS_CSV, rows)):
        if not there:
            missing.append(f"{path / name} is missing: without it; --resume writes it when something is done")
    title = str(about.get("experiment", "comparison")).capitalize()
    shown: dict[str, Any] = {"about": about, "pictures": pictures, "tables": tables, "rows": rows}
    return render("results.html", title=title, missing=missing, **shown)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None


def deployment_page(path: Path) -> HtmlReport:
    """The page of a deployment's folder; raises `FastMimicError`."""
    missing, pictures = [], []
    try:
        try:
            log = DeploymentLog.load(path)
            if not log.facts.result:
                log = with_result(robot_of(log), log)
            about = log.facts.as_dict()
            pictures.append(Picture.of(deployment_figure(log, f"{about['motion']} on {about['robot']}"), "log"))
        except LogError as error:
            if not (path / RESULT).is_file():
                raise
            missing.append(f"{error}: without the pictures")
            about = read_json(path / RESULT)
        title = f"{about['motion']} on {about['robot']}, deployed by driver {about['driver']}"
        summary = dict(summary_rows(about["result"]))
        arguments = said_arguments(about.get("arguments", {}))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path}: not the figures and the log of a deployment ({error})") from None
    shown: dict[str, Any] = {"about": about, "summary": summary, "arguments": arguments, "pictures": pictures}
    return render("deployment.html", title=title, missing=missing, **shown)
