"""The simulators, each an entry of a registry. To add one, register one entry."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError
from fastmimic.base.registry import Registry
from fastmimic.robot import Robot

if TYPE_CHECKING:  # its disturbances are entries that refer to simulators
    from fastmimic.simulation.conditions import Conditions


PHYSICS_RATE_HZ: Final = 1000.0
PYBULLET_URDFS: Final = {"a1": "a1/a1.urdf"}  # in the package `pybullet_data`, by robot


class Placement(NamedTuple):
    """States of n robots, or one for all, in the order of `Simulation.reset`: root (n, 3), m, and (n, 4), world frame;
    joints (n, 12), rad; their velocities (n, 3), m/s, world frame, (n, 3), rad/s, body frame, and (n, 12), rad/s."""

    root_pos: Array
    root_quat: Array
    joint_pos: Array
    lin_vel: Array
    ang_vel_b: Array
    joint_vel: Array


class Simulation(Protocol):
    """n robots that take commands and give the present states, (n,) of `OBSERVATION`; see `MujocoSimulation`."""

    observation: Records

    def reset(self, *state: Array) -> None:
        """Puts the robots into given states, the arrays of `Placement`."""

    def step(self, commands: Records) -> Records:
        """Applies commands (n,) of `COMMAND` for one control step; returns the new observation."""


@dataclass(frozen=True)
class Simulator:
    """A simulator: `make(robot, n, conditions, control_rate_hz, threads)` returns a simulation; `check` raises
    `ConfigError` if it is missing or does not know the robot; `realizes` names its own disturbances and terrains."""

    name: str
    about: str
    make: "Callable[[Robot, int, Conditions, float, int], Simulation]"
    check: Callable[[Robot], None] = lambda robot: None
    realizes: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()  # modules that must be installed
    robots: tuple[str, ...] | None = None  # names of those that it has a description of; None for any

    @property
    def installed(self) -> bool:
        return all(find_spec(name) is not None for name in self.needs)

    def knows(self, robot: str) -> bool:
        """Whether it has a robot, given by its name or the path of its MJCF."""
        return self.robots is None or robot.lower() in self.robots


def _mujoco(robot: Robot, n: int, conditions: "Conditions", control_rate_hz: float, threads: int) -> Simulation:
    from fastmimic.simulation.mujoco_sim import MujocoSimulation

    on: dict[str, Any] = {"ground": conditions.ground, "ideal": conditions.ideal, "control_rate_hz": control_rate_hz}
    return MujocoSimulation(robot, n, conditions.disturbances, threads=threads, **on)


def _pybullet(robot: Robot, n: int, conditions: "Conditions", control_rate_hz: float, threads: int) -> Simulation:
    from fastmimic.simulation.pybullet_sim import PybulletSimulation

    on: dict[str, Any] = {"ground": conditions.ground, "ideal": conditions.ideal, "control_rate_hz": control_rate_hz}
    return PybulletSimulation(robot, n, conditions.disturbances, **on)


def _check_pybullet(robot: Robot) -> None:
    from fastmimic.simulation.pybullet_sim import PybulletSimulation

    PybulletSimulation(robot, 1).close()


_EVERYWHERE: Final = ("motor-strength", "top-speed", "delay", "push", "side-push")

SIMULATORS: Final = Registry(
    "simulator",
    [
        Simulator("mujoco", "where motions are optimised", _mujoco, realizes=_EVERYWHERE),
        Simulator(
            "pybullet",
            "slower, with the manufacturer's URDF",
            _pybullet,
            _check_pybullet,
            realizes=(*_EVERYWHERE, "friction", "payload", "com-x", "com-y", "joint-friction", "joint-damping"),
            needs=("pybullet", "pybullet_data", "pybullet_utils"),
            robots=tuple(PYBULLET_URDFS),
        ),
    ],
)
FIRST_SIMULATOR, SECOND_SIMULATOR = list(SIMULATORS)[:2]
"""Where motions are optimised, and where the results are tested again."""


def make_simulation(
    robot: Robot, n: int, conditions: "Conditions", *, control_rate_hz: float, threads: int = 1
) -> Simulation:
    """n robots in the simulator of the conditions (not its observation). `threads` is an upper bound; PyBullet has one.
    Raises `ConfigError` as `Simulator.check`, for a disturbance that is not realised, or for rates that do not fit."""
    return SIMULATORS[conditions.simulator].make(robot, n, conditions, control_rate_hz, threads)


def substeps_of(control_rate_hz: float) -> int:
    """Physics steps in a control step; raises `ConfigError` if they are not a whole number."""
    substeps = PHYSICS_RATE_HZ / control_rate_hz
    if substeps < 1 or abs(substeps - round(substeps)) > 1e-9:
        physics = f"the physics rate ({PHYSICS_RATE_HZ:g} Hz)"
        raise ConfigError(f"{physics} must be a multiple of the control rate ({control_rate_hz:g} Hz)")
    return round(substeps)
