"""The controller: from robot states and references to joint commands of all robots, compiled (paper, §III-B)."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Records
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import floats, inlined, kernel, record_dtype
from fastmimic.base.vectors import copy, heading_vector, transposed_times
from fastmimic.control.config import ControllerConfig, StanceConfig, loaded_robot, pack_config
from fastmimic.control.footing import feel_slides, see_ground
from fastmimic.control.horizon import HORIZON_CONSTRAINTS, HORIZON_VARIABLES, PLAN, plan_forces, track_plan
from fastmimic.control.horizon_preview import FORESIGHT
from fastmimic.control.joint_commands import add_leg_dynamics, finish_leg, lift_off, stance_leg, swing_leg
from fastmimic.control.native import make_workspace, seconds_now
from fastmimic.control.recovery import LEAVES, NO_RECOVERY, begin_or_end_recovery, recovery_gaits
from fastmimic.control.stance import MAX_CONSTRAINTS, MAX_VARIABLES, begin_legs, plan_leg, stance_forces
from fastmimic.control.tracking import (
    body_frame,
    compare_to_reference,
    estimate_disturbance,
    expect_acceleration,
    regulate,
)
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator import GAINS, STATES, motion_gains
from fastmimic.reference.table import CLOCK, advance_clock, put_root_at, stack_tables, steps_due, taken_up_at
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, MEMORY, OBSERVATION, pack_model

SCRATCH: Final = record_dtype(
    [
        # rotations: body → heading frame, the same of a sample in its own one, reference's body → robot's heading frame
        *floats(rotation=(3, 3), candidate=(3, 3), reference_rotation=(3, 3)),
        # cos and sin of the robot's heading, and of the turn from there to that of the reference's origin
        *floats(heading=2, turn=2),
        # body frame: centre of mass and feet; heading frame: inertia, and the feet from the centre of mass
        *floats(com=3, inertia=(3, 3), inverse_inertia=(3, 3), feet=(4, 3), arms=(4, 3)),
        # velocities and accelerations of the base and of the reference, heading frame
        *floats(lin_vel=3, ang_vel=3, ref_lin_vel=3, ref_ang_vel=3, ref_lin_acc=3, ref_ang_acc=3),
        # reference minus robot, heading frame, and the regulator's state: robot minus reference
        *floats(error=3, angle_error=3, lin_vel_error=3, ang_vel_error=3, state=STATES),
        # the acceleration that carries the weight, m/s², in the ground's frame and in the heading frame, and how far
        # downhill the feet stand for it, m
        *floats(uphill=3, against=3, lean=2),
        # the same velocities in the body frame, for the legs; the reference's in its own one
        *floats(velocity_error=3, lin_vel_b=3, ang_vel_b=3, ref_lin_vel_b=3, ref_ang_vel_b=3),
        # accelerations that the forces have to give, their momentum of the legs, and those minus gravity
        *floats(desired=6, momentum=6, gravity_acc=3, gravity_acc_b=3),
        *floats(columns=(12, 6), weighted=(12, 6), column=6, change=3, vector=3, quat=4),
        # legs; the foot's target in the body frame
        *floats(jacobian=(3, 3), force_b=3, foot_target=3, joint_acc=12, torque=3),
    ]
)
"""Work memory of the control law, one record per thread: it allocates nothing. The suffix _b is for the body frame."""


class WorkMemory(NamedTuple):
    """Work memory of one thread, (1,) each: the two QPs, `SCRATCH` and `FORESIGHT`. What only the horizon needs is
    None with instant forces: the kernels are then compiled without it, in half the time."""

    qp: Any
    plan_qp: Any
    scratch: Any
    foresight: Any


@kernel
def control_step(
    configs: Any,
    models: Any,
    tables: Any,
    gains: Any,
    clocks: Any,
    observations: Any,
    seen: Any,
    memories: Any,
    commands: Any,
    plans: Any,
    trots: Any,
    trot_gains: Any,
    trot_clocks: Any,
    qps: Any,
    plan_qps: Any,
    scratches: Any,
    foresights: Any,
) -> None:
    """Computes the commands of all robots; robot i follows table min(i, k − 1) of (k, samples) at its clock, with gains
    (1 or k, g), or one of the `trots` (p, m) at its own clock. The records are (n,), those of the configuration, the
    model and the work memory (1,). The arguments are flat because a call with tuples of arrays takes 2 µs longer."""
    config, model, scratch = configs[0], models[0], scratches[0]
    for i in range(observations.shape[0]):
        table = tables[min(i, tables.shape[0] - 1)]
        clock, obs, memory, command = clocks[i], observations[i], memories[i], commands[i]
        ref = table[clock.sample]
        gain = gains[min(i, gains.shape[0] - 1), min(ref.gain, gains.shape[1] - 1)]
        if config.follow_ground == 1:
            see_ground(config, model, ref, obs, memory, seen[0], scratch)
            obs = seen[0]
        compare_to_reference(model, ref, clock, obs, scratch)
        piece = clock.sample * trots.shape[0] // table.shape[0]
        trot, own = trots[piece], trot_clocks[i]
        if config.recovery_steps == 1:
            changed = begin_or_end_recovery(config, table, clock, gain, trot, own, obs, memory, scratch)
            if memory.recovering > 0:
                ref, clock = trot[own.sample], own
                gain = trot_gains[piece, min(ref.gain, trot_gains.shape[1] - 1)]
                compare_to_reference(model, ref, clock, obs, scratch)
            if changed:
                _take_over(config, ref, memory, scratch)
        body_frame(ref, scratch)
        estimate_disturbance(config, obs, memory, scratch)
        for leg in range(4):
            if plan_leg(config, memory, leg, ref.contact[leg] == 1, ref.swung[leg], obs.foot_force[leg, 2]):
                lift_off(config, ref, memory, scratch, leg)
        feel_slides(config, model, obs, memory, scratch)
        regulate(config, ref, gain, memory, scratch)
        planned = False
        if foresights is not None:
            plan, ahead = plans[i], foresights[0]
            _plan_ahead(config, model, table, clock, obs, memory, scratch, plan, ahead, plan_qps[0])
            planned = plan.valid == 1
            if planned:
                _follow_plan(config, obs, memory, scratch, plan, gain, ahead)
        solved = _forces(config, model, ref, gain, memory, planned, scratch, qps[0])
        expect_acceleration(model, memory, scratch)
        for leg in range(4):
            if memory.stance[leg] == 1:
                stance_leg(config, model, obs, memory, command, scratch, leg, solved)
            else:
                swing_leg(config, model, obs, ref, memory, command, scratch, leg)
            add_leg_dynamics(config, model, obs, memory, command, scratch, leg)
            finish_leg(config, model, command, leg)
        if memory.recovering > 0:
            for _ in range(steps_due(own, trot.shape[0], memory.haste, trot)):
                advance_clock(own, trot.shape[0], obs.root_pos[0], obs.root_pos[1], trot)
            put_root_at(own, trot, obs.root_pos[0], obs.root_pos[1])  # it has a velocity to keep, and no place
            if memory.recovering == LEAVES:
                memory.haste = taken_up_at(memory.taken_up)


@inlined
def _take_over(config: Any, ref: Any, memory: Any, scratch: Any) -> None:
    """Takes feet in the air as they are, when the reference changes."""
    for leg in range(4):
        if memory.stance[leg] == 0:
            lift_off(config, ref, memory, scratch, leg)
        memory.early[leg] = 0
        for a in range(2):
            memory.lag[leg, a] = 0.0


@inlined
def _forces(config: Any, model: Any, ref: Any, gain: Any, memory: Any, planned: bool, scratch: Any, qp: Any) -> bool:
    """Stance forces, and the base acceleration for the legs' own dynamics; False if the stance QP failed."""
    desired, gravity_acc = scratch.desired, scratch.gravity_acc
    for k in range(6):
        limit = config.acceleration_limit[k]
        desired[k] = min(max(desired[k], -limit), limit)
    for k in range(3):
        gravity_acc[k] = desired[k] + scratch.against[k]
    transposed_times(scratch.rotation, gravity_acc, scratch.gravity_acc_b)
    _add_leg_momentum(config, ref, scratch)
    if planned and config.horizon_interval == 1:
        return True
    return bool(stance_forces(config, model, gain, memory, scratch, qp))


