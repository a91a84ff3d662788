"""A deployment's figures and commands in words; those of a log that was cut off."""

from typing import Any, Final

import numpy as np

from fastmimic.base.conventions import JOINT_NAMES, LEGS
from fastmimic.base.errors import ConfigError
from fastmimic.base.files import packaged
from fastmimic.base.text import NONE, number
from fastmimic.deploy.deployment import result_of
from fastmimic.deploy.driver import Packets
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.realtime_loop import LoopOutcome
from fastmimic.deploy.safety import StopReason
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot

CUT_OFF: Final = "the program was killed, or its computer lost power, or the disk was full"

_TIMES: Final = packaged("fastmimic.deploy", "times.json", dict[str, str])


def robot_of(log: DeploymentLog, given: str | None = None) -> Robot:
    """The robot of a log, or another description of it by name or MJCF file; raises `FastMimicError`."""
    name = log.facts.robot
    chosen = given or log.facts.arguments.get("robot") or name
    if chosen == name and name not in ROBOT_NAMES:
        raise ConfigError(f"the log's robot '{name}' is not built in; give its MJCF by --robot FILE.xml")
    return load_robot(chosen)


def with_result(robot: Robot, log: DeploymentLog) -> DeploymentLog:
    """A log with a result: of one that was cut off, what its rows tell."""
    if log.facts.result:
        return log
    last = log.rows[-1]
    counts = (int(last[name]) for name in ("received", "lost", "rejected", "foreign"))
    packets = Packets(int(log.rows["sent"].sum()), *counts)
    phase = list(DeploymentPhase)[last["phase"]]
    outcome = LoopOutcome(StopReason.UNKNOWN, CUT_OFF, phase, int(last["missed"]), int(last["skipped"]), packets)
    result = result_of(robot, log, log.facts.controller, outcome, len(log.rows))
    result["log_ends"] = f"at {last['time_s']:.1f} s: {CUT_OFF}"
    return log.with_result(result)


def summary_rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values of a deployment's figures; without times if it ran on a virtual clock."""
    r, packets = result, result["packets"]
    way = f"{r['motion_s']:.1f} s, {r['way_m']:.1f} m"
    why = f": {r['stopped_because']}" if r["stopped_because"] else ""
    rows = [("stopped by", r["stopped_by"] + why), ("fell", "yes" if r["fell"] else "no")]
    if "response_ms" in r:
        errors = f"{number(r['velocity_error_m_s'], 3)} m/s, {number(r['yaw_rate_error_rad_s'], 3)} rad/s"
        rows += [("steered", way), ("velocity error, median", errors)]
        rows.append(("response, median", f"{number(r['response_ms'], 0)} ms"))
    else:
        rows.append(("in motion", f"{number(r['cycles'], 1)} cycles, {way}"))
        rows.append(("reward, estimated", number(r["reward_mean"], 3)))
    if r["reward_truth_mean"] is not None:
        rows.append(("reward, ground truth", number(r["reward_truth_mean"], 3)))
    if r["swing_clearance_m"] is not None:
        heights = zip(LEGS, r["swing_clearance_m"], strict=True)
        rows.append(("swing clearance, mm", ", ".join(f"{leg} {number(c, 0, 1e3)}" for leg, c in heights)))
    if "foot_sensors" in r:  # not of a log that was cut off
        rows.append(("contact by", _contact_by(r["foot_force"], r["foot_sensors"])))
    missed = f"{r['deadline_misses']} late, {r['periods_skipped']} skipped"
    rows.append(("periods", f"{r['periods']} at {r['rate_hz']:g} Hz, {missed}"))
    for name, title in _TIMES.items() if r["control_us"]["max"] else ():
        if name != "solve_us" or r[name]["median"] is not None:
            rows.append((title, _spread(r[name])))
    cut = r["commands_cut"]
    rows.append(("commands cut to the limits", f"{cut}, no fault: what is beyond is not sent" if cut else "none"))
    if r.get("log_ends"):
        rows.append(("log", f"ends {r['log_ends']}"))
    rows.append(("packets", ", ".join(f"{packets[name]} {name}" for name in ("sent", "received", "lost", "rejected"))))
    return rows


def _contact_by(foot_force: str, used: list[str]) -> str:
    """What told the robot of its contacts, in words."""
    if foot_force != "auto":
        return "joint torques" if foot_force == "off" else "foot sensors"
    unused = ", ".join(leg for leg in LEGS if leg not in used)
    said = f"joint torques, and foot sensors {', '.join(used)}" if used else "joint torques"
    return said + (f"; foot sensors {unused} were not found right" if unused else "")


def command_table(log: DeploymentLog) -> list[str]:
    """The commands of each phase as a table, to check before a deployment."""
    rows = log.rows
    lines = []
    for phase in DeploymentPhase:
        part = rows[rows["phase"] == phase]
        if not len(part) or phase in (DeploymentPhase.DONE, DeploymentPhase.DAMP):
            continue
        command, reading = part["command"], part["reading"]
        lines.append(f"{phase.text}, {len(part) / log.rate_hz:.1f} s")
        lines.append("              angle, rad        is at   speed   stiffness  damping   torque, N·m")
        torque = log.facts.torque_limit
        for j, name in enumerate(JOINT_NAMES):
            q = command["joint_pos"][:, j]
            most = float(np.abs(command["torque"][:, j]).max())
            lines.append(
                f"  {name:12}{q.min():+6.2f} … {q.max():+5.2f}  {reading['joint_pos'][-1, j]:+7.2f}"
                f"  {np.abs(command['joint_vel'][:, j]).max():6.1f}  {command['stiffness'][:, j].max():9.0f}"
                f"  {command['damping'][:, j].max():8.1f}   {most:5.1f} of {torque[j]:.1f}"
            )
    return lines


def _spread(found: dict[str, float | None]) -> str:
    if found["median"] is None:
        return NONE
    return f"median {found['median']:.0f}, 99 % below {found['p99']:.0f}, at most {found['max']:.0f}"
