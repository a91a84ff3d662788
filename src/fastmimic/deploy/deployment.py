"""Deploying a motion: what `fastmimic deploy` does, for Python, and the figures: reward and timing."""

import dataclasses
import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Indices, Records
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError, LogError, check_positive
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.computer import SHORT_SPIN_S, LoopClock, StopSwitch, VirtualClock, undisturbed
from fastmimic.deploy.driver import RobotDriver
from fastmimic.deploy.log import PERIODS, ROW, TRUTH, DeploymentLog, LogWriter, Recorder, RunFacts, new_log_file
from fastmimic.deploy.realtime_loop import Loop, LoopOutcome
from fastmimic.deploy.safety import Guard, SafetyLimits, StopReason
from fastmimic.deploy.sequence import Follower, make_sequence
from fastmimic.deploy.sim import TIPPED
from fastmimic.deploy.state_machine import DeploymentPhase, StateMachine
from fastmimic.episode.loop import MakeController
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.reward import Scorer, demonstration_in_world
from fastmimic.episode.rollout import Rollout, summarised
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.imitation.evaluate import Evaluation
from fastmimic.imitation.methods import check_controller, controller_for
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.state import MEMORY
from fastmimic.simulation.conditions import Conditions
from fastmimic.steering.commands import CommandErrors

DEFAULT_S: Final = 10.0
_WAY_S: Final = 0.5  # between the places of which the way is the sum
_MARGIN_S: Final = 30.0  # more than standing up, blending in and out, sitting down and damping take
_SCORED: Final = "reward_mean", "components", "swing_clearance_m"
_COUNTED: Final = "drift_m_per_s", "early_contacts_per_s", "stance_slip_m"


@dataclass(frozen=True, kw_only=True)
class DeployOptions:
    """How a motion is deployed. At most one of `cycles`, `duration_s` and `endless` says when it ends; 10 s by default.
    `method`, `config` and `policy` are as in `fastmimic.imitation.evaluate.evaluate`."""

    method: str | None = None
    config: ControllerConfig | str | None = None
    policy: MakeController | None = None
    solve_rate_hz: float | None = None  # of the horizon planner, Hz; the control rate if None
    estimator: EstimatorConfig | None = None
    cycles: int | None = None
    duration_s: float | None = None
    endless: bool = False
    limits: SafetyLimits | None = None  # `SafetyLimits.of` the robot if None
    dry_run: bool = False  # whether commands are computed but not sent
    real_time: bool | None = None  # whether to request real-time scheduling and locked memory; where permitted if None
    logged_s: float = 330.0  # longest time in memory, and in the figures; of a longer run the last part
    log: Path | None = None  # new file to which the log is written while it runs
    driver: str | None = None  # its name for the log; that of its class if None
    arguments: dict[str, Any] = field(default_factory=dict)  # for the log, JSON-serialisable
    versions: dict[str, str] = field(default_factory=dict)  # for the log

    def controller(self, motion: Motion) -> tuple[str, ControllerConfig]:
        """The method's name and the controller's parameters; raises `ConfigError` for a bad name, policy or rate."""
        learned = self.policy is not None
        method, config = controller_for(motion, "rl" if learned and self.method is None else self.method, self.config)
        check_controller(method, learned)
        if config.stance.forces == "horizon":
            rate = config.rate_hz if self.solve_rate_hz is None else self.solve_rate_hz
            config = dataclasses.replace(config, horizon=dataclasses.replace(config.horizon, solve_rate_hz=rate))
        elif self.solve_rate_hz is not None:
            raise ConfigError(f"method '{method.name}' does not plan ahead; a solve rate is for lh and lh-dmp")
        return method.name, config

    def ending(self, motion: Motion) -> tuple[float, StopReason, float]:
        """After how many steps the motion ends, why, and after how long at most, s; raises `ConfigError`."""
        options = {"cycles": self.cycles, "duration": self.duration_s, "endless": self.endless}
        given = [name for name, value in options.items() if value]
        if len(given) > 1:
            raise ConfigError(f"{' and '.join(given)} both say when the motion ends; give one of them")
        if self.cycles is not None and self.cycles < 1:
            raise ConfigError(f"the cycles must be at least 1, found {self.cycles}")
        if self.duration_s is not None:
            check_positive(self.duration_s, "the duration")
        if motion.cycle is None:
            if given:
                raise ConfigError(f"motion '{motion.name}' does not repeat; leave out {given[0]}")
            return math.inf, StopReason.END, motion.period_s
        if self.cycles is not None:
            return self.cycles * motion.n_samples, StopReason.CYCLES, self.cycles * motion.period_s
        if self.endless:
            return math.inf, StopReason.ASKED, math.inf
        duration_s = DEFAULT_S if self.duration_s is None else self.duration_s
        return max(1, round(duration_s * motion.rate_hz)), StopReason.DURATION, duration_s


