"""What the Go2's wire costs: messages, checksums, and the way to another process and back over loopback.

    python benchmarks/wire.py [--seconds 10] [--json]

Commands of 500 Hz go to a process that answers each with a state at once, as a robot does on its own clock. `round
trip` is from handing over a command to having the reading of its answer; `lost` counts both ways.
"""

import argparse
import contextlib
import json
import multiprocessing
import time
from typing import Any

import numpy as np

from fastmimic.deploy.dds.cyclone import Participant, Reader, Writer
from fastmimic.deploy.go2.messages import (
    LOW_COMMAND_TOPIC,
    LOW_STATE_TOPIC,
    RATE_HZ,
    CommandWire,
    LowCommand,
    LowState,
    StateWire,
    crc32,
)
from fastmimic.robot import load_robot
from fastmimic.robot.state import COMMAND, READING


def answer(domain: int, ready: Any, stop: Any) -> None:
    """The other process: a state for each command, with the command's number as its tick."""
    reading = np.zeros(1, READING)
    reading["quat"][0, 0] = 1.0
    with contextlib.closing(Participant(domain)) as participant:
        reader = Reader(participant, LOW_COMMAND_TOPIC, LowCommand)
        writer = Writer(participant, LOW_STATE_TOPIC, LowState)
        assert writer.record is not None
        state, commands = StateWire(writer.record), CommandWire(reader.samples)
        state.clear()
        state.write(reading, 0)
        commands.intact(0)
        ready.set()
        while not stop.is_set():
            reader.wait(0.1)
            for i in range(reader.take()):
                if reader.valid[i] and commands.intact(i):
                    state.write(reading, round(float(reader.samples["motor_cmd"]["tau"][i, 0])))
                    writer.write()


def microseconds(call: Any, times: int = 3000) -> float:
    """The median of a call's duration, µs."""
    taken = np.zeros(times)
    for k in range(times):
        begin = time.perf_counter()
        call()
        taken[k] = time.perf_counter() - begin
    return float(np.median(taken) * 1e6)


def pieces() -> dict[str, float]:
    """What happens in one process, µs."""
    sent, got = np.zeros(1, np.dtype(LowCommand)), np.zeros(1, np.dtype(LowState))
    command, reading = np.zeros(1, COMMAND), np.zeros(1, READING)
    commands, states = CommandWire(sent), StateWire(got)
    commands.clear()
    states.clear()
    reading["quat"][0, 0] = 1.0
    states.write(reading, 1)
    words = got.view(np.uint32).reshape(-1)
    return {
        "command_to_message_us": microseconds(lambda: commands.write(command)),
        "checksum_of_a_state_us": microseconds(lambda: crc32(words)),
        "message_to_reading_us": microseconds(lambda: states.read(0, reading)),
    }


def over_loopback(domain: int, seconds: float) -> dict[str, float]:
    """To another process and back."""
    context = multiprocessing.get_context("spawn")
    ready, stop = context.Event(), context.Event()
    process = context.Process(target=answer, args=(domain, ready, stop))
    process.start()
    robot, command, reading = load_robot("go2"), np.zeros(1, COMMAND), np.zeros(1, READING)
    command["joint_pos"] = robot.home_joint_pos
    taken, writing, sent, received, wrong = [], [], 0, 0, 0
    try:
        ready.wait(60)
        with contextlib.closing(Participant(domain)) as participant:
            writer = Writer(participant, LOW_COMMAND_TOPIC, LowCommand)
            reader = Reader(participant, LOW_STATE_TOPIC, LowState)
            assert writer.record is not None
            commands, states = CommandWire(writer.record), StateWire(reader.samples)
            commands.clear()
            while not (writer.matched() and reader.matched()):
                time.sleep(0.05)
            time.sleep(0.5)
            due = time.perf_counter()
            while sent < seconds * RATE_HZ:
                sent += 1
                command["torque"][0, 0] = sent
                begin = time.perf_counter()
                commands.write(command)
                writer.write()
                writing.append(time.perf_counter() - begin)
                due += 1.0 / RATE_HZ
                while (left := due - time.perf_counter()) > 0:
                    reader.wait(left)
                    for i in range(reader.take()):
                        state = states.read(i, reading)
                        wrong += state.checksum != state.expected
                        received += 1
                        if state.tick == sent:
                            taken.append(time.perf_counter() - begin)
                due = max(due, time.perf_counter() - 0.02)
            reader.wait(0.2)
            received += reader.take()
    finally:
        stop.set()
        process.join(10)
    trip, write = np.array(taken) * 1e6, np.array(writing) * 1e6
    return {
        "sent": sent,
        "lost": sent - received,
        "wrong": wrong,
        "write_p50_us": float(np.median(write)),
        "write_p99_us": float(np.percentile(write, 99)),
        "round_trip_p50_us": float(np.median(trip)),
        "round_trip_p99_us": float(np.percentile(trip, 99)),
        "round_trip_max_us": float(trip.max()),
    }


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--domain", type=int, default=101)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = pieces() | over_loopback(arguments.domain, arguments.seconds)
    if arguments.json:
        print(json.dumps({name: round(value, 1) for name, value in found.items()}, indent=1))
        return
    for name, value in found.items():
        unit = " µs" if name.endswith("_us") else ""
        print(f"{name.removesuffix('_us').replace('_', ' '):24} {value:8.0f}{unit}")


if __name__ == "__main__":
    main()
