"""`fastmimic deploy` runs a motion on a robot; `robot-sim` simulates one that speaks a real robot's protocol."""

import json
import math
import signal
import sys
import threading
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from tyro.conf import OmitArgPrefixes, Positional

from fastmimic.base.errors import ConfigError, DriverError, OutputError, unknown
from fastmimic.base.files import write_json
from fastmimic.base.machine import versions
from fastmimic.base.progress import note, slow_start
from fastmimic.commands import options as opt
from fastmimic.commands.console import EXIT_INTERRUPTED, on_signal, put, put_json, put_table
from fastmimic.commands.show import is_whole
from fastmimic.deploy.computer import LoopClock, StopSwitch, VirtualClock
from fastmimic.deploy.dds.cyclone import check_interface
from fastmimic.deploy.driver import DRIVERS, SIM, WIRED, RobotDriver, make_driver
from fastmimic.deploy.log import ENDING, LOG, RESULT, ground_truth_writer, open_deployment
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.motion.motion import Motion
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.runs.work_folder import MOTION, default_folder
from fastmimic.simulation.conditions import Conditions, parse_disturbance
from fastmimic.simulation.config import ideal_sensors

if TYPE_CHECKING:
    from fastmimic.deploy.deployment import Deployment
    from fastmimic.deploy.safety import SafetyLimits
    from fastmimic.deploy.state_machine import StateMachine
    from fastmimic.steering.commands import Commands