@dataclass(frozen=True, eq=False)
class Deployment:
    """A finished deployment: how it ended, its log, and in a dry run one line per kind of violation."""

    outcome: LoopOutcome
    log: DeploymentLog
    noted: tuple[str, ...] = ()

    @property
    def result(self) -> dict[str, Any]:
        """The figures, JSON-serialisable."""
        return self.log.facts.result


def deploy(
    motion: Motion,
    robot: Robot,
    driver: RobotDriver,
    options: DeployOptions = DeployOptions(),
    *,
    follower: Follower | None = None,
    clock: LoopClock | None = None,
    switch: StopSwitch | None = None,
    on_ready: Callable[[], bool] | None = None,
    watch: Callable[[StateMachine, Any], None] | None = None,
    note: Callable[[str], None] = lambda line: None,
) -> Deployment:
    """Makes a robot stand up, run a motion, and sit down.

    Args:
        motion: a cyclic motion, or a stitched one, which runs once.
        driver: not yet open; it is closed at the end.
        follower: of this motion and controller, if already made; or of a robot that is steered, which stands before.
        clock: the computer's if None. A simulated robot must have the same.
        switch: the operator's stop; keys and signals if None.
        on_ready: called when states arrive, before the first command; False cancels.
        watch: called after each period with the state machine and the period's record of `ROW`.
        note: takes lines for the operator.

    Raises `ConfigError` for arguments that contradict each other, `MotionError` for a motion that cannot be begun or
    ended; before anything is sent, `OutputError` without room for the log and `DriverError` without a fit robot.
    """
    method, config = options.controller(motion)
    motion = motion if options.policy is None else motion.target
    steps, reason, seconds = options.ending(motion)
    limits = options.limits if options.limits is not None else SafetyLimits.of(robot)
    rate_hz = config.rate_hz
    guard = Guard(robot, limits, rate_hz, dry=options.dry_run)
    follower = follower if follower is not None else Follower(make_sequence(robot, motion, config))
    machine = StateMachine(robot, follower, guard, config, estimator=options.estimator, policy=options.policy)
    planned_s = motion.period_s + _MARGIN_S + seconds
    recorder = Recorder(ROW, round(min(planned_s, options.logged_s) * rate_hz))
    clock = clock if clock is not None else LoopClock()
    asked = options.real_time
    real_time = not isinstance(clock, VirtualClock) if asked is None else asked
    facts = RunFacts(
        rate_hz=rate_hz,
        robot=robot.name,
        motion=motion.name,
        driver=options.driver or type(driver).__name__,
        steered=follower.steered,
        method=method,
        config=config.as_dict(),
        latency_s=machine.estimator.config.latency_s,
        foot_force=machine.estimator.config.foot_force,
        limits=dataclasses.asdict(limits),
        torque_limit=robot.torque_limit.tolist(),
        joint_speed_limit=robot.joint_speed_limit.tolist(),
        dry_run=options.dry_run,
        arguments=options.arguments,
        versions=options.versions,
    )
    truth_at = getattr(driver, "truth_at", None)  # a simulated robot's states, by the number of the message

    def columns(rows: Records) -> dict[str, Records]:
        return {PERIODS: rows} if truth_at is None else {PERIODS: rows, TRUTH: truth_at(rows["sequence"])}

    writer = None
    if options.log is not None:
        planned = round((planned_s if math.isfinite(planned_s) else options.logged_s) * rate_hz)
        file = new_log_file(options.log, motion, facts.as_dict(), planned, with_truth=truth_at is not None)
        writer = LogWriter(recorder, file, columns)
    with writer or nullcontext(), driver, undisturbed(real_time=real_time) as refused:
        for line in refused if asked else ():
            note(line)
        if real_time and not refused:
            clock.spin_s = SHORT_SPIN_S
        with switch if switch is not None else StopSwitch() as hand:
            outcome = Loop(driver, machine, recorder, clock, steps, reason, hand, watch, note).run(on_ready)
    rows = recorder.rows()
    found = DeploymentLog(rows, motion, facts, columns(rows).get(TRUTH))
    if lost := recorder.periods - len(rows):
        note(f"the figures are of the last {len(rows) / rate_hz:.0f} s, without the first {lost / rate_hz:.0f} s")
    result = result_of(robot, found, config, outcome, recorder.periods)
    result["foot_sensors"] = [leg for leg, used in zip(LEGS, machine.estimator.believed[0], strict=True) if used]
    if writer is not None:
        writer.end({"result": result})
        result["log_ends"] = writer.ends
    found = found.with_result(result)
    return Deployment(outcome, found, tuple(noted.text for noted in guard.noted.values()))


