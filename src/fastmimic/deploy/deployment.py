"""A deployment from its parts to its result: what `fastmimic deploy` does, for Python."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.driver import RobotDriver
from fastmimic.deploy.emergency_stop import StopSwitch
from fastmimic.deploy.log import LOST_ROWS, DeploymentLog, Recorder
from fastmimic.deploy.loop import EndCondition, Loop, LoopOutcome
from fastmimic.deploy.loop_clock import SHORT_SPIN_S, SPIN_S, LoopClock, RealClock, undisturbed
from fastmimic.deploy.safety import DryRunGuard, Guard, StopReason
from fastmimic.deploy.safety_limits import SafetyLimits
from fastmimic.deploy.scoring import figures, score_log, true_states
from fastmimic.deploy.sequence import MotionSequence, make_sequence
from fastmimic.deploy.state_machine import DeploymentPhase, StateMachine
from fastmimic.episode.loop import MakeController
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.imitation.methods import check_controller, controller_for
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

DEFAULT_S: Final = 10.0
LOGGED_S: Final = 300.0
"""Of a run without an end, and at most."""
_MARGIN_S: Final = 30.0
"""Standing up, sitting down and being damped take less."""
FELL: Final = (StopReason.TILT, StopReason.HEIGHT)


@dataclass(frozen=True, eq=False)
class Deployment:
    """What came of it.

    Attributes:
        outcome: how it ended.
        log: everything.
        noted: in a dry run, what was beyond the limits, a line for each kind.
    """

    outcome: LoopOutcome
    log: DeploymentLog
    noted: tuple[str, ...] = ()

    @property
    def result(self) -> dict[str, Any]:
        """The figures, JSON-serialisable."""
        found: dict[str, Any] = self.log.meta["result"]
        return found


def deployed_config(
    motion: Motion,
    method: str | None,
    config: ControllerConfig | str | None,
    solve_rate_hz: float | None,
    learned: bool,
) -> tuple[str, ControllerConfig]:
    """The method's name and the controller's parameters of a deployment.

    Args:
        motion: what is deployed.
        method, config: as in `fastmimic.imitation.imitate.evaluate`.
        solve_rate_hz: how often a controller that looks ahead plans anew; its own rate, which is that of the loop, if
            None.
        learned: whether there is a policy.

    Raises:
        ConfigError: an unknown name, a policy without use for one, or a rate that does not fit.
    """
    chosen, found = controller_for(motion, "rl" if learned and method is None else method, config)
    check_controller(chosen, learned)
    if found.recovery.enabled and found.recovery.phase_rate != 1.0:
        raise ConfigError(
            f"recovery.phase_rate is {found.recovery.phase_rate:g}; a deployment keeps the reference at its pace: it"
            " must be 1"
        )
    if found.stance.forces == "horizon":
        rate = found.rate_hz if solve_rate_hz is None else solve_rate_hz
        found = dataclasses.replace(found, horizon=dataclasses.replace(found.horizon, solve_rate_hz=rate))
    elif solve_rate_hz is not None:
        raise ConfigError(f"method '{chosen.name}' does not plan ahead; a solve rate is for lh and lh-dmp")
    return chosen.name, found


def deploy(
    motion: Motion,
    robot: Robot,
    driver: RobotDriver,
    *,
    method: str | None = None,
    config: ControllerConfig | str | None = None,
    policy: MakeController | None = None,
    solve_rate_hz: float | None = None,
    estimator: EstimatorConfig | None = None,
    sequence: MotionSequence | None = None,
    cycles: int | None = None,
    duration_s: float | None = None,
    endless: bool = False,
    limits: SafetyLimits | None = None,
    clock: LoopClock | None = None,
    switch: StopSwitch | None = None,
    dry_run: bool = False,
    real_time: bool = False,
    on_ready: Callable[[], bool] | None = None,
    watch: Callable[[StateMachine, NDArray[Any]], None] | None = None,
    note: Callable[[str], None] | None = None,
) -> Deployment:
    """Has a robot stand up, do a motion, and sit down.

    Args:
        motion: a motion that repeats, or a stitched one, which is done once.
        robot: its model.
        driver: not yet open; it is closed in the end.
        method, config, policy: as in `fastmimic.imitation.imitate.evaluate`.
        solve_rate_hz: of planning ahead; at the loop's rate if None.
        estimator: its parameters.
        sequence: of this motion and controller, if it was made before.
        cycles, duration_s, endless: how many cycles, or how long, or until a person ends it; 10 s if none is given.
        limits: of safety; `SafetyLimits.of` the robot if None.
        clock: the computer's if None. A simulated robot has to have the same.
        switch: a person's hand; keys and signals if None.
        dry_run: compute everything and send nothing.
        real_time: ask the system for real-time scheduling and locked memory.
        on_ready: called when all is prepared and there are states, before the first command; False calls it off.
        watch: called after each period with the machine and its command.
        note: takes lines for a person.

    Raises:
        ConfigError: arguments that contradict each other.
        MotionError: a motion that the robot cannot begin or end.
        DriverError: a robot that is not there or not fit to begin. Nothing was sent then.
    """
    method, config = deployed_config(motion, method, config, solve_rate_hz, policy is not None)
    if policy is not None:
        motion = motion.target
    ending, seconds = _ending(motion, cycles, duration_s, endless)
    limits = limits if limits is not None else SafetyLimits.of(robot)
    rate_hz = config.rate_hz
    guard = (DryRunGuard if dry_run else Guard)(robot, limits, rate_hz)
    sequence = sequence if sequence is not None else make_sequence(robot, motion, config)
    machine = StateMachine(robot, sequence, guard, config, estimator=estimator, policy=policy)
    around = sequence.blend_in.last + sequence.blend_out.last + round(_MARGIN_S * rate_hz)
    steps = around + round(seconds * rate_hz) + motion.n_samples if math.isfinite(seconds) else None
    recorder = Recorder(min(steps or round(LOGGED_S * rate_hz), around + round(LOGGED_S * rate_hz)))
    clock = clock if clock is not None else RealClock(SHORT_SPIN_S if real_time else SPIN_S)
    with driver, undisturbed(real_time=real_time) as refused:
        for line in refused:
            _say(note, line)
        with switch if switch is not None else StopSwitch() as hand:
            loop = Loop(
                driver,
                machine,
                guard,
                recorder,
                clock,
                rate_hz,
                ending=ending,
                switch=hand,
                dry=dry_run,
                watch=watch,
            )
            outcome = loop.run(on_ready)
    meta = {
        "rate_hz": rate_hz,
        "robot": robot.name,
        "motion": motion.name,
        "driver": type(driver).__name__,
        "method": method,
        "config": config.as_dict(),
        "latency_s": machine.estimator.config.latency_s,
        "limits": dataclasses.asdict(limits),
        "torque_limit": robot.torque_limit.tolist(),
        "joint_speed_limit": robot.joint_speed_limit.tolist(),
        "dry_run": dry_run,
    }
    log = DeploymentLog(recorder.rows(), motion, meta)
    truth = getattr(driver, "truth", None)  # a simulated robot's
    if truth is not None:
        log = dataclasses.replace(log, truth=true_states(log, truth, np.arange(len(truth))))
    if recorder.periods > len(log.rows):
        _say(note, LOST_ROWS.format((recorder.periods - len(log.rows)) / rate_hz, len(log.rows) / rate_hz))
    meta["result"] = _result(robot, log, config, outcome, recorder.periods)
    noted = tuple(found.text for found in guard.noted.values()) if isinstance(guard, DryRunGuard) else ()
    return Deployment(outcome, log, noted)


def _say(note: Callable[[str], None] | None, line: str) -> None:
    if note is not None:
        note(line)


def _ending(motion: Motion, cycles: int | None, duration_s: float | None, endless: bool) -> tuple[EndCondition, float]:
    """When the motion is left, and after how long at most, s."""
    given = [name for name, value in (("cycles", cycles), ("duration", duration_s), ("endless", endless)) if value]
    if len(given) > 1:
        raise ConfigError(f"{' and '.join(given)} both say when the motion ends; give one of them")
    if cycles is not None and cycles < 1:
        raise ConfigError(f"the cycles must be at least 1, found {cycles}")
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0):
        raise ConfigError(f"the duration must be positive, found {duration_s}")
    if motion.cycle is None:
        if given:
            raise ConfigError(f"motion '{motion.name}' does not repeat: it is done once; leave out {given[0]}")
        return EndCondition(), motion.period_s
    if cycles is not None:
        return EndCondition(cycles=cycles), cycles * motion.period_s
    if endless:
        return EndCondition(), math.inf
    duration_s = DEFAULT_S if duration_s is None else duration_s
    return EndCondition(steps=max(1, round(duration_s * motion.rate_hz))), duration_s


def _result(
    robot: Robot, log: DeploymentLog, config: ControllerConfig, outcome: LoopOutcome, periods: int
) -> dict[str, Any]:
    rows, dt = log.rows, 1.0 / log.rate_hz
    estimated = score_log(robot, log, config)
    true = None if log.truth is None else score_log(robot, log, config, log.truth)
    computed = rows[rows["phase"] == DeploymentPhase.FOLLOW]
    solved = rows["solve_s"][(rows["solve_s"] > 0) & (rows["phase"] == DeploymentPhase.FOLLOW)]
    sent = rows[rows["sent"]]
    undamped = rows[rows["phase"] != DeploymentPhase.DAMP]
    found = {
        "fell": outcome.stopped_by in FELL or bool(true is not None and true.fell[0]),
        "stopped_by": outcome.stopped_by.value,
        "stopped_because": outcome.text or None,
        "stopped_in": outcome.phase.text,
        "periods": periods,
        "rate_hz": log.rate_hz,
        "deadline_misses": outcome.deadline_misses,
        "periods_skipped": outcome.skipped,
        "period_error_us": percentiles(np.abs(np.diff(undamped["time_s"]) - dt), 1e6),
        "control_us": percentiles(computed["control_s"], 1e6),
        "solve_us": percentiles(solved, 1e6),
        "read_us": percentiles(rows["read_s"], 1e6),
        "write_us": percentiles(sent["write_s"], 1e6),
        "round_trip_us": percentiles(sent["round_trip_s"][sent["fresh"]], 1e6),
        "packets": dataclasses.asdict(outcome.packets),
        "commands_cut": int((rows["cut"] > 0).sum()),
        "cycles": float(rows["in_motion"].sum() / log.motion.n_samples),
    }
    found |= figures(estimated)
    found["reward_truth_mean"] = None if true is None else float(true.reward[0])
    found["swing_clearance_truth_m"] = figures(true)["swing_clearance_m"] if true is not None else None
    return found


def percentiles(values: NDArray[np.float64], unit: float) -> dict[str, float | None]:
    """Median, 99th percentile and greatest value, multiplied by `unit`; None without values."""
    if not len(values):
        return {"median": None, "p99": None, "max": None}
    median, p99 = np.percentile(values, (50, 99))
    return {"median": float(median * unit), "p99": float(p99 * unit), "max": float(np.max(values) * unit)}
