"""The Go2's driver against a publisher that says what each test wants, and against nobody."""

import contextlib
import ctypes
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="CycloneDDS is not installed")

from deploy.dds_domains import free_domain, unicast_ports
from fastmimic.base.errors import DriverError
from fastmimic.deploy.dds.cyclone import MAX_PARTICIPANTS, Participant, Reader, Writer
from fastmimic.deploy.dds.types import Message, program
from fastmimic.deploy.driver import damping_command
from fastmimic.deploy.go2 import messages
from fastmimic.deploy.go2.driver import Go2Driver
from fastmimic.deploy.go2.messages import (
    LOW_COMMAND_TOPIC,
    LOW_STATE_TOPIC,
    CommandWire,
    LowCommand,
    LowState,
    StateWire,
)
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.state import COMMAND, READING


@pytest.fixture(scope="module")
def go2() -> Robot:
    return load_robot("go2")


class Publisher:
    """A robot that says what it is told to."""

    def __init__(self, robot: Robot, domain: int) -> None:
        self.domain = domain
        self.participant = Participant(domain)
        self._writer = Writer(self.participant, LOW_STATE_TOPIC, LowState)
        assert self._writer.record is not None
        self.record = self._writer.record
        self.commands = Reader(self.participant, LOW_COMMAND_TOPIC, LowCommand, 64)
        self.wire = StateWire(self.record)
        self.wire.clear()
        self.reading = np.zeros(1, READING)
        self.reading["quat"] = [1, 0, 0, 0]
        self.reading["joint_pos"] = robot.home_joint_pos
        self.tick = 0
        self.spoil: Callable[[np.ndarray[Any, Any]], None] = lambda record: None

    def send(self, tick: int | None = None) -> None:
        """A state, by default the next one."""
        self.tick = self.tick + 2 if tick is None else tick
        self.wire.write(self.reading, self.tick)
        self.spoil(self.record)
        self._writer.write()

    @contextlib.contextmanager
    def talking(self) -> Iterator[None]:
        """Sends at 500 Hz meanwhile."""
        stop = threading.Event()

        def talk() -> None:
            while not stop.wait(0.002):
                self.send()

        thread = threading.Thread(target=talk)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


@pytest.fixture
def publisher(go2: Robot) -> Iterator[Publisher]:
    found = Publisher(go2, free_domain())
    yield found
    found.participant.close()


@pytest.fixture
def driver(go2: Robot, publisher: Publisher) -> Iterator[Go2Driver]:
    """An open one, and nothing under way."""
    found = Go2Driver(go2, domain=publisher.domain, release=False)
    with publisher.talking():
        found.open()
    while found.read(0.1) is not None:
        pass
    found.packets.received = found.packets.lost = found.packets.rejected = 0
    yield found
    found.close()


def newest(driver: Go2Driver) -> Any:
    """What has arrived, once it has had the time to."""
    time.sleep(0.05)
    return driver.read()


def test_a_state_becomes_a_reading(driver: Go2Driver, publisher: Publisher) -> None:
    publisher.reading["gyro"] = [0.1, -0.2, 0.3]
    publisher.reading["accel"] = [0, 0, 9.81]
    publisher.reading["joint_vel"] = np.arange(12) / 8
    publisher.reading["torque"] = -np.arange(12) / 4
    publisher.reading["foot_force"] = [10, 20, 30, 40]
    publisher.send()
    before = time.perf_counter()
    state = driver.read(5.0)
    assert state is not None
    for name in READING.names or ():
        assert state.reading[name] == pytest.approx(publisher.reading[name], abs=1e-6), name
    assert state.sequence == publisher.tick
    assert before <= state.received <= time.perf_counter()
    publisher.reading["gyro"] = 7.0
    publisher.send()
    assert newest(driver).reading["gyro"][0] == pytest.approx([7, 7, 7])
    assert state.reading["gyro"][0] == pytest.approx([0.1, -0.2, 0.3])


def test_only_the_newest_state_is_returned_and_all_are_counted(driver: Go2Driver, publisher: Publisher) -> None:
    for _ in range(5):
        publisher.send()
    state = newest(driver)
    assert state.sequence == publisher.tick
    assert driver.packets.received == 5
    assert driver.read() is None


def test_a_state_with_a_wrong_checksum_is_rejected(driver: Go2Driver, publisher: Publisher) -> None:
    def flip(record: np.ndarray[Any, Any]) -> None:
        record.view(np.uint8)[100] ^= 4

    publisher.spoil = flip
    publisher.send()
    assert newest(driver) is None
    assert (driver.packets.received, driver.packets.rejected) == (0, 1)


