"""A policy as a controller for the closed loop, in place of the model-based one."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import PolicyError
from fastmimic.base.jit import kernel
from fastmimic.control.config import ControllerConfig, pack_config
from fastmimic.control.gait import plan_leg
from fastmimic.episode.loop import MakeController
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE, pack_settings
from fastmimic.learning.observation import act_robot, command_robot, make_senses, observe_robot
from fastmimic.learning.policy import Policy, infer_robot
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import stack_tables
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, MEMORY


@kernel
def policy_step(
    config: Any,
    settings: Any,
    network: Any,
    tables: Any,
    clocks: Any,
    observations: Any,
    senses: Any,
    memories: Any,
    commands: Any,
    rotation: Array,
    seen: NDArray[np.float32],
    action: Array,
) -> None:
    """Computes the commands of all robots; robot i follows table min(i, k − 1) at its clock.

    The gait planner runs although the policy does not need it, so that leg states and early touch-downs mean the same
    as under the model-based controller.
    """
    for i in range(observations.shape[0]):
        table, clock, obs = tables[min(i, tables.shape[0] - 1)], clocks[i], observations[i]
        for leg in range(4):
            plan_leg(config[0], memories[i], leg, table[clock.sample].contact[leg] == 1, obs.foot_force[leg, 2])
        if senses[i].age < 0 or senses[i].age >= settings[0].decimation:
            observe_robot(settings[0], table, clock, obs, senses[i], rotation, seen)
            infer_robot(network, seen, action)
            act_robot(settings[0], action, senses[i])
        command_robot(settings[0], senses[i], commands[i])


class PolicyController:
    """n robots under one policy; steps like `fastmimic.control.controller.Controller`. Not for several threads.

    Attributes:
        config: the model-based controller's, for the loop's rate and the contact thresholds.
        tables: (1 or n, t) of `SAMPLE`, the reference motions.
        memory: (n,) of `MEMORY`, leg states of the gait planner.
        command: (n,) of `COMMAND`, the last ones.
    """

    def __init__(self, policy: Policy, robot: Robot, motion: Motion, n: int, config: ControllerConfig) -> None:
        """Raises `PolicyError` if the policy is for another robot, another motion, or another control rate."""
        policy.check(robot, motion)
        if abs(policy.config.control_rate_hz - config.rate_hz) > 1e-9:
            raise PolicyError(
                f"the policy's joint targets go out at {policy.config.control_rate_hz:g} Hz, and the loop runs at"
                f" {config.rate_hz:g} Hz"
            )
        self.config = config
        self.tables = stack_tables([motion], robot)
        self.memory = np.zeros(n, MEMORY)
        self.command = np.zeros(n, COMMAND)
        self._config = pack_config(config, robot)
        self._settings = pack_settings(policy.config, robot)
        self._network = policy.network()
        self._senses = make_senses(n)
        self._rotation = np.zeros((3, 3))
        self._seen = np.zeros(OBSERVATION_SIZE, np.float32)
        self._action = np.zeros(ACTION_SIZE)

    def reset(self, sample: NDArray[np.int64]) -> None:
        """Clears the memory; leg states become those of the reference motion at `sample` (n,)."""
        self.memory[...] = np.zeros((), MEMORY)
        rows = np.minimum(np.arange(len(self.memory)), len(self.tables) - 1)
        self.memory["stance"] = self.tables["contact"][rows, sample]
        self.memory["since_switch"] = 1e3
        self._senses[...] = make_senses(len(self._senses))

    def step(self, observation: NDArray[Any], clocks: NDArray[Any]) -> NDArray[Any]:
        """Commands for the next control step, (n,) of `COMMAND`, overwritten by the next call. Takes (n,) records of
        `OBSERVATION` and of `CLOCK`."""
        policy_step(
            self._config,
            self._settings,
            self._network,
            self.tables,
            clocks,
            observation,
            self._senses,
            self.memory,
            self.command,
            self._rotation,
            self._seen,
            self._action,
        )
        return self.command


def controlled_by(policy: Policy) -> MakeController:
    """A factory of controllers for the closed loop."""
    return partial(PolicyController, policy)
