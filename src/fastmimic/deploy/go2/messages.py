"""The Go2's low-level messages in C's layout, converted to and from the project's units; and its services (JSON on
rt/api/SERVICE/request and …/response), with the release of its motion service.

Fields are those of Unitree's IDL, in `unitree.idl`; a quadruped uses the first 12 of the 20 motors. CDR's alignment
differs from C's between nested structures; the checksum covers C's layout with its padding. Joints (FR, FL, RR, RL;
hip, thigh, calf), signs and quaternion (w, x, y, z; body → world) are the project's; the IMU's axes the body's.
"""

import json
import math
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Records
from fastmimic.base.errors import DriverError
from fastmimic.base.rotations import roll_pitch_from_quat, yaw_from_quat
from fastmimic.deploy.dds.cyclone import LOOPBACK, Participant, TextReader, Writer
from fastmimic.deploy.dds.types import messages_of

LOW_COMMAND_TOPIC: Final = "rt/lowcmd"
LOW_STATE_TOPIC: Final = "rt/lowstate"
HEAD: Final = (0xFE, 0xEF)
LOW_LEVEL: Final = 0xFF  # the level flag of commands to the motors
SERVO: Final = 0x01  # the motor follows commands; 0 switches it off
STOP_POSITION: Final = 2.146e9  # no position: the stiffness does not act
STOP_VELOCITY: Final = 16000.0  # no velocity: the damping does not act
RATE_HZ: Final = 500.0  # of states and commands
TICKS_PER_STATE: Final = 2  # a tick is 1 ms
FOOT_COUNTS_PER_N: Final = 1.0  # assumed: the vendor gives no unit of the foot sensors
_BITS_REVERSED: Final = bytes(int(f"{octet:08b}"[::-1], 2) for octet in range(256))

_TYPES: Final = messages_of(Path(__file__).with_name("unitree.idl").read_text(encoding="utf-8"))
LowCommand: Final = _TYPES["unitree_go::msg::dds_::LowCmd_"]
LowState: Final = _TYPES["unitree_go::msg::dds_::LowState_"]
Request: Final = _TYPES["unitree_api::msg::dds_::Request_"]
Response: Final = _TYPES["unitree_api::msg::dds_::Response_"]

MOTION_SWITCHER: Final = "motion_switcher"
CHECK_MODE: Final = 1001
SELECT_MODE: Final = 1002
RELEASE_MODE: Final = 1003
SPORT: Final = "sport"
STAND_UP: Final = 1004
STAND_DOWN: Final = 1005

NOT_IMPLEMENTED: Final = 3203  # code of the answer to an unknown request

FIND_S: Final = 1.0  # for a service on this computer to be found
ANSWER_S: Final = 5.0
LIE_DOWN_S: Final = 10.0  # for the robot to lie down
SETTLE_S: Final = 0.5  # from when it looks as if it lay
RELEASE_S: Final = 10.0


def crc32(words: NDArray[np.uint32]) -> int:
    """Unitree's checksum of a message (n,) in C's layout, as little-endian words, without the last, which holds it:
    CRC-32/MPEG-2 (polynomial 0x04c11db7, from 0xffffffff) over big-endian words: zlib's with all bits reversed."""
    reversed_crc = zlib.crc32(words[:-1].byteswap().tobytes().translate(_BITS_REVERSED)) ^ 0xFFFFFFFF
    return int(f"{reversed_crc:032b}"[::-1], 2)


