"""What a deployment makes of faults: of sensors, motors, the link, programs and people.

    python benchmarks/faults.py [--robot go2] [--motion trot] [--only imu …] [--instants 8] [--wire] [--json] [--write]

Each case deploys a motion on a simulated robot with one fault, in lock step (`--wire`: also on robots in processes of
their own, in real time, over DDS). The fault is there from the beginning, or comes a second after the motion has begun;
in lock step at so many instants of a period, each in a run of its own. A row says how it ended, mostly: what stopped
the deployment, its exit status, in how many runs the robot fell (tipped over, or landed hard on its trunk), the
greatest joint speed as a share of its limit and the greatest tilt of the trunk until the deployment ended or the joints
were damped, and whether the log was whole. `--write` puts the table into docs/deploy.md.
"""

import argparse
import dataclasses
import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put

from fastmimic import load_motion
from fastmimic.base.arrays import Records
from fastmimic.base.errors import FastMimicError
from fastmimic.base.rotations import quat_from_rotvec, quat_multiply, quat_rotate_inverse
from fastmimic.base.text import markdown_table
from fastmimic.commands.deploy import EXIT_VIOLATION
from fastmimic.deploy.computer import StopSwitch, VirtualClock
from fastmimic.deploy.dds.cyclone import Participant, Writer
from fastmimic.deploy.deployment import DeployOptions, deploy
from fastmimic.deploy.driver import StateMessage, damping_command
from fastmimic.deploy.go2 import messages
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.safety import StopReason
from fastmimic.deploy.sequence import Follower, MotionSequence, make_sequence
from fastmimic.deploy.sim import LinkFaults, SimDriver
from fastmimic.deploy.state_machine import DeploymentPhase, StateMachine
from fastmimic.robot import Robot, load_robot
from fastmimic.simulation.conditions import Conditions

PAGE = Path(__file__).resolve().parent.parent / "docs" / "deploy.md"
LATE_S = 1.0  # after the motion has begun
MOTION_S = 4.0

Tamper = Callable[[Any, dict[str, Any]], None]  # changes one reading of `READING` in place; keeps what it needs


def turned(angle: float, *axis: float) -> Tamper:
    """The IMU mounted in another way: turned about an axis of the trunk."""

    def tamper(reading: Any, kept: dict[str, Any]) -> None:
        mounting = quat_from_rotvec(angle * np.array(axis))
        reading["quat"] = quat_multiply(reading["quat"], mounting)
        for name in ("gyro", "accel"):
            reading[name] = quat_rotate_inverse(mounting, reading[name])

    return tamper


def frozen(*names: str, joints: tuple[int, ...] = ()) -> Tamper:
    """Fields, or joints, that keep saying what they said first."""

    def tamper(reading: Any, kept: dict[str, Any]) -> None:
        first = kept.setdefault("first", reading.copy())
        for name in names:
            reading[name] = first[name]
        for joint in joints:
            for name in ("joint_pos", "joint_vel"):
                reading[name][joint] = first[name][joint]

    return tamper


def scaled(name: str, factor: float, at: Any = slice(None)) -> Tamper:
    def tamper(reading: Any, kept: dict[str, Any]) -> None:
        reading[name][at] *= factor

    return tamper


def shifted(name: str, offset: float, at: Any = slice(None)) -> Tamper:
    def tamper(reading: Any, kept: dict[str, Any]) -> None:
        reading[name][at] += offset

    return tamper


def fixed(name: str, value: float, at: Any = slice(None)) -> Tamper:
    def tamper(reading: Any, kept: dict[str, Any]) -> None:
        reading[name][at] = value

    return tamper


def swapped(first: tuple[int, ...], second: tuple[int, ...], *names: str) -> Tamper:
    """Joints whose readings come in each other's place."""

    def tamper(reading: Any, kept: dict[str, Any]) -> None:
        for name in names:
            reading[name][[*first, *second]] = reading[name][[*second, *first]]

    return tamper


def as_xyzw(reading: Any, kept: dict[str, Any]) -> None:
    reading["quat"] = np.roll(reading["quat"], -1)


def drifting(reading: Any, kept: dict[str, Any]) -> None:
    """An orientation that rolls away at 0.2 rad/s."""
    kept["angle"] = kept.get("angle", 0.0) + 0.2 * 0.002
    reading["quat"] = quat_multiply(reading["quat"], quat_from_rotvec(np.array([kept["angle"], 0.0, 0.0])))