@dataclass(frozen=True, eq=False)
class ScoredLog:
    """The score of a deployment, and row by row what it is against."""

    rollout: Rollout
    rows: Indices  # (k,) those of the log that are scored
    sample: Indices  # (k,) of the demonstration
    demonstration: Records  # (k,) of `SAMPLE`, in the world
    terms: Array  # (k, n) the reward's, as in `REWARD_TERMS`


def score_log(
    robot: Robot, log: DeploymentLog, config: ControllerConfig, observation: Records | None = None
) -> ScoredLog | None:
    """Scores the periods in the motion itself against its demonstration, as one episode; None if there are none, or the
    robot was steered. `config` is the controller's, `observation` (t,) of `OBSERVATION` the states in the log's rows,
    the estimates if None. The reference starts as the controller's did and is then synchronised to them."""
    motion, rows = log.motion, np.flatnonzero(log.rows["in_motion"])
    if log.facts.steered or not len(rows):
        return None
    seen = log.rows["estimate"] if observation is None else observation
    if len(seen) != len(log.rows):
        raise LogError(f"{len(seen)} states for the {len(log.rows)} periods of the log")
    seen = np.ascontiguousarray(seen[rows])
    counts = log.rows[rows]
    clock = _first_clock(motion, counts[0], seen[0])
    table = reference_table(motion.target, robot)
    if not ((counts["sample"] >= 0) & (counts["sample"] < len(table)) & (np.abs(counts["haste"]) <= len(table))).all():
        raise LogError("the log is damaged: it has samples that its motion has not")
    scorer, memory = Scorer(robot, table, 1, config, log.rate_hz), np.zeros(1, MEMORY)
    clocks, terms = np.zeros(len(rows), clock.dtype), []
    for i in range(len(rows)):
        if i > 0:
            # periods that are not there were left out of the reference as well
            advance_clocks(clock, table[None], seen["root_pos"][i : i + 1], counts["haste"][i - 1 : i])
        for name in ("early_touchdowns", "qp_failures"):
            memory[name] = counts[name][i] - counts[name][0]
        scorer.score(clock, seen[i : i + 1], memory)
        clocks[i] = clock[0]
        terms.append(scorer.terms[0])
    rollout = summarised(scorer.counted(), len(rows), log.rate_hz)
    demonstration = demonstration_in_world(table, clocks["sample"], clocks["origin"])
    return ScoredLog(rollout, rows, clocks["sample"], demonstration, np.array(terms))


