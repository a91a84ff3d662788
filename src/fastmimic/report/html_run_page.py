"""The page of a run: what the template `run.html` shows."""

import json
from collections.abc import Iterable, Mapping
from typing import Any, Final

from markupsafe import Markup

from fastmimic.base.conventions import LEGS
from fastmimic.base.text import NONE
from fastmimic.imitation.methods import METHODS
from fastmimic.report import html_episodes, html_limits, html_search
from fastmimic.report.html_page import render
from fastmimic.report.html_plots import Figure
from fastmimic.report.html_run import RunData

_FIGURES: Final = (  # label, name in metrics.json, digits, scale
    ("fell", "fell", 0, 1.0),
    ("drift, m/s", "drift_m_per_s", 3, 1.0),
    *((f"swing clearance {leg}, mm", f"swing_clearance_m.{{}}.{i}", 1, 1e3) for i, leg in enumerate(LEGS)),
    ("early contacts, 1/s", "early_contacts_per_s", 1, 1.0),
    ("stance slip, mm", "stance_slip_m", 2, 1e3),
    ("foot height error, RMS, mm", "foot_z_rmse_m", 2, 1e3),
    ("foot fore-aft error, RMS, mm", "foot_x_rmse_m", 2, 1e3),
    ("steps without a QP solution", "qp_failures", 0, 1.0),
)
_TILES: Final = (  # label, name in metrics.json, digits, scale, unit
    ("Reward", "reward", 3, 1.0, ""),
    ("Fell", "fell", 0, 1.0, ""),
    ("Drift", "drift_m_per_s", 3, 1.0, "m/s"),
    ("Foot height error", "foot_z_rmse_m", 1, 1e3, "mm"),
    ("Fore-aft error", "foot_x_rmse_m", 1, 1e3, "mm"),
)