class CommandWire:
    """Converts command messages, `record` (n,) of `LowCommand`, in memory; writes only the first."""

    def __init__(self, record: Records) -> None:
        self.record = record
        motors = record["motor_cmd"]
        names = {"joint_pos": "q", "joint_vel": "dq", "stiffness": "kp", "damping": "kd", "torque": "tau"}
        self._fields = [(name, motors[wire][:, :12]) for name, wire in names.items()]
        self._modes = motors["mode"][:, :12]
        self._words = record.view(np.uint32).reshape(len(record), -1)

    def clear(self) -> None:
        """Sets what all commands share: head, level, and unused motors without a target."""
        self.record[...] = np.zeros((), self.record.dtype)
        self.record["head"] = HEAD
        self.record["level_flag"] = LOW_LEVEL
        motors = self.record["motor_cmd"]
        motors["mode"], motors["q"], motors["dq"] = SERVO, STOP_POSITION, STOP_VELOCITY

    def write(self, command: Records) -> None:
        """Puts (1,) of `COMMAND` into the first message, with its checksum."""
        for name, wire in self._fields:
            wire[0] = command[name][0]
        self._words[0, -1] = crc32(self._words[0])

    def intact(self, i: int) -> bool:
        """Whether message i has the right head, level and checksum, and is finite."""
        record = self.record[i]
        return (
            tuple(record["head"]) == HEAD
            and record["level_flag"] == LOW_LEVEL
            and int(self._words[i, -1]) == crc32(self._words[i])
            and all(bool(np.isfinite(wire[i]).all()) for _, wire in self._fields)
        )

    def read(self, i: int, command: Records) -> None:
        """Puts message i into (1,) of `COMMAND`; without a position or velocity the gain is 0."""
        for name, wire in self._fields:
            command[name][0] = wire[i]
        command["stiffness"][command["joint_pos"] >= STOP_POSITION / 2] = 0.0
        command["damping"][command["joint_vel"] >= STOP_VELOCITY] = 0.0
        for name in ("stiffness", "damping", "torque"):
            command[name][0][self._modes[i] != SERVO] = 0.0
        command["joint_pos"][command["stiffness"] == 0.0] = 0.0
        command["joint_vel"][command["damping"] == 0.0] = 0.0


class StateWire:
    """Converts state messages, `record` (n,) of `LowState`, in memory; writes only the first."""

    def __init__(self, record: Records) -> None:
        self.record = record
        imu, motors = record["imu_state"], record["motor_state"]
        of_imu = {"quat": "quaternion", "gyro": "gyroscope", "accel": "accelerometer"}
        of_motors = {"joint_pos": "q", "joint_vel": "dq", "torque": "tau_est"}
        self._fields = [(name, imu[wire]) for name, wire in of_imu.items()]
        self._fields += [(name, motors[wire][:, :12]) for name, wire in of_motors.items()]
        self._rpy, self._feet, self._ticks = imu["rpy"], record["foot_force"], record["tick"]
        self._words = record.view(np.uint32).reshape(len(record), -1)

    def clear(self) -> None:
        """Sets the unused fields to a healthy robot's values."""
        self.record[...] = np.zeros((), self.record.dtype)
        self.record["head"] = HEAD
        self.record["level_flag"] = LOW_LEVEL
        self.record["imu_state"]["temperature"] = 60
        motors = self.record["motor_state"]
        motors["mode"][:, :12], motors["temperature"][:, :12] = SERVO, 35
        battery = self.record["bms_state"]
        battery["soc"], battery["current"], battery["cycle"] = 90, -2500, 10
        battery["bq_ntc"], battery["mcu_ntc"], battery["cell_vol"][:, :8] = 30, 32, 3900
        self.record["temperature_ntc1"], self.record["temperature_ntc2"] = 40, 40
        self.record["power_v"], self.record["power_a"] = 31.2, 2.5

    def write(self, reading: Records, tick: int) -> None:
        """Puts (1,) of `READING` into the first message, with its tick (ms) and checksum."""
        for name, wire in self._fields:
            wire[0] = reading[name][0]
        quat = reading["quat"][0]
        self._rpy[0] = (*roll_pitch_from_quat(quat), yaw_from_quat(quat))
        self._feet[0] = np.clip(np.rint(FOOT_COUNTS_PER_N * reading["foot_force"][0]), -32768, 32767)
        self._ticks[0] = tick & 0xFFFFFFFF
        self._words[0, -1] = crc32(self._words[0])

    def read(self, i: int, reading: Records) -> "Received":
        """Puts message i into (1,) of `READING`; returns what the checks need."""
        for name, wire in self._fields:
            reading[name][0] = wire[i]
        reading["foot_force"][0] = self._feet[i]
        reading["foot_force"] /= FOOT_COUNTS_PER_N
        w, x, y, z = reading["quat"][0].tolist()
        norm = w * w + x * x + y * y + z * z
        oriented = 0.8 < norm < 1.2
        if oriented:
            reading["quat"] /= math.sqrt(norm)
        sound = oriented and bool(np.isfinite(reading.view(np.float64)).all())
        return Received(int(self._words[i, -1]), crc32(self._words[i]), sound, int(self._ticks[i]))


class Received(NamedTuple):
    """What the checks of a state message need."""

    checksum: int  # in the message
    expected: int
    sound: bool  # finite, with a valid quaternion
    tick: int  # ms


class Answer(NamedTuple):
    """An error code, 0 for none, and the result."""

    code: int
    data: dict[str, Any]