ANGLES, MOVEMENTS = ("joint_pos",), ("joint_pos", "joint_vel")
IMU = ("quat", "gyro", "accel")
SENSORS: dict[str, Tamper] = {
    "imu frozen": frozen(*IMU),
    "gyroscope frozen": frozen("gyro"),
    "accelerometer frozen": frozen("accel"),
    "orientation frozen": frozen("quat"),
    "imu upside down": turned(np.pi, 1, 0, 0),
    "imu turned by 90° about the vertical": turned(np.pi / 2, 0, 0, 1),
    "imu back to front": turned(np.pi, 0, 0, 1),
    "imu tilted by 0.4 rad": turned(0.4, 0, 1, 0),
    "gyroscope in °/s": scaled("gyro", 180 / np.pi),
    "gyroscope with the other sign": scaled("gyro", -1.0),
    "accelerometer in g": scaled("accel", 1 / 9.81),
    "orientation as x, y, z, w": as_xyzw,
    "orientation drifts by 0.2 rad/s": drifting,
    "imu not a number": fixed("gyro", np.nan),
    "a knee frozen": frozen(joints=(2,)),
    "a hip frozen": frozen(joints=(4,)),
    "a joint's angle off by 0.3 rad": shifted("joint_pos", 0.3, 5),
    "hips swapped, left and right": swapped((1,), (4,), *MOVEMENTS),
    "hips swapped, angles only": swapped((1,), (4,), *ANGLES),
    "legs swapped, left and right": swapped((0, 1, 2), (3, 4, 5), *MOVEMENTS),
    "hip and knee swapped": swapped((1,), (2,), *MOVEMENTS),
    "joint angles in °": scaled("joint_pos", 180 / np.pi),
    "joint speeds in °/s": scaled("joint_vel", 180 / np.pi),
    "joint speeds with the other sign": scaled("joint_vel", -1.0),
    "joint speeds 0": fixed("joint_vel", 0.0),
    "torques 0": fixed("torque", 0.0),
    "torques with the other sign": scaled("torque", -1.0),
    "torques ÷ 10": scaled("torque", 0.1),
    "a foot sensor dead": fixed("foot_force", 0.0, 1),
    "foot sensors dead": fixed("foot_force", 0.0),
    "foot sensors × 10": scaled("foot_force", 10.0),
    "foot sensors 60 N": fixed("foot_force", 60.0),
    "all readings frozen": frozen(*IMU, "joint_pos", "joint_vel", "torque", "foot_force"),
}


def dead_motor(joint: int) -> Tamper:
    """A command whose joint gets no torque."""

    def tamper(command: Any, kept: dict[str, Any]) -> None:
        for name in ("stiffness", "damping", "torque"):
            command[name][joint] = 0.0

    return tamper


def runaway(joint: int) -> Tamper:
    """A motor that gives all its torque."""

    def tamper(command: Any, kept: dict[str, Any]) -> None:
        dead_motor(joint)(command, kept)
        command["torque"][joint] = 100.0

    return tamper


MOTORS: dict[str, Tamper] = {
    "a knee's motor dead": dead_motor(2),
    "a hip's motor dead": dead_motor(10),
    "a knee's motor at full torque": runaway(5),
}
LINKS: dict[str, LinkFaults] = {
    "5 % of all messages lost": LinkFaults(loss=0.05),
    "20 % of all messages lost": LinkFaults(loss=0.2),
    "5 % twice, 5 % late, 5 % damaged, 1 % NaN": LinkFaults(
        duplicate=0.05, reorder=0.05, corrupt=0.05, not_finite=0.01
    ),
    "2 ms each way": LinkFaults(latency_s=0.002),
    "4 ms each way": LinkFaults(latency_s=0.004),
    "10 ms each way": LinkFaults(latency_s=0.01),
}
OUTAGES: dict[str, float] = {"silence of 10 ms": 0.01, "silence of 50 ms": 0.05, "silence for good": np.inf}
WORLDS: dict[str, tuple[str, ...]] = {
    "push of 1 m/s from the side": ("side-push=12@6",),
    "push of 5 m/s from the side": ("side-push=60@6",),
    "friction 0.2": ("friction=0.2",),
    "payload 5 kg": ("payload=5",),
    "motors at 60 %": ("motor-strength=0.6",),
    "foot sensors dead, and a load of 3 kg": ("foot-force-scale=0", "payload=3"),
}
OPERATORS: dict[str, Callable[[StopSwitch], None]] = {
    "emergency key": lambda switch: setattr(switch, "key", True),
    "SIGTERM": lambda switch: setattr(switch, "signals", 1),
    "key to sit down": lambda switch: setattr(switch, "leave", True),
}


