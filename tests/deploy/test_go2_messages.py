"""The Go2's messages: Unitree's layout and checksum, and the project's units on this side of them."""

import ctypes
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastmimic.deploy.go2.messages import (
    FOOT_COUNTS_PER_N,
    STOP_POSITION,
    STOP_VELOCITY,
    CommandWire,
    LowCommand,
    LowState,
    StateWire,
    crc32,
)
from fastmimic.robot.state import COMMAND, READING

pytestmark = pytest.mark.nojit

POLYNOMIAL = 0x04C11DB7
COMMAND_FORMAT = "<4B4IH2x" + 20 * "B3x5f3I" + "4B55Bx2I"
STATE_FORMAT = "<4B4IH2x13fB3x" + 20 * "B3x7fB3x3I" + "4BiH4B15H" + "8hI41B3xf2B2x2f4H2I"
"""The messages as Unitree's SDK packs them for their checksum (unitree_sdk2_python, utils/crc.py)."""


def vendors_crc(packed: bytes) -> int:
    """Bit by bit over 32-bit words but the last, as Unitree describes it."""
    crc = 0xFFFFFFFF
    for (word,) in struct.iter_unpack("<I", packed[:-4]):
        for k in range(31, -1, -1):
            top = crc >> 31
            crc = crc << 1 & 0xFFFFFFFF
            if top:
                crc ^= POLYNOMIAL
            if word >> k & 1:
                crc ^= POLYNOMIAL
    return crc


def values(message: Any) -> list[Any]:
    """The numbers in a message, in order."""
    found: list[Any] = []
    for name in message.dtype.names:
        part = message[name]
        if part.dtype.names and part.ndim:
            found += [v for row in part for v in values(row)]
        elif part.dtype.names:
            found += values(part)
        else:
            found += np.ravel(part).tolist()
    return found


def empty(kind: Any) -> np.ndarray[Any, Any]:
    return np.zeros(1, np.dtype(kind))


def a_command() -> np.ndarray[Any, Any]:
    command = np.zeros(1, COMMAND)
    for k, name in enumerate(COMMAND.names or ()):
        command[name] = k + 0.125 * np.arange(12)
    return command


def a_reading() -> np.ndarray[Any, Any]:
    reading = np.zeros(1, READING)
    reading["quat"] = [0.8, 0.0, 0.6, 0.0]
    reading["gyro"], reading["accel"] = [0.5, -0.25, 0.125], [1.0, 2.0, 9.5]
    for k, name in enumerate(("joint_pos", "joint_vel", "torque")):
        reading[name] = k - 0.125 * np.arange(12)
    reading["foot_force"] = [0.0, 55.0, -3.0, 120.0]
    return reading


def test_the_layout_is_the_vendors() -> None:
    assert ctypes.sizeof(LowCommand) == struct.calcsize(COMMAND_FORMAT) == 812
    assert ctypes.sizeof(LowState) == struct.calcsize(STATE_FORMAT) == 1180


def test_the_crc_is_a_known_one_over_words_with_their_most_significant_byte_first() -> None:
    words = np.frombuffer(b"43218765" + b"\0\0\0\0", np.uint32)
    assert crc32(words) == vendors_crc(b"43218765\0\0\0\0") == mpeg2(b"12345678")


def mpeg2(data: bytes) -> int:
    """The textbook's: bit by bit, most significant first."""
    crc = 0xFFFFFFFF
    for octet in data:
        crc ^= octet << 24
        for _ in range(8):
            crc = (crc << 1 ^ POLYNOMIAL if crc >> 31 else crc << 1) & 0xFFFFFFFF
    return crc


def test_the_crc_of_nine_digits_is_the_catalogues() -> None:
    assert mpeg2(b"123456789") == 0x0376E6E7  # the check value of CRC-32/MPEG-2


def test_a_command_has_the_checksum_that_the_vendor_computes() -> None:
    record = empty(LowCommand)
    wire = CommandWire(record)
    wire.clear()
    wire.write(a_command())
    packed = struct.pack(COMMAND_FORMAT, *values(record[0]))
    assert packed == record.tobytes()
    assert record["crc"][0] == vendors_crc(packed)
    assert wire.intact(0)


