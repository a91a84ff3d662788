"""The figures of a deployment, from its log: the motion's reward, timing, and their summary in words."""

from dataclasses import asdict
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.conventions import JOINT_NAMES, LEGS
from fastmimic.base.errors import DeploymentError
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.base.text import NONE, number
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.realtime_loop import LoopOutcome
from fastmimic.deploy.safety import StopReason
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.reward import Scorer
from fastmimic.episode.rollout import Rollout, summarised
from fastmimic.imitation.evaluate import Evaluation
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.state import MEMORY
from fastmimic.simulation.conditions import Conditions

_SCORED: Final = "reward_mean", "components", "swing_clearance_m"
_COUNTED: Final = "drift_m_per_s", "early_contacts_per_s", "stance_slip_m"
_TIMES: Final = {
    "period_error_us": "period error, µs",
    "control_us": "control, µs",
    "solve_us": "  planning ahead, µs",
    "read_us": "reading, µs",
    "write_us": "writing, µs",
    "round_trip_us": "state received to command sent, µs",
}


def score_log(
    robot: Robot, log: DeploymentLog, config: ControllerConfig, observation: NDArray[Any] | None = None
) -> Rollout | None:
    """Scores the periods in the motion itself against its demonstration, as one episode; None if there are none.
    `config` is the controller's, `observation` (t,) of `OBSERVATION` the state in each row of the log, the estimate if
    None. The reference starts as the controller's did and is then synchronised to these states."""
    motion, rows = log.motion, np.flatnonzero(log.rows["in_motion"])
    if not len(rows):
        return None
    seen = log.rows["estimate"] if observation is None else observation
    if len(seen) != len(log.rows):
        raise DeploymentError(f"{len(seen)} states for the {len(log.rows)} periods of the log")
    seen = np.ascontiguousarray(seen[rows])
    counts = log.rows[rows]
    clock = _first_clock(motion, counts[0], seen[0])
    table = reference_table(motion.target, robot)
    scorer, memory = Scorer(robot, table, 1, config, log.rate_hz), np.zeros(1, MEMORY)
    before = counts[0]
    for i in range(len(rows)):
        if i > 0:
            # periods that are not there were left out of the reference as well
            advance_clocks(clock, table[None], seen["root_pos"][i : i + 1])
        memory["early_touchdowns"] = counts["early_touchdowns"][i] - before["early_touchdowns"]
        memory["qp_failures"] = counts["qp_failures"][i] - before["qp_failures"]
        scorer.score(clock, seen[i : i + 1], memory)
    return summarised(scorer.counted(), len(rows), log.rate_hz)


def evaluation_of(robot: Robot, log: DeploymentLog, config: ControllerConfig) -> Evaluation:
    """The `fastmimic.evaluate` result of a deployment, by the true states if known, else by the estimate. Raises
    `DeploymentError` if the robot did not reach the motion."""
    rollout = score_log(robot, log, config, log.truth)
    if rollout is None:
        raise DeploymentError(f"the robot never came to the motion: {log.meta['result']['stopped_because']}")
    conditions = Conditions(observe="sensors")
    return Evaluation(log.motion, rollout, str(log.meta["method"]), config, robot.name, conditions)


def figures(rollout: Rollout | None) -> dict[str, Any]:
    """An episode's figures, JSON-serialisable; each None without an episode."""
    if rollout is None:
        return {"reward_mean": None, "components": None, "swing_clearance_m": None, "motion_s": 0.0}
    found = Metrics.of(rollout).as_dict()
    return {name: found[name] for name in (*_SCORED, *_COUNTED)} | {"motion_s": rollout.duration_s}


def true_states(log: DeploymentLog, truth: NDArray[Any], sequence: NDArray[np.int64]) -> NDArray[Any]:
    """A simulated robot's true states in the log's rows, (t,) of `OBSERVATION`. `truth` (k,) of `OBSERVATION` belongs
    to the ascending message numbers `sequence` (k,). Raises `DeploymentError` if a message of the log is not among
    them."""
    wanted = log.rows["sequence"]
    at = np.searchsorted(sequence, wanted)
    found = at < len(sequence)
    found[found] = sequence[at[found]] == wanted[found]
    if not found.all():
        raise DeploymentError(
            f"the log has state {wanted[~found][0]}, and there are true ones of {sequence[0]} to {sequence[-1]}:"
            " another run's?"
        )
    return truth[at]