@dataclass(frozen=True)
class Case:
    """One fault, from the beginning or `late_s` into the motion."""

    name: str
    reading: Tamper | None = None
    command: Tamper | None = None
    link: LinkFaults = LinkFaults()
    silence_s: float = 0.0
    world: Any = ()  # disturbances
    operator: Callable[[StopSwitch], None] | None = None
    late: bool = False
    late_s: float = LATE_S


def cases() -> list[Case]:
    """All cases in lock step."""
    found = [Case("nothing")]
    for name, tamper in SENSORS.items():
        found += [Case(name, reading=tamper), Case(f"{name}, in the motion", reading=tamper, late=True)]
    found += [Case(f"{name}, in the motion", command=tamper, late=True) for name, tamper in MOTORS.items()]
    found += [Case(name, link=faults) for name, faults in LINKS.items()]
    found += [Case(name, silence_s=seconds, late=True) for name, seconds in OUTAGES.items()]
    found += [Case(name, world=world) for name, world in WORLDS.items()]
    found += [Case(name, operator=act, late=True) for name, act in OPERATORS.items()]
    return found


class FaultyDriver(SimDriver):
    """A simulated robot with a fault. `moving_s` is how long the motion has lasted."""

    def __init__(self, robot: Robot, clock: VirtualClock, case: Case) -> None:
        conditions = Conditions(observe="sensors", disturbances=case.world)
        super().__init__(robot, clock, conditions=conditions, faults=case.link)
        self._case, self.moving_s = case, 0.0
        self._kept: dict[str, Any] = {}

    @property
    def at_fault(self) -> bool:
        return not self._case.late or self.moving_s > self._case.late_s

    def _newest(self) -> StateMessage | None:
        state = super()._newest()
        if state is None or not self.at_fault:
            return state
        if self._case.late_s < self.moving_s < self._case.late_s + self._case.silence_s:
            return None
        if self._case.reading is None:
            return state
        reading = state.reading.copy()
        self._case.reading(reading[0], self._kept)
        if not np.isfinite(reading.view(np.float64)).all():  # as every driver
            self.packets.rejected += 1
            return None
        return dataclasses.replace(state, reading=reading)

    def _send(self, command: Records) -> bool:
        if self.at_fault and self._case.command is not None:
            command = command.copy()
            self._case.command(command[0], self._kept)
        return super()._send(command)


def lock_step(robot: Robot, sequence: MotionSequence, case: Case) -> dict[str, Any]:
    """One case on a virtual clock."""
    clock, switch = VirtualClock(), StopSwitch(stream=None)
    driver = FaultyDriver(robot, clock, case)

    def watch(machine: StateMachine, command: Records) -> None:
        driver.moving_s += machine.dt * machine.in_motion
        if case.operator is not None and driver.at_fault:
            case.operator(switch)

    options = DeployOptions(duration_s=MOTION_S)
    row: dict[str, Any] = {"name": case.name, "where": "lock step"}
    try:
        follower = Follower(sequence)
        done = deploy(
            sequence.motion, robot, driver, options, follower=follower, clock=clock, switch=switch, watch=watch
        )
    except FastMimicError as error:
        return row | ended("refused", "", 2, str(error)) | {"fell": False, "log_complete": True}
    outcome, log = done.outcome, done.log
    assert log.truth is not None
    before = ~np.isin(log.rows["phase"], (DeploymentPhase.CROUCH, DeploymentPhase.DAMP))
    truth = log.truth[before]
    up = 1.0 - 2.0 * (truth["root_quat"][:, 1] ** 2 + truth["root_quat"][:, 2] ** 2)
    status = (
        0 if outcome.stopped_by.planned else 130 if outcome.stopped_by.value in ("key", "signal") else EXIT_VIOLATION
    )
    how = "done" if status == 0 else "damped"
    return (
        row
        | ended(how, outcome.stopped_by.value, status, outcome.text)
        | {
            "fell": bool(done.result["fell"] or driver.body.fell),
            "peak_joint_speed_share": float((np.abs(truth["joint_vel"]) / robot.joint_speed_limit).max()),
            "peak_tilt_rad": float(np.arccos(np.clip(up, -1.0, 1.0)).max()),
            "while": outcome.phase.text,
            "log_complete": len(log.rows) == done.result["periods"],
        }
    )


