"""Deployments in lock step whose robot, wire or controller can be made to fail."""

from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fastmimic.deploy.computer import StopSwitch, VirtualClock
from fastmimic.deploy.deployment import Deployment, DeployOptions, deploy
from fastmimic.deploy.driver import Packets, RobotDriver, StateMessage
from fastmimic.deploy.safety import SafetyLimits
from fastmimic.deploy.sequence import Follower, MotionSequence
from fastmimic.deploy.sim import SimDriver
from fastmimic.deploy.state_machine import StateMachine
from fastmimic.robot import Robot

Watch = Callable[[StateMachine, NDArray[Any]], None]


class Tampered:
    """A driver whose states can be changed or withheld, and that remembers what was written.

    Attributes:
        change: gets each state and returns it, another one, or None.
        written: (1,) of `COMMAND` each.
    """

    def __init__(self, driver: RobotDriver) -> None:
        self.driver = driver
        self.change: Callable[[StateMessage], StateMessage | None] = lambda state: state
        self.written: list[NDArray[Any]] = []
        self.opened = self.closed = 0

    @property
    def packets(self) -> Packets:
        return self.driver.packets

    def truth_at(self, sequence: NDArray[np.int64]) -> Any:
        assert isinstance(self.driver, SimDriver)
        return self.driver.truth_at(sequence)

    def open(self) -> None:
        self.opened += 1
        self.driver.open()

    def read(self, timeout_s: float = 0.0) -> StateMessage | None:
        state = self.driver.read(timeout_s)
        return None if state is None else self.change(state)

    def write(self, command: NDArray[Any]) -> None:
        self.written.append(command.copy())
        self.driver.write(command)

    def close(self) -> None:
        self.closed += 1
        self.driver.close()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Rig:
    """One deployment. Its parts may be changed before it runs.

    Attributes:
        clock: virtual.
        sim: the robot; driver: what stands between it and the loop.
        switch: a person's hand, without a terminal.
    """

    def __init__(self, robot: Robot, sequence: MotionSequence) -> None:
        self.robot, self.sequence, self.follower = robot, sequence, Follower(sequence)
        self.clock = VirtualClock()
        self.switch = StopSwitch(stream=None)
        self.put_in(SimDriver(robot, self.clock))

    def put_in(self, sim: SimDriver) -> None:
        """Another robot, on the rig's clock."""
        self.sim, self.driver = sim, Tampered(sim)

    def run(self, *, watch: Watch | None = None, limits: SafetyLimits | None = None, **arguments: Any) -> Deployment:
        """A short deployment, unless the arguments say otherwise."""
        repeats = self.sequence.motion.cycle is not None
        if repeats and not {"cycles", "endless", "duration_s"} & arguments.keys():
            arguments["duration_s"] = 0.2
        called = {name: arguments.pop(name) for name in ("note", "on_ready") if name in arguments}
        return deploy(
            self.sequence.motion,
            self.robot,
            self.driver,
            DeployOptions(limits=limits, **arguments),
            follower=self.follower,
            clock=self.clock,
            switch=self.switch,
            watch=watch,
            **called,
        )


def once(when: Callable[[StateMachine], bool], act: Callable[[StateMachine], None]) -> Watch:
    """Acts at the first period in which something is so."""
    done = False

    def watch(machine: StateMachine, command: NDArray[Any]) -> None:
        nonlocal done
        if not done and when(machine):
            done = True
            act(machine)

    return watch


def assert_damped(rig: Rig, limits: SafetyLimits | None = None) -> None:
    """The last commands are mere damping, and the robot lies, its legs still giving way slowly at most."""
    limits = limits if limits is not None else SafetyLimits()
    last = rig.driver.written[-1]
    for name in ("joint_vel", "stiffness", "torque"):
        np.testing.assert_array_equal(last[name], 0.0)
    np.testing.assert_array_equal(last["damping"], limits.damping)
    truth = rig.sim.body.observation[0]
    assert truth["root_pos"][2] < 0.17, "m; it stands at 0.28"
    assert np.abs(truth["joint_vel"]).max() < 1.5, "rad/s"