def test_a_state_without_a_checksum_is_rejected_after_ones_with(driver: Go2Driver, publisher: Publisher) -> None:
    publisher.spoil = lambda record: record["crc"].fill(0)
    publisher.send()
    assert newest(driver) is None
    assert driver.packets.rejected == 1


@pytest.mark.parametrize(("field", "value"), [("joint_pos", np.nan), ("gyro", np.inf), ("quat", 0.0)])
def test_a_state_that_makes_no_sense_is_rejected(
    driver: Go2Driver, publisher: Publisher, field: str, value: float
) -> None:
    publisher.reading[field][0, 0] = value
    publisher.send()
    assert newest(driver) is None
    assert driver.packets.rejected == 1


def test_duplicates_and_stragglers_are_rejected_and_gaps_are_counted(driver: Go2Driver, publisher: Publisher) -> None:
    at = publisher.tick
    for tick in (at + 2, at + 2, at + 8, at + 6, at + 10):
        publisher.send(tick)
    assert newest(driver).sequence == at + 10
    packets = driver.packets
    assert (packets.received, packets.rejected, packets.lost) == (3, 2, 2)


def test_a_command_reaches_the_motors(driver: Go2Driver, publisher: Publisher) -> None:
    command = damping_command(2.5)
    command["joint_pos"], command["stiffness"], command["torque"] = np.arange(12) / 8, 30.0, -1.5
    driver.write(command)
    assert publisher.commands.wait(5.0)
    assert publisher.commands.take() == 1
    wire, arrived = CommandWire(publisher.commands.samples), np.zeros(1, COMMAND)
    assert wire.intact(0)
    wire.read(0, arrived)
    assert arrived == command
    assert driver.packets.sent == 1


def test_a_command_that_is_not_finite_is_not_sent(driver: Go2Driver, publisher: Publisher) -> None:
    command = damping_command()
    command["torque"][0, 3] = np.nan
    with pytest.raises(DriverError, match="not finite"):
        driver.write(command)
    assert not publisher.commands.wait(0.2)


def test_opening_and_closing_send_nothing(go2: Robot, publisher: Publisher) -> None:
    driver = Go2Driver(go2, domain=publisher.domain)
    with publisher.talking(), driver:
        pass
    driver.close()
    taken = publisher.commands.take()
    assert not publisher.commands.valid[:taken].any()
    assert driver.packets.sent == 0


def test_a_robot_elsewhere_whose_software_cannot_be_asked_is_not_taken_over(publisher: Publisher) -> None:
    with contextlib.closing(Participant(publisher.domain)) as participant:
        participant.interface = "another"
        with pytest.raises(DriverError, match="no service 'motion_switcher' on 'another'"):
            messages.release_motion_service(participant, lambda: True, print, find_far_s=0.1)


def test_a_publisher_without_checksums_and_ticks_is_taken_as_it_is(go2: Robot, publisher: Publisher) -> None:
    """As unitree_mujoco in Python, which fills in neither."""

    def bare(record: np.ndarray[Any, Any]) -> None:
        record["crc"], record["tick"] = 0, 0

    publisher.spoil = bare
    with publisher.talking(), Go2Driver(go2, domain=publisher.domain) as driver:
        first, second = driver.read(5.0), driver.read(5.0)
    assert first is not None
    assert second is not None
    assert second.sequence > first.sequence
    assert driver.packets.rejected == driver.packets.lost == 0


def test_checksums_that_are_all_wrong_mean_another_version(go2: Robot, publisher: Publisher) -> None:
    publisher.spoil = lambda record: record["crc"].fill(77)
    with publisher.talking(), pytest.raises(DriverError, match="wrong checksums"):
        Go2Driver(go2, domain=publisher.domain).open()


def test_joints_outside_the_robots_limits_mean_another_robot(go2: Robot, publisher: Publisher) -> None:
    publisher.reading["joint_pos"][0, 5] = 1.9
    with publisher.talking(), pytest.raises(DriverError, match=r"FL_knee.* 1\.90 rad, outside the go2's"):
        Go2Driver(go2, domain=publisher.domain, timeout_s=1.0).open()


def test_two_robots_in_one_domain_are_not_told_apart(go2: Robot, publisher: Publisher) -> None:
    other = Publisher(go2, publisher.domain)
    with (
        contextlib.closing(other.participant),
        publisher.talking(),
        other.talking(),
        pytest.raises(DriverError, match="2 robots"),
    ):
        Go2Driver(go2, domain=publisher.domain).open()