def at_instants(robot: Robot, sequence: MotionSequence, case: Case, count: int) -> dict[str, Any]:
    """One case on a virtual clock, at `count` instants of the motion's period if it comes in the motion: how it ended
    most often, the worst figures, and in how many it fell."""
    if not case.late:
        return lock_step(robot, sequence, case)
    delays = [k * sequence.motion.period_s / count for k in range(count)]
    runs = [lock_step(robot, sequence, dataclasses.replace(case, late_s=LATE_S + delay)) for delay in delays]
    endings = [(run["outcome"], run["stopped_by"], run["rc"]) for run in runs]
    row = runs[endings.index(max(endings, key=endings.count))]
    worst = {name: max(run.get(name, 0.0) for run in runs) for name in ("peak_joint_speed_share", "peak_tilt_rad")}
    falls = sum(run["fell"] for run in runs)
    whole = all(run["log_complete"] for run in runs)
    return row | worst | {"fell": falls > 0, "falls": falls, "instants": count, "log_complete": whole}


@dataclass(frozen=True)
class WireCase:
    """One fault between two processes. `strike` gets robot and program once the motion has begun."""

    name: str
    sim: tuple[str, ...] = ()
    deploy: tuple[str, ...] = ()
    strike: Callable[["Processes"], None] | None = None
    file_size: int | None = None  # bytes after which the program's files cannot grow, as on a full disk


@dataclass
class Processes:
    robot: "subprocess.Popen[str]"
    program: "subprocess.Popen[str]"
    domain: int


def killed(processes: Processes) -> None:
    processes.program.kill()


def robot_killed(processes: Processes) -> None:
    processes.robot.kill()


def signalled(number: signal.Signals) -> Callable[[Processes], None]:
    return lambda processes: processes.program.send_signal(number)


def commanded_by_others(processes: Processes) -> None:
    """A second program sends commands without gain for half a second."""
    with closing(Participant(processes.domain)) as stranger:
        writer = Writer(stranger, messages.LOW_COMMAND_TOPIC, messages.LowCommand)
        assert writer.record is not None
        command = messages.CommandWire(writer.record)
        command.clear()
        for _ in range(250):
            command.write(damping_command(0.0))
            writer.write()
            time.sleep(0.002)


WIRE = (
    WireCase("nothing"),
    WireCase("5 % of all messages lost, 4 ms more", ("--loss", "0.05", "--command-loss", "0.05", "--latency-ms", "4")),
    WireCase("5 % twice, 5 % late, 5 % damaged", ("--duplicate", "0.05", "--reorder", "0.05", "--corrupt", "0.05")),
    WireCase("foot sensors dead", ("--disturb", "foot-force-scale=0")),
    WireCase("payload 5 kg", ("--disturb", "payload=5")),
    WireCase("the robot's computer dies", strike=robot_killed),
    WireCase("the robot falls silent", ("--dead-after", "20")),
    WireCase("this program is killed", strike=killed),
    WireCase("SIGTERM", strike=signalled(signal.SIGTERM)),
    WireCase("the terminal is closed", strike=signalled(signal.SIGHUP)),
    WireCase("another program commands", strike=commanded_by_others),
    WireCase("another program commands, sit", deploy=("--limit", "foreign=sit"), strike=commanded_by_others),
    WireCase("the disk is full", file_size=8_000_000),
)


