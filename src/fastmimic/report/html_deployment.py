"""The page of a deployment: how it ended, whether the computer was fast enough, and what it asked of the motors."""

import json
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import JOINTS_PER_LEG
from fastmimic.base.errors import ConfigError, DeploymentError
from fastmimic.deploy.files import LOG, RESULT
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.deploy.summary import summary_rows
from fastmimic.report.html_parts import Figure, Key, Page, Panel, numbers, pairs
from fastmimic.report.html_traces import LIMIT, curve, greatest, layout_of, level

ROBOT: Final = Key("the robot", "var(--after)")
BINS: Final = 60
_SHOWN: Final = 99.9
"""Percentile at which the histograms end; what is beyond is in the last bar."""


def deployment_page(path: Path) -> tuple[Page, tuple[str, ...]]:
    """The page of a deployment's folder, and a sentence for each thing that it lacks.

    Raises:
        ConfigError: its figures cannot be read.
    """
    try:
        about = json.loads((path / RESULT).read_text(encoding="utf-8"))
        result = about["result"]
        title = f"{about['motion']} on {about['robot']}, deployed by driver {about['driver']}"
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path / RESULT}: not the figures of a deployment ({error})") from None
    missing: list[str] = []
    log = None
    try:
        log = DeploymentLog.load(_log_file(path, about))
    except DeploymentError as error:
        missing.append(f"{error}: without the plots")
    page = Page(f"{title}: FastMimic report")
    page.add(f"<h1>{escape(title)}</h1>", f'<p class="lead">{escape(_summary(result))}</p>')
    if missing:
        page.add(f'<div class="notes" id="notes"><ul>{"".join(f"<li>{escape(m)}</li>" for m in missing)}</ul></div>')
    page.section("figures", "In numbers")
    page.add(pairs(dict(summary_rows(result))))
    if log is not None:
        _plots(page, log, result)
    page.section("run", "What was run")
    arguments = {k.replace("_", "-"): v for k, v in about["arguments"].items() if v not in (None, False, "", [])}
    page.add(
        f'<div class="two"><div><h3>Arguments</h3>{pairs(arguments)}<h3 class="next">Versions</h3>'
        f"{pairs(about.get('versions', {}))}</div><div><h3>Safety limits</h3>{pairs(about['limits'])}</div></div>"
    )
    return page, tuple(missing)


def _log_file(path: Path, about: dict[str, Any]) -> Path:
    given = about.get("arguments", {}).get("log")
    return Path(given) if given else path / LOG


def _summary(result: dict[str, Any]) -> str:
    if result["stopped_because"]:
        return f"Stopped while {result['stopped_in']}: {result['stopped_because']}."
    return f"Ended as planned ({result['stopped_by']}), after {result['cycles']:.1f} cycles."


def _plots(page: Page, log: DeploymentLog, result: dict[str, Any]) -> None:
    rows = log.rows
    time = rows["time_s"]
    page.section("base", "The base")
    page.figure(_base(time, rows, log))
    if result["control_us"]["max"]:  # on a virtual clock nothing takes any time
        page.section("times", "Times")
        page.figure(_periods(time, rows, log))
        page.figure(_histograms(rows))
    page.section("limits", "Limits of the robot")
    for figure in _motors(time, rows, log):
        page.figure(figure)


def _base(time: Array, rows: NDArray[Any], log: DeploymentLog) -> Figure:
    following = rows["phase"] == DeploymentPhase.FOLLOW
    height = np.where(following, rows["estimate"]["root_pos"][:, 2], np.nan)
    q = rows["reading"]["quat"]
    tilt = np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0))
    span = float(time[0]), float(time[-1])
    data = [curve(time, height, ROBOT)]
    key = Key("truth", "var(--before)", "2px,5px")
    legend = [ROBOT]
    if log.truth is not None:
        data.insert(0, curve(time, log.truth["root_pos"][:, 2], key))
        legend.append(key)
    panels = [
        Panel("Height", data, layout_of("time (s)", "height of the base (m)", 240, span)),
        Panel("Tilt", [curve(time, tilt, ROBOT, peak=True)], layout_of("time (s)", "tilt (rad)", 240, span)),
    ]
    return Figure(
        "base",
        f"Height and tilt: at most {greatest(tilt):.2f} rad from the vertical",
        "The height is the estimate, which there is while the controller is at work.",
        panels,
        2,
        legend,
    )