def test_a_state_has_the_checksum_that_the_vendor_computes() -> None:
    record = empty(LowState)
    wire = StateWire(record)
    wire.clear()
    wire.write(a_reading(), 1234)
    packed = struct.pack(STATE_FORMAT, *values(record[0]))
    assert packed == record.tobytes()
    received = wire.read(0, np.zeros(1, READING))
    assert received == (vendors_crc(packed), vendors_crc(packed), True, 1234)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 811 - 4), st.integers(0, 7))
def test_any_flipped_bit_is_noticed(octet: int, bit: int) -> None:
    record = empty(LowCommand)
    wire = CommandWire(record)
    wire.clear()
    wire.write(a_command())
    record.view(np.uint8)[octet] ^= 1 << bit
    assert not wire.intact(0)


def test_a_command_arrives_as_it_was_sent() -> None:
    record, arrived = empty(LowCommand), np.zeros(1, COMMAND)
    wire = CommandWire(record)
    wire.clear()
    wire.write(a_command())
    wire.read(0, arrived)
    command = a_command()
    command["joint_pos"][command["stiffness"] == 0] = 0.0
    assert arrived == command


def test_unused_motors_get_no_target() -> None:
    record = empty(LowCommand)
    wire = CommandWire(record)
    wire.clear()
    wire.write(a_command())
    rest = record["motor_cmd"][0, 12:]
    assert (rest["q"] == np.float32(STOP_POSITION)).all()
    assert (rest["dq"] == STOP_VELOCITY).all()
    assert not rest["kp"].any()
    assert not rest["kd"].any()
    assert not rest["tau"].any()


def test_a_motor_follows_no_target_that_means_none_and_nothing_at_all_when_it_is_off() -> None:
    record, arrived = empty(LowCommand), np.zeros(1, COMMAND)
    wire = CommandWire(record)
    wire.clear()
    wire.write(a_command())
    motors = record["motor_cmd"][0]
    motors["q"][0], motors["dq"][1], motors["mode"][2] = STOP_POSITION, STOP_VELOCITY, 0
    wire.read(0, arrived)
    assert arrived["stiffness"][0, 0] == 0 < arrived["damping"][0, 0]
    assert arrived["damping"][0, 1] == 0 < arrived["stiffness"][0, 1]
    assert not any(arrived[name][0, 2] for name in ("stiffness", "damping", "torque"))
    assert np.isfinite(arrived.view(np.float64)).all()
    assert abs(arrived.view(np.float64)).max() < 100


def test_a_state_arrives_as_it_was_measured() -> None:
    record, arrived = empty(LowState), np.zeros(1, READING)
    wire = StateWire(record)
    wire.clear()
    wire.write(a_reading(), 7)
    wire.read(0, arrived)
    for name in READING.names or ():
        assert arrived[name] == pytest.approx(a_reading()[name], abs=1e-6)
    assert record["foot_force"][0].tolist() == [0, round(55 * FOOT_COUNTS_PER_N), round(-3 * FOOT_COUNTS_PER_N), 120]


@pytest.mark.parametrize("force", [1e9, -1e9])
def test_a_foot_force_beyond_the_sensors_range_stays_at_its_end(force: float) -> None:
    record, reading = empty(LowState), a_reading()
    reading["foot_force"] = force
    StateWire(record).write(reading, 1)
    assert abs(int(record["foot_force"][0, 0])) in (32767, 32768)
    assert record["foot_force"][0, 0] * force > 0


@pytest.mark.parametrize("broken", ["quat", "gyro", "joint_pos", "torque"])
def test_states_that_make_no_sense_are_not_sound(broken: str) -> None:
    record, reading = empty(LowState), a_reading()
    reading[broken] = np.nan
    wire = StateWire(record)
    wire.write(reading, 1) if broken != "quat" else None  # a quaternion of zeros
    assert not wire.read(0, np.zeros(1, READING)).sound
