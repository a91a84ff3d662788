"""The page of a deployment: how it ended, timing, and load on the motors."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, DeploymentError
from fastmimic.base.files import read_json
from fastmimic.deploy.log import LOG, RESULT, DeploymentLog
from fastmimic.deploy.scoring import summary_rows
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.report.html_limits import against_limit
from fastmimic.report.html_page import render
from fastmimic.report.html_plots import Figure, Key, Plot, curve, greatest, layout_of, numbers

ROBOT: Final = Key("the robot", "var(--after)")
BINS: Final = 60
_SHOWN: Final = 99.9  # percentile at which the histograms end; the last bar holds the rest


def deployment_page(path: Path) -> tuple[str, tuple[str, ...]]:
    """The page of a deployment's folder, and a sentence for each thing missing in it; raises `ConfigError`."""
    about = read_json(path / RESULT)
    try:
        result = about["result"]
        title = f"{about['motion']} on {about['robot']}, deployed by driver {about['driver']}"
    except (KeyError, TypeError) as error:
        raise ConfigError(f"{path / RESULT}: not the figures of a deployment ({error})") from None
    missing: list[str] = []
    sections: dict[str, list[Figure]] = {"base": [], "times": [], "limits": []}
    try:
        sections = _sections(DeploymentLog.load(_log_file(path, about)), result)
    except DeploymentError as error:
        missing.append(f"{error}: without the plots")
    page = render(
        "deployment.html",
        [figure for found in sections.values() for figure in found],
        title=title,
        lead=_lead(result),
        missing=missing,
        summary=dict(summary_rows(result)),
        sections=sections,
        arguments={k.replace("_", "-"): v for k, v in about["arguments"].items() if v not in (None, False, "", [])},
        versions=about.get("versions", {}),
        limits=about["limits"],
    )
    return page, tuple(missing)


def _log_file(path: Path, about: dict[str, Any]) -> Path:
    given = about.get("arguments", {}).get("log")
    return Path(given) if given else path / LOG


def _lead(result: dict[str, Any]) -> str:
    if result["stopped_because"]:
        return f"Stopped while {result['stopped_in']}: {result['stopped_because']}."
    return f"Ended as planned ({result['stopped_by']}), after {result['cycles']:.1f} cycles."


def _sections(log: DeploymentLog, result: dict[str, Any]) -> dict[str, list[Figure]]:
    rows = log.rows
    time = rows["time_s"]
    timed = bool(result["control_us"]["max"])  # on a virtual clock nothing takes any time
    span = float(time[0]), float(time[-1])
    return {
        "base": [_base(time, rows, log)],
        "times": [_periods(time, rows, log), _histograms(rows)] if timed else [],
        "limits": [
            against_limit((name, f"{title}, as the robot says", unit), [(time, values, ROBOT)], limit, span)
            for name, title, unit, values, limit in (
                ("torque", "Motor torque", "N·m", rows["reading"]["torque"], log.meta["torque_limit"]),
                ("speed", "Joint speed", "rad/s", rows["reading"]["joint_vel"], log.meta["joint_speed_limit"]),
            )
        ],
    }


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
    plots = [
        Plot("Height", data, layout_of("time (s)", "height of the base (m)", 240, span)),
        Plot("Tilt", [curve(time, tilt, ROBOT, peak=True)], layout_of("time (s)", "tilt (rad)", 240, span)),
    ]
    return Figure(
        "base",
        f"Height and tilt: at most {greatest(tilt):.2f} rad from the vertical",
        "The height is the estimate, which there is while the controller is at work.",
        plots,
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
    plots = [
        Plot("Period error", [curve(time, np.fmax(error, least), ROBOT, peak=True)], layout),
        Plot(
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
        plots,
        2,
    )


def _histograms(rows: NDArray[Any]) -> Figure:
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
        bars = {
            "type": "bar",
            "x": numbers(middle),
            "y": counts.tolist(),
            "marker": {"color": ROBOT.color},
            "hovertemplate": "%{x:.0f} µs: %{y}",
        }
        note = f"median {np.median(us):.0f} µs, 99 % below {np.percentile(us, 99):.0f} µs"
        plots.append(Plot(title, [bars], layout_of("µs", "periods", 220), note))
        said.append(f"{name} {np.median(us):.0f} µs")
    return Figure(
        "histograms",
        f"What takes how long, in the median: {', '.join(said)}",
        f"The last bar holds everything beyond the {_SHOWN:g}th percentile.",
        plots,
        2,
    )
