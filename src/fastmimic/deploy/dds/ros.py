"""Topics of ROS 2 over DDS: what a robot does, for RViz, Foxglove and nodes; and the velocity that a node wants of it.

Types and topics bear the names that ROS 2 gives them on DDS (design.ros2.org, "Topic and Service name mapping").
"""

import ctypes
import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.deploy.dds.cyclone import LOOPBACK, Participant, Reader, Writer
from fastmimic.deploy.dds.types import messages_of
from fastmimic.robot import Robot
from fastmimic.steering.commands import ReceivedCommands

TOPICS: Final = {
    "joint_states": "sensor_msgs::msg::dds_::JointState_",
    "joint_commands": "sensor_msgs::msg::dds_::JointState_",
    "odom": "nav_msgs::msg::dds_::Odometry_",
    "tf": "tf2_msgs::msg::dds_::TFMessage_",
}
TWIST: Final = "geometry_msgs::msg::dds_::Twist_"
_TYPES: Final = messages_of(Path(__file__).with_name("ros.idl").read_text(encoding="utf-8"))
_WORLD, _BODY = b"odom", b"base"
_PERIOD_S: Final = 0.0199  # between two messages of a topic
_DISCOVERY_S: Final = 0.5  # for the programs that publish a topic to be found


def _participant(domain: int | None, interface: str | None) -> Participant:
    """In the domain and by the interface of this computer's ROS 2 if None."""
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if domain is None and not given.isdecimal():
        raise ConfigError(f"ROS_DOMAIN_ID is not the number of a DDS domain: '{given}'")
    return Participant(int(given) if domain is None else domain, LOOPBACK if interface is None else interface)


class RosPublisher:
    """Publishes `TOPICS`: angles, speeds and torques of the joints as measured and as commanded; the trunk's estimated
    place in the frame `odom`, with its velocity in its own frame `base`; and that frame. Within it, a function takes
    each period, a record of `fastmimic.deploy.log.ROW`, and publishes 50 a second. Raises `DriverError`."""

    def __init__(self, robot: Robot, interface: str | None = None, domain: int | None = None) -> None:
        self._participant = _participant(domain, interface)
        writers = [Writer(self._participant, f"rt/{topic}", _TYPES[name]) for topic, name in TOPICS.items()]
        joints, self._place, self._frames = writers[:2], *writers[2:]
        self._joints = [(writer, _JointMessage(writer.message, robot.joint_names)) for writer in joints]
        self._frame = _TYPES["geometry_msgs::msg::dds_::TransformStamped_"]()
        _refer(self._frames.message.transforms, ctypes.pointer(self._frame), 1)
        for message in (self._place.message, self._frame):
            message.header.frame_id, message.child_frame_id = _WORLD, _BODY
        self._last_s = -math.inf

    def __enter__(self) -> Callable[[Any], None]:
        return self._publish

    def __exit__(self, *_: object) -> None:
        self._participant.close()

    def _publish(self, row: Any) -> None:
        if 0 <= row["time_s"] - self._last_s < _PERIOD_S:
            return
        self._last_s = row["time_s"]
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        for (writer, joints), record in zip(self._joints, (row["reading"], row["command"]), strict=True):
            joints.values[...] = record["joint_pos"], record["joint_vel"], record["torque"]
            _stamp(writer.message, seconds, nanoseconds)
            writer.write()
        seen = row["estimate"]
        if not seen["root_quat"].any():  # the estimate begins when the robot stands
            return
        pose, twist, moved = self._place.message.pose.pose, self._place.message.twist.twist, self._frame.transform
        for place in (pose.position, moved.translation):
            place.x, place.y, place.z = seen["root_pos"]
        for turned in (pose.orientation, moved.rotation):
            turned.w, turned.x, turned.y, turned.z = seen["root_quat"]
        to_world = matrix_from_quat(seen["root_quat"])
        for vector, name in ((twist.linear, "lin_vel"), (twist.angular, "ang_vel")):
            vector.x, vector.y, vector.z = seen[name] @ to_world
        for message in (self._place.message, self._frame):
            _stamp(message, seconds, nanoseconds)
        self._place.write()
        self._frames.write()


class _JointMessage:
    """The memory that a `JointState` message refers to: names, and `values` (3, 12), rad, rad/s and N·m."""

    def __init__(self, message: Any, names: tuple[str, ...]) -> None:
        self._names = (ctypes.c_char_p * len(names))(*(name.encode() for name in names))
        self.values = np.zeros((3, len(names)))
        _refer(message.name, self._names, len(names))
        for sequence, row in zip((message.position, message.velocity, message.effort), self.values, strict=True):
            _refer(sequence, row.ctypes.data, len(names))


def _refer(sequence: Any, memory: Any, length: int) -> None:
    sequence.maximum = sequence.length = length
    sequence.buffer = ctypes.cast(memory, ctypes.c_void_p)


def _stamp(message: Any, seconds: int, nanoseconds: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds


class CommandTopic(ReceivedCommands):
    """Velocities from a topic of `geometry_msgs/Twist`, such as cmd_vel. Raises `DriverError`, and `ConfigError` if
    only messages of another type are published there."""

    def __init__(self, topic: str, interface: str | None = None, domain: int | None = None) -> None:
        super().__init__()
        self._participant = _participant(domain, interface)
        name = f"rt/{topic.removeprefix('/')}"
        self._reader = Reader(self._participant, name, _TYPES[TWIST])
        end, found = time.monotonic() + _DISCOVERY_S, list[str]()
        while TWIST not in found and time.monotonic() < end:
            time.sleep(0.05)
            found = self._participant.publishers(name)
        if found and TWIST not in found:
            self.close()
            kind = found[0].replace("::msg::dds_::", "/").removesuffix("_")
            raise ConfigError(f"topic {topic} has messages of {kind}, and a robot is steered by geometry_msgs/Twist")

    def close(self) -> None:
        self._participant.close()

    def received(self) -> list[Array]:
        samples: Records = self._reader.samples[: self._reader.take()]
        sent = samples[self._reader.valid[: len(samples)]]
        found = np.column_stack([sent["linear"]["x"], sent["linear"]["y"], sent["angular"]["z"]])
        return list(found[np.isfinite(found).all(axis=1)])
