"""`fastmimic deploy` and `fastmimic robot-sim`, two processes that know nothing of each other but the wire.

The limits of time are wide; `benchmarks/deploy.py` measures how well time is kept.
"""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="CycloneDDS is not installed")

from deploy.dds_domains import free_domain
from fastmimic.cli import main
from fastmimic.deploy.dds.cyclone import Participant, Writer
from fastmimic.deploy.driver import damping_command
from fastmimic.deploy.go2 import messages
from fastmimic.deploy.log import GROUND_TRUTH, ROBOT_SIM, load_ground_truth
from fastmimic.deploy.log_file import LogFile

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

PATIENT = ("--limit", "stale_s=2", "--limit", "overrun_s=2")
NO_LEAN = ("--limit", "lean=0")


class Sim:
    """A robot in a process of its own, whose foot sensors read 0, as those of Unitree's public simulator do."""

    def __init__(self, folder: Path) -> None:
        self.domain = free_domain()
        self.truth = folder / "truth.mcap"
        options = ["--domain", str(self.domain), "--watchdog-ms", "300", "--json", "--log", str(self.truth)]
        options += ["--disturb", "foot-force-scale=0"]
        self._process = fastmimic("robot-sim", *options, cwd=folder)

    def end(self) -> dict[str, Any]:
        """Its account."""
        self._process.send_signal(signal.SIGINT)
        out, err = self._process.communicate(timeout=60)
        assert self._process.returncode == 0, err
        return dict(json.loads(out))

    def kill(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()


def fastmimic(*arguments: str, cwd: Path) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "fastmimic", *arguments]
    return subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def sim(tmp_path: Path) -> Iterator[Sim]:
    robot = Sim(tmp_path)
    yield robot
    robot.kill()


def deploying(sim: Sim, folder: Path, *options: str) -> "subprocess.Popen[str]":
    where = ("--robot", "go2", "--driver", "go2", "--domain", str(sim.domain), "--yes", "--out", "there")
    return fastmimic("deploy", "stand", *where, *PATIENT, *options, cwd=folder)


def test_a_robot_stands_up_and_lies_down_again(sim: Sim, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    process = deploying(sim, tmp_path, "--duration", "0.3", "--json")
    out, err = process.communicate(timeout=180)
    assert process.returncode == 0, err
    found, told = json.loads(out), sim.end()
    assert (found["fell"], found["stopped_by"]) == (False, "duration")
    assert (told["fell"], told["commands_rejected"]) == (False, 0)
    assert found["packets"]["rejected"] == 0
    assert told["commands_received"] >= 0.9 * found["packets"]["sent"] > 1000
    assert found["packets"]["received"] > 1000
    assert told["base_pos"][2] < 0.2  # it lies
    stood = scored(capsys, tmp_path, sim.truth)
    assert stood["pose"] > 0.9  # the velocities' share depends on how busy the machine is
    rows = load_ground_truth(sim.truth)
    rows["observation"]["joint_pos"] += 0.2
    bent = LogFile(tmp_path / "bent.mcap", {ROBOT_SIM: GROUND_TRUTH}, len(rows))
    bent.add_rows(np.arange(len(rows)), {ROBOT_SIM: rows})
    bent.end({})
    assert scored(capsys, tmp_path, bent.path)["pose"] < stood["pose"] - 0.2  # by what the robot really did


def scored(capsys: pytest.CaptureFixture[str], folder: Path, truth: Path) -> dict[str, float]:
    """Terms of the reward of the deployment in `folder`, by the true states."""
    assert main(["evaluate", str(folder / "there" / "log.mcap"), "--truth", str(truth), "--json"]) == 0
    return dict(json.loads(capsys.readouterr().out)["components"])


def wait_for(process: "subprocess.Popen[str]", phase: str) -> None:
    """Until a program says what it does."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(phase):
            return


def test_whose_program_is_killed_while_it_stands_damps_itself(sim: Sim, tmp_path: Path) -> None:
    process = deploying(sim, tmp_path, "--endless", *NO_LEAN)
    wait_for(process, "blending into stand")
    time.sleep(0.5)
    assert process.poll() is None
    process.kill()
    process.communicate()
    time.sleep(1.5)
    told = sim.end()
    assert told["damped"] == 1
    assert told["damped_s"] > 1.0
    assert told["base_pos"][2] < 0.2


@pytest.mark.parametrize(
    ("limit", "during", "ends"),
    [("damp", "stiffening the joints", "was damped while"), ("sit", "blending into stand", "sat down")],
)
def test_another_program_that_commands_the_motors_is_heard(
    sim: Sim, tmp_path: Path, limit: str, during: str, ends: str
) -> None:
    process = deploying(sim, tmp_path, "--endless", "--json", "--limit", f"foreign={limit}", *NO_LEAN)
    wait_for(process, during)
    with closing(Participant(sim.domain)) as stranger:
        writer = Writer(stranger, messages.LOW_COMMAND_TOPIC, messages.LowCommand)
        wire = messages.CommandWire(writer.record)
        wire.clear()
        for _ in range(250):
            wire.write(damping_command(0.0))
            writer.write()
            time.sleep(0.002)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 3, err
    found = json.loads(out)
    assert found["stopped_by"] == "foreign_commands"
    assert "another program sends commands to the robot's motors" in err
    assert ends in err
    heard = found["packets"]["foreign"]
    assert heard > 0
    if limit == "damp":  # within 50 ms: the stranger sends one in 2 ms
        assert int(err.split("motors, ")[1].split(" until now")[0]) <= 25
