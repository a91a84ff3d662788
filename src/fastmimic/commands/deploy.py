"""`fastmimic deploy` runs a motion on a robot."""

import sys
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from tyro.conf import OmitArgPrefixes, Positional

from fastmimic.base.errors import ConfigError, DriverError, OutputError, unknown
from fastmimic.base.files import write_json
from fastmimic.base.machine import versions
from fastmimic.base.progress import note, slow_start
from fastmimic.commands import options as opt
from fastmimic.commands.console import EXIT_CUT_OFF, EXIT_INTERRUPTED, put, put_json, put_table
from fastmimic.commands.show import is_whole
from fastmimic.deploy.computer import LoopClock, StopSwitch, VirtualClock
from fastmimic.deploy.driver import DRIVERS, SIM, WIRED, RobotDriver, make_driver
from fastmimic.deploy.log import ENDING, LOG, RESULT, open_deployment
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.motion.motion import Motion
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.runs.work_folder import MOTION, default_folder
from fastmimic.simulation.conditions import Conditions

if TYPE_CHECKING:
    from fastmimic.deploy.deployment import Deployment
    from fastmimic.deploy.safety import SafetyLimits
    from fastmimic.deploy.state_machine import StateMachine
    from fastmimic.steering.commands import Commands

EXIT_VIOLATION: Final = 3  # exit status: a safety limit was exceeded and the joints were damped
STAND: Final = "stand"
REAL_TIME: Final = {"auto": None, "on": True, "off": False}


@opt.command
class SimulatedRobotOptions:
    """For '--driver sim' only."""

    lock_step: opt.Flag = False
    loss: Annotated[float, opt.option("SHARE")] = 0.0
    latency_ms: Annotated[float, opt.option("MS")] = 0.0
    seed: int = 0
    disturb: opt.Disturbances = ()


