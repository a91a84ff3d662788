"""Live simulated robots: `fastmimic play` in the browser, `robot-sim` with a real robot's protocol."""

import json
import math
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, Final

from tyro.conf import OmitArgPrefixes, Positional

from fastmimic.base.errors import ConfigError
from fastmimic.base.progress import note, slow_start
from fastmimic.base.signals import on_signal
from fastmimic.commands import options as opt
from fastmimic.commands.console import EXIT_CUT_OFF, put
from fastmimic.commands.pictures import serve
from fastmimic.commands.show import is_whole
from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.deploy.dds.cyclone import check_interface
from fastmimic.deploy.log import ENDING, ground_truth_writer
from fastmimic.robot import ROBOT_NAMES, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.simulation.conditions import Conditions, parse_disturbance
from fastmimic.simulation.config import ideal_sensors

SIMULATED: Final = ("go2",)


@opt.command
class Play:
    """Simulates a robot under the controller live in the browser. Switch motions or steer, push the robot, change
    friction and payload, by mouse, keyboard or gamepad. A robot that falls gets up again."""

    motions: Annotated[Positional[tuple[str, ...]], opt.option("[MOTION|RUN ...]")] = ()
    robot: opt.RobotChoice = None
    port: opt.Port = 8080
    method: Annotated[str, opt.shared("NAME", "first method")] = "mbc"
    config: opt.ConfigName = "default"
    observe: opt.Observation = "truth"
    disturb: opt.Disturbances = ()
    seed: int = 0
    ideal: opt.Ideal = False
    terrain: opt.TerrainName = None
    steered: Annotated[opt.SteeredBy, OmitArgPrefixes]

    def run(self) -> None:
        from fastmimic.viewer.viewer import free_port, require_viser

        require_viser()
        free_port(self.port)  # before the motions are loaded
        from fastmimic.play.page import PlayPage
        from fastmimic.play.session import DEFAULTS, LiveSession, check_method, load_motions
        from fastmimic.reference.motion_set import MotionSet, warm_up

        check_method(self.method)
        config = controller_config(self.config)
        conditions = opt.apply(Conditions, self, disturbances=opt.joined(self.disturb))
        self.steered.check(self.motions == (opt.STEER,))
        if self.motions == (opt.STEER,):
            return self._steered(config, conditions)
        sources = [find_motion(source) for source in self.motions or DEFAULTS]
        name = opt.robot_name(self.robot, *sources)
        robot = load_robot(name)
        # transitions take about a second each: another process makes them, so that the simulation keeps real time
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            with on_signal(signal.SIG_IGN, signal.SIGINT):  # it ignores Ctrl-C from its first moment on: we handle it
                executor.submit(warm_up, name)  # while this process loads
            with slow_start():
                motions = load_motions(sources, robot)
                played = MotionSet(robot, motions, executor=executor, source=name, regulator=config.regulator)
                session = LiveSession(robot, played, method=self.method, config=config, conditions=conditions)
            session.switch(next(iter(motions)))
            try:
                with PlayPage(session, f"{robot.name}, live", self.port) as page:
                    serve(page, ", ".join(played.names), self.port)
            finally:
                # waits: the interpreter's own exit does not close the pool safely
                executor.shutdown(cancel_futures=True)

    def _steered(self, config: ControllerConfig, conditions: Conditions) -> None:
        from fastmimic.play.page import PlayPage
        from fastmimic.play.session import LiveSession

        with self.steered.opened() as commands:
            gaits = self.steered.gaits(self.robot)
            with slow_start():
                session = LiveSession(
                    gaits.robot, {}, method=self.method, config=config, conditions=conditions, gaits=gaits
                )
            with PlayPage(session, f"{gaits.robot.name}, steered", self.port, commands) as page:
                serve(page, " and ".join(self.steered.gait) or opt.STEER, self.port)


@opt.command
class FaultOptions:
    """Faults of the connection and of the robot."""

    loss: Annotated[float, opt.option("SHARE")] = 0.0
    corrupt: Annotated[float, opt.option("SHARE")] = 0.0
    duplicate: Annotated[float, opt.option("SHARE")] = 0.0
    reorder: Annotated[float, opt.option("SHARE")] = 0.0
    latency_ms: Annotated[float, opt.option("MS")] = 0.0
    command_loss: Annotated[float, opt.option("SHARE")] = 0.0
    command_corrupt: Annotated[float, opt.option("SHARE")] = 0.0
    command_latency_ms: Annotated[float, opt.option("MS")] = 0.0
    dead_after: opt.Seconds = None


@opt.command
class RobotSim:
    """Simulates a Go2 that speaks the real DDS protocol: it runs in MuJoCo in real time, publishes its state and obeys
    low-level commands. 'fastmimic deploy' and Unitree's own SDK talk to it."""

    robot: Annotated[str, opt.option("NAME|FILE")] = "go2"
    interface: Annotated[str, opt.option("NAME")] = "lo"
    domain: Annotated[int, opt.option("N")] = 0
    start: Annotated[str, opt.option("lying|standing")] = "lying"
    sensors: Annotated[str, opt.option("real|ideal")] = "real"
    seed: int = 0
    disturb: opt.Disturbances = ()
    watchdog_ms: Annotated[float, opt.option("MS")] = 20.0
    duration: opt.Seconds = None
    log: Annotated[Path | None, opt.option("FILE.mcap")] = None
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
