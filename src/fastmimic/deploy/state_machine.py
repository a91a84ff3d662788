"""What the robot is told, from lying to lying: up, on its way, down. It knows states, and nothing of time or wires."""

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import yaw_from_quat
from fastmimic.control.config import ControllerConfig, pack_config
from fastmimic.control.controller import Controller
from fastmimic.deploy.safety import DryRunGuard, Guard, Violation
from fastmimic.deploy.sequence import Follower, MotionSequence
from fastmimic.episode.loop import LoopController, MakeController
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.estimation.estimator import START, Estimator
from fastmimic.reference.standing import along, rising_path, smooth, standing_gains
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import COMMAND, OBSERVATION

HOLD_S: Final = 0.4
"""In which the joints become stiff where they are."""
FOLD_S: Final = 1.2
RISE_S: Final = 1.5
SETTLE_S: Final = 0.6
SIT_S: Final = 1.8
RELEASE_S: Final = 0.5
_STANDING: Final = 0.75
"""Share of the standing posture's height of the hips over the feet from which the robot is taken to stand already."""
_WARM_UP: Final = 20
_LEGS: Final = np.ones((1, 4), np.int64)


class DeploymentPhase(IntEnum):
    """Of a deployment."""

    HOLD = 0
    FOLD = 1
    RISE = 2
    SETTLE = 3
    FOLLOW = 4
    SIT = 5
    RELEASE = 6
    DONE = 7
    DAMP = 8
    """After a violation or an emergency stop."""

    @property
    def text(self) -> str:
        """In words."""
        return _WORDS[self]


_WORDS: Final = {
    DeploymentPhase.HOLD: "taking hold",
    DeploymentPhase.FOLD: "folding its legs",
    DeploymentPhase.RISE: "standing up",
    DeploymentPhase.SETTLE: "standing",
    DeploymentPhase.FOLLOW: "on its way",
    DeploymentPhase.SIT: "sitting down",
    DeploymentPhase.RELEASE: "letting go",
    DeploymentPhase.DONE: "done",
    DeploymentPhase.DAMP: "damped",
}
_LASTS_S: Final = {
    DeploymentPhase.HOLD: HOLD_S,
    DeploymentPhase.FOLD: FOLD_S,
    DeploymentPhase.RISE: RISE_S,
    DeploymentPhase.SETTLE: SETTLE_S,
    DeploymentPhase.SIT: SIT_S,
    DeploymentPhase.RELEASE: RELEASE_S,
}


