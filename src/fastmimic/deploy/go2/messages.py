"""The Go2's low-level messages in C's layout, converted to and from the project's units.

Fields are those of Unitree's IDL, in `unitree.idl`; a quadruped uses the first 12 of the 20 motors. CDR's alignment
differs from C's between nested structures; the checksum covers C's layout with its padding. Joints (FR, FL, RR, RL;
hip, thigh, calf), their signs and the quaternion (w, x, y, z; body → world) are the project's; the IMU's axes are the
body's.
"""

import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.jit import kernel
from fastmimic.deploy.dds import messages_of
from fastmimic.deploy.go2.crc import TABLE, checksum, crc32

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

_TYPES: Final = messages_of(Path(__file__).with_name("unitree.idl").read_text(encoding="utf-8"))
LowCommand: Final = _TYPES["unitree_go::msg::dds_::LowCmd_"]
LowState: Final = _TYPES["unitree_go::msg::dds_::LowState_"]
Request: Final = _TYPES["unitree_api::msg::dds_::Request_"]
Response: Final = _TYPES["unitree_api::msg::dds_::Response_"]


class CommandWire:
    """Converts command messages, `record` (n,) of `LowCommand`, in memory; writes only the first."""

    def __init__(self, record: NDArray[Any]) -> None:
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

    def write(self, command: NDArray[Any]) -> None:
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

    def read(self, i: int, command: NDArray[Any]) -> None:
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

    def __init__(self, record: NDArray[Any]) -> None:
        self.record = record
        imu, motors = record["imu_state"], record["motor_state"]
        self._fields = [
            ("quat", imu["quaternion"]),
            ("gyro", imu["gyroscope"]),
            ("accel", imu["accelerometer"]),
            ("joint_pos", motors["q"][:, :12]),
            ("joint_vel", motors["dq"][:, :12]),
            ("torque", motors["tau_est"][:, :12]),
        ]
        self._rpy = imu["rpy"]
        self._feet = record["foot_force"]
        self._words, self._floats, self._shorts = (
            record.view(kind).reshape(len(record), -1) for kind in (np.uint32, np.float32, np.int16)
        )

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

    def write(self, reading: NDArray[Any], tick: int) -> None:
        """Puts (1,) of `READING` into the first message, with its tick (ms) and checksum."""
        for name, wire in self._fields:
            wire[0] = reading[name][0]
        self._rpy[0] = roll_pitch_yaw(reading["quat"][0])
        counts = np.clip(np.rint(FOOT_COUNTS_PER_N * reading["foot_force"][0]), -32768, 32767)
        self._feet[0] = counts
        self.record["tick"] = tick & 0xFFFFFFFF
        self._words[0, -1] = crc32(self._words[0])

    def read(self, i: int, reading: NDArray[Any]) -> "Received":
        """Puts message i into (1,) of `READING`; returns what the checks need."""
        return Received(*_read_state(self._words[i], self._floats[i], self._shorts[i], _STATE_WORDS, TABLE, reading))


class Received(NamedTuple):
    """What the checks of a state message need.

    Attributes:
        checksum, expected: the checksum in the message and the right one.
        sound: whether it is finite, with a valid quaternion.
        tick: ms.
    """

    checksum: int
    expected: int
    sound: bool
    tick: int


def _state_words() -> NDArray[np.int64]:
    """Word offsets: quaternion, gyroscope, accelerometer; q, dq, tau_est of motor 0; motor stride; foot forces;
    tick."""
    state = np.dtype(LowState)
    imu, motors = state["imu_state"], state["motor_state"].base
    at = {name: state.fields[name][1] for name in ("imu_state", "motor_state", "foot_force", "tick")}
    octets = [at["imu_state"] + imu.fields[name][1] for name in ("quaternion", "gyroscope", "accelerometer")]
    octets += [at["motor_state"] + motors.fields[name][1] for name in ("q", "dq", "tau_est")]
    return np.array([*octets, motors.itemsize, at["foot_force"], at["tick"]], np.int64) // 4


_STATE_WORDS: Final = _state_words()


@kernel
def _read_state(words: Any, floats: Any, shorts: Any, at: Any, table: Any, out: Any) -> tuple[Any, Any, bool, Any]:
    reading = out[0]
    norm = 0.0
    for k in range(4):
        reading.quat[k] = floats[at[0] + k]
        norm += reading.quat[k] * reading.quat[k]
        reading.foot_force[k] = shorts[2 * at[7] + k] / FOOT_COUNTS_PER_N
    sound = norm > 0.8 and norm < 1.2
    if sound:
        for k in range(4):
            reading.quat[k] /= np.sqrt(norm)
    for k in range(3):
        reading.gyro[k], reading.accel[k] = floats[at[1] + k], floats[at[2] + k]
        sound = sound and np.isfinite(reading.gyro[k]) and np.isfinite(reading.accel[k])
    for j in range(12):
        motor = j * at[6]
        reading.joint_pos[j], reading.joint_vel[j] = floats[at[3] + motor], floats[at[4] + motor]
        reading.torque[j] = floats[at[5] + motor]
        sound = sound and np.isfinite(reading.joint_pos[j]) and np.isfinite(reading.joint_vel[j])
        sound = sound and np.isfinite(reading.torque[j])
    last = len(words) - 1
    return np.int64(words[last]), checksum(words, last, table), sound, np.int64(words[at[8]])


def roll_pitch_yaw(quat: NDArray[np.float64]) -> tuple[float, float, float]:
    """Angles about x, y and z, rad, of a unit quaternion (w, x, y, z)."""
    w, x, y, z = (float(v) for v in quat)
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