@kernel
def _plan_ahead(
    config: Any, model: Any, table: Any, clock: Any, obs: Any, memory: Any, scratch: Any, plan: Any, ahead: Any, qp: Any
) -> None:
    """Plans at the planning rate and at the start of a cycle, where the reference may jump."""
    plan.age += 1
    memory.solve_time = 0.0
    if plan.valid == 0 or plan.age >= config.horizon_interval or table[clock.sample].sync == 1:
        began = seconds_now(ahead.time)
        plan_forces(config, model, table, clock, obs, memory, scratch, plan, ahead, qp)
        memory.solve_time = seconds_now(ahead.time) - began


@kernel
def _follow_plan(config: Any, obs: Any, memory: Any, scratch: Any, plan: Any, gain: Any, ahead: Any) -> None:
    """ẍ_des follows the plan; if every control step is planned, the forces do, too."""
    track_plan(config, obs, plan, gain, scratch.state, ahead, scratch.desired)
    if config.horizon_interval == 1:
        for leg in range(4):
            copy(plan.force[0, leg], memory.force[leg])
        memory.failed_in_a_row = 0


@inlined
def _add_leg_momentum(config: Any, ref: Any, scratch: Any) -> None:
    """Adds to ẍ_des what the motion of the reference's legs takes."""
    c, s, momentum = scratch.turn[0], scratch.turn[1], scratch.momentum
    heading_vector(c, -s, ref.leg_lin_acc, momentum[0:3])
    heading_vector(c, -s, ref.leg_ang_acc, momentum[3:6])
    for r in range(6):
        momentum[r] *= config.leg_momentum
        scratch.desired[r] += momentum[r]