def test_a_robot_that_somebody_else_commands_is_left_to_him(
    go2: Robot, driver: Go2Driver, publisher: Publisher
) -> None:
    stop = threading.Event()

    def command() -> None:
        while not stop.wait(0.002):
            driver.write(damping_command())

    thread = threading.Thread(target=command)
    thread.start()
    try:
        with publisher.talking(), pytest.raises(DriverError, match="another program sends commands"):
            Go2Driver(go2, domain=publisher.domain).open()
        with publisher.talking(), Go2Driver(go2, domain=publisher.domain, release=False) as onlooker:
            assert onlooker.read(5.0) is not None
    finally:
        stop.set()
        thread.join()


def test_a_second_robot_that_comes_later_is_not_listened_to(
    go2: Robot, driver: Go2Driver, publisher: Publisher
) -> None:
    publisher.send()
    assert newest(driver) is not None
    other = Publisher(go2, publisher.domain)
    with contextlib.closing(other.participant):
        other.send(publisher.tick + 2)
        assert newest(driver) is None
    assert driver.packets.rejected == 1


def test_silence_is_said_to_be_that(go2: Robot) -> None:
    domain = free_domain()
    with pytest.raises(DriverError, match=rf"no robot's state within 0.3 s in DDS domain {domain} on 'lo'"):
        Go2Driver(go2, domain=domain, timeout_s=0.3).open()


class HumanoidState(Message):
    """Of another family, under the same topic."""

    typename = "unitree_hg::msg::dds_::LowState_"
    _fields_ = LowState._fields_


def test_a_robot_of_another_family_is_named(go2: Robot) -> None:
    domain = free_domain()
    with contextlib.closing(Participant(domain)) as participant:
        Writer(participant, LOW_STATE_TOPIC, HumanoidState)
        with pytest.raises(DriverError, match=r"not of the Go2's family.*unitree_hg"):
            Go2Driver(go2, domain=domain, timeout_s=0.5).open()


def test_an_unknown_interface_is_named_with_those_that_are_there(go2: Robot) -> None:
    with pytest.raises(DriverError, match="no network interface 'nowhere0'.*" + socket.if_nameindex()[0][1]):
        Go2Driver(go2, interface="nowhere0").open()


@pytest.mark.parametrize("domain", [-1, 231])
def test_a_domain_has_a_number(go2: Robot, domain: int) -> None:
    with pytest.raises(DriverError, match="a number from 0 to 230"):
        Go2Driver(go2, domain=domain).open()


def test_a_full_domain_is_said_to_be_that(go2: Robot) -> None:
    domain = free_domain()
    with contextlib.ExitStack() as stack:
        for port in unicast_ports(domain)[: 2 * MAX_PARTICIPANTS]:
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)).bind(("127.0.0.1", port))
        with pytest.raises(DriverError, match=f"no place left in DDS domain {domain}"):
            Go2Driver(go2, domain=domain).open()
    Participant(domain).close()  # and then there is again


def test_a_missing_library_is_one_line_with_the_command_that_mends_it(
    go2: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fastmimic.deploy.dds import cyclone

    monkeypatch.setitem(__import__("sys").modules, "cyclonedds.internal", None)
    monkeypatch.setattr(cyclone, "cyclone", cyclone.cyclone.__wrapped__)
    with pytest.raises(DriverError, match=r"pip install 'fastmimic\[go2\]'"):
        Go2Driver(go2).open()


@pytest.mark.slow
def test_a_driver_can_be_opened_again(go2: Robot, publisher: Publisher) -> None:
    driver = Go2Driver(go2, domain=publisher.domain)
    with publisher.talking():
        for _ in range(2):
            with driver:
                assert driver.read(5.0) is not None


def test_nested_structures_are_unrolled_into_one_program() -> None:
    class Inner(Message):
        _fields_ = [("flag", ctypes.c_uint8), ("value", ctypes.c_float)]  # noqa: RUF012

    class Outer(Message):
        _fields_ = [("head", ctypes.c_uint16), ("inner", Inner * 2), ("last", ctypes.c_int32 * 3)]  # noqa: RUF012

    # dds/ddsc/dds_opcodes.h: ADR with type and flags (signed 8, floating point 4), offset, and an array's length
    short, octet, real, array = 0x01020000, 0x01010000, 0x01030004, 0x01080308
    assert program(Outer) == [short, 0, octet, 4, real, 8, octet, 12, real, 16, array, 20, 3]
