"""Which simulator episodes run in, behind one small interface."""

from typing import Any, Protocol

from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions
from fastmimic.simulation.mujoco_sim import MujocoSimulation


class Simulation(Protocol):
    """n robots that take commands and give observations; see `MujocoSimulation`.

    Attributes:
        observation: (n,) of `OBSERVATION`, the present states.
    """

    observation: NDArray[Any]

    def reset(
        self, root_pos: Array, root_quat: Array, joint_pos: Array, lin_vel: Array, ang_vel_b: Array, joint_vel: Array
    ) -> None:
        """Puts the robots into given states; arrays (n, …), world frame but for the angular velocity (body frame)."""

    def observe(self) -> NDArray[Any]:
        """The robots' present states, (n,) of `OBSERVATION`."""

    def step(self, commands: NDArray[Any]) -> NDArray[Any]:
        """Applies commands (n,) of `COMMAND` for one control step and returns the new observation."""


def check_simulator(robot: Robot, simulator: str) -> None:
    """Makes sure that the simulator is there and knows the robot; for before long work.

    Raises:
        ConfigError: PyBullet is not installed or does not know the robot.
    """
    if simulator == "pybullet":
        from fastmimic.simulation.pybullet_sim import PybulletSimulation

        PybulletSimulation(robot, 1).close()


def make_simulation(
    robot: Robot, n: int, conditions: Conditions, *, control_rate_hz: float, threads: int = 1
) -> Simulation:
    """n robots in the simulator of the conditions, disturbed as they say.

    Args:
        robot: the robot.
        n: how many.
        conditions: whose `simulator`, `disturbances` and `seed` count here.
        control_rate_hz: Hz.
        threads: of MuJoCo; PyBullet has one.

    Raises:
        ConfigError: PyBullet is not installed or does not know the robot, a disturbance that the simulator does not
            realise, or rates that do not fit.
    """
    if conditions.simulator == "pybullet":
        from fastmimic.simulation.pybullet_sim import PybulletSimulation

        return PybulletSimulation(
            robot, n, disturbances=conditions.disturbances, seed=conditions.seed, control_rate_hz=control_rate_hz
        )
    if conditions.disturbances:
        from fastmimic.simulation.mujoco_disturbed import DisturbedMujocoSimulation

        return DisturbedMujocoSimulation(
            robot,
            n,
            conditions.disturbances,
            seed=conditions.seed,
            control_rate_hz=control_rate_hz,
            threads=threads,
        )
    return MujocoSimulation(robot, n, control_rate_hz=control_rate_hz, threads=threads)
