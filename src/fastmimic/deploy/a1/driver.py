"""The driver of an A1 through `robot_interface`, the binding of Unitree's SDK that the published A1 code builds.

Its interface, as fast_and_efficient and motion_imitation use it: `RobotInterface(0xff)` for low-level control,
`receive_observation()` for the latest state, `send_command(60 numbers)` with (q, kp, dq, kd, tau) of each joint in
turn. Legs come FR, FL, RR, RL, the quaternion w, x, y, z, angles and signs as in Unitree's description: the project's.
"""

import importlib
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import DriverError
from fastmimic.deploy.driver import Packets, RobotDriver, StateMessage
from fastmimic.deploy.identity import impossible_joint
from fastmimic.estimation.reading import READING
from fastmimic.robot import Robot

MODULE: Final = "robot_interface"
LOW_LEVEL: Final = 0xFF
FIRST_STATE_S: Final = 3.0
FOOT_N_PER_COUNT: Final = 1.0
"""Of the pressure sensors in the feet. Assumed: the vendor gives no unit."""

_FIELDS: Final = ("joint_pos", "stiffness", "joint_vel", "damping", "torque")
_POLL_S: Final = 0.0002
_ASK_S: Final = 0.002


class A1Driver(RobotDriver):
    """A `RobotDriver`.

    The A1 answers those who write to it: until the first state, `open` writes commands without gains or torque, which
    move nothing but end the damping that it may be in. Checksums are the SDK's business; of lost states it says
    nothing, so `packets.lost` stays 0.

    Args:
        robot: which it is expected to be.
        release: write such commands; without, it only listens, and hears something only if the A1 answers anyway.
        say: is told what happens while it opens.
    """

    def __init__(self, robot: Robot, *, release: bool = True, say: Callable[[str], None] = lambda text: None) -> None:
        self._robot = robot
        self._release, self._say = release, say
        self.packets = Packets()
        self._interface: Any = None
        self._sequence = -1
        self._command = np.zeros(60, np.float32)

    def open(self) -> None:
        """See `RobotDriver`; but for commands without gains or torque, until it answers.

        Raises:
            DriverError: no binding, or another one of that name; no state; another robot.
        """
        interface = _binding()
        try:
            self._interface = interface(LOW_LEVEL)
        except TypeError:  # the older binding knows low-level control only
            self._interface = interface()
        self._sequence = -1
        try:
            self._await_state()
        except BaseException:
            self.close()
            raise
        self.packets = Packets()

    def read(self, timeout_s: float = 0.0) -> StateMessage | None:
        """See `RobotDriver`."""
        end = time.perf_counter() + timeout_s
        while True:
            reading = self._newest()
            if reading is not None:
                return StateMessage(reading, self._sequence, time.perf_counter())
            left = end - time.perf_counter()
            if left <= 0:
                return None
            time.sleep(min(_POLL_S, left))

    def write(self, command: NDArray[Any]) -> None:
        """See `RobotDriver`.

        Raises:
            DriverError: the command is not finite; nothing was sent.
        """
        if not np.isfinite(command.view(np.float64)).all():
            raise DriverError("a command that is not finite was not sent to the motors")
        for k, name in enumerate(_FIELDS):
            self._command[k::5] = command[name][0]
        self._interface.send_command(self._command)
        self.packets.sent += 1

    def close(self) -> None:
        """See `RobotDriver`."""
        self._interface = None

    def _newest(self) -> NDArray[Any] | None:
        """(1,) of `READING` if there is a state that is new and makes sense."""
        state = self._interface.receive_observation()
        tick = int(state.tick)
        if tick == self._sequence or (self._sequence < 0 and tick == 0):
            return None  # the same one again
        reading = _reading(state)
        norm = float(np.linalg.norm(reading["quat"]))
        if tick < self._sequence or not np.isfinite(reading.view(np.float64)).all() or not 0.9 < norm < 1.1:
            self.packets.rejected += 1
            return None
        reading["quat"] /= norm
        self._sequence = tick
        self.packets.received += 1
        return reading

    def _await_state(self) -> None:
        end, outside = time.monotonic() + FIRST_STATE_S, ""
        nothing = np.zeros(60, np.float32)
        if self._release:
            self._say("asking the A1 for its state by commands without gains or torque")
        while time.monotonic() < end:
            if self._release:
                self._interface.send_command(nothing)
            time.sleep(_ASK_S)
            reading = self._newest()
            if reading is not None:
                outside = impossible_joint(self._robot, reading["joint_pos"][0])
                if not outside:
                    return
        raise DriverError(
            outside
            or f"no A1's state within {FIRST_STATE_S:g} s: is it on, in damping mode, and this computer on its network"
            " (192.168.123.x)?"
        )


def _binding() -> Any:
    """The binding's class."""
    where = (
        "build it from third_party/unitree_legged_sdk of github.com/yxyang/fast_and_efficient (cmake, make) and put"
        f" {MODULE}*.so on PYTHONPATH; see docs/wire.md"
    )
    try:
        module = importlib.import_module(MODULE)
    except ImportError as error:
        raise DriverError(f"the A1 needs Unitree's '{MODULE}', which cannot be imported ({error}): {where}") from None
    interface = getattr(module, "RobotInterface", None)
    if not all(hasattr(interface, name) for name in ("send_command", "receive_observation")):
        raise DriverError(
            f"{getattr(module, '__file__', MODULE)} is another '{MODULE}': it has no RobotInterface with send_command"
            f" and receive_observation; {where}"
        )
    return interface


def _reading(state: Any) -> NDArray[Any]:
    """(1,) of `READING` from the SDK's state."""
    reading, imu, motors = np.zeros(1, READING), state.imu, state.motorState[:12]
    reading["quat"], reading["gyro"], reading["accel"] = imu.quaternion, imu.gyroscope, imu.accelerometer
    reading["joint_pos"] = [motor.q for motor in motors]
    reading["joint_vel"] = [motor.dq for motor in motors]
    reading["torque"] = [motor.tauEst for motor in motors]
    reading["foot_force"] = state.footForce
    reading["foot_force"] *= FOOT_N_PER_COUNT
    return reading
