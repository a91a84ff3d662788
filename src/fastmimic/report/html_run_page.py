"""The page of a run: what the template `run.html` shows."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import FastMimicError
from fastmimic.base.text import NONE
from fastmimic.report import html_episodes, html_search
from fastmimic.report.html_page import HtmlReport, plotly_bundle, render
from fastmimic.report.html_plots import Figure
from fastmimic.report.html_run import RerunEpisodes, RunData, read_run


def run_page(path: Path, replay: Callable[[RerunEpisodes], str] | None) -> HtmlReport:
    """The page of a run's folder; `replay` makes an HTML page that plays its episodes. Raises `ConfigError`."""
    plotly_bundle()  # before the episodes: without it there is no page
    run = read_run(path)
    missing, played = [*run.missing], ""
    if replay is not None and run.episodes is not None:
        try:
            played = replay(run.episodes)
        except FastMimicError as error:
            missing.append(f"{error}: without the replay in 3D")
    m, sections, controller = run.metrics, _sections(run), run.config.get("controller")
    return render(
        "run.html",
        [figure for found in sections.values() for figure in found],
        title=f"{m['motion']} on {m['robot']}",
        missing=missing,
        replay=played,
        m=m,
        e=run.episodes,
        shown=_Metrics(m),
        video=run.video,
        sections=sections,
        arguments=_arguments(run.config.get("arguments", {})),
        about=_about(run),
        controller=json.dumps(controller, indent=2, ensure_ascii=False) if controller else "",
        legs=LEGS,
    )


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
        """HTML of one figure."""
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


def _sections(run: RunData) -> dict[str, list[Figure]]:
    m, e, optimisation = run.metrics, run.episodes, []
    if run.search is not None:
        optimisation.append(
            html_search.convergence(
                run.search,
                m["reward"]["before"],
                m["reward"]["after"],
                unchanged=html_search.as_fitted(m["parameters"]),
                randomized="randomization" in m,
            )
        )
    if m["parameters"]:
        optimisation.append(html_search.parameters(m["parameters"]))
    sections: dict[str, list[Figure]] = {"optimisation": optimisation}
    if e is None:
        return sections | {"tracking": [], "terms": [], "limits": [], "times": []}
    solved = html_episodes.solve_times(e)
    return sections | {
        "tracking": [*html_episodes.feet(e), html_episodes.paths(e), html_episodes.gait(e)],
        "terms": [html_episodes.reward(e)],
        "limits": [*html_episodes.limits(e), html_episodes.friction(e)],
        "times": [] if solved is None else [solved],
    }


def _arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments as on the command line."""
    arguments = {k.replace("_", "-"): v for k, v in given.items() if v is not False and v not in (None, "", [])}
    for name in ("motions", "cycles"):
        if name in arguments:
            arguments[name] = " ".join(str(v) for v in arguments[name])
    return {k: "yes" if v is True else v for k, v in arguments.items()}


def _about(run: RunData) -> dict[str, Any]:
    source, licence = run.config.get("source"), run.config.get("licence")
    about: dict[str, Any] = {"motion": run.metrics["motion"], "robot": run.metrics["robot"]}
    if isinstance(source, dict):
        about |= {k: v for k, v in source.items() if isinstance(v, str | int | float)}
    return about | ({"licence": licence} if licence else {})
