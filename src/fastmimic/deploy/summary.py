"""The summary of a deployment in words."""

from typing import Any

import numpy as np

from fastmimic.base.conventions import JOINT_NAMES, LEGS
from fastmimic.base.text import NONE, number
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.state_machine import DeploymentPhase


def summary_rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values of a deployment's figures."""
    r = result
    rows = [
        ("stopped by", r["stopped_by"] + (f": {r['stopped_because']}" if r["stopped_because"] else "")),
        ("fell", "yes" if r["fell"] else "no"),
        ("cycles", f"{r['cycles']:.1f}, {r['motion_s']:.1f} s"),
        ("reward, estimated", number(r["reward_mean"], 3)),
    ]
    if r["reward_truth_mean"] is not None:
        rows.append(("reward, ground truth", number(r["reward_truth_mean"], 3)))
    if r["swing_clearance_m"] is not None:
        heights = zip(LEGS, r["swing_clearance_m"], strict=True)
        rows.append(("swing clearance, mm", ", ".join(f"{leg} {number(c, 0, 1e3)}" for leg, c in heights)))
    packets = r["packets"]
    rows += [
        (
            "periods",
            f"{r['periods']} at {r['rate_hz']:g} Hz, {r['deadline_misses']} late, {r['periods_skipped']} skipped",
        ),
        *(_times(r) if r["control_us"]["max"] else []),
        ("commands cut to the limits", str(r["commands_cut"])),
        (
            "packets",
            f"{packets['sent']} sent, {packets['received']} received, {packets['lost']} lost,"
            f" {packets['rejected']} rejected",
        ),
    ]
    return rows


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
        torque = np.array(log.meta["torque_limit"])
        for j, name in enumerate(JOINT_NAMES):
            q = command["joint_pos"][:, j]
            most = float(np.abs(command["torque"][:, j]).max())
            lines.append(
                f"  {name:12}{q.min():+6.2f} … {q.max():+5.2f}  {reading['joint_pos'][-1, j]:+7.2f}"
                f"  {np.abs(command['joint_vel'][:, j]).max():6.1f}  {command['stiffness'][:, j].max():9.0f}"
                f"  {command['damping'][:, j].max():8.1f}   {most:5.1f} of {torque[j]:.1f}"
            )
    return lines


def _times(r: dict[str, Any]) -> list[tuple[str, str]]:
    """The times measured; none on a virtual clock."""
    return [
        ("period error, µs", _spread(r["period_error_us"])),
        ("control, µs", _spread(r["control_us"])),
        *([("  planning ahead, µs", _spread(r["solve_us"]))] if r["solve_us"]["median"] is not None else []),
        ("reading, µs", _spread(r["read_us"])),
        ("writing, µs", _spread(r["write_us"])),
        ("state received to command sent, µs", _spread(r["round_trip_us"])),
    ]


def _spread(found: dict[str, float | None]) -> str:
    if found["median"] is None:
        return NONE
    return f"median {found['median']:.0f}, 99 % below {found['p99']:.0f}, at most {found['max']:.0f}"