def evaluation_of(robot: Robot, log: DeploymentLog, config: ControllerConfig) -> Evaluation:
    """The `fastmimic.evaluate` result of a deployment, by the true states if known, else by the estimate. Raises
    `LogError` if the robot did not reach the motion."""
    scored = score_log(robot, log, config, log.truth)
    if log.facts.steered:
        raise LogError("the robot was steered: there is no motion to score it against")
    if scored is None:
        raise LogError(f"the robot never came to the motion: {log.facts.result['stopped_because']}")
    conditions = Conditions(observe="sensors")
    return Evaluation(log.motion, scored.rollout, log.facts.method, config, robot.name, conditions)


def figures(scored: ScoredLog | None) -> dict[str, Any]:
    """The figures, JSON-serialisable; each None where nothing is scored."""
    found = {} if scored is None else Metrics.of(scored.rollout).as_dict()
    return {name: found.get(name) for name in (*_SCORED, *_COUNTED)}


def true_states(log: DeploymentLog, truth: Records, sequence: Indices) -> Records:
    """A simulated robot's true states in the log's rows, (t,) of `OBSERVATION`. `truth` (k,) of `OBSERVATION` belongs
    to the messages numbered `sequence` (k,), ascending. Raises `LogError` if the log has another message."""
    wanted = log.rows["sequence"]
    at = np.searchsorted(sequence, wanted)
    found = at < len(sequence)
    found[found] = sequence[at[found]] == wanted[found]
    if not found.all():
        said = f"the log has state {wanted[~found][0]}, and there are true ones of {sequence[0]} to {sequence[-1]}"
        raise LogError(f"{said}: another run's?")
    return truth[at]


def _first_clock(motion: Motion, row: Any, seen: Any) -> Records:
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
    rows, inside = log.rows, log.rows["in_motion"]
    places = (rows["estimate"] if log.truth is None else log.truth)["root_pos"][inside]
    places = np.concatenate([places[:: round(_WAY_S * log.rate_hz)], places[-1:]])
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
    quat = rows["reading"]["quat"] if log.truth is None else log.truth["root_quat"]
    tipped = 1 - 2 * (quat[:, 1] ** 2 + quat[:, 2] ** 2) < TIPPED
    fell = outcome.stopped_by is StopReason.HEIGHT or bool(tipped.any())
    return {
        "fell": fell or bool(true is not None and true.rollout.fell[0]),
        "stopped_by": outcome.stopped_by.value,
        "stopped_because": outcome.text or None,
        "stopped_in": outcome.phase.text,
        "periods": periods,
        "rate_hz": log.rate_hz,
        "deadline_misses": outcome.deadline_misses,
        "periods_skipped": outcome.skipped,
        **{name: _microseconds(seconds) for name, seconds in times.items()},
        "packets": dataclasses.asdict(outcome.packets),
        "commands_cut": int((rows["cut"] > 0).sum()),
        "foot_force": log.facts.foot_force,
        "log_ends": None,
        "cycles": None if log.facts.steered else float(inside.sum() / log.motion.n_samples),
        "motion_s": float(inside.sum() / log.rate_hz),
        "way_m": float(np.hypot(*np.diff(places[:, :2], axis=0).T).sum()),
        **(command_errors(log) if log.facts.steered else {}),
        **figures(score_log(robot, log, config)),
        "reward_truth_mean": truly["reward_mean"],
        "swing_clearance_truth_m": truly["swing_clearance_m"],
    }


def command_errors(log: DeploymentLog) -> dict[str, float | None]:
    """How well a steered robot followed the velocities that it took, by the true states if known, else the estimate."""
    inside, found = log.rows["in_motion"], CommandErrors()
    states = log.rows["estimate"] if log.truth is None else log.truth
    if inside.any():
        found.add(states[inside], log.rows["wanted"][inside], 1.0 / log.rate_hz)
    return found.as_dict()


def _microseconds(seconds: Array) -> dict[str, float | None]:
    """Median, 99th percentile and maximum in µs; None without values."""
    if not len(seconds):
        return {"median": None, "p99": None, "max": None}
    median, p99 = np.percentile(seconds, (50, 99))
    return {"median": float(median * 1e6), "p99": float(p99 * 1e6), "max": float(np.max(seconds) * 1e6)}
