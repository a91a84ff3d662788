"""ROS 2's topics, read and written by CycloneDDS's own Python binding with the types as ROS 2 defines them."""

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="CycloneDDS is not installed")

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from deploy.dds_domains import free_domain
from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.base.rotations import quat_from_yaw
from fastmimic.cli import main
from fastmimic.deploy.dds.cyclone import Participant
from fastmimic.deploy.dds.ros import CommandTopic, RosPublisher
from fastmimic.deploy.log import LOG, ROW, DeploymentLog
from fastmimic.robot import load_robot
from fastmimic.steering import commands
from fastmimic.steering.gait_field import GaitField


def ros(package: str, name: str, /, **fields: Any) -> Any:
    """A type as ROS 2 names and serialises it on DDS."""
    return final(make_idl_struct(name, f"{package}::msg::dds_::{name}_", fields))


Time = ros("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
Header = ros("std_msgs", "Header", stamp=Time, frame_id=str)
NUMBERS = {name: sequence[float64] for name in ("position", "velocity", "effort")}
JointState = ros("sensor_msgs", "JointState", header=Header, name=sequence[str], **NUMBERS)
Vector3 = ros("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
Quaternion = ros("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
Transform = ros("geometry_msgs", "Transform", translation=Vector3, rotation=Quaternion)
TransformStamped = ros("geometry_msgs", "TransformStamped", header=Header, child_frame_id=str, transform=Transform)
TFMessage = ros("tf2_msgs", "TFMessage", transforms=sequence[TransformStamped])
Twist = ros("geometry_msgs", "Twist", linear=Vector3, angular=Vector3)
Pose = ros("geometry_msgs", "Pose", position=Vector3, orientation=Quaternion)
PoseWithCovariance = ros("geometry_msgs", "PoseWithCovariance", pose=Pose, covariance=array[float64, 36])
TwistWithCovariance = ros("geometry_msgs", "TwistWithCovariance", twist=Twist, covariance=array[float64, 36])
MOVED = {"child_frame_id": str, "pose": PoseWithCovariance, "twist": TwistWithCovariance}
Odometry = ros("nav_msgs", "Odometry", header=Header, **MOVED)

KINDS = {"joint_states": JointState, "joint_commands": JointState, "odom": Odometry, "tf": TFMessage}


@pytest.fixture
def domain() -> int:
    return free_domain()


def newest(reader: Any, wait_s: float = 10.0) -> Any:
    until = time.monotonic() + wait_s
    while time.monotonic() < until:
        if found := reader.take(16):
            return found[-1]
        time.sleep(0.01)
    raise AssertionError("nothing was published")


@contextlib.contextmanager
def readers(domain: int) -> Iterator[dict[str, Any]]:
    """In a domain that this process has opened."""
    participant = DomainParticipant(domain)
    yield {name: DataReader(participant, Topic(participant, f"rt/{name}", kind)) for name, kind in KINDS.items()}


def a_row() -> np.void:
    row, rng = np.zeros(1, ROW)[0], np.random.default_rng(1)
    for record in (row["reading"], row["command"]):
        for name in ("joint_pos", "joint_vel", "torque"):
            record[name] = rng.normal(size=12)
    row["estimate"]["root_pos"] = 1.0, 2.0, 0.3
    row["estimate"]["root_quat"] = quat_from_yaw(0.5 * np.pi)
    row["estimate"]["lin_vel"] = 0.0, 0.7, 0.0  # along its nose
    row["estimate"]["ang_vel"] = 0.0, 0.0, 0.4
    return row


def test_a_ros_program_reads_what_is_published(domain: int) -> None:
    robot, row = load_robot("go2"), a_row()
    with RosPublisher(robot, domain=domain) as publish, readers(domain) as found:
        for k in range(20):
            row["time_s"] = 0.02 * k
            publish(row)
            time.sleep(0.01)
        got = {name: newest(reader) for name, reader in found.items()}
    for name, record in (("joint_states", row["reading"]), ("joint_commands", row["command"])):
        state = got[name]
        assert tuple(state.name) == robot.joint_names
        np.testing.assert_array_equal(state.position, record["joint_pos"])
        np.testing.assert_array_equal(state.velocity, record["joint_vel"])
        np.testing.assert_array_equal(state.effort, record["torque"])
        assert abs(state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec - time.time()) < 60.0
    odom, (frame,) = got["odom"], got["tf"].transforms
    assert (
        (odom.header.frame_id, odom.child_frame_id) == (frame.header.frame_id, frame.child_frame_id) == ("odom", "base")
    )
    place, turned = odom.pose.pose.position, odom.pose.pose.orientation
    assert (place.x, place.y, place.z) == (1.0, 2.0, 0.3)
    np.testing.assert_allclose([turned.w, turned.x, turned.y, turned.z], row["estimate"]["root_quat"])
    assert frame.transform.translation == place
    assert frame.transform.rotation == turned
    twist = odom.twist.twist
    np.testing.assert_allclose([twist.linear.x, twist.linear.y, twist.angular.z], [0.7, 0.0, 0.4], atol=1e-12)


def test_fifty_times_a_second_and_no_place_before_there_is_an_estimate(domain: int) -> None:
    row = a_row()
    row["estimate"]["root_quat"] = 0.0
    with RosPublisher(load_robot("a1"), domain=domain) as publish, readers(domain) as found:
        counted, reader = [], found["joint_states"]
        for k in range(2000):
            row["time_s"] = 0.002 * k
            publish(row)
            time.sleep(0.001)
            counted.append(len(reader.take(16)))
            if sum(counted[:-100]):  # they have found each other
                break
        assert 9 <= sum(counted[-100:]) <= 11
        assert not found["odom"].take(16)
        assert not found["tf"].take(16)


@contextlib.contextmanager
def a_node(domain: int, topic: str, kind: Any) -> Iterator[Callable[[Any], None]]:
    """Publishes as a ROS 2 node does."""
    with contextlib.closing(Participant(domain)):  # keeps the domain on the loopback
        participant = DomainParticipant(domain)
        writer = DataWriter(participant, Topic(participant, f"rt/{topic}", kind))
        yield writer.write


def test_a_node_steers_and_its_silence_stops(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        a_node(domain, "cmd_vel", Twist) as write,
        contextlib.closing(CommandTopic("/cmd_vel", domain=domain)) as topic,
    ):
        assert topic.velocity(0.0) is None
        wanted, until = [0.7, 0.1, -1.0], time.monotonic() + 10.0
        found = None
        while found is None and time.monotonic() < until:
            write(Twist(Vector3(float("nan"), 0.0, 0.0), Vector3(0.0, 0.0, 0.0)))
            write(Twist(Vector3(0.7, 0.1, 0.0), Vector3(0.0, 0.0, -1.0)))
            time.sleep(0.02)
            found = topic.velocity(0.0)
        np.testing.assert_array_equal(found, wanted)  # type: ignore[arg-type]
        now = time.monotonic()
        monkeypatch.setattr(commands.time, "monotonic", lambda: now + commands.LOST_S + 0.01)
        np.testing.assert_array_equal(topic.velocity(0.0), np.zeros(3))  # type: ignore[arg-type]
        assert topic.velocity(0.0) is None


def test_a_topic_of_another_type_is_refused_by_name(domain: int) -> None:
    with (
        a_node(domain, "cmd_vel", JointState),
        pytest.raises(
            ConfigError, match=r"topic cmd_vel has messages of sensor_msgs/JointState, .*geometry_msgs/Twist"
        ),
    ):
        CommandTopic("cmd_vel", domain=domain)


def test_the_domain_is_that_of_ros(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with contextlib.closing(CommandTopic("cmd_vel")) as topic:
        assert topic._participant.domain == domain
    monkeypatch.setenv("ROS_DOMAIN_ID", "home")
    with pytest.raises(ConfigError, match="ROS_DOMAIN_ID is not the number of a DDS domain: 'home'"):
        CommandTopic("cmd_vel")
    monkeypatch.setenv("ROS_DOMAIN_ID", "500")
    with pytest.raises(DriverError, match="a DDS domain is a number from 0 to 230"):
        RosPublisher(load_robot("a1"))


@pytest.mark.slow
def test_deploy_publishes_and_is_steered_by_a_node(
    domain: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    gaits: GaitField,
) -> None:
    monkeypatch.setattr("fastmimic.steering.gait_field.gait_field", lambda *_, **__: gaits)
    given = ["--driver", "sim", "--lock-step", "--domain", str(domain), "--publish", "--json", "--out"]
    with a_node(domain, "cmd_vel", Twist), readers(domain) as found:
        status = main(["deploy", "steer", "--topic", "cmd_vel", "--duration", "1", *given, str(tmp_path / "run")])
        told = json.loads(capsys.readouterr().out)
        assert status == 0
        assert not told["fell"]
        last = DeploymentLog.load(tmp_path / "run" / LOG).rows[-1]
        state = newest(found["joint_states"])
        np.testing.assert_allclose(state.position, last["reading"]["joint_pos"], atol=0.05)
        assert len(newest(found["tf"]).transforms) == 1


def test_only_one_source_of_velocities(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["deploy", "steer", "--driver", "sim", "--topic", "cmd_vel", "--udp", "9870"]) == 2
    assert "velocities come from --udp PORT, --topic NAME or --commands FILE.csv: give one of them" in (
        capsys.readouterr().err
    )