def _periods(time: Array, rows: NDArray[Any], log: DeploymentLog) -> Figure:
    error = np.full(len(rows), np.nan)
    error[1:] = 1e6 * np.abs(np.diff(time) - 1.0 / log.rate_hz)
    span = float(time[0]), float(time[-1])
    layout = layout_of("time (s)", f"|period − {1e3 / log.rate_hz:g} ms| (µs)", 240, span)
    layout["yaxis"]["type"] = "log"
    least = 0.1  # µs, for the logarithm
    panels = [
        Panel("Period error", [curve(time, np.fmax(error, least), ROBOT, peak=True)], layout),
        Panel(
            "Age of the state when it was used",
            [curve(time, 1e3 * rows["age_s"], ROBOT, peak=True)],
            layout_of("time (s)", "age (ms)", 240, span),
        ),
    ]
    found = error[1:]
    return Figure(
        "periods",
        f"Periods: 99 % are within {np.percentile(found, 99):.0f} µs, the worst was {greatest(found):.0f} µs off"
        if len(found)
        else "Periods",
        "The greatest value of so many periods that the page stays small.",
        panels,
        2,
    )


def _histograms(rows: NDArray[Any]) -> Figure:
    following = rows[rows["phase"] == DeploymentPhase.FOLLOW]
    panels, said = [], []
    for title, name, values in (
        ("State in hand to command ready", "control", following["control_s"]),
        ("Planning ahead", "planning", following["solve_s"][following["solve_s"] > 0]),
        ("Writing", "writing", rows["write_s"][rows["sent"]]),
        ("State's arrival to command gone", "round trip", rows["round_trip_s"][rows["sent"] & rows["fresh"]]),
    ):
        if not len(values):
            continue
        us = 1e6 * values
        end = float(np.percentile(us, _SHOWN))
        counts, edges = np.histogram(np.minimum(us, end), BINS, (0.0, max(end, 1e-3)))
        middle = 0.5 * (edges[1:] + edges[:-1])
        bars = {
            "type": "bar",
            "x": numbers(middle),
            "y": counts.tolist(),
            "marker": {"color": ROBOT.color},
            "hovertemplate": "%{x:.0f} µs: %{y}",
        }
        label = f"{title} <small>median {np.median(us):.0f} µs, 99 % below {np.percentile(us, 99):.0f} µs</small>"
        panels.append(Panel(label, [bars], layout_of("µs", "periods", 220)))
        said.append(f"{name} {np.median(us):.0f} µs")
    return Figure(
        "histograms",
        f"What takes how long, in the median: {', '.join(said)}",
        f"The last bar holds everything beyond the {_SHOWN:g}th percentile.",
        panels,
        2,
    )


def _motors(time: Array, rows: NDArray[Any], log: DeploymentLog) -> list[Figure]:
    figures = []
    span = float(time[0]), float(time[-1])
    for name, title, unit, values, limit in (
        ("torque", "Motor torque", "N·m", rows["reading"]["torque"], log.meta["torque_limit"]),
        ("speed", "Joint speed", "rad/s", rows["reading"]["joint_vel"], log.meta["joint_speed_limit"]),
    ):
        limits = np.array(limit).reshape(4, 3)
        largest = np.abs(values).reshape(-1, 4, 3).max(axis=1)
        panels, used = [], 0.0
        for j, joint in enumerate(JOINTS_PER_LEG):
            most, peak = float(limits[:, j].min()), greatest(largest[:, j])
            used = max(used, peak / most)
            layout = layout_of("time (s)", f"greatest of four ({unit})", 230, span, (0, 1.08 * max(most, peak)))
            layout["shapes"] = [level(most, LIMIT)]
            panels.append(
                Panel(
                    f"{joint.capitalize()} <small>peak {peak:.1f}, limit {most:g} {unit}</small>",
                    [curve(time, largest[:, j], ROBOT, peak=True)],
                    layout,
                )
            )
        figures.append(
            Figure(
                name,
                f"{title}, as the robot says: at most {100 * used:.0f} % of the limit",
                "The greatest absolute value among the four legs.",
                panels,
                3,
                (ROBOT, LIMIT),
            )
        )
    return figures
