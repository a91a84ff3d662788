"""`fastmimic deploy`: runs a motion on a robot."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import OmitArgPrefixes, Positional

from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.base.files import write_json
from fastmimic.base.machine import versions
from fastmimic.commands import options as opt
from fastmimic.commands.console import EXIT_INTERRUPTED, note, put, put_json, put_table, slow_start
from fastmimic.deploy.computer import LoopClock, StopSwitch, VirtualClock
from fastmimic.deploy.driver import DRIVERS, SIM, WIRED, check_driver, make_driver
from fastmimic.deploy.log import LOG, RESULT, open_deployment
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.runs.work_folder import MOTION, default_folder

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fastmimic.deploy.deployment import Deployment
    from fastmimic.deploy.driver import RobotDriver
    from fastmimic.deploy.safety import SafetyLimits
    from fastmimic.deploy.state_machine import StateMachine

EXIT_VIOLATION: Final = 3
"""Exit status: a safety limit was exceeded and the joints were damped."""
STAND: Final = "stand"


@dataclass(frozen=True, kw_only=True)
class SimulatedRobotOptions:
    """For '--driver sim' only."""

    lock_step: opt.Flag = False
    """Run as fast as possible and deterministically instead of in real time."""
    loss: Annotated[float, opt.option("SHARE")] = 0.0
    """Share of the messages that are lost, in either direction."""
    latency_ms: Annotated[float, opt.option("MS")] = 0.0
    """Latency of each message, in either direction, in addition to the sensors'."""
    seed: int = 0
    """Seed of the sensor noise and the message losses."""
    disturb: opt.Disturbances = ()