EXIT_VIOLATION: Final = 3
"""Exit status: a safety limit was exceeded and the joints were damped."""
EXIT_CUT_OFF: Final = 4
"""Exit status: all went as planned, but the log or the figures are not on the disk."""
STAND: Final = "stand"
SIMULATED: Final = ("go2",)
REAL_TIME: Final = {"auto": None, "on": True, "off": False}


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
    motion runs once. "steer": the robot goes at the velocities of --udp, --topic or --commands."""
    driver: Annotated[str, opt.option("NAME", lambda: f"Robot: {', '.join(DRIVERS)} (simulated).")]
    interface: Annotated[str | None, opt.option("NAME")] = None
    """Network interface of the robot. Default: lo, for a simulated one."""
    domain: Annotated[int | None, opt.option("N")] = None
    """DDS domain of a Go2, and of --publish and --topic. Default: 0, for those two $ROS_DOMAIN_ID."""
    cycles: Annotated[int | None, opt.option("N")] = None
    """Number of cycles."""
    duration: opt.Seconds = None
    """Duration of the motion without standing up and sitting down. Default: 10 s."""
    endless: opt.Flag = False
    """Run until s or a stop."""
    robot: opt.RobotChoice = None
    foot_force: opt.FootForce = "auto"
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
    real_time: Annotated[Literal["auto", "on", "off"], opt.option("auto|on|off")] = "auto"
    """Real-time scheduling and locked memory. auto: where the system permits it."""
    out: Annotated[Path | None, opt.option("FOLDER")] = None
    """Folder of the results. Default: runs/deploy-MOTION-ROBOT-DRIVER, numbered if it exists."""
    log: Annotated[Path | None, opt.option("FILE.mcap")] = None
    """File of the log. Default: log.mcap in the folder."""
    publish: opt.Flag = False
    """Publish joint_states, joint_commands, odom and tf over DDS while it runs, for RViz, Foxglove and ROS 2 nodes."""
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
            write_json(folder / RESULT, found.log.meta)
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
                raise ConfigError(
                    "standard input is not a terminal, so nobody can confirm the start or stop the robot by a key;"
                    " --yes starts without"
                )
        elif opt.given(self, "interface", "domain") and not (self.publish or self.steered.topic):
            raise ConfigError(f"--interface and --domain are for a robot on the wire, not for '--driver {SIM}'")

    def _load(self) -> tuple[Robot, Motion]:
        from fastmimic.reference.standing import standing

        source = None if self.motion in (STAND, opt.STEER) else find_motion(self.motion)
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
            about={"driver": self.driver, "arguments": opt.recorded(self), "versions": versions()},
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
        from fastmimic.deploy.account import command_table, summary_rows

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


@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """Faults of the connection and of the robot."""

    loss: Annotated[float, opt.option("SHARE")] = 0.0
    """Share of the states that are lost."""
    corrupt: Annotated[float, opt.option("SHARE")] = 0.0
    """Share of the states that arrive with a flipped bit."""
    duplicate: Annotated[float, opt.option("SHARE")] = 0.0
    """Share of the states that arrive twice."""
    reorder: Annotated[float, opt.option("SHARE")] = 0.0
    """Share of the states that arrive after the next one."""
    latency_ms: Annotated[float, opt.option("MS")] = 0.0
    """Additional latency of the states."""
    command_loss: Annotated[float, opt.option("SHARE")] = 0.0
    """Share of the commands that are lost."""
    command_corrupt: Annotated[float, opt.option("SHARE")] = 0.0
    """Share of the commands that arrive with a flipped bit."""
    command_latency_ms: Annotated[float, opt.option("MS")] = 0.0
    """Additional latency of the commands."""
    dead_after: opt.Seconds = None
    """Time after which the robot falls silent, as if its computer had died. Default: never."""


@dataclass(frozen=True, kw_only=True)
class RobotSim:
    """Simulates a Go2 that speaks the real DDS protocol: it runs in MuJoCo in real time, publishes its state and obeys
    low-level commands. 'fastmimic deploy' and Unitree's own SDK talk to it.

    It is reachable on this computer only, unless another interface is named. Ctrl-C ends it.
    """

    robot: Annotated[str, opt.option("NAME|FILE")] = "go2"
    """go2, or your own robot's MJCF file for a body that uses the Go2's messages."""
    interface: Annotated[str, opt.option("NAME")] = "lo"
    """Network interface."""
    domain: Annotated[int, opt.option("N")] = 0
    """DDS domain."""
    start: Annotated[str, opt.option("lying|standing")] = "lying"
    """Initial state: lying with limp motors, or standing under its own motion service, which ignores low-level commands
    until it is released."""
    sensors: Annotated[str, opt.option("real|ideal")] = "real"
    """Sensors with or without noise, bias and latency."""
    seed: int = 0
    """Seed of the sensor noise and the faults."""
    disturb: opt.Disturbances = ()
    watchdog_ms: Annotated[float, opt.option("MS")] = 20.0
    """Time without a command after which the motors damp."""
    duration: opt.Seconds = None
    """Time until it ends. Default: it runs until Ctrl-C."""
    log: Annotated[Path | None, opt.option("FILE.mcap")] = None
    """File for the ground truth of what the robot did."""
    json: opt.JsonFlag = False
    fault: Annotated[FaultOptions, OmitArgPrefixes]

    def run(self) -> int:
        from fastmimic.deploy.sim_server import SimServer

        settings = self._settings()
        opt.check_duration(self.duration)
        duration = math.inf if self.duration is None else self.duration
        writer = None if self.log is None else ground_truth_writer(opt.check_writable(self.log, ENDING))
        with writer or nullcontext():
            with slow_start():
                server = SimServer(load_robot(self.robot), settings, None if writer is None else writer.recorder)
            stop = threading.Event()
            with closing(server), on_signal(lambda *_: stop.set(), signal.SIGINT, signal.SIGTERM):
                note(f"a {self.robot}, {self.start}, in DDS domain {self.domain} on '{self.interface}'; Ctrl-C ends it")
                server.run(stop, duration, _status)
        summary = {"robot": self.robot, **server.summary()}
        if self.json:
            put(json.dumps(summary, indent=1))
        else:
            put(*(f"{name.replace('_', ' ')}: {value}" for name, value in summary.items()))
        if writer is None:
            return 0
        writer.end({})
        note(f"ground truth in {self.log}")
        return 0 if is_whole(writer.ends) else EXIT_CUT_OFF

    def _settings(self) -> Any:
        from fastmimic.deploy.sim import LinkFaults
        from fastmimic.deploy.sim_server import SimSettings

        check_interface(self.interface)
        if self.robot.lower() in ROBOT_NAMES and self.robot.lower() not in SIMULATED:
            raise ConfigError(f"robot-sim does not speak the protocol of a {self.robot}; give {' or '.join(SIMULATED)}")
        if self.sensors not in ("real", "ideal"):
            raise ConfigError(f"--sensors takes real or ideal, found '{self.sensors}'")
        fault = self.fault
        commands = {name: getattr(fault, f"command_{name}") for name in ("loss", "corrupt")}
        return opt.apply(
            SimSettings,
            self,
            sensors=ideal_sensors() if self.sensors == "ideal" else None,
            disturbances=tuple(parse_disturbance(text) for text in opt.joined(self.disturb)),
            states=opt.apply(LinkFaults, fault, latency_s=fault.latency_ms / 1e3, seed=self.seed),
            commands=LinkFaults(latency_s=fault.command_latency_ms / 1e3, seed=self.seed, **commands),
            watchdog_s=self.watchdog_ms / 1e3,
            dead_after_s=math.inf if fault.dead_after is None else fault.dead_after,
        )


def _status(server: Any) -> None:
    counts, body = server.counts, server.body
    height = float(body.observation["root_pos"][0, 2])
    mode = "motion service" if body.service.active else "damped" if body.damped else "commanded"
    note(
        f"{body.time:6.1f} s  {server.realtime_factor:4.0%} of real time  {counts.states_sent} states"
        f"  {counts.commands_received} commands ({counts.commands_rejected} rejected)  {mode}  base at {height:.3f} m"
        + ("  fell" if body.fell else "")
    )