@opt.command
class Deploy:
    """Stands up, blends into the motion, runs it, blends out and sits down, at 500 Hz, using onboard sensors only."""

    motion: Annotated[Positional[str], opt.option("MOTION")]
    driver: Annotated[str, opt.option("NAME", lambda: f"Robot: {', '.join(DRIVERS)} (simulated).")]
    interface: Annotated[str | None, opt.option("NAME")] = None
    domain: Annotated[int | None, opt.option("N")] = None
    cycles: Annotated[int | None, opt.option("N")] = None
    duration: opt.Seconds = None
    endless: opt.Flag = False
    robot: opt.RobotChoice = None
    foot_force: opt.FootForce = "auto"
    method: opt.FoundMethod = None
    config: opt.FoundConfig = None
    policy: opt.PolicyFile = None
    solve_rate: Annotated[float | None, opt.option("HZ")] = None
    limits: Annotated[Path | None, opt.option("FILE.toml")] = None
    limit: Annotated[opt.Several, opt.option("NAME=VALUE ...")] = ()
    dry_run: opt.Flag = False
    yes: opt.Flag = False
    real_time: Annotated[Literal["auto", "on", "off"], opt.option("auto|on|off")] = "auto"
    out: Annotated[Path | None, opt.option("FOLDER")] = None
    log: Annotated[Path | None, opt.option("FILE.mcap")] = None
    publish: opt.Flag = False
    json: opt.JsonFlag = False
    simulated: Annotated[SimulatedRobotOptions, OmitArgPrefixes]
    steered: Annotated[opt.SteeredBy, OmitArgPrefixes]
    clip: opt.ClipReading

    def run(self) -> int:
        from fastmimic.deploy.safety import read_limits

        self._check()
        robot, motion = self._load()
        limits = read_limits(robot, self.limits, opt.joined(self.limit))
        policy = None if self.policy is None else opt.policy_controller(self.policy, robot, motion)
        name = opt.folder_name("deploy", motion.name, robot.name, self.driver)
        folder = self.out if self.out is not None else default_folder(opt.RUNS, name, resume=False)
        log = folder / LOG if self.log is None else opt.check_writable(self.log, ENDING)
        with self.steered.opened(self.interface, self.domain) as commands, open_deployment(folder):
            found = self._deploy(robot, motion, limits, policy, log, commands)
        written = self._write(found, motion, folder)
        self._report(found, log)
        return self._status(found, written)

    def _write(self, found: "Deployment", motion: Motion, folder: Path) -> bool:
        """Writes motion and figures; returns whether they and the whole log are on the disk, and says so if not."""
        whole = is_whole(found.result["log_ends"])
        try:
            motion.save(folder / MOTION)
            write_json(folder / RESULT, found.log.facts.as_dict())
        except OutputError as error:
            note(f"fastmimic: {error}")
            return False
        return whole

    def _check(self) -> None:
        """Raises `ConfigError` for options that do not fit the driver, before any long work."""
        if self.driver not in DRIVERS:
            raise unknown("driver", self.driver, DRIVERS)
        opt.check_duration(self.duration)
        self.steered.check(self.motion == opt.STEER, others_steer=False)
        if self.driver != SIM:
            for name in opt.given(self.simulated):
                raise ConfigError(f"{name} is for '--driver sim', not for a robot on the wire")
            if not (self.yes or self.dry_run or sys.stdin.isatty()):
                said = "standard input is not a terminal, so nobody can confirm the start or stop the robot by a key"
                raise ConfigError(f"{said}; --yes starts without")
        elif opt.given(self, "interface", "domain") and not (self.publish or self.steered.topic):
            raise ConfigError(f"--interface and --domain are for a robot on the wire, not for '--driver {SIM}'")

    def _load(self) -> tuple[Robot, Motion]:
        from fastmimic.reference.standing import standing

        source = None if self.motion in (STAND, opt.STEER) else find_motion(self.motion)
        driven = self.driver if self.driver in WIRED else None
        own = None if source is None else source.robot
        if driven not in (None, *ROBOT_NAMES):  # no built-in robot
            if self.robot is None and own is None:
                said = f"driver '{self.driver}' needs the robot's model: give its file with --robot"
                raise ConfigError(f"{said}, or a motion made for it")
            driven = None
        if driven is not None and own is not None and own != driven:
            said = f"motion '{self.motion}' is for robot '{own}'"
            raise ConfigError(f"{said}, and driver '{self.driver}' drives a {driven}")
        if driven is not None and self.robot is not None and load_robot(self.robot).name != driven:
            raise ConfigError(f"driver '{self.driver}' drives a {driven}, not '{self.robot}'; leave out --robot")
        robot = load_robot(self.robot or driven or own or opt.DEFAULT_ROBOT)
        if source is None:
            steered = opt.given(self, "cycles", "policy") if self.motion == opt.STEER else []
            for name in (*opt.given(self.clip), *steered):
                raise ConfigError(f"{name} cannot be applied to '{self.motion}'")
            stands = standing(robot)
            return robot, replace(stands, provenance=replace(stands.provenance, name=self.motion))
        return robot, source.load(robot, **self.clip.overrides())

    def _deploy(
        self, robot: Robot, motion: Motion, limits: "SafetyLimits", policy: Any, log: Path, commands: "Commands | None"
    ) -> "Deployment":
        from fastmimic.deploy.deployment import DeployOptions, deploy
        from fastmimic.deploy.sequence import SteeredFollower, make_sequence
        from fastmimic.deploy.state_machine import DeploymentPhase

        clock: LoopClock = VirtualClock() if self.simulated.lock_step else LoopClock()
        switch, ready, dry = StopSwitch(), None, self.dry_run
        if self.driver == SIM:
            driver = self._simulated(robot, clock)
        else:
            given = {k: v for k in ("interface", "domain") if (v := getattr(self, k)) is not None}
            driver = make_driver(self.driver, robot, release=not dry, say=note, **given)
            if dry and not _answers(driver):
                clock = VirtualClock()
                driver, dry = self._simulated(robot, clock), False
            elif not dry and not self.yes:
                ready = partial(_agreed, switch)
        duration_s, endless = self.duration, self.endless
        if commands is not None and duration_s is None and not endless:
            duration_s, endless = commands.end_s, commands.end_s is None
        options = opt.apply(
            DeployOptions,
            self,
            policy=policy,
            solve_rate_hz=self.solve_rate,
            estimator=EstimatorConfig(foot_force=self.foot_force),
            duration_s=duration_s,
            endless=endless,
            limits=limits,
            dry_run=dry,
            real_time=REAL_TIME[self.real_time],
            log=log,
            driver=self.driver,
            arguments=opt.recorded(self),
            versions=versions(),
        )
        follower, doing = None, ""
        if commands is not None:
            stands = make_sequence(robot, motion, options.controller(motion)[1])
            follower = SteeredFollower(stands, self.steered.gaits(self.robot or robot.name), commands.velocity)
        with slow_start() as started, self._publisher(robot) as publish:

            def watch(machine: "StateMachine", row: Any) -> None:
                nonlocal doing
                if machine.doing != doing and machine.phase is not DeploymentPhase.DONE:
                    started()
                    doing = machine.doing
                    note(doing)
                publish(row)

            loop: dict[str, Any] = {"clock": clock, "switch": switch, "on_ready": ready, "watch": watch, "note": note}
            return deploy(motion, robot, driver, options, follower=follower, **loop)

    def _publisher(self, robot: Robot) -> Any:
        if not self.publish:
            return nullcontext(lambda row: None)
        from fastmimic.deploy.dds.ros import RosPublisher

        return RosPublisher(robot, self.interface, self.domain)

    def _simulated(self, robot: Robot, clock: Any) -> RobotDriver:
        from fastmimic.deploy.sim import LinkFaults, SimDriver

        given = self.simulated
        disturbances: Any = opt.joined(given.disturb)
        conditions = Conditions(observe="sensors", seed=given.seed, disturbances=disturbances)
        faults = LinkFaults(latency_s=1e-3 * given.latency_ms, loss=given.loss, seed=given.seed)
        return SimDriver(robot, clock, conditions=conditions, faults=faults)

    def _report(self, found: "Deployment", log: Path) -> None:
        from fastmimic.deploy.summary import command_table, summary_rows

        if self.dry_run:
            for line in command_table(found.log):
                (note if self.json else put)(line)
            for line in found.noted:
                note(f"fastmimic: dry run: {line}")
        if self.json:
            return put_json({**found.result, "log": str(log)})
        put_table(summary_rows(found.result))
        put(f"log in {log}")

    def _status(self, found: "Deployment", written: bool) -> int:
        from fastmimic.deploy.safety import StopReason
        from fastmimic.deploy.state_machine import DeploymentPhase

        outcome = found.outcome
        if outcome.stopped_by.planned:
            return 0 if written else EXIT_CUT_OFF
        sat = outcome.phase is DeploymentPhase.DONE
        note(f"fastmimic: {outcome.text}; the robot {'sat down' if sat else f'was damped while {outcome.phase.text}'}")
        return EXIT_INTERRUPTED if outcome.stopped_by in (StopReason.KEY, StopReason.SIGNAL) else EXIT_VIOLATION


def _answers(driver: RobotDriver) -> bool:
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
