"""The state machine of a deployment: hold, fold, rise, settle, lean, follow the motion sequence, sit down, release."""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.rotations import yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.control.controller import Controller
from fastmimic.deploy.plausibility import LEAN_S, Lean, LoadCheck
from fastmimic.deploy.safety import Guard, StopReason, Violation
from fastmimic.deploy.sequence import Follower
from fastmimic.episode.loop import LoopController, MakeController
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.estimation.estimator import START, Estimator
from fastmimic.reference.standing import along, rising_path, smooth, standing_gains
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.robot.state import COMMAND, OBSERVATION

_STANDING: Final = 0.75  # share of the standing height above which a robot counts as standing
_WARM_UP: Final = 20
_LEGS: Final = np.ones((1, 4), np.int64)


class DeploymentPhase(IntEnum):
    """The phases: number, words, and duration, s, where it is fixed. DAMP follows a violation or an emergency stop."""

    text: str
    lasts_s: float

    def __new__(cls, number: int, text: str, lasts_s: float = 0.0) -> "DeploymentPhase":
        phase = int.__new__(cls, number)
        phase._value_, phase.text, phase.lasts_s = number, text, lasts_s
        return phase

    HOLD = 0, "stiffening the joints", 0.4
    FOLD = 1, "folding its legs", 1.2
    RISE = 2, "standing up", 1.5
    SETTLE = 3, "standing", 0.6
    LEAN = 4, "leaning to check its sensors", LEAN_S
    FOLLOW = 5, "following the motion"
    SIT = 6, "sitting down", 1.8
    RELEASE = 7, "releasing the joints", 0.5
    DONE = 8, "done"
    CROUCH = 9, "crouching"
    DAMP = 10, "damped"


