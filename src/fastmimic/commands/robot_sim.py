"""`fastmimic robot-sim`: a simulated robot with a real one's wire, in a process of its own."""

import json
import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import arg

from fastmimic.base.errors import ConfigError
from fastmimic.commands.console import note, put, slow_start

if TYPE_CHECKING:
    from fastmimic.deploy.robot_sim.sim_server import SimServer, SimSettings

WIRED: Final = ("go2",)


@dataclass(frozen=True, kw_only=True)
class RobotSim:
    """Is a robot: a Go2 in MuJoCo, in real time, that publishes its state and obeys low-level commands over DDS as the
    real one does. 'fastmimic deploy' and Unitree's own SDK talk to it.

    It talks on this computer only, unless another interface is named. Ctrl-C ends it.
    """

    robot: Annotated[str, arg(metavar="NAME|FILE.xml")] = "go2"
    """go2, or the MJCF of your own for a body that speaks the Go2's messages."""
    interface: Annotated[str, arg(metavar="NAME")] = "lo"
    """Network interface."""
    domain: Annotated[int, arg(metavar="N")] = 0
    """DDS domain."""
    start: Annotated[str, arg(metavar="lying|standing")] = "lying"
    """How it begins: lying with limp motors, or standing under its own motion service, which ignores low-level commands
    until it is released."""
    sensors: Annotated[str, arg(metavar="real|ideal")] = "real"
    """Whether its sensors have noise, bias and latency."""
    seed: int = 0
    """Of the sensors' errors and of the faults."""
    watchdog_ms: Annotated[float, arg(metavar="MS")] = 20.0
    """Without a command for so long, its motors damp."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """Until it ends by itself; by default never."""
    log: Annotated[Path | None, arg(metavar="FILE.npz")] = None
    """Where to write what it really did."""
    json: bool = False
    """Print the account at the end as JSON."""
    loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Of the states that are lost."""
    corrupt: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Of the states that arrive with a bit flipped."""
    duplicate: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Of the states that arrive twice."""
    reorder: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Of the states that arrive after the next one."""
    latency_ms: Annotated[float, arg(metavar="MS")] = 0.0
    """Until a state arrives, besides what the wire needs."""
    command_loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Of the commands that are lost."""
    command_corrupt: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Of the commands that arrive with a bit flipped."""
    command_latency_ms: Annotated[float, arg(metavar="MS")] = 0.0
    """Until a command arrives."""
    dead_after: Annotated[float | None, arg(metavar="S")] = None
    """When it falls silent for good, as if its computer had died."""

    def run(self) -> int:
        """Is a robot until Ctrl-C or the end; returns the exit status."""
        from fastmimic.commands.options import check_duration, check_writable
        from fastmimic.deploy.robot_sim.ground_truth import GroundTruthLog
        from fastmimic.deploy.robot_sim.sim_server import SimServer
        from fastmimic.robot import load_robot

        settings = self._settings()
        duration = math.inf if self.duration is None else check_duration(self.duration)
        if self.log is not None:
            check_writable(self.log, ".npz")
        log = GroundTruthLog() if self.log is not None else None
        with slow_start():
            server = SimServer(load_robot(self.robot), settings, log)
        with server, _until_interrupted() as stop:
            note(f"a {self.robot}, {self.start}, in DDS domain {self.domain} on '{self.interface}'; Ctrl-C ends it")
            server.run(stop, duration, _status)
        self._account(server)
        if log is not None and self.log is not None:
            log.save(self.log)
            note(f"what it really did: {self.log}")
        return 0

    def _settings(self) -> "SimSettings":
        """What was asked for, once it is certain that it can be."""
        from fastmimic.deploy.dds import check_interface
        from fastmimic.deploy.robot_sim.faults import Faults
        from fastmimic.deploy.robot_sim.sim_server import SimSettings
        from fastmimic.deploy.robot_sim.simulated_body import Start
        from fastmimic.robot import ROBOT_NAMES
        from fastmimic.simulation.sensors import ideal_sensors

        check_interface(self.interface)
        if self.robot.lower() in ROBOT_NAMES and self.robot.lower() not in WIRED:
            raise ConfigError(f"the {self.robot} has another wire than robot-sim: give one of {', '.join(WIRED)}")
        _check_choice("--start", self.start, [s.value for s in Start])
        _check_choice("--sensors", self.sensors, ["real", "ideal"])
        states = Faults(
            loss=self.loss,
            corrupt=self.corrupt,
            duplicate=self.duplicate,
            reorder=self.reorder,
            latency_s=self.latency_ms / 1e3,
        )
        commands = Faults(loss=self.command_loss, corrupt=self.command_corrupt, latency_s=self.command_latency_ms / 1e3)
        return SimSettings(
            domain=self.domain,
            interface=self.interface,
            start=Start(self.start),
            sensors=ideal_sensors() if self.sensors == "ideal" else None,
            seed=self.seed,
            states=states,
            commands=commands,
            command_timeout_s=self.watchdog_ms / 1e3,
            dead_after_s=math.inf if self.dead_after is None else self.dead_after,
        )

    def _account(self, server: "SimServer") -> None:
        summary = {"robot": self.robot, **server.summary()}
        if self.json:
            put(json.dumps(summary, indent=1))
            return
        for name, value in summary.items():
            put(f"{name.replace('_', ' ')}: {value}")


@contextmanager
def _until_interrupted() -> Iterator[threading.Event]:
    """An event that Ctrl-C or SIGTERM sets, so that what runs can come to its end."""
    stop = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        yield stop
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _check_choice(option: str, found: str, allowed: list[str]) -> None:
    if found not in allowed:
        raise ConfigError(f"{option} takes {' or '.join(allowed)}, found '{found}'")


def _status(server: "SimServer") -> None:
    counts, body = server.counts, server.body
    height = float(body.observation["root_pos"][0, 2])
    who = "its own service" if body.service.active else "damped" if body.damped else "commanded"
    note(
        f"{body.time:6.1f} s  {server.realtime_factor:4.0%} of real time  {counts.states_sent} states"
        f"  {counts.commands_received} commands ({counts.commands_rejected} rejected)  {who}  base at {height:.3f} m"
        + ("  fell" if body.fell else "")
    )
