"""The page of a run: its files, its two nominal episodes, simulated again, and what `run.html` shows of them.

Episodes are not stored: they follow exactly from `motion.npz` and `config.json`, which `metrics.json` checks.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from markupsafe import Markup

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import CheckpointError, ConfigError, naming
from fastmimic.base.files import read_json
from fastmimic.base.text import NONE
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.rollout import Log, Rollout
from fastmimic.experiments.measurement import shown_window
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import Checkpoint
from fastmimic.report import html_episodes
from fastmimic.report import html_page as draw
from fastmimic.report.html_page import AFTER, BEFORE, ONLY, Figure, HtmlReport, Key, Plot, numbers, render
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.work_folder import CONFIG, METRICS, MOTION, VIDEO, RunFolder

_FITTED: Final = Key("as fitted", "var(--before)", symbol="circle-open")
_FOUND: Final = Key("found", "var(--after)", symbol="diamond")


@dataclass(frozen=True, eq=False)
class RerunEpisodes:
    """The run's nominal episodes, simulated again with their logs."""

    robot: Robot
    motion: Motion
    config: ControllerConfig
    series: tuple[tuple[Rollout, Log, Key], ...]  # with the demonstration and, after an optimisation, with its result
    differences: tuple[str, ...]  # sentences about rewards that differ from `metrics.json`

    @property
    def done_once(self) -> bool:
        """Whether the motion has no cycle for synchronising the reference with the robot."""
        target = self.motion.target
        return target.cycle is None and len(target.cycle_starts) == 1

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
        return [draw.rule(border, x=s / self.log.rate_hz, width=1) for s in self.motion.target.segment_starts if s]


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
    draw.plotly_bundle()  # before the episodes: without it there is no page
    m = read_json(path / METRICS)
    try:
        msgspec.convert(m, _Figures)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path / METRICS}: not the figures of a run ({error})") from None
    missing: list[str] = []
    config: dict[str, Any] = {}
    search, episodes, played = None, None, ""
    with draw.leaving_out("arguments and controller, and without the plots of the episodes", missing):
        config = _config(path)
    if m["parameters"]:
        with draw.leaving_out("the plot of the optimisation", missing):
            search = _search(RunFolder(path).checkpoint, len(m["parameters"]))
    if config:
        with draw.leaving_out("the plots of the episodes", missing):
            episodes = _run_again(path, m, config)
    video = path / VIDEO if (path / VIDEO).is_file() else None
    if video is None and not config.get("arguments", {}).get("no_video"):
        missing.append(f"{path / VIDEO} is missing: without the video")
    if replay is not None and episodes is not None:
        with draw.leaving_out("the replay in 3D", missing):
            played = replay(episodes)
    controller, source, licence = (config.get(name) for name in ("controller", "source", "licence"))
    about = {"motion": m["motion"], "robot": m["robot"]}
    if isinstance(source, dict):
        about |= {k: v for k, v in source.items() if isinstance(v, str | int | float)}
    return render(
        "run.html",
        _sections(m, search, episodes),
        title=f"{m['motion']} on {m['robot']}",
        missing=missing,
        replay=played,
        m=m,
        e=episodes,
        shown=_Metrics(m),
        video=video,
        arguments=draw.said_arguments(config.get("arguments", {})),
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
    run = [("before", motion.target, ONLY)]
    if metrics["parameters"]:
        run = [("before", motion.target, BEFORE), ("after", motion, AFTER)]
    series, differences = [], []
    for name, reference, key in run:
        rollout = run_episodes(robot, reference, duration_s=seconds, config=controller, log=True)
        series.append((rollout, rollout.course, key))
        if float(rollout.reward[0]) != (recorded := metrics["reward"][name]):
            again = f"the episode run again has reward {rollout.reward[0]:.6f}"
            differences.append(f"{name}: {again}, the run recorded {recorded:.6f}")
    return RerunEpisodes(robot, motion, controller, tuple(series), tuple(differences))


def _search(path: Path, parameters: int) -> Checkpoint:
    try:
        found = Checkpoint.load(path)
    except CheckpointError as error:
        raise ConfigError(str(error).partition(";")[0]) from None  # its advice is for who resumes
    if found.candidates.shape[2] != parameters:
        raise ConfigError(f"{path} is of another run")
    return found


class _Metrics:
    """The figures of `metrics.json` for the page, with name and exact value as data."""

    def __init__(self, metrics: Mapping[str, Any]) -> None:
        self._metrics = metrics

    def value(self, key: str) -> Any:
        """A figure by its path, such as `reward.before` or `swing_clearance_m.after.2`; None if missing."""
        found: Any = self._metrics
        for name in key.split("."):
            if isinstance(found, list):
                found = found[int(name)] if int(name) < len(found) else None
            else:
                found = found.get(name) if isinstance(found, dict) else None
        return found

    def __call__(self, key: str, digits: int, scale: float = 1.0) -> Markup:
        value = self.value(key)
        if value is None:
            return Markup(NONE)
        text = ("yes" if value else "no") if isinstance(value, bool) else f"{scale * value:.{digits}f}"
        return Markup('<data data-metric="{}" value="{}">{}</data>').format(key, repr(value), text)

    def least_clearance(self, when: str) -> str:
        """The smallest share of the demonstration's swing clearance among the swinging legs."""
        wanted, got = self.value("swing_clearance_m.demonstration"), self.value(f"swing_clearance_m.{when}")
        shares = [g / w for g, w in zip(got or [], wanted or [], strict=False) if g is not None and w]
        return Markup("{:.0f} <small>%</small>").format(100 * min(shares)) if shares else NONE


def _sections(m: Mapping[str, Any], search: Checkpoint | None, e: RerunEpisodes | None) -> dict[str, list[Figure]]:
    optimisation = []
    if search is not None:
        rewards = m["reward"]["before"], m["reward"]["after"]
        optimisation.append(convergence(search, *rewards, unchanged=as_fitted(m["parameters"])))
    if m["parameters"]:
        optimisation.append(parameters(m["parameters"]))
    sections: dict[str, list[Figure]] = {"optimisation": optimisation}
    if e is None:
        return sections | {"tracking": [], "terms": [], "limits": [], "times": []}
    return sections | {
        "tracking": [*html_episodes.feet(e), html_episodes.paths(e), html_episodes.gait(e)],
        "terms": [html_episodes.reward(e)],
        "limits": [*html_episodes.limits(e), html_episodes.friction(e)],
        "times": html_episodes.solve_times(e),
    }


def convergence(search: Checkpoint, before: float, after: float, *, unchanged: bool = False) -> Figure:
    """Scores of the candidates by generation, and their spread; `before` and `after` are rewards of the run.
    `unchanged` if the motion as fitted is the result."""
    scores = search.scores
    k = np.arange(1, len(scores) + 1)
    mean, std = scores.mean(axis=1), scores.std(axis=1)
    best = np.maximum.accumulate(scores.max(axis=1))
    spread = search.candidates.std(axis=1).mean(axis=1)
    x, mode = k.tolist(), "lines" if len(k) > 2 else "lines+markers"
    band = Key("candidates, ± 1 std", "var(--band)", pattern="")
    average = Key("candidates, mean", "var(--before)", "dot")
    leader = Key("best so far", "var(--after)", "solid")
    start = Key("reward before", "var(--demo)", "dash")
    data = [
        draw.line(x, mean - std, Key("", "rgba(0,0,0,0)"), hoverinfo="skip"),
        draw.line(x, mean + std, Key("", "rgba(0,0,0,0)"), fill="tonexty", fillcolor="var(--band)", hoverinfo="skip"),
        draw.line(x, mean, average, mode=mode),
        draw.line(x, best, leader, mode=mode),
        draw.line([x[0], x[-1]], np.array([before, before]), start),
    ]
    drawn = np.concatenate([mean - std, best, [before]])
    low, high = float(np.percentile(drawn, 2)), float(max(best.max(), before))
    margin = 0.08 * max(high - low, 1e-3)
    reward = draw.layout_of("iteration", "score (reward − penalty)", height=330, yrange=(low - margin, high + margin))
    step = draw.layout_of("iteration", "spread (share of the range)", height=330)
    step["yaxis"]["type"] = "log"
    for layout in (reward, step):
        layout["xaxis"] |= {"tickmode": "linear", "dtick": 1, "tick0": 0} if len(k) <= 10 else {}
    gained = after - before
    verb = "rises" if gained > 5e-4 else "falls" if gained < -5e-4 else "hardly changes"
    effort = f"{len(k)} iteration{'s' if len(k) > 1 else ''}"
    title = f"The reward {verb}: {before:.3f} before, {after:.3f} after {effort}"
    if unchanged:
        title = f"{effort.capitalize()} found nothing better than the motion as fitted (reward {after:.3f})"
    spreads = Plot("Spread of the candidates", [draw.line(x, spread, leader, mode=mode)], step)
    return Figure("convergence", title, [Plot("Score", data, reward), spreads], 2, (leader, average, band, start))


def as_fitted(found: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the result is the motion as fitted, from the parameters of `metrics.json`."""
    return all(p["value"] == p["initial"] for p in found)


def parameters(found: Sequence[dict[str, Any]]) -> Figure:
    """Baselines and amplitudes between their bounds, from the parameters of `metrics.json`."""
    plots = []
    for kind, measured, title, axis, unit, scale in (
        ("goal", "m", "Baseline g", "change of the baseline (mm)", "mm", 1e3),
        ("goal", "rad", "Baseline g of angles", "change of the baseline (°)", "°", float(np.degrees(1.0))),
        ("amplitude", "1", "Amplitude a", "amplitude (1 = as fitted)", "", 1.0),
    ):
        own = [p for p in found if p["name"].endswith(f".{kind}") and p["unit"] == measured]
        if not own:
            continue
        shift = [p["initial"] if kind == "goal" else 0.0 for p in own]
        names = [p["name"].rsplit(".", 1)[0].replace("_foot_z", " foot z").replace("_", " ") for p in own]
        ends: list[float | None] = []
        for p, s in zip(own, shift, strict=True):
            ends += [*numbers([scale * (p["lower"] - s), scale * (p["upper"] - s)]), None]
        bounds = draw.line(ends, [name for name in names for _ in range(3)], Key("bounds", "var(--muted)"))
        ticks = {"symbol": "line-ns-open", "size": 11, "color": "var(--muted)"}
        data = [bounds | {"mode": "lines+markers", "marker": ticks, "line": {"color": "var(--grid)", "width": 6}}]
        for value, key, size in (("initial", _FITTED, 15), ("value", _FOUND, 10)):
            x = numbers([scale * (p[value] - s) for p, s in zip(own, shift, strict=True)])
            data.append(draw.points(x, names, key, f"%{{y}}: %{{x:.4g}} {unit}".rstrip(), size=size))
        layout = draw.layout_of(axis, "", height=70 + 26 * len(own), hovermode="closest")
        layout["yaxis"] |= {**draw.rows_axis(names), "showgrid": False}
        plots.append(Plot(title, data, layout))
    at = sum(min(p["value"] - p["lower"], p["upper"] - p["value"]) < 0.01 * (p["upper"] - p["lower"]) for p in found)
    ending = "none at a bound" if not at else f"{at} at a bound, where the search would have gone further"
    if as_fitted(found):
        ending = "all as they were fitted"
    title = f"What the optimiser chose: {len(found)} parameters, {ending}"
    return Figure("parameters", title, plots, 2, (_FITTED, _FOUND, Key("bounds", "var(--grid)", pattern="")))