class StateMachine:
    """Commands for one robot, step by step, each `dt` s. `guard` checks states and commands; `violation` is what it
    found in the last step. `follower` is the position in the motion sequence, in phase `FOLLOW`; `observation` (1,) of
    `OBSERVATION` the controller's input, all 0 before the robot stands."""

    def __init__(
        self,
        robot: Robot,
        follower: Follower,
        guard: Guard,
        config: ControllerConfig,
        *,
        estimator: EstimatorConfig | None = None,
        policy: MakeController | None = None,
    ) -> None:
        """`policy` makes the controller of the motion itself; the model-based one, of `config`, blends in and out."""
        sequence = follower.sequence
        self.robot, self.follower, self.sequence, self.guard = robot, follower, sequence, guard
        self.dt = 1.0 / config.rate_hz
        self._model_based = Controller(robot, [sequence.motion], 1, config)
        if follower.steered:
            self._model_based.recover_with(None)  # recovery steps would be another gait
        self._regulated = config.stance.feedback == "regulator"
        self.controller: LoopController = self._model_based
        self._own = policy(robot, sequence.motion.target, 1, config) if policy is not None else self.controller
        self.estimator = Estimator(robot, 1, config.rate_hz, estimator)
        self.observation = self.estimator.observation
        self._path, _ = rising_path(robot, sequence.stand)
        self._folded_feet, self._standing_feet = foot_positions(robot, self._path[[0, -1]])
        self._stiffness, self._damping = standing_gains(robot)
        self._command = np.zeros(1, COMMAND)
        self._last = np.zeros(1, COMMAND)
        self._load = LoadCheck(robot)
        self._lean = Lean(robot, sequence.stand, guard.limits.lean)
        self._from = sequence.stand
        self._estimating, self._folded, self._leave_early = False, True, False
        self.phase, self._steps = DeploymentPhase.HOLD, 0
        self.violation: Violation | None = None

    def begin(self, reading: Records) -> Violation | None:
        """Begins with the first state (1,) of `READING`; returns a violation that prevents standing up."""
        self.guard.reset()
        self._last[...] = np.zeros(1, COMMAND)  # not what was rehearsed
        self._last["joint_pos"] = reading["joint_pos"]
        found = self._check(reading, 0.0)
        if found is None:
            self._estimating = False
            self.observation[...] = np.zeros(1, OBSERVATION)
            self._go(DeploymentPhase.HOLD, reading)
        return found

    def warm_up(self, reading: Records, rehearse: Callable[[], bool] | None = None) -> None:
        """Runs all phases once to compile and cache all, then the motion while `rehearse` says so, and begins again."""
        follower, guard = self.follower, self.guard
        self.guard = Guard(self.robot, guard.limits, 1.0 / self.dt, dry=True)
        for phase in DeploymentPhase:
            if phase.lasts_s:
                self._estimating = False
                self._go(phase, reading)
                self.step(reading)
        for begin in (follower.begin, follower.leave_motion, follower.enter_motion):
            self._start_estimating(reading)
            self._start_following()
            begin(np.zeros(3))
            self._switch_controller()
            self.phase = DeploymentPhase.FOLLOW
            for _ in range(_WARM_UP):
                self.step(reading)
        while rehearse is not None and rehearse():
            self.step(reading)
        self.guard, self._estimating, self.violation = guard, False, None
        self._go(DeploymentPhase.HOLD, reading)

    @property
    def doing(self) -> str:
        """The current phase, or the part of the sequence, in words."""
        return self.follower.text if self.phase is DeploymentPhase.FOLLOW else self.phase.text

    @property
    def in_motion(self) -> bool:
        """Whether the robot executes the motion itself, neither blending in nor out."""
        return self.phase is DeploymentPhase.FOLLOW and self.follower.in_motion

    def crouch(self, share: float) -> Records:
        """(1,) of `COMMAND` at a share in [0, 1] of crouching: all legs come to where they stand, as long as the
        longest one is, and fold. It goes by joint angles alone, from the last command on: no sensor need be right."""
        if share == 0.0:
            last = self._last["joint_pos"]
            self._standing_feet[:, 2] = foot_positions(self.robot, last)[0, :, 2].min()
            self._keep_torques(last[0])
        feet = self._standing_feet + smooth(share) * (self._folded_feet - self._standing_feet)
        joints = inverse_kinematics(self.robot, feet)[0]
        return self._hold(self._from + smooth(3.0 * share) * (joints - self._from))

    def leave(self) -> None:
        """Makes the robot blend out and sit down as soon as the motion allows."""
        self.follower.leaving = True
        self._leave_early = True

    def step(self, reading: Records, elapsed_s: float | None = None) -> Records:
        """One control step from the newest state (1,) of `READING`, `elapsed_s` after the last one: 0 if it is the same
        one, a period if None. Returns (1,) of `COMMAND`, overwritten by the next call; it must not be sent if
        `violation` is set."""
        following, follower = self.phase is DeploymentPhase.FOLLOW, self.follower
        reference = (follower.tables[0], follower.clock) if following else (None, None)
        elapsed_s = self.dt if elapsed_s is None else elapsed_s
        self.violation = self._check(reading, elapsed_s, *reference)
        if self.violation is not None:
            return self._command
        if self._estimating:
            self.estimator.step(reading, self.controller.memory["stance"] if following else _LEGS)
        if self.phase is DeploymentPhase.LEAN:
            self._lean.add(reading, self._last["joint_pos"][0], elapsed_s, self.estimator.load)
        if following:
            command = self._follow()
            if self.phase is DeploymentPhase.FOLLOW or self.violation is not None:
                return command
        return self._posture(reading)

    def _check(self, reading: Records, elapsed_s: float, *reference: Any) -> Violation | None:
        """A limit that a state is beyond, or sensors that contradict each other, who also tell its tilt."""
        limit = self.guard.check_state(reading, *reference)
        doubt = self.guard.check_doubt(self.guard.senses.check(reading, self._last, elapsed_s))
        return doubt or limit if limit is None or limit.reason is StopReason.TILT else limit

    def _follow(self) -> Records:
        """The controller's command; after the last one, the phase is `SIT`."""
        observation, follower = self.observation, self.follower
        if follower.advance(observation, self.controller.memory):
            self._switch_controller()
        self.violation = self.guard.check_estimate(observation, follower.tables[0], follower.clock)
        if self.violation is None and not self.guard.dry:  # in a dry run the legs bear nothing
            self.violation = self.guard.check_doubt(self._load.check(self.estimator.load, self.dt))
        if self.violation is not None:
            return self._command
        if follower.done:
            self._keep_torques(observation["joint_pos"][0])
            self.phase, self._steps = DeploymentPhase.SIT, 0
            return self._command
        if self._regulated:
            self._model_based.gains = follower.gains
        command = self.controller.step(observation, follower.clock)
        failed = int(self.controller.memory["failed_in_a_row"][0])
        self.violation = self.guard.check_number(StopReason.QP_FAILURE, failed)
        return self._cut(command)

    def _cut(self, command: Records) -> Records:
        found = self.guard.cut_command(command)
        self._last[...] = command
        self.violation = self.violation if self.violation is not None else found
        return command

    def _keep_torques(self, joints: Array) -> None:
        """The next posture begins where the stiffness gives the last command's torques, at joints (12,) in rad."""
        last = self._last[0]
        torque = last["torque"] + last["stiffness"] * (last["joint_pos"] - joints)
        self._from = joints + torque / self._stiffness

    def _hold(self, joints: Array, stiffness: float = 1.0) -> Records:
        """The command (1,) that holds joints (12,), rad, at a share of the standing stiffness."""
        command = self._command
        command["joint_pos"], command["joint_vel"], command["torque"] = joints, 0.0, 0.0
        command["stiffness"], command["damping"] = stiffness * self._stiffness, self._damping
        return self._cut(command)

    def _posture(self, reading: Records) -> Records:
        """The command of a phase without the controller; at its end the next phase begins."""
        phase, path, stiffness = self.phase, self._path, 1.0
        share = (self._steps + 1) * self.dt / phase.lasts_s if phase.lasts_s else 1.0
        self._steps += 1
        if phase is DeploymentPhase.HOLD:
            joints, stiffness = self._from, smooth(share)
        elif phase is DeploymentPhase.FOLD:
            joints = self._from + smooth(share) * (path[0] - self._from)
        elif phase is DeploymentPhase.RISE:
            joints = along(path, share) if self._folded else self._from + smooth(share) * (path[-1] - self._from)
        elif phase is DeploymentPhase.SETTLE:
            joints = path[-1]
        elif phase is DeploymentPhase.LEAN:
            joints = self._lean.posture(share)
        elif phase is DeploymentPhase.SIT:  # from the joints at the controller's last step
            joints = along(path, 1.0 - share) + (1.0 - smooth(min(1.0, 3.0 * share))) * (self._from - path[-1])
        else:
            joints, stiffness = path[0], 1.0 - smooth(share)
        command = self._hold(joints, stiffness)
        if share >= 1.0 - 1e-9 and self.violation is None:
            self._next(reading)
        return command

    def _next(self, reading: Records) -> None:
        if self.phase is DeploymentPhase.HOLD:
            height, stand = _height(self.robot, reading["joint_pos"][0]), _height(self.robot, self.sequence.stand)
            self._folded = height < _STANDING * stand
            self._go(DeploymentPhase.FOLD if self._folded else DeploymentPhase.RISE, reading)
        elif self.phase is DeploymentPhase.RISE:
            self._start_estimating(reading)
            self._go(DeploymentPhase.SETTLE, reading)
        elif self.phase is DeploymentPhase.SETTLE:
            self.violation = self.guard.check_posture(reading, self.sequence.stand)
            if self.violation is None and self.guard.leans and not self._leave_early:
                self._lean.begin()
                self._go(DeploymentPhase.LEAN, reading)
            elif self.violation is None:
                self._go_on(reading)
        elif self.phase is DeploymentPhase.LEAN:
            doubt = self._lean.verdict(self.estimator.ground, self.guard.limits.sensors_ground)
            self.violation = self.guard.check_doubt(doubt)
            if self.violation is None:
                self._go_on(reading)
        elif self.phase is not DeploymentPhase.DONE:
            self._go(list(DeploymentPhase)[self.phase + 1], reading)

    def _go_on(self, reading: Records) -> None:
        """From standing to the motion, or down again."""
        if self._leave_early:
            self._go(DeploymentPhase.SIT, reading)
        else:
            self._start_following()
            self.phase = DeploymentPhase.FOLLOW

    def _go(self, phase: DeploymentPhase, reading: Records) -> None:
        self.phase, self._steps = phase, 0
        self._from = np.array(reading["joint_pos"][0])

    def _start_estimating(self, reading: Records) -> None:
        """Starts the estimator with the robot at the world's origin, facing x."""
        self.estimator.reset(reading, np.zeros(1, START), _LEGS)
        self._load = LoadCheck(self.robot)
        self._estimating = True

    def _start_following(self) -> None:
        root, yaw = self.observation["root_pos"][0], float(yaw_from_quat(self.observation["root_quat"][0]))
        self.follower.begin(np.array([root[0], root[1], yaw]))
        self._switch_controller(begins=True)

    def _switch_controller(self, begins: bool = False) -> None:
        """Chooses the controller of the current part, with the part's table."""
        follower = self.follower
        chosen = self._own if follower.in_motion else self._model_based
        chosen.tables = follower.tables
        if chosen is not self.controller or begins:
            self.controller = chosen
            chosen.reset(follower.clock["sample"])


def _height(robot: Robot, joints: Array) -> float:
    """Mean height of the hips over the feet, m."""
    feet = foot_positions(robot, joints)
    return float(np.mean(robot.hip_pos_b[:, 2] - feet[:, 2]))