class StateMachine:
    """Commands for one robot, a control step after the other.

    Attributes:
        phase: the present one.
        follower: where in the sequence it is, in the phase `FOLLOW`.
        observation: (1,) of `OBSERVATION`, what the controller is told; all 0 before the robot stands.
        violation: what it found wrong in the last step.
        cycles: of the motion that are complete.
    """

    def __init__(
        self,
        robot: Robot,
        sequence: MotionSequence,
        guard: Guard,
        config: ControllerConfig,
        *,
        estimator: EstimatorConfig | None = None,
        policy: MakeController | None = None,
    ) -> None:
        """
        Args:
            robot: the robot.
            sequence: where it goes.
            guard: what it may do.
            config: of the controller.
            estimator: of the estimator.
            policy: makes the controller of the motion itself; the model-based one goes there and back.
        """
        motion = sequence.motion
        self.robot, self.sequence, self.guard = robot, sequence, guard
        self._dt = 1.0 / config.rate_hz
        self._model_based = Controller(robot, [motion], 1, config)
        self._own: LoopController = self._model_based if policy is None else policy(robot, motion.target, 1, config)
        self.controller: LoopController = self._model_based
        self._failed = self.controller.memory["failed_in_a_row"]
        self.estimator = Estimator(robot, 1, config.rate_hz, estimator)
        recovers = config.recovery.enabled and policy is None
        self.follower = Follower(sequence, pack_config(config, robot) if recovers else None)
        self._path, _ = rising_path(robot, sequence.stand)
        self._stiffness, self._damping = standing_gains(robot)
        self._reach = _height(robot, sequence.stand)
        self._command = np.zeros(1, COMMAND)
        self._words = f"passing into {motion.name}", motion.name, f"passing out of {motion.name}"
        self._nothing = np.zeros(1, OBSERVATION)
        self._from = sequence.stand
        self._estimating, self._folded, self._leave_early = False, True, False
        self.phase, self._steps = DeploymentPhase.HOLD, 0
        self.violation: Violation | None = None

    def begin(self, reading: NDArray[Any]) -> Violation | None:
        """Takes the robot as it is, by its first state (1,) of `READING`; returns what keeps it from standing up."""
        self.guard.reset()
        found = self.guard.check_state(reading)
        if found is None:
            self._estimating = False
            self._go(DeploymentPhase.HOLD, reading)
        return found

    def warm_up(self, reading: NDArray[Any]) -> None:
        """Has everything compiled and in the caches; nothing of it is remembered."""
        way, guard = self.sequence, self.guard
        self.guard = DryRunGuard(self.robot, guard.limits, 1.0 / self._dt)
        for phase in DeploymentPhase:
            if phase in _LASTS_S:
                self._estimating = False
                self._go(phase, reading)
                self.step(reading)
        for part in (way.blend_in, way.main, way.blend_out):
            self._start_estimating(reading)
            self._start_following()
            self.follower.enter(part, np.zeros(3))
            self._switch_controller()
            self.phase = DeploymentPhase.FOLLOW
            for _ in range(_WARM_UP):
                self.step(reading)
        self.guard, self._estimating, self.violation = guard, False, None
        self._go(DeploymentPhase.HOLD, reading)

    @property
    def observation(self) -> NDArray[Any]:
        return self.estimator.observation if self._estimating else self._nothing

    @property
    def doing(self) -> str:
        """What it does, in words."""
        if self.phase is not DeploymentPhase.FOLLOW:
            return _WORDS[self.phase]
        way, part = self.sequence, self.follower.part
        return self._words[0 if part is way.blend_in else 1 if part is way.main else 2]

    @property
    def in_motion(self) -> bool:
        """Whether the robot does the motion itself at present, neither on its way there nor back."""
        return self.phase is DeploymentPhase.FOLLOW and self.follower.in_motion

    @property
    def cycles(self) -> int:
        return self.follower.steps // self.sequence.motion.n_samples

    def leave(self) -> None:
        """Has the robot go back to standing and sit down as soon as the motion can be left."""
        self.follower.leaving = True
        self._leave_early = True

    def step(self, reading: NDArray[Any]) -> NDArray[Any]:
        """One control step.

        Args:
            reading: (1,) of `READING`, the newest.

        Returns:
            (1,) of `COMMAND`, overwritten by the next call. Where `violation` is set it is not to be sent.
        """
        following = self.phase is DeploymentPhase.FOLLOW
        follower = self.follower
        if following:
            self.violation = self.guard.check_state(reading, follower.table, follower.clock)
        else:
            self.violation = self.guard.check_state(reading)
        if self.violation is not None:
            return self._command
        self._look(reading)
        if following:
            command = self._follow()
            if self.phase is DeploymentPhase.FOLLOW or self.violation is not None:
                return command
        return self._posture(reading)

    def _look(self, reading: NDArray[Any]) -> None:
        """Takes in the state, where there is an estimate."""
        if self._estimating:
            following = self.phase is DeploymentPhase.FOLLOW
            self.estimator.step(reading, self.controller.memory["stance"] if following else _LEGS)

    def _follow(self) -> NDArray[Any]:
        """The controller's command, or the first one of sitting down."""
        observation, follower = self.estimator.observation, self.follower
        if follower.advance(observation):
            self._switch_controller()
        self.violation = self.guard.check_estimate(observation, follower.table, follower.clock)
        if self.violation is not None:
            return self._command
        if follower.done:
            last, joints = self.controller.command[0], observation["joint_pos"][0]
            torque = last["torque"] + last["stiffness"] * (last["joint_pos"] - joints)
            self._from = joints + torque / self._stiffness  # so that the joints go on pushing as they do
            self.phase, self._steps = DeploymentPhase.SIT, 0
            return self._command
        command = self._drive()
        self.violation = self.guard.check_solver(int(self._failed[0]))
        return self._cut(command)

    def _drive(self) -> NDArray[Any]:
        return self.controller.step(self.estimator.observation, self.follower.clock)

    def _cut(self, command: NDArray[Any]) -> NDArray[Any]:
        found = self.guard.cut_command(command)
        self.violation = self.violation if self.violation is not None else found
        return command

    def _posture(self, reading: NDArray[Any]) -> NDArray[Any]:
        """A command of one of the phases without the controller, and what comes after it."""
        share = (self._steps + 1) * self._dt / _LASTS_S[self.phase] if self.phase in _LASTS_S else 1.0
        self._steps += 1
        stiffness, damping = 1.0, 1.0
        path = self._path
        if self.phase is DeploymentPhase.HOLD:
            joints, stiffness = self._from, smooth(share)
        elif self.phase is DeploymentPhase.FOLD:
            joints = self._from + smooth(share) * (path[0] - self._from)
        elif self.phase is DeploymentPhase.RISE:
            joints = along(path, share) if self._folded else self._from + smooth(share) * (path[-1] - self._from)
        elif self.phase is DeploymentPhase.SETTLE:
            joints = path[-1]
        elif self.phase is DeploymentPhase.SIT:
            # from wherever the controller left the joints
            joints = along(path, 1.0 - share) + (1.0 - smooth(min(1.0, 3.0 * share))) * (self._from - path[-1])
        else:
            joints, stiffness = path[0], 1.0 - smooth(share)
        command = self._cut(self._command_of_posture(joints, stiffness, damping))
        if share >= 1.0 - 1e-9 and self.violation is None:
            self._next(reading)
        return command

    def _command_of_posture(self, joints: Array, stiffness: float = 1.0, damping: float = 1.0) -> NDArray[Any]:
        command = self._command
        command["joint_pos"], command["joint_vel"], command["torque"] = joints, 0.0, 0.0
        command["stiffness"], command["damping"] = stiffness * self._stiffness, damping * self._damping
        return command

    def _next(self, reading: NDArray[Any]) -> None:
        """The next phase, with this state."""
        if self.phase is DeploymentPhase.HOLD:
            self._folded = _height(self.robot, reading["joint_pos"][0]) < _STANDING * self._reach
            self._go(DeploymentPhase.FOLD if self._folded else DeploymentPhase.RISE, reading)
        elif self.phase is DeploymentPhase.RISE:
            self._start_estimating(reading)
            self._go(DeploymentPhase.SETTLE, reading)
        elif self.phase is DeploymentPhase.SETTLE:
            self.violation = self.guard.check_posture(reading, self.sequence.stand)
            if self.violation is None and self._leave_early:
                self._go(DeploymentPhase.SIT, reading)
            elif self.violation is None:
                self._start_following()
                self.phase = DeploymentPhase.FOLLOW
        elif self.phase is not DeploymentPhase.DONE:
            self._go(DeploymentPhase(self.phase + 1), reading)

    def _go(self, phase: DeploymentPhase, reading: NDArray[Any]) -> None:
        self.phase, self._steps = phase, 0
        self._from = np.array(reading["joint_pos"][0])

    def _start_estimating(self, reading: NDArray[Any]) -> None:
        """The robot stands: its place is the world's origin, its heading the x axis."""
        self.estimator.reset(reading, np.zeros(1, START), _LEGS)
        self._estimating = True

    def _start_following(self) -> None:
        observation = self.estimator.observation
        root, yaw = observation["root_pos"][0], float(yaw_from_quat(observation["root_quat"][0]))
        self.follower.begin(np.array([root[0], root[1], yaw]))
        self._switch_controller()

    def _switch_controller(self) -> None:
        """Whose turn it is, with the table of the present stretch."""
        follower = self.follower
        chosen = self._own if follower.in_motion else self._model_based
        begins = follower.part is self.sequence.blend_in
        if chosen is not self.controller or begins:
            self.controller, self._failed = chosen, chosen.memory["failed_in_a_row"]
            chosen.tables = follower.part.table
            chosen.reset(follower.clock["sample"])
        chosen.tables = follower.part.table


def _height(robot: Robot, joints: Array) -> float:
    """Mean height of the hips over the feet, m."""
    feet = foot_positions(robot, joints[None])[0]
    return float(np.mean(robot.hip_pos_b[:, 2] - feet[:, 2]))