def run_page(run: RunData, replay: str = "") -> str:
    """The page of a run; `replay` is an HTML page that plays its episodes, empty for none."""
    m, e = run.metrics, run.episodes
    shown = _Metrics(m)
    sections = _sections(run)
    columns = ("before", "after") if run.optimised else ("before",)
    return render(
        "run.html",
        [figure for found in sections.values() for figure in found],
        title=f"{m['motion']} on {m['robot']}",
        replay=replay,
        sections=sections,
        lead=_lead(m),
        verified=_verified(run),
        notes=[*run.missing, *_differences(run)],
        tiles=_tiles(run, shown),
        video=run.video,
        columns=("", *(columns if run.optimised else ("not optimised",))),
        numbers=_numbers(shown, columns),
        effort=Markup("{} episodes, {} s simulated in {} s").format(
            shown("evaluations", 0), shown("simulated_s", 0), shown("wall_s", 1)
        ),
        done_once=e is not None and e.done_once,
        segments=_segments(shown),
        parameters=_parameters(shown),
        arguments=_arguments(run.config.get("arguments", {})),
        about=_about(run),
        versions=m.get("versions", {}),
        controller=json.dumps(run.config.get("controller"), indent=2, ensure_ascii=False)
        if run.config.get("controller")
        else "",
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
    solved = html_limits.solve_times(e)
    return sections | {
        "tracking": [*html_episodes.feet(e), html_episodes.paths(e), html_episodes.gait(e)],
        "terms": [html_episodes.reward(e)],
        "limits": [*html_limits.limits(e), html_limits.friction(e)],
        "times": [] if solved is None else [solved],
    }


def _lead(m: Mapping[str, Any]) -> str:
    method = METHODS.get(m.get("method", ""))
    name = f"{method.label}, {method.summary}" if method is not None else str(m.get("method", "unknown method"))
    parts = [name, f"{m.get('config', '')} controller", f"episodes of {m['duration_s']:g} s"]
    if m.get("iterations"):
        plural = "" if m["iterations"] == 1 else "s"
        parts.append(f"{m['iterations']} iteration{plural}, seed {m.get('seed')}")
    return "; ".join(parts) + (". The search was interrupted." if m.get("interrupted") else ".")


def _verified(run: RunData) -> str:
    """A sentence if the simulated episodes have the recorded rewards; else empty."""
    e = run.episodes
    if e is None or e.differences:
        return ""
    if e.after is None:
        return "The nominal episode was run again for this page; the reward is to the last bit that of"
    return "Both nominal episodes were run again for this page; the rewards are to the last bit those of"


def _differences(run: RunData) -> Iterable[str]:
    if run.episodes is None or not run.episodes.differences:
        return ()
    said = "The plots show the episodes that were run again; the figures are the recorded ones."
    return (*run.episodes.differences, said)


def _tiles(run: RunData, shown: _Metrics) -> list[dict[str, str]]:
    """The most important figures."""
    now = "after" if run.optimised else "before"

    def tile(label: str, value: str, before: str, unit: str = "", prefix: str = "") -> dict[str, str]:
        was = Markup("{}before {}").format(prefix, before) if run.optimised else f"{prefix}not optimised"
        return {"label": label, "value": value, "unit": unit, "was": was}

    tiles = []
    for label, key, digits, scale, unit in _TILES:
        if key == "drift_m_per_s" and run.episodes is not None and run.episodes.done_once:
            continue  # it is 0, as nothing is synchronised
        value, before = (shown(f"{key}.{when}", digits, scale) for when in (now, "before"))
        tiles.append(tile(label, value, before, unit, "RMS, " if "rmse" in key else ""))
    tiles.insert(2, tile("Swing clearance", shown.least_clearance(now), shown.least_clearance("before")))
    return tiles


def _numbers(shown: _Metrics, columns: tuple[str, ...]) -> tuple[list[Any], list[Any]]:
    """The rows of two tables, before and after: rewards, and the rest."""

    def row(label: Any, key: str, digits: int, scale: float = 1.0, *, sub: bool = False) -> dict[str, Any]:
        key = key if "{}" in key else f"{key}.{{}}"
        return {"cells": [label, *(shown(key.format(when), digits, scale) for when in columns)], "sub": sub}

    rewards = [row("reward", "reward", 4)]
    terms = shown.value("reward.components_before") or {}
    rewards += [row(term.replace("_", " "), f"reward.components_{{}}.{term}", 4, sub=True) for term in terms]
    robots = shown.value("randomization.held_out.robots")
    if robots is not None:
        for label, key in (("mean over", "mean"), ("worst of", "worst"), ("share of falls,", "fell")):
            rewards.append(row(f"{label} {robots} other robots", f"randomization.held_out.{{}}.{key}", 4))
    others = []
    for label, key, digits, scale in _FIGURES:
        if key.startswith("swing"):
            wanted = shown(key.format("demonstration"), digits, scale)
            others.append(row(Markup("{} (of {})").format(label, wanted), key, digits, scale))
        else:
            others.append(row(label, key, digits, scale))
    return rewards, others


def _segments(shown: _Metrics) -> list[list[str]]:
    """The segments of a stitched motion."""
    return [
        [
            str(segment["motion"]),
            *(shown(f"segments.{i}.{key}", digits) for key, digits in (("cycles", 0), ("first_s", 2), ("last_s", 2))),
            shown(f"segments.{i}.reward.before", 3),
            shown(f"individual_optima.segments.{i}", 3),
            shown(f"segments.{i}.reward.after", 3),
            shown(f"segments.{i}.fell.after", 0),
        ]
        for i, segment in enumerate(shown.value("segments") or [])
    ]


def _parameters(shown: _Metrics) -> list[list[str]]:
    """The parameters with their bounds."""
    return [
        [
            Markup("<code>{}</code>").format(parameter["name"]),
            *(shown(f"parameters.{i}.{key}", 4) for key in ("lower", "initial", "value", "upper")),
            parameter["unit"] if parameter["unit"] != "1" else NONE,
        ]
        for i, parameter in enumerate(shown.value("parameters"))
    ]


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
