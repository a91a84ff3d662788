"""A peer on CycloneDDS 0.10, the version of robots and of Unitree's SDK, at the other end of the wire.

It is built with Debian's cyclonedds-dev and cyclonedds-tools, and has nothing of this package in it. Type descriptions
of version 11, as its Python binding sends them, would end it with a segmentation fault.
"""

import contextlib
import json
import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="CycloneDDS is not installed")

from deploy.dds_domains import free_domain
from fastmimic.deploy.dds.cyclone import configuration
from fastmimic.deploy.go2 import messages
from fastmimic.deploy.go2.driver import Go2Driver
from fastmimic.deploy.log import GROUND_TRUTH, Recorder
from fastmimic.deploy.sim_server import SimServer, SimSettings
from fastmimic.robot import load_robot
from fastmimic.robot.state import COMMAND

HERE = Path(__file__).parent
VENDOR_TYPES = {"LowCmd_": "832876ceec9737d69f6ed62a3f63", "LowState_": "853a99e23d0daa1610b65c526b40"}
"""The hashes of the types' structure in Unitree's SDK (unitree_sdk2, include/unitree/idl/go2)."""


@pytest.fixture(scope="module")
def peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    version = Path("/usr/include/dds/version.h")
    missing = [tool for tool in ("idlc", "gcc") if shutil.which(tool) is None]
    if missing or not version.exists():
        pytest.skip("no CycloneDDS 0.10 to build a peer with: apt-get install cyclonedds-dev cyclonedds-tools gcc")
    found = re.search(r'DDS_VERSION "(0\.10\.\d+)"', version.read_text())
    if found is None:
        pytest.skip(f"{version} is not of CycloneDDS 0.10")
    folder = tmp_path_factory.mktemp("peer")
    subprocess.run(["idlc", str(Path(messages.__file__).with_name("unitree.idl"))], cwd=folder, check=True)
    command = ["gcc", "-O1", "-I.", str(HERE / "peer.c"), "unitree.c", "-lddsc", "-o", "peer"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "peer"


@pytest.fixture
def start(peer: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def call(domain: int, role: str) -> subprocess.Popen[str]:
        environment = os.environ | {"CYCLONEDDS_URI": configuration("lo")}
        command = [str(peer), str(domain), role]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment))
        return started[-1]

    yield call
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def account(process: subprocess.Popen[str]) -> dict[str, Any]:
    process.terminate()
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0, f"the peer ended with {process.returncode}"
    return json.loads(out)


def test_the_peers_messages_are_the_vendors(peer: Path) -> None:
    code = (peer.parent / "unitree.c").read_text()
    for name, digest in VENDOR_TYPES.items():
        description = code[code.index(f"{name}_ops []") :]
        found = re.search(r"\[MINIMAL (\w+)\] \(#deps: [1-9]", description)
        assert found is not None
        assert found[1] == digest, name


def test_a_driver_reads_a_robot_on_0_10_and_commands_it(start: Callable[..., subprocess.Popen[str]]) -> None:
    domain = free_domain()
    robot = start(domain, "robot")
    command = np.zeros(1, COMMAND)
    command["joint_pos"], command["stiffness"] = 0.3, 20.0
    with Go2Driver(load_robot("go2"), domain=domain) as driver:
        for _ in range(300):
            driver.write(command)
            state = driver.read(10.0)
            assert state is not None
        packets = driver.packets
    reading = state.reading[0]
    assert reading["joint_pos"] == pytest.approx([0.05, 0.9, -1.8] * 4)
    assert reading["joint_vel"] == pytest.approx(0.25 * np.arange(12))
    assert reading["torque"] == pytest.approx(0.5 * np.arange(12))
    assert reading["quat"] == pytest.approx([1, 0, 0, 0])
    assert reading["gyro"] == pytest.approx([0.1, 0.2, 0.3])
    assert reading["accel"] == pytest.approx([7, 8, 9])
    assert reading["foot_force"] == pytest.approx([-5, 15, 35, 55])
    assert packets.rejected == 0
    assert packets.lost <= 0.05 * packets.received
    seen = account(robot)
    assert seen["wrong"] == 0
    assert seen["odd"] == 0
    assert 0.8 * packets.sent <= seen["received"] <= packets.sent


def test_a_client_on_0_10_reads_and_commands_the_simulated_robot(start: Callable[..., subprocess.Popen[str]]) -> None:
    domain = free_domain()
    stop, log = threading.Event(), Recorder(GROUND_TRUTH, 60_000)
    with contextlib.closing(SimServer(load_robot("go2"), SimSettings(domain=domain), log)) as sim:
        client = start(domain, "client")
        runner = threading.Thread(target=sim.run, args=(stop, 60.0))
        runner.start()
        try:
            end = time.monotonic() + 60
            while sim.counts.commands_received < 300 or sim.counts.states_sent < 600:
                assert client.poll() is None, f"the peer ended with {client.returncode}"
                assert time.monotonic() < end
                time.sleep(0.05)
            seen = account(client)
        finally:
            stop.set()
            runner.join()
    assert seen["wrong"] == 0
    assert seen["received"] > 200
    assert seen["gaps"] <= 0.05 * seen["received"]
    assert sim.counts.commands_rejected == 0
    assert sim.counts.commands_received <= seen["sent"]
    truth = log.rows()
    obeyed = truth["command"][~truth["damped"]][-1]
    assert obeyed["joint_pos"] == pytest.approx(0.1 * np.arange(12))
    assert obeyed["joint_vel"] == pytest.approx(0.2 * np.arange(12))
    assert obeyed["stiffness"] == pytest.approx(1.0 + np.arange(12))
    assert obeyed["damping"] == pytest.approx(2.0 + np.arange(12))
    assert obeyed["torque"] == pytest.approx(0.3 * np.arange(12))