def _first_clock(motion: Motion, row: Any, seen: Any) -> NDArray[Any]:
    """The reference's clock in the first row, moved from the robot's estimated place to the true one."""
    clock = make_clocks(motion, 1)
    clock["sample"] = row["sample"]
    believed = row["estimate"]
    turn = float(yaw_from_quat(seen["root_quat"]) - yaw_from_quat(believed["root_quat"]))
    offset = row["origin"][:2] - believed["root_pos"][:2]
    clock["origin"][0, :2] = seen["root_pos"][:2] + rotate_planar(turn, offset)
    clock["origin"][0, 2] = row["origin"][2] + turn
    return clock


def result_of(
    robot: Robot, log: DeploymentLog, config: ControllerConfig, outcome: LoopOutcome, periods: int
) -> dict[str, Any]:
    """All figures of a deployment of so many `periods`, JSON-serialisable."""
    rows = log.rows
    true = None if log.truth is None else score_log(robot, log, config, log.truth)
    truly = figures(true)
    followed, sent = rows[rows["phase"] == DeploymentPhase.FOLLOW], rows[rows["sent"]]
    undamped = rows["time_s"][rows["phase"] != DeploymentPhase.DAMP]
    times = {
        "period_error_us": np.abs(np.diff(undamped) - 1.0 / log.rate_hz),
        "control_us": followed["control_s"],
        "solve_us": followed["solve_s"][followed["solve_s"] > 0],
        "read_us": rows["read_s"],
        "write_us": sent["write_s"],
        "round_trip_us": sent["round_trip_s"][sent["fresh"]],
    }
    return {
        "fell": outcome.stopped_by in (StopReason.TILT, StopReason.HEIGHT) or bool(true is not None and true.fell[0]),
        "stopped_by": outcome.stopped_by.value,
        "stopped_because": outcome.text or None,
        "stopped_in": outcome.phase.text,
        "periods": periods,
        "rate_hz": log.rate_hz,
        "deadline_misses": outcome.deadline_misses,
        "periods_skipped": outcome.skipped,
        **{name: _microseconds(seconds) for name, seconds in times.items()},
        "packets": asdict(outcome.packets),
        "commands_cut": int((rows["cut"] > 0).sum()),
        "cycles": float(rows["in_motion"].sum() / log.motion.n_samples),
        **figures(score_log(robot, log, config)),
        "reward_truth_mean": truly["reward_mean"],
        "swing_clearance_truth_m": truly["swing_clearance_m"],
    }


def _microseconds(seconds: NDArray[np.float64]) -> dict[str, float | None]:
    """Median, 99th percentile and maximum in µs; None without values."""
    if not len(seconds):
        return {"median": None, "p99": None, "max": None}
    median, p99 = np.percentile(seconds, (50, 99))
    return {"median": float(median * 1e6), "p99": float(p99 * 1e6), "max": float(np.max(seconds) * 1e6)}


def summary_rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values of a deployment's figures; without times if it ran on a virtual clock."""
    r, packets = result, result["packets"]
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
    missed = f"{r['deadline_misses']} late, {r['periods_skipped']} skipped"
    rows.append(("periods", f"{r['periods']} at {r['rate_hz']:g} Hz, {missed}"))
    for name, title in _TIMES.items() if r["control_us"]["max"] else ():
        if name != "solve_us" or r[name]["median"] is not None:
            rows.append((title, _spread(r[name])))
    rows.append(("commands cut to the limits", str(r["commands_cut"])))
    rows.append(("packets", ", ".join(f"{packets[name]} {name}" for name in ("sent", "received", "lost", "rejected"))))
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


def _spread(found: dict[str, float | None]) -> str:
    if found["median"] is None:
        return NONE
    return f"median {found['median']:.0f}, 99 % below {found['p99']:.0f}, at most {found['max']:.0f}"