def on_the_wire(motion: str, robot: Robot, case: WireCase, domain: int) -> dict[str, Any]:
    """One case between `fastmimic robot-sim` and `fastmimic deploy`, in real time."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        sim = started("robot-sim", "--domain", str(domain), "--json", *case.sim)
        until(sim, "states")
        options = ["--domain", str(domain), "--yes", "--json", "--duration", str(MOTION_S), "--out", str(out)]
        limit = None if case.file_size is None else lambda: small_files(case.file_size or 0)
        program = started("deploy", motion, "--driver", "go2", *options, *case.deploy, preexec=limit)
        said = until(program, f"blending out of {motion}" if case.strike is None else f"\n{motion}")
        if case.strike is not None:
            time.sleep(LATE_S)
            case.strike(Processes(sim, program, domain))
        said += program.communicate(timeout=120)[1]
        time.sleep(2.0)
        told: dict[str, Any] = {}
        if sim.poll() is None:
            sim.send_signal(signal.SIGINT)
            told = json.loads(sim.communicate(timeout=60)[0])
        log = DeploymentLog.load(out)
    rows = log.rows[~np.isin(log.rows["phase"], (DeploymentPhase.CROUCH, DeploymentPhase.DAMP))]
    up = 1.0 - 2.0 * (rows["reading"]["quat"][:, 1] ** 2 + rows["reading"]["quat"][:, 2] ** 2)
    result = log.facts.result
    how = "killed" if program.returncode < 0 else "done" if program.returncode in (0, 4) else "damped"
    if case.deploy and result.get("stopped_by") == StopReason.FOREIGN:
        how = "sat down"
    last = said.strip().splitlines()[-1]
    complete = bool(result) or how == "killed" or program.returncode == 4
    return (
        {"name": case.name, "where": "on the wire"}
        | ended(how, result.get("stopped_by", ""), program.returncode, last if program.returncode else "")
        | {
            "fell": bool(told.get("fell", result.get("fell", False))),
            "peak_joint_speed_share": float((np.abs(rows["reading"]["joint_vel"]) / robot.joint_speed_limit).max()),
            "peak_tilt_rad": float(np.arccos(np.clip(up, -1.0, 1.0)).max()),
            "log_complete": complete and bool(len(log.rows)),
            "logged_s": float(log.rows["time_s"][-1]),
        }
    )


def started(*arguments: str, preexec: Callable[[], None] | None = None) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "fastmimic", *arguments]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, preexec_fn=preexec)


def until(process: "subprocess.Popen[str]", text: str) -> str:
    """What a process says until it has said this, or ends."""
    said = ""
    assert process.stderr is not None
    for line_ in process.stderr:
        said += line_
        if text in said:
            break
    return said


def small_files(size: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def ended(outcome: str, stopped_by: str, rc: int, text: str) -> dict[str, Any]:
    return {"outcome": outcome, "stopped_by": stopped_by, "rc": rc, "text": text}


def line(row: dict[str, Any]) -> str:
    """A row for the terminal."""
    fell = "fell" if row["fell"] else ""
    return (
        f"{row['name']:52} {row['outcome']:8} {row['stopped_by']:16} {row['rc']:3} {fell:5}"
        f" {row.get('peak_joint_speed_share', 0.0):5.2f} {row.get('peak_tilt_rad', 0.0):5.2f} {row['text'][:100]}"
    )


def fallen(row: dict[str, Any]) -> str:
    if not row["fell"]:
        return "no"
    return f"**{row['falls']} of {row['instants']}**" if "falls" in row else "**yes**"


def table(rows: list[dict[str, Any]]) -> list[str]:
    """The rows for the page: those that are not simply done."""
    head = ("fault", "where", "how it ended", "exit status", "fell", "joint speed, share", "tilt, rad", "log")
    cells = [
        (
            row["name"],
            row["where"],
            row["outcome"] + (f": `{row['stopped_by']}`" if row["outcome"] not in ("done", "refused") else ""),
            str(row["rc"]),
            fallen(row),
            f"{row['peak_joint_speed_share']:.2f}" if "peak_tilt_rad" in row else "–",
            f"{row['peak_tilt_rad']:.2f}" if "peak_tilt_rad" in row else "–",
            "whole" if row["log_complete"] else "**no**",
        )
        for row in rows
    ]
    return markdown_table(head, cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="go2")
    parser.add_argument("--motion", default="trot")
    parser.add_argument("--instants", type=int, default=8, help="at which a fault comes in the motion, in lock step")
    parser.add_argument("--wire", action="store_true", help="also between processes, in real time")
    parser.add_argument("--domain", type=int, default=97, help="DDS domain of the first of these")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    robot = load_robot(args.robot)
    motion = load_motion(args.motion, robot)
    sequence = make_sequence(robot, motion, DeployOptions().controller(motion)[1])
    rows = []
    for case in cases():
        if args.only in case.name:
            rows.append(at_instants(robot, sequence, case, args.instants))
            print(line(rows[-1]), file=sys.stderr, flush=True)
    for i, wired in enumerate(WIRE if args.wire else ()):
        if args.only in wired.name:
            rows.append(on_the_wire(args.motion, robot, wired, args.domain + i))
            print(line(rows[-1]), file=sys.stderr, flush=True)
    if args.write:
        put(PAGE, "faults", "\n".join(table(rows)))
    if args.json:
        print(json.dumps({"cases": rows}, indent=1))


if __name__ == "__main__":
    main()