class ServiceClient:
    def __init__(self, participant: Participant, service: str) -> None:
        self._service = service
        self._requests = Writer(participant, f"rt/api/{service}/request", Request)
        self._responses = TextReader(participant, f"rt/api/{service}/response", Response)

    def find(self, timeout_s: float = FIND_S) -> bool:
        """Waits for the service; returns whether there is one."""
        end = time.monotonic() + timeout_s
        while self._requests.matched() == 0:
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        time.sleep(0.2)  # for it to find the reader of its answers
        return True

    def ask(self, api_id: int) -> Answer:
        """Sends a request and waits for its answer; raises `DriverError` if none comes."""
        request = self._requests.message
        number = time.monotonic_ns()
        request.header.identity.id, request.header.identity.api_id = number, api_id
        request.parameter = b"{}"
        self._responses.take(_heard)  # discards old answers
        self._requests.write()
        end = time.monotonic() + ANSWER_S
        while time.monotonic() < end:
            for identity, answer in self._responses.take(_heard):
                if identity == number:
                    return answer
            time.sleep(0.005)
        raise DriverError(f"the robot's service '{self._service}' does not answer request {api_id}")


class ServiceServer:
    """The simulated robot's side of a service; each handler, by api id, returns its result, None for an empty one."""

    def __init__(self, participant: Participant, service: str, handlers: dict[int, Callable[[], Any]]) -> None:
        self.handlers = handlers
        self._requests = TextReader(participant, f"rt/api/{service}/request", Request)
        self._responses = Writer(participant, f"rt/api/{service}/response", Response)

    def poll(self) -> None:
        """Answers the requests that have arrived."""
        asked = self._requests.take(lambda request: (request.header.identity.id, request.header.identity.api_id))
        for number, api_id in asked:
            handler = self.handlers.get(api_id)
            response = self._responses.message
            response.header.identity.id, response.header.identity.api_id = number, api_id
            response.header.status.code = 0 if handler else NOT_IMPLEMENTED
            response.data = json.dumps((handler() if handler else None) or {}).encode()
            self._responses.write()


def release_motion_service(
    participant: Participant, lies: Callable[[], bool], say: Callable[[str], None], *, find_far_s: float = 5.0
) -> None:
    """Makes a robot's motion service release the motors, once the robot lies: standing, it would fall. `lies` says
    whether it lies now, `say` takes lines on progress. A simulator on this computer need not have such a service; one
    elsewhere is looked for during `find_far_s`.
    Raises `DriverError`: a robot without it, or one that does not answer, lie down or release the motors."""
    switcher = ServiceClient(participant, MOTION_SWITCHER)
    here = participant.interface == LOOPBACK
    if not switcher.find(FIND_S if here else find_far_s):
        if here:
            return
        said = f"no service '{MOTION_SWITCHER}' on '{participant.interface}'"
        raise DriverError(f"{said}, so the robot's own software may command the motors: nothing is sent to them")
    released = mode = _active_mode(switcher)
    if mode is None:
        return
    if not lies():
        say(f"the robot's motion service '{mode}' is active: it lies down first")
        _lie_down(participant, lies)
    end = time.monotonic() + RELEASE_S
    while mode is not None:
        if time.monotonic() > end:
            raise DriverError(f"the robot's motion service '{mode}' does not release the motors")
        switcher.ask(RELEASE_MODE)
        mode = _active_mode(switcher)
    say(f"the robot's motion service '{released}' was released")


def _lie_down(participant: Participant, lies: Callable[[], bool]) -> None:
    sport = ServiceClient(participant, SPORT)
    code = sport.ask(STAND_DOWN).code if sport.find() else None
    end = time.monotonic() + LIE_DOWN_S
    while not lies():
        if code != 0 or time.monotonic() > end:
            why = "it has no sport service" if code is None else f"its service answered with code {code}"
            said = f"the motors can be released only after the robot lies, but {why} and it still stands"
            raise DriverError(f"{said}: lie it down by its remote control")
        time.sleep(0.05)
    time.sleep(SETTLE_S)


def _active_mode(switcher: ServiceClient) -> str | None:
    answer = switcher.ask(CHECK_MODE)
    if answer.code != 0:
        raise DriverError(f"the robot does not report whether its motion service is active (code {answer.code})")
    return str(answer.data.get("name") or "") or None


def _heard(response: Any) -> tuple[int, Answer]:
    try:
        data = json.loads((response.data or b"").decode(errors="replace") or "{}")
    except ValueError:
        data = {}
    return response.header.identity.id, Answer(response.header.status.code, data if isinstance(data, dict) else {})
