"""`fastmimic deploy`: a motion on a robot."""

import dataclasses
import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import Positional, UseAppendAction, arg

from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.commands.console import EXIT_INTERRUPTED, note, put, slow_start, table
from fastmimic.commands.options import MotionOptions, check_duration, check_writable, policy_controller
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fastmimic.deploy.deployment import Deployment
    from fastmimic.deploy.driver import RobotDriver
    from fastmimic.deploy.emergency_stop import StopSwitch
    from fastmimic.deploy.safety_limits import SafetyLimits
    from fastmimic.deploy.state_machine import StateMachine

EXIT_VIOLATION: Final = 3
"""The robot was damped because something was beyond its limits."""
STAND: Final = "stand"
_SIM_ONLY: Final = ("lock_step", "loss", "latency_ms", "seed", "disturb")


@dataclass(frozen=True, kw_only=True)
class Deploy(MotionOptions):
    """Has a robot stand up, pass into a motion, do it, pass out of it and sit down, at 500 Hz, from its sensors alone.

    In the terminal space, Enter and q stop the robot at once, as SIGINT (Ctrl-C) and SIGTERM do: its joints are damped
    and it sinks down. s has it sit down properly. Read docs/deploy.md before the first time.
    """

    motion: Annotated[Positional[str], arg(metavar="MOTION")]
    """A robot motion (.npz), a clip, a name of 'fastmimic motions', or "stand". A stitched motion is done once."""
    driver: Annotated[str, arg(metavar="go2|a1|sim")]
    """Which robot: one on the wire, or one that is simulated in this process."""
    interface: Annotated[str | None, arg(metavar="NAME")] = None
    """Network interface to a robot on the wire; by default lo, for a simulated one."""
    domain: Annotated[int | None, arg(metavar="N")] = None
    """DDS domain of a Go2; by default 0."""
    cycles: Annotated[int | None, arg(metavar="N")] = None
    """How many cycles."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """How long the motion itself lasts, by default 10; standing up and sitting down come on top."""
    endless: bool = False
    """Until s or a stop."""
    method: Annotated[str | None, arg(metavar="NAME")] = None
    """Whose controller: raibert, mbc, lh; by default that with which the motion was optimised, or mbc."""
    config: Annotated[str | None, arg(metavar="default|robust|paper")] = None
    """The controller's parameters; by default those with which the motion was optimised, or "default"."""
    policy: Annotated[Path | None, arg(metavar="FILE")] = None
    """A trained policy (policy.npz of 'fastmimic train') in place of a method's controller, for the motion itself."""
    solve_rate: Annotated[float | None, arg(metavar="HZ")] = None
    """How often lh plans ahead; by default in every period, 500."""
    limits: Annotated[Path | None, arg(metavar="FILE.toml")] = None
    """Safety limits in place of the default ones."""
    limit: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=VALUE")] = ()
    """One safety limit, such as tilt=0.5; may be given several times. An unknown NAME lists them all."""
    dry_run: bool = False
    """Compute the commands and show them, and send none. Without a robot the states are those of a simulated one."""
    yes: bool = False
    """Begin without asking."""
    real_time: bool = False
    """Ask the system for real-time scheduling and for memory that stays where it is."""
    out: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """By default runs/deploy-MOTION-ROBOT-DRIVER, numbered if taken."""
    log: Annotated[Path | None, arg(metavar="FILE.npz")] = None
    """Where the log goes; by default log.npz in the folder."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    lock_step: bool = False
    """Simulated: as fast as possible, and the same every time, in place of real time."""
    loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Simulated: of the messages that are lost, in either direction."""
    latency_ms: Annotated[float, arg(metavar="MS")] = 0.0
    """Simulated: of every message, in either direction, besides that of the sensors."""
    seed: int = 0
    """Simulated: of the sensors' errors and the wire's faults."""
    disturb: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=VALUE")] = ()
    """Simulated: what is not as the controller expects, such as payload=2 (kg) or friction=0.4, as in 'evaluate'."""

    def run(self) -> int:
        """Does it, writes the folder, prints the figures; returns the exit status."""
        from fastmimic.deploy.drivers import SIM, check_driver
        from fastmimic.deploy.files import MOTION, open_deployment
        from fastmimic.deploy.safety_limits import read_limits

        check_driver(self.driver)
        self._check(SIM)
        robot, motion = self._load()
        limits = read_limits(robot, self.limits, self.limit)
        policy = None if self.policy is None else policy_controller(self.policy, robot, motion)
        folder, log = self._places(robot, motion)
        with open_deployment(folder):
            found = self._deploy(robot, motion, limits, policy)
            found.log.meta["driver"] = self.driver
            found.log.save(log)
        motion.save(folder / MOTION)
        self._write_result(found, folder)
        self._report(found, log)
        return self._status(found)

    def _check(self, sim: str) -> None:
        """Refuses what cannot be before anything takes long."""
        if self.duration is not None:
            check_duration(self.duration)
        if self.driver != sim:
            defaults = {field.name: field.default for field in dataclasses.fields(self)}
            given = [name for name in _SIM_ONLY if getattr(self, name) != defaults[name]]
            if given:
                raise ConfigError(f"--{given[0].replace('_', '-')} is for '--driver sim', not for a robot on the wire")
            if not (self.yes or self.dry_run or sys.stdin.isatty()):
                raise ConfigError(
                    "standard input is not a terminal, so nobody can be asked before the robot moves, or stop it by a"
                    " key; --yes goes on without"
                )
        elif self.interface is not None or self.domain is not None:
            raise ConfigError(f"--interface and --domain are for a robot on the wire, not for '--driver {sim}'")

    def _load(self) -> tuple[Robot, Motion]:
        """The driver's robot, and the motion for it."""
        from fastmimic.commands.options import DEFAULT_ROBOT
        from fastmimic.deploy.drivers import robot_driven
        from fastmimic.reference.standing import standing
        from fastmimic.robot import load_robot
        from fastmimic.runs.loading import find_motion

        source = None if self.motion == STAND else find_motion(self.motion)
        driven, own = robot_driven(self.driver), None if source is None else source.robot
        if driven is not None and own is not None and own != driven:
            raise ConfigError(
                f"motion '{self.motion}' is for robot '{own}', and driver '{self.driver}' drives a {driven}"
            )
        if driven is not None and self.robot is not None and load_robot(self.robot).name != driven:
            raise ConfigError(f"driver '{self.driver}' drives a {driven}, not '{self.robot}'; leave out --robot")
        robot = load_robot(self.robot or driven or own or DEFAULT_ROBOT)
        if source is None:
            if self.overrides():
                raise ConfigError(f"--{next(iter(self.overrides())).replace('_', '-')} cannot be applied to '{STAND}'")
            return robot, standing(robot)
        return robot, source.load(robot, **self.overrides())

    def _places(self, robot: Robot, motion: Motion) -> tuple[Path, Path]:
        """The folder and the log's file."""
        from fastmimic.commands.imitate import RUNS
        from fastmimic.deploy.files import LOG
        from fastmimic.report.run_folder import default_folder

        name = re.sub(r"[^\w.-]+", "-", f"deploy-{motion.name}-{robot.name}-{self.driver}")
        folder = self.out if self.out is not None else default_folder(RUNS, name, resume=False)
        return folder, folder / LOG if self.log is None else check_writable(self.log, ".npz")

    def _deploy(self, robot: Robot, motion: Motion, limits: "SafetyLimits", policy: Any) -> "Deployment":
        from fastmimic.deploy.deployment import deploy
        from fastmimic.deploy.drivers import SIM, make_driver
        from fastmimic.deploy.emergency_stop import StopSwitch
        from fastmimic.deploy.loop_clock import SHORT_SPIN_S, SPIN_S, LoopClock, RealClock, VirtualClock

        clock: LoopClock = VirtualClock() if self.lock_step else RealClock(SHORT_SPIN_S if self.real_time else SPIN_S)
        switch, ask, dry = StopSwitch(), None, self.dry_run
        if self.driver == SIM:
            driver = self._simulated(robot, clock)
        else:
            options = {"interface": self.interface, "domain": self.domain}
            given = {name: value for name, value in options.items() if value is not None}
            driver = make_driver(self.driver, robot, touch=not dry, say=note, **given)
            if dry and not _answers(driver):
                clock = VirtualClock()
                driver, dry = self._simulated(robot, clock), False
            elif not dry and not self.yes:
                ask = switch
        with slow_start() as started:
            return deploy(
                motion,
                robot,
                driver,
                method=self.method,
                config=self.config,
                policy=policy,
                solve_rate_hz=self.solve_rate,
                cycles=self.cycles,
                duration_s=self.duration,
                endless=self.endless,
                limits=limits,
                clock=clock,
                switch=switch,
                dry_run=dry,
                real_time=self.real_time,
                on_ready=None if ask is None else lambda: _agreed(ask),
                watch=_Watch(started),
                note=note,
            )

    def _simulated(self, robot: Robot, clock: Any) -> "RobotDriver":
        from fastmimic.deploy.sim import SimDriver
        from fastmimic.deploy.simulated_link import LinkFaults
        from fastmimic.simulation.conditions import Conditions

        conditions = Conditions(observe="sensors", seed=self.seed, disturbances=self.disturb)  # type: ignore[arg-type]
        link = LinkFaults(latency_s=1e-3 * self.latency_ms, loss=self.loss, seed=self.seed)
        return SimDriver(robot, clock, conditions=conditions, link=link)

    def _write_result(self, found: "Deployment", folder: Path) -> None:
        from fastmimic.deploy.files import RESULT
        from fastmimic.imitation.imitate import versions
        from fastmimic.report.run_folder import write_json

        arguments = {k: str(v) if isinstance(v, Path) else v for k, v in dataclasses.asdict(self).items()}
        about = {k: v for k, v in found.log.meta.items() if k != "result"}
        write_json(folder / RESULT, {"arguments": arguments, **about, "result": found.result, "versions": versions()})

    def _report(self, found: "Deployment", log: Path) -> None:
        from fastmimic.deploy.summary import command_table, summary_lines
        from fastmimic.report.run_folder import finite

        if self.dry_run:
            for line in command_table(found.log):
                (note if self.json else put)(line)
            for line in found.noted:
                note(f"fastmimic: dry run: {line}")
        if self.json:
            put(json.dumps(finite({**found.result, "log": str(log)}), allow_nan=False))
            return
        for line in summary_lines(found.result, table):
            put(line)
        put(f"log in {log}")

    def _status(self, found: "Deployment") -> int:
        from fastmimic.deploy.safety import StopReason

        outcome = found.outcome
        if outcome.stopped_by.planned:
            return 0
        note(f"fastmimic: {outcome.text}; the robot was damped while {outcome.phase.text}")
        return EXIT_INTERRUPTED if outcome.stopped_by in (StopReason.KEY, StopReason.SIGNAL) else EXIT_VIOLATION


def _answers(driver: "RobotDriver") -> bool:
    """Whether there is a robot, which is not touched."""
    try:
        with driver:
            return True
    except DriverError as error:
        note(f"no robot: {error}")
        note("the states are those of a simulated one, which gets the commands")
        return False


def _agreed(switch: "StopSwitch") -> bool:
    note("ready: is there room around the robot, and a hand on its own emergency stop? Enter begins, q calls it off")
    return switch.wait_for_consent()


class _Watch:
    """Says what the robot does, when that changes."""

    def __init__(self, started: Callable[[], None]) -> None:
        self._started, self._last = started, ""

    def __call__(self, machine: "StateMachine", command: "NDArray[Any]") -> None:
        if machine.doing is not self._last:
            self._started()
            self._last = machine.doing
            note(self._last)
