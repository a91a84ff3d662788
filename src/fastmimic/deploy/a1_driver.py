"""The driver of an A1 through `robot_interface`, the binding of Unitree's SDK that the published A1 code builds.

Its interface: `RobotInterface(0xff)`, `receive_observation()`, and `send_command` of 60 numbers, (q, kp, dq, kd, tau)
per joint. Order of legs, quaternion, angles and signs are the project's.
"""

import importlib
import time
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Records
from fastmimic.base.errors import DriverError
from fastmimic.deploy.driver import Packets, RobotDriver, StateMessage, implausible_joint
from fastmimic.robot.state import READING

MODULE: Final = "robot_interface"
LOW_LEVEL: Final = 0xFF
FOOT_N_PER_COUNT: Final = 1.0  # assumed: the vendor gives no unit of the foot sensors

_FIELDS: Final = ("joint_pos", "stiffness", "joint_vel", "damping", "torque")
_REQUEST_S: Final = 0.002


class A1Driver(RobotDriver):
    """The A1 answers only who writes to it: until the first state, `open` writes commands without gains or torque,
    which end the robot's damping mode. With `release=False` it only listens and may hear nothing. The SDK checks
    checksums and reports no lost states: `packets.lost` stays 0."""

    _interface: Any = None

    def _connect(self) -> None:
        """Raises `DriverError` also without the binding, or for another module of that name."""
        interface = _binding()
        try:
            self._interface = interface(LOW_LEVEL)
        except TypeError:  # the older binding has only low-level control
            self._interface = interface()
        self._command = np.zeros(60, np.float32)
        self._await_state()
        self.packets = Packets()

    def close(self) -> None:
        self._interface = None

    def _newest(self) -> StateMessage | None:
        state = self._interface.receive_observation()
        tick = int(state.tick)
        if tick == self._sequence or (self._sequence < 0 and tick == 0):
            return None  # no new state
        reading = _reading(state)
        norm = float(np.linalg.norm(reading["quat"]))
        good = bool(np.isfinite(reading.view(np.float64)).all()) and 0.9 < norm < 1.1
        if not self._count(tick, good=good, step=0):
            return None
        reading["quat"] /= norm
        return StateMessage(reading, tick, self._now())

    def _send(self, command: Records) -> bool:
        for k, name in enumerate(_FIELDS):
            self._command[k::5] = command[name][0]
        self._interface.send_command(self._command)
        return True

    def _await_state(self) -> None:
        end, problem = time.monotonic() + self._timeout_s, ""
        if self._release:
            self._say("requesting the A1's state by commands without gains or torque")
        while time.monotonic() < end:
            if self._release:
                self._interface.send_command(np.zeros(60, np.float32))
            time.sleep(_REQUEST_S)
            state = self._newest()
            if state is not None:
                problem = implausible_joint(self._robot, state.reading["joint_pos"][0])
                if not problem:
                    return
        hint = "is it on, in damping mode, and this computer on its network (192.168.123.x)?"
        raise DriverError(problem or f"no state of an A1 within {self._timeout_s:g} s: {hint}")


def _binding() -> Any:
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
        lacks = "it has no RobotInterface with send_command and receive_observation"
        raise DriverError(f"{getattr(module, '__file__', MODULE)} is another '{MODULE}': {lacks}; {where}")
    return interface


def _reading(state: Any) -> Records:
    """(1,) of `READING` from the SDK's state."""
    reading, imu, motors = np.zeros(1, READING), state.imu, state.motorState[:12]
    reading["quat"], reading["gyro"], reading["accel"] = imu.quaternion, imu.gyroscope, imu.accelerometer
    reading["joint_pos"] = [motor.q for motor in motors]
    reading["joint_vel"] = [motor.dq for motor in motors]
    reading["torque"] = [motor.tauEst for motor in motors]
    reading["foot_force"] = state.footForce
    reading["foot_force"] *= FOOT_N_PER_COUNT
    return reading