def constant_gains_of(stance: StanceConfig) -> Records:
    """The paper's feedback (eq. 1), (1,) of `GAINS`: k_p, k_d and Q."""
    gains = np.zeros(1, GAINS)
    gains["trunk"][0, :, :6], gains["trunk"][0, :, 6:12] = np.diag(stance.position_gain), np.diag(stance.velocity_gain)
    gains["weight"][0] = np.diag(stance.acceleration_weight)
    return gains


def gains_of(motion: Motion, robot: Robot, config: ControllerConfig) -> Records:
    """The feedback (g,) of `GAINS` along a motion's demonstration, or the paper's constant one (1,)."""
    if config.stance.feedback == "constant":
        return constant_gains_of(config.stance)
    return motion_gains(motion, robot, config.regulator)


class Controller:
    """n robots under one configuration, each following a reference of the same length. For one thread at a time."""

    def __init__(self, robot: Robot, motions: Sequence[Motion], n: int, config: ControllerConfig | None = None) -> None:
        """`motions` has one reference for all robots, or one for each. Raises `ConfigError` if the references are at
        another rate or neither 1 nor n, or the config is for another robot; `MotionError` if they differ in length."""
        self.config = config if config is not None else ControllerConfig()
        if self.config.robot not in ("", robot.name):
            own = f"controller configuration '{self.config.name}' is for robot '{self.config.robot}'"
            raise ConfigError(f"{own}, not '{robot.name}'")
        robot = loaded_robot(robot, self.config.load)
        if len(motions) not in (1, n):
            raise ConfigError(f"{n} robots need 1 or {n} references, found {len(motions)}")
        for motion in motions:
            motion.check_rate(self.config.rate_hz)
        self.tables = stack_tables(motions, robot)
        self.gains = np.stack([gains_of(motion, robot, self.config) for motion in motions])
        self.memory = np.zeros(n, MEMORY)
        self.command = np.zeros(n, COMMAND)
        self.plan = np.zeros(n, PLAN)
        self._seen, self._trot_clocks = np.zeros(1, OBSERVATION), np.zeros(n, CLOCK)
        self._robot, self._config = robot, pack_config(self.config, robot)
        self._model = pack_model(robot)
        self._recovers: Motion | None = None
        self.recover_with(motions[0])
        ahead = self._config["horizon"][0] == 1
        plan_qp = make_workspace(HORIZON_VARIABLES, HORIZON_CONSTRAINTS) if ahead else None
        foresight = np.zeros(1, FORESIGHT) if ahead else None
        qp, scratch = make_workspace(MAX_VARIABLES, MAX_CONSTRAINTS), np.zeros(1, SCRATCH)
        self._work = WorkMemory(qp, plan_qp, scratch, foresight)
        scratch["uphill"][:, 2] = GRAVITY  # on level ground

    def recover_with(self, motion: Motion | None) -> None:
        """Takes recovery steps from now on as they fit a motion; none at all if None."""
        if motion is not self._recovers:
            recovers = self.config.gait.recovery_steps and motion is not None
            self._config["recovery_steps"] = recovers
            self._trots = recovery_gaits(motion, self._robot, self.config.regulator) if recovers else NO_RECOVERY
            self._recovers = motion

    def reset(self, sample: NDArray[np.int64]) -> None:
        """Starts each robot in the leg states that its reference has at `sample` (n,)."""
        begin_legs(self.memory, self.tables, sample)
        self.plan["valid"] = 0

    def step(self, observation: Records, clocks: Records) -> Records:
        """The next control step's commands, (n,), overwritten by the next call; from (n,) of `OBSERVATION`, `CLOCK`."""
        robots = self.tables, self.gains, clocks, observation, self._seen, self.memory, self.command, self.plan
        control_step(self._config, self._model, *robots, *self._trots, self._trot_clocks, *self._work)
        return self.command
