"""The page of a deployment: how it ended, timing, and load on the motors."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError, DeploymentError
from fastmimic.base.files import read_json
from fastmimic.deploy.account import robot_of, summary_rows, with_result
from fastmimic.deploy.log import RESULT, DeploymentLog
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.report import html_page as draw
from fastmimic.report.html_episodes import against_limit
from fastmimic.report.html_page import Figure, HtmlReport, Key, Plot, greatest, numbers, render, time_plot

ROBOT: Final = Key("the robot", "var(--after)")
BINS: Final = 60
_SHOWN: Final = 99.9  # percentile at which the histograms end; the last bar holds the rest


def deployment_page(path: Path) -> HtmlReport:
    """The page of a deployment's folder; raises `FastMimicError`."""
    missing: list[str] = []
    sections: draw.Sections = {"base": [], "times": [], "limits": []}
    try:
        try:
            log = DeploymentLog.load(path)
            if "result" not in log.meta:
                log = with_result(robot_of(log), log)
            about = log.meta
            sections = _sections(log, about["result"])
        except DeploymentError as error:
            if not (path / RESULT).is_file():
                raise
            missing.append(f"{error}: without the plots")
            about = read_json(path / RESULT)
        title = f"{about['motion']} on {about['robot']}, deployed by driver {about['driver']}"
        summary = dict(summary_rows(about["result"]))
        arguments = draw.said_arguments(about.get("arguments", {}))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path}: not the figures and the log of a deployment ({error})") from None
    shown: dict[str, Any] = {"about": about, "summary": summary, "arguments": arguments}
    return render("deployment.html", sections, title=title, missing=missing, **shown)


def _sections(log: DeploymentLog, result: dict[str, Any]) -> draw.Sections:
    rows = log.rows
    time = rows["time_s"]
    span = float(time[0]), float(time[-1])
    timed = bool(result["control_us"]["max"])  # on a virtual clock nothing takes any time
    limits = []
    for name, title, unit, values, limit in (
        ("torque", "Motor torque, as the robot says", "N·m", "torque", "torque_limit"),
        ("speed", "Joint speed, as the robot says", "rad/s", "joint_vel", "joint_speed_limit"),
    ):
        found, most = [(rows["reading"][values], ROBOT)], log.meta[limit]
        limits.append(against_limit(name, title, unit, time, found, most, span, about="as measured"))
    times = [_periods(time, span, log), _histograms(rows)] if timed else []
    return {"base": [_base(time, span, log)], "times": times, "limits": limits}


def _base(time: Array, span: tuple[float, float], log: DeploymentLog) -> Figure:
    rows = log.rows
    following = rows["phase"] == DeploymentPhase.FOLLOW
    height = np.where(following, rows["estimate"]["root_pos"][:, 2], np.nan)
    q = rows["reading"]["quat"]
    tilt = np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0))
    heights = [(height, ROBOT)]
    if log.truth is not None:
        heights.append((log.truth["root_pos"][:, 2], Key("truth", "var(--before)", "2px,5px")))
    plots = [
        time_plot("Height", "height of the base (m)", time, heights, span, height=240),
        time_plot("Tilt", "tilt (rad)", time, [(tilt, ROBOT)], span, height=240, peak=True),
    ]
    title = f"Height and tilt: at most {greatest(tilt):.2f} rad from the vertical"
    return Figure("base", title, plots, 2, [key for _, key in heights])


def _periods(time: Array, span: tuple[float, float], log: DeploymentLog) -> Figure:
    error = np.full(len(time), np.nan)
    error[1:] = 1e6 * np.abs(np.diff(time) - 1.0 / log.rate_hz)
    drawn = [(np.fmax(error, 0.1), ROBOT)]  # at least 0.1 µs, for the logarithm
    unit = f"|period − {1e3 / log.rate_hz:g} ms| (µs)"
    periods = time_plot("Period error", unit, time, drawn, span, height=240, peak=True)
    periods.layout["yaxis"]["type"] = "log"
    ages = [(1e3 * log.rows["age_s"], ROBOT)]
    age = time_plot("Age of the state when it was used", "age (ms)", time, ages, span, height=240, peak=True)
    found = error[1:]
    said = f": 99 % are within {np.percentile(found, 99):.0f} µs, the worst was {greatest(found):.0f} µs off"
    return Figure("periods", f"Periods{said if len(found) else ''}", [periods, age], 2)


def _histograms(rows: Records) -> Figure:
    following = rows[rows["phase"] == DeploymentPhase.FOLLOW]
    plots, said = [], []
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
        look = {"marker": {"color": ROBOT.color}, "hovertemplate": "%{x:.0f} µs: %{y}"}
        bars = {"type": "bar", "x": numbers(middle), "y": counts.tolist(), **look}
        note = f"median {np.median(us):.0f} µs, 99 % below {np.percentile(us, 99):.0f} µs"
        plots.append(Plot(title, [bars], draw.layout_of("µs", "periods", 220), note))
        said.append(f"{name} {np.median(us):.0f} µs")
    title = f"What takes how long, in the median: {', '.join(said)}"
    return Figure("histograms", title, plots, 2, told={"percent": _SHOWN})