@dataclass(frozen=True, kw_only=True)
class Deploy:
    """Stands up, blends into the motion, runs it, blends out and sits down, at 500 Hz, using onboard sensors only.

    In the terminal, space, Enter and q stop the robot at once, as SIGINT (Ctrl-C) and SIGTERM do: its joints are damped
    and it sinks down. s makes it sit down. Read docs/deploy.md before the first time.
    """

    motion: Annotated[Positional[str], opt.option("MOTION")]
    """A robot motion (.npz), the folder of a run, a clip, a name from 'fastmimic motions', or "stand". A stitched
    motion runs once."""
    driver: Annotated[str, opt.option("NAME", lambda: f"Robot: {', '.join(DRIVERS)} (simulated).")]
    interface: Annotated[str | None, opt.option("NAME")] = None
    """Network interface of the robot. Default: lo, for a simulated one."""
    domain: Annotated[int | None, opt.option("N")] = None
    """DDS domain of a Go2. Default: 0."""
    cycles: Annotated[int | None, opt.option("N")] = None
    """Number of cycles."""
    duration: opt.Seconds = None
    """Duration of the motion without standing up and sitting down. Default: 10 s."""
    endless: opt.Flag = False
    """Run until s or a stop."""
    robot: opt.RobotChoice = None
    method: opt.FoundMethod = None
    config: opt.FoundConfig = None
    policy: opt.PolicyFile = None
    solve_rate: Annotated[float | None, opt.option("HZ")] = None
    """Rate at which lh plans. Default: each control period, 500 Hz."""
    limits: Annotated[Path | None, opt.option("FILE.toml")] = None
    """Safety limits. Default: the robot's."""
    limit: Annotated[opt.Several, opt.option("NAME=VALUE ...")] = ()
    """Safety limits, e.g. tilt=0.5. An unknown NAME lists them all."""
    dry_run: opt.Flag = False
    """Compute and show the commands without sending them. Without a robot, the states are simulated."""
    yes: opt.Flag = False
    """Start without confirmation."""
    real_time: opt.Flag = False
    """Request real-time scheduling and locked memory from the system."""
    out: Annotated[Path | None, opt.option("FOLDER")] = None
    """Folder of the results. Default: runs/deploy-MOTION-ROBOT-DRIVER, numbered if it exists."""
    log: Annotated[Path | None, opt.option("FILE.npz")] = None
    """File of the log. Default: log.npz in the folder."""
    json: opt.JsonFlag = False
    simulated: Annotated[SimulatedRobotOptions, OmitArgPrefixes]
    clip: opt.ClipReading

    def run(self) -> int:
        from fastmimic.deploy.safety import read_limits

        check_driver(self.driver)
        self._check()
        robot, motion = self._load()
        limits = read_limits(robot, self.limits, opt.joined(self.limit))
        policy = None if self.policy is None else opt.policy_controller(self.policy, robot, motion)
        name = opt.folder_name("deploy", motion.name, robot.name, self.driver)
        folder = self.out if self.out is not None else default_folder(opt.RUNS, name, resume=False)
        log = folder / LOG if self.log is None else opt.check_writable(self.log, ".npz")
        with open_deployment(folder):
            found = self._deploy(robot, motion, limits, policy)
            found.log.meta["driver"] = self.driver
            found.log.save(log)
        motion.save(folder / MOTION)
        about = {key: value for key, value in found.log.meta.items() if key != "result"}
        about = {"arguments": opt.recorded(self), **about, "result": found.result, "versions": versions()}
        write_json(folder / RESULT, about)
        self._report(found, log)
        return self._status(found)

    def _check(self) -> None:
        """Raises `ConfigError` for options that do not fit the driver, before any long work."""
        opt.check_duration(self.duration)
        if self.driver != SIM:
            for name in opt.given(self.simulated):
                raise ConfigError(f"{name} is for '--driver sim', not for a robot on the wire")
            if not (self.yes or self.dry_run or sys.stdin.isatty()):
                raise ConfigError(
                    "standard input is not a terminal, so nobody can confirm the start or stop the robot by a key;"
                    " --yes starts without"
                )
        elif self.interface is not None or self.domain is not None:
            raise ConfigError(f"--interface and --domain are for a robot on the wire, not for '--driver {SIM}'")

    def _load(self) -> tuple[Robot, Motion]:
        """The driver's robot, and the motion for it."""
        from fastmimic.reference.standing import standing

        source = None if self.motion == STAND else find_motion(self.motion)
        driven = self.driver if self.driver in WIRED else None
        own = None if source is None else source.robot
        if driven is not None and own is not None and own != driven:
            raise ConfigError(
                f"motion '{self.motion}' is for robot '{own}', and driver '{self.driver}' drives a {driven}"
            )
        if driven is not None and self.robot is not None and load_robot(self.robot).name != driven:
            raise ConfigError(f"driver '{self.driver}' drives a {driven}, not '{self.robot}'; leave out --robot")
        robot = load_robot(self.robot or driven or own or opt.DEFAULT_ROBOT)
        if source is None:
            for name in opt.given(self.clip):
                raise ConfigError(f"{name} cannot be applied to '{STAND}'")
            return robot, standing(robot)
        return robot, source.load(robot, **self.clip.overrides())

    def _deploy(self, robot: Robot, motion: Motion, limits: "SafetyLimits", policy: Any) -> "Deployment":
        from fastmimic.deploy.deployment import DeployOptions, deploy

        clock: LoopClock = VirtualClock() if self.simulated.lock_step else LoopClock(self.real_time)
        switch, ask, dry = StopSwitch(), None, self.dry_run
        if self.driver == SIM:
            driver = self._simulated(robot, clock)
        else:
            named = {"interface": self.interface, "domain": self.domain}
            given = {name: value for name, value in named.items() if value is not None}
            driver = make_driver(self.driver, robot, release=not dry, say=note, **given)
            if dry and not _answers(driver):
                clock = VirtualClock()
                driver, dry = self._simulated(robot, clock), False
            elif not dry and not self.yes:
                ask = switch
        options = DeployOptions(
            method=self.method,
            config=self.config,
            policy=policy,
            solve_rate_hz=self.solve_rate,
            cycles=self.cycles,
            duration_s=self.duration,
            endless=self.endless,
            limits=limits,
            dry_run=dry,
            real_time=self.real_time,
        )
        with slow_start() as started:
            ready = None if ask is None else lambda: _agreed(ask)
            watch = _Watch(started)
            return deploy(
                motion, robot, driver, options, clock=clock, switch=switch, on_ready=ready, watch=watch, note=note
            )

    def _simulated(self, robot: Robot, clock: Any) -> "RobotDriver":
        from fastmimic.deploy.sim import LinkFaults, SimDriver
        from fastmimic.simulation.conditions import Conditions

        given = self.simulated
        disturbances: Any = opt.joined(given.disturb)
        conditions = Conditions(observe="sensors", seed=given.seed, disturbances=disturbances)
        faults = LinkFaults(latency_s=1e-3 * given.latency_ms, loss=given.loss, seed=given.seed)
        return SimDriver(robot, clock, conditions=conditions, faults=faults)

    def _report(self, found: "Deployment", log: Path) -> None:
        from fastmimic.deploy.scoring import command_table, summary_rows

        if self.dry_run:
            for line in command_table(found.log):
                (note if self.json else put)(line)
            for line in found.noted:
                note(f"fastmimic: dry run: {line}")
        if self.json:
            put_json({**found.result, "log": str(log)})
            return
        put_table(summary_rows(found.result))
        put(f"log in {log}")

    def _status(self, found: "Deployment") -> int:
        from fastmimic.deploy.safety import StopReason

        outcome = found.outcome
        if outcome.stopped_by.planned:
            return 0
        note(f"fastmimic: {outcome.text}; the robot was damped while {outcome.phase.text}")
        return EXIT_INTERRUPTED if outcome.stopped_by in (StopReason.KEY, StopReason.SIGNAL) else EXIT_VIOLATION


def _answers(driver: "RobotDriver") -> bool:
    """Whether a robot answers; it is not moved."""
    try:
        with driver:
            return True
    except DriverError as error:
        note(f"no robot: {error}")
        note("a simulated robot takes its place")
        return False


def _agreed(switch: StopSwitch) -> bool:
    note("ready: is the space around the robot free, and a hand on its emergency stop? Enter starts, q cancels")
    return switch.wait_for_consent()


class _Watch:
    """Prints what the robot does, whenever that changes."""

    def __init__(self, started: Callable[[], None]) -> None:
        self._started, self._last = started, ""

    def __call__(self, machine: "StateMachine", command: "NDArray[Any]") -> None:
        if machine.doing is not self._last:
            self._started()
            self._last = machine.doing
            note(self._last)
