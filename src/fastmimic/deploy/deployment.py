"""Deploying a motion: what `fastmimic deploy` does, for Python."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.computer import LoopClock, StopSwitch, undisturbed
from fastmimic.deploy.driver import RobotDriver
from fastmimic.deploy.log import DeploymentLog, Recorder
from fastmimic.deploy.realtime_loop import Loop, LoopOutcome
from fastmimic.deploy.safety import Guard, SafetyLimits, StopReason
from fastmimic.deploy.scoring import result_of
from fastmimic.deploy.sequence import MotionSequence, make_sequence
from fastmimic.deploy.state_machine import StateMachine
from fastmimic.episode.loop import MakeController
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.imitation.methods import check_controller, controller_for
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

DEFAULT_S: Final = 10.0
_MARGIN_S: Final = 30.0  # more than standing up, sitting down and damping take


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
    real_time: bool = False  # whether to request real-time scheduling and locked memory
    logged_s: float = 330.0  # longest time in the log; of a longer run the last part

    def controller(self, motion: Motion) -> tuple[str, ControllerConfig]:
        """The method's name and the controller's parameters; raises `ConfigError` for a bad name, policy or rate."""
        learned = self.policy is not None
        method, config = controller_for(motion, "rl" if learned and self.method is None else self.method, self.config)
        check_controller(method, learned)
        if config.recovery.enabled and config.recovery.phase_rate != 1.0:
            raise ConfigError(
                f"recovery.phase_rate is {config.recovery.phase_rate:g}; a deployment needs 1: its reference keeps pace"
            )
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
        if self.duration_s is not None and not (math.isfinite(self.duration_s) and self.duration_s > 0):
            raise ConfigError(f"the duration must be positive, found {self.duration_s}")
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
        found: dict[str, Any] = self.log.meta["result"]
        return found


def deploy(
    motion: Motion,
    robot: Robot,
    driver: RobotDriver,
    options: DeployOptions | None = None,
    *,
    sequence: MotionSequence | None = None,
    clock: LoopClock | None = None,
    switch: StopSwitch | None = None,
    on_ready: Callable[[], bool] | None = None,
    watch: Callable[[StateMachine, NDArray[Any]], None] | None = None,
    note: Callable[[str], None] = lambda line: None,
) -> Deployment:
    """Makes a robot stand up, run a motion, and sit down.

    Args:
        motion: a cyclic motion, or a stitched one, which runs once.
        driver: not yet open; it is closed at the end.
        sequence: of this motion and controller, if already made.
        clock: the computer's if None. A simulated robot must have the same.
        switch: the operator's stop; keys and signals if None.
        on_ready: called when states arrive, before the first command; False cancels.
        watch: called after each period with the state machine and its command.
        note: takes lines for the operator.

    Raises:
        ConfigError: arguments that contradict each other.
        MotionError: a motion that the robot cannot begin or end.
        DriverError: no robot, or one that is not fit to begin. Nothing was sent then.
    """
    options = options if options is not None else DeployOptions()
    method, config = options.controller(motion)
    motion = motion if options.policy is None else motion.target
    steps, reason, seconds = options.ending(motion)
    limits = options.limits if options.limits is not None else SafetyLimits.of(robot)
    rate_hz = config.rate_hz
    guard = Guard(robot, limits, rate_hz, dry=options.dry_run)
    sequence = sequence if sequence is not None else make_sequence(robot, motion, config)
    machine = StateMachine(robot, sequence, guard, config, estimator=options.estimator, policy=options.policy)
    around = sequence.blend_in.last + sequence.blend_out.last + sequence.motion.n_samples
    recorder = Recorder(round(min(around / rate_hz + _MARGIN_S + seconds, options.logged_s) * rate_hz))
    clock = clock if clock is not None else LoopClock(options.real_time)
    with driver, undisturbed(real_time=options.real_time) as refused:
        for line in refused:
            note(line)
        with switch if switch is not None else StopSwitch() as hand:
            loop = Loop(driver, machine, recorder, clock, steps, reason, hand, options.dry_run, watch)
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
        "dry_run": options.dry_run,
    }
    log = DeploymentLog(recorder.rows(), motion, meta)
    truth = getattr(driver, "truth", None)  # a simulated robot's, by the number of the message
    if truth is not None:
        log = dataclasses.replace(log, truth=truth[log.rows["sequence"]])
    if lost := recorder.periods - len(log.rows):
        kept_s = len(log.rows) / rate_hz
        note(f"the first {lost / rate_hz:.0f} s are not in the log, which holds the last {kept_s:.0f} s")
    meta["result"] = result_of(robot, log, config, outcome, recorder.periods)
    return Deployment(outcome, log, tuple(found.text for found in guard.noted.values()))
