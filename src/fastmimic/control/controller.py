"""The controller: from the robots' states and references to joint commands, all robots in one compiled call.

Gait planner → stance forces and adaptation → swing → joint commands (paper, §III-B).
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import inlined, kernel, record_dtype
from fastmimic.base.vectors import heading_vector, quat_to_matrix, rotation_error, times, transposed_times, turn_rows
from fastmimic.control.adaptation import DAMPING_AFTER_FAILURE, stance_leg
from fastmimic.control.config import ControllerConfig, default_config, pack_config
from fastmimic.control.daqp import make_workspace
from fastmimic.control.gait import plan_leg
from fastmimic.control.horizon import FORESIGHT, PLAN, plan_forces, track_plan
from fastmimic.control.horizon import MAX_CONSTRAINTS as HORIZON_CONSTRAINTS
from fastmimic.control.horizon import MAX_VARIABLES as HORIZON_VARIABLES
from fastmimic.control.inertia import WORK as INERTIA_WORK
from fastmimic.control.inertia import add_standing_leg
from fastmimic.control.load import loaded_robot
from fastmimic.control.stance import MAX_CONSTRAINTS, MAX_VARIABLES, invert_symmetric_3x3, stance_forces
from fastmimic.control.stopwatch import seconds_now
from fastmimic.control.swing import lift_off, swing_leg
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import stack_tables
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import leg_inverse_dynamics, leg_mass_moment
from fastmimic.robot.kinematics import leg_forward
from fastmimic.robot.state import COMMAND, MEMORY, pack_model

DRY_FRICTION_FROM: Final = 0.5
"""rad/s; at less, it is made up for in part, so that torques do not jump where joints turn round."""

SCRATCH: Final = record_dtype(
    [
        ("rotation", "f8", (3, 3)),  # body → heading frame
        ("reference_rotation", "f8", (3, 3)),  # reference's body → robot's heading frame
        ("inertia", "f8", (3, 3)),
        ("inverse_inertia", "f8", (3, 3)),
        ("turn", "f8", (2,)),  # cos and sin from the robot's heading to that of the reference's origin
        ("arms", "f8", (4, 3)),  # feet from the CoM, heading frame
        ("feet", "f8", (4, 3)),  # body frame
        ("lin_vel", "f8", (3,)),  # of the base, heading frame
        ("ang_vel", "f8", (3,)),
        ("ref_lin_vel", "f8", (3,)),  # of the reference, heading frame
        ("ref_ang_vel", "f8", (3,)),
        ("error", "f8", (3,)),  # position, reference minus robot, heading frame; x and y then relative to the feet
        ("angle_error", "f8", (3,)),
        ("lin_vel_error", "f8", (3,)),
        ("ang_vel_error", "f8", (3,)),
        ("desired", "f8", (6,)),  # acceleration that the forces are to give
        ("columns", "f8", (12, 6)),
        ("jacobian", "f8", (3, 3)),
        ("shift", "f8", (2,)),  # of the reference to where the standing feet are, heading frame
        ("position_error", "f8", (3,)),  # reference minus robot in the world, body frame
        ("velocity_error", "f8", (3,)),  # likewise
        ("lin_vel_b", "f8", (3,)),  # of the base, body frame
        ("ang_vel_b", "f8", (3,)),
        ("ref_lin_vel_b", "f8", (3,)),  # of the reference, in its own body frame
        ("ref_ang_vel_b", "f8", (3,)),
        ("gravity_acc_b", "f8", (3,)),  # wanted of the base, minus gravity, body frame
        ("torque", "f8", (3,)),
        ("work", "f8", (3,)),
        ("joint_acc", "f8", (12,)),  # of what the legs follow
        ("recovering", "f8"),  # 1 after a push, else 0
        ("com", "f8", (3,)),  # body frame
        ("held_inertia", "f8", (3, 3)),  # of the trunk with the standing feet held, body frame
        ("held", INERTIA_WORK),
    ]
)
"""Work memory of the kernel, so that it allocates nothing. One record for each thread."""


@inlined
def _desired_acceleration(
    config: Any, error: Array, velocity_error: Array, feedforward: Array, out: Array, at: int
) -> None:
    """k_p e + k_d ė + feed-forward, into out[at:at + 3]."""
    for i in range(3):
        a = config.kp[at + i] * error[i] + config.kd[at + i] * velocity_error[i]
        out[at + i] = a + config.reference_acceleration * feedforward[i]


@kernel
def control_step(
    config: Any,
    model: Any,
    tables: Any,
    clocks: Any,
    observations: Any,
    memories: Any,
    commands: Any,
    plans: Any,
    qp: Any,
    plan_qp: Any,
    scratch: Any,
    foresight: Any,
) -> None:
    """Computes the commands of all robots; robot i follows table min(i, k − 1) at its clock."""
    for i in range(observations.shape[0]):
        table = tables[min(i, tables.shape[0] - 1)]
        _control_robot(
            config[0],
            model[0],
            table,
            clocks[i],
            observations[i],
            memories[i],
            commands[i],
            plans[i],
            qp[0],
            plan_qp[0],
            scratch[0],
            foresight[0],
        )


@kernel
def _control_robot(
    config: Any,
    model: Any,
    table: Any,
    clock: Any,
    obs: Any,
    memory: Any,
    command: Any,
    plan: Any,
    qp: Any,
    plan_qp: Any,
    scratch: Any,
    foresight: Any,
) -> None:
    ref = table[clock.sample]
    scratch.recovering = float(clock.recovering)
    _compare(model, ref, clock, obs, scratch)
    _want(config, ref, memory, scratch)
    height_error = scratch.error[2]
    for leg in range(4):
        if plan_leg(config, memory, leg, ref.contact[leg] == 1, obs.foot_force[leg, 2]):
            lift_off(config, ref, memory, scratch, scratch.feet[leg], leg, height_error, scratch.work)
    planned = config.horizon == 1 and _plan_ahead(
        config, model, table, clock, obs, memory, scratch, plan, foresight, plan_qp
    )
    solved = _forces(config, model, ref, obs, memory, planned, scratch, qp)
    for leg in range(4):
        if memory.stance[leg] == 1:
            stance_leg(config, model, obs, memory, command, scratch, leg, solved)
        else:
            swing_leg(config, model, obs, ref, memory, command, scratch, leg, height_error)
        _leg_dynamics(config, model, obs, memory, command, scratch, leg)
        for j in range(3 * leg, 3 * leg + 3):
            _make_up_for_losses(model, command, j)
            _keep_within_limits(config, model, command, j)


@inlined
def _compare(model: Any, ref: Any, clock: Any, obs: Any, scratch: Any) -> None:
    """Where the robot is, what it does, and what is missing to the reference; all in the robot's heading frame."""
    rotation, reference_rotation = scratch.rotation, scratch.reference_rotation
    quat_to_matrix(obs.root_quat, rotation)
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    turn_rows(c, -s, rotation)
    quat_to_matrix(ref.root_quat, reference_rotation)
    turn = clock.origin[2] - yaw
    ct, st = np.cos(turn), np.sin(turn)
    turn_rows(ct, st, reference_rotation)
    scratch.turn[0], scratch.turn[1] = ct, st

    _feet_and_com(model, obs, rotation, scratch.feet, scratch.arms, scratch.com)
    _heading_inertia(model.inertia, rotation, scratch.inertia)
    invert_symmetric_3x3(scratch.inertia, scratch.inverse_inertia)
    heading_vector(c, s, obs.lin_vel, scratch.lin_vel)
    heading_vector(c, s, obs.ang_vel, scratch.ang_vel)
    heading_vector(ct, -st, ref.lin_vel, scratch.ref_lin_vel)
    heading_vector(ct, -st, ref.ang_vel, scratch.ref_ang_vel)

    co, so = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    x = clock.origin[0] + co * ref.root_pos[0] - so * ref.root_pos[1] - obs.root_pos[0]
    y = clock.origin[1] + so * ref.root_pos[0] + co * ref.root_pos[1] - obs.root_pos[1]
    scratch.error[0], scratch.error[1] = c * x + s * y, -s * x + c * y
    scratch.error[2] = ref.root_pos[2] - obs.root_pos[2]
    rotation_error(reference_rotation, rotation, scratch.angle_error)
    for k in range(3):
        scratch.lin_vel_error[k] = scratch.ref_lin_vel[k] - scratch.lin_vel[k]
        scratch.ang_vel_error[k] = scratch.ref_ang_vel[k] - scratch.ang_vel[k]


@inlined
def _want(config: Any, ref: Any, memory: Any, scratch: Any) -> None:
    """What the legs are to do about it: ẍ_des for the standing ones, errors and velocities in the body frame."""
    rotation, reference_rotation, error = scratch.rotation, scratch.reference_rotation, scratch.error
    transposed_times(rotation, scratch.lin_vel, scratch.lin_vel_b)
    transposed_times(rotation, scratch.ang_vel, scratch.ang_vel_b)
    transposed_times(reference_rotation, scratch.ref_lin_vel, scratch.ref_lin_vel_b)
    transposed_times(reference_rotation, scratch.ref_ang_vel, scratch.ref_ang_vel_b)
    transposed_times(rotation, error, scratch.position_error)
    transposed_times(rotation, scratch.lin_vel_error, scratch.velocity_error)
    scratch.joint_acc[:] = ref.joint_acc

    scratch.shift[0], scratch.shift[1] = -error[0], -error[1]
    _relative_to_feet(config, ref, rotation, reference_rotation, scratch.feet, memory, error)
    scratch.shift[0] += error[0]
    scratch.shift[1] += error[1]
    c, s = scratch.turn[0], scratch.turn[1]
    heading_vector(c, -s, ref.lin_acc, scratch.work)
    _desired_acceleration(config, error, scratch.lin_vel_error, scratch.work, scratch.desired, 0)
    heading_vector(c, -s, ref.ang_acc, scratch.work)
    _desired_acceleration(config, scratch.angle_error, scratch.ang_vel_error, scratch.work, scratch.desired, 3)


@inlined
def _forces(config: Any, model: Any, ref: Any, obs: Any, memory: Any, planned: bool, scratch: Any, qp: Any) -> bool:
    """Forces of the standing legs, and the base's acceleration that the legs' own dynamics go by.

    Returns:
        False if the stance QP failed.
    """
    desired, gravity_acc = scratch.desired, scratch.work
    for k in range(6):
        limit = config.acceleration_limit[k]
        desired[k] = min(max(desired[k], -limit), limit)
    for k in range(3):
        gravity_acc[k] = desired[k] + (GRAVITY if k == 2 else 0.0)
    transposed_times(scratch.rotation, gravity_acc, scratch.gravity_acc_b)
    if config.standing_inertia == 1:
        _turn_over_standing_feet(config, model, ref, obs, memory, scratch)
    _add_leg_momentum(config, ref, scratch.turn[0], scratch.turn[1], desired, scratch.work)
    if planned and config.horizon_interval == 1:
        return True
    return bool(
        stance_forces(config, model.mass, scratch.inverse_inertia, scratch.arms, desired, memory, qp, scratch.columns)
    )


@kernel
def _turn_over_standing_feet(config: Any, model: Any, ref: Any, obs: Any, memory: Any, scratch: Any) -> None:
    """Gives the angular acceleration that is wanted beyond the reference's the moment that it takes while the standing
    feet stay, as an acceleration of the rigid body; the reference's own has `leg_momentum`."""
    held, desired = scratch.held_inertia, scratch.desired
    held[:, :] = model.inertia
    for leg in range(4):
        if memory.stance[leg] == 1:
            q = obs.joint_pos[3 * leg : 3 * leg + 3]
            add_standing_leg(model, leg, q, scratch.feet[leg], scratch.com, scratch.held, held)
    heading_vector(scratch.turn[0], -scratch.turn[1], ref.ang_acc, scratch.work)
    beyond, moment = scratch.held.vector, scratch.held.place
    for k in range(3):
        beyond[k] = desired[3 + k] - config.reference_acceleration * scratch.work[k]
    transposed_times(scratch.rotation, beyond, moment)
    times(held, moment, beyond)
    times(scratch.rotation, beyond, moment)
    times(scratch.inverse_inertia, moment, beyond)
    for k in range(3):
        desired[3 + k] = config.reference_acceleration * scratch.work[k] + beyond[k]


@kernel
def _plan_ahead(
    config: Any,
    model: Any,
    table: Any,
    clock: Any,
    obs: Any,
    memory: Any,
    scratch: Any,
    plan: Any,
    foresight: Any,
    qp: Any,
) -> bool:
    """Plans when it is time to, and where a cycle starts, since the reference may jump there.

    ẍ_des, and with a plan for every control step the forces, are then the plan's.

    Returns:
        False if there is no plan, because the solver failed: what the stance wants at present stays in force.
    """
    plan.age += 1
    memory.solve_time = 0.0
    if plan.valid == 0 or plan.age >= config.horizon_interval or table[clock.sample].sync == 1:
        began = seconds_now(foresight.time)
        plan_forces(config, model, table, clock, obs, memory, scratch, plan, foresight, qp)
        memory.solve_time = seconds_now(foresight.time) - began
    if plan.valid == 0:
        return False
    track_plan(config, obs, plan, foresight, scratch.desired)
    if config.horizon_interval == 1:
        memory.force[:, :] = plan.force[0]
        memory.failed_in_a_row = 0
    return True


@inlined
def _add_leg_momentum(config: Any, ref: Any, c: float, s: float, desired: Array, work: Array) -> None:
    """Adds to ẍ_des (6,) what the legs' motion takes beyond it; (c, s) of the reference's heading from the robot's."""
    heading_vector(c, -s, ref.leg_lin_acc, work)
    for k in range(3):
        desired[k] += config.leg_momentum * work[k]
    heading_vector(c, -s, ref.leg_ang_acc, work)
    for k in range(3):
        desired[3 + k] += config.leg_momentum * work[k]


@inlined
def _relative_to_feet(
    config: Any, ref: Any, rotation: Array, reference_rotation: Array, feet: Array, memory: Any, error: Array
) -> None:
    """Mixes the position error with that relative to where the standing feet are (x and y, heading frame).

    Over feet that did not land where the reference's did, the body has to be where it is over the reference's feet, not
    where it is in the world: balance is a matter of the feet. Those that are about to leave count less and less.
    """
    ex = ey = total = 0.0
    for leg in range(4):
        if memory.stance[leg] == 0 or ref.contact[leg] == 0:
            continue
        weight = min(ref.remaining[leg], config.foothold_preview + config.dt)
        for k in range(3):
            ex += weight * (rotation[0, k] * feet[leg, k] - reference_rotation[0, k] * ref.foot_pos[leg, k])
            ey += weight * (rotation[1, k] * feet[leg, k] - reference_rotation[1, k] * ref.foot_pos[leg, k])
        total += weight
    if total > 0:
        error[0] += config.foothold_share * (ex / total - error[0])
        error[1] += config.foothold_share * (ey / total - error[1])


@inlined
def _make_up_for_losses(model: Any, command: Any, j: int) -> None:
    """Adds the torque that joint j loses to viscous and dry friction at the velocity that it is to have."""
    velocity = command.joint_vel[j]
    if model.joint_damping[j] > 0.0:
        command.torque[j] += model.joint_damping[j] * velocity
    if model.joint_friction[j] > 0.0:
        command.torque[j] += model.joint_friction[j] * np.tanh(velocity / DRY_FRICTION_FROM)


@inlined
def _keep_within_limits(config: Any, model: Any, command: Any, j: int) -> None:
    """Clips the command of joint j; what a NaN among the observations made unknown becomes mere damping."""
    if not np.isfinite(command.joint_pos[j] + command.joint_vel[j] + command.torque[j]):
        command.joint_pos[j], command.joint_vel[j], command.torque[j] = 0.0, 0.0, 0.0
        command.stiffness[j], command.damping[j] = 0.0, DAMPING_AFTER_FAILURE
    lower, upper = model.lower[j] + config.joint_margin, model.upper[j] - config.joint_margin
    command.joint_pos[j] = min(max(command.joint_pos[j], lower), upper)
    limit = model.torque_limit[j]
    command.torque[j] = min(max(command.torque[j], -limit), limit)


@inlined
def _feet_and_com(model: Any, obs: Any, rotation: Array, feet: Array, arms: Array, com: Array) -> None:
    """Feet in the body frame, and their lever arms from the centre of mass in the heading frame."""
    com[0], com[1], com[2] = model.trunk_moment[0], model.trunk_moment[1], model.trunk_moment[2]
    for leg in range(4):
        q = obs.joint_pos[3 * leg : 3 * leg + 3]
        feet[leg, 0], feet[leg, 1], feet[leg, 2] = leg_forward(model.geometry[leg], q[0], q[1], q[2])
        m0, m1, m2 = leg_mass_moment(model.geometry[leg], model.link_mass[leg], model.link_com[leg], q)
        com[0] += m0
        com[1] += m1
        com[2] += m2
    for k in range(3):
        com[k] /= model.mass
    for leg in range(4):
        x, y, z = feet[leg, 0] - com[0], feet[leg, 1] - com[1], feet[leg, 2] - com[2]
        for k in range(3):
            arms[leg, k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
        arms[leg, 2] -= model.foot_radius  # the ground is felt under the centre of the foot sphere


@inlined
def _heading_inertia(inertia: Array, rotation: Array, out: Array) -> None:
    """R I Rᵀ."""
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += rotation[i, a] * inertia[a, b] * rotation[j, b]
            out[i, j] = total
            out[j, i] = total


@inlined
def _leg_dynamics(config: Any, model: Any, obs: Any, memory: Any, command: Any, scratch: Any, leg: int) -> None:
    """Adds the torques that carry and move the leg itself along what it follows."""
    weight = config.stance_dynamics if memory.stance[leg] == 1 else config.swing_dynamics
    if weight == 0.0:
        return
    part = slice(3 * leg, 3 * leg + 3)
    leg_inverse_dynamics(
        model.geometry[leg],
        model.link_mass[leg],
        model.link_com[leg],
        model.link_inertia[leg],
        obs.joint_pos[part],
        obs.joint_vel[part],
        scratch.joint_acc[part],
        scratch.ang_vel_b,
        scratch.gravity_acc_b,
        scratch.torque,
    )
    for i in range(3):
        j = 3 * leg + i
        command.torque[j] += weight * (scratch.torque[i] + model.armature[j] * scratch.joint_acc[j])


class Controller:
    """n robots under one configuration, each following a reference of the same length.

    Not to be shared between threads: it owns the kernels' work arrays.
    """

    def __init__(
        self,
        robot: Robot,
        motions: Sequence[Motion],
        n: int,
        config: ControllerConfig | None = None,
    ) -> None:
        """
        Args:
            robot: the robot.
            motions: one reference for all robots, or one for each.
            n: number of robots.
            config: parameters; the default configuration if None.

        Raises:
            ConfigError: the references' rate is not the controller's, there are neither 1 nor n of them, or the
                parameters are for another robot.
            MotionError: the references differ in length.
        """
        self.config = config if config is not None else default_config()
        if self.config.robot not in ("", robot.name):
            raise ConfigError(
                f"controller configuration '{self.config.name}' is for robot '{self.config.robot}', not '{robot.name}'"
            )
        robot = loaded_robot(robot, self.config.load)
        if len(motions) not in (1, n):
            raise ConfigError(f"{n} robots need 1 or {n} references, found {len(motions)}")
        for motion in motions:
            if abs(motion.rate_hz - self.config.rate_hz) > 1e-9:
                raise ConfigError(
                    f"motion '{motion.name}' has {motion.rate_hz:g} samples a second and the controller runs at"
                    f" {self.config.rate_hz:g} Hz; retarget the clip with that rate"
                )
        self.tables = stack_tables(motions, robot)
        self.memory = np.zeros(n, MEMORY)
        self.command = np.zeros(n, COMMAND)
        self._model = pack_model(robot)
        self._config = pack_config(self.config, robot)
        self._qp = make_workspace(MAX_VARIABLES, MAX_CONSTRAINTS)
        self._scratch = np.zeros(1, SCRATCH)
        self.plan = np.zeros(n, PLAN)
        self._plan_qp = make_workspace(HORIZON_VARIABLES, HORIZON_CONSTRAINTS)
        self._foresight = np.zeros(1, FORESIGHT)

    def reset(self, sample: NDArray[np.int64]) -> None:
        """Starts each robot in the leg states that its reference wants at `sample` (n,)."""
        self.memory[...] = np.zeros((), MEMORY)
        rows = np.minimum(np.arange(len(self.memory)), len(self.tables) - 1)
        self.memory["stance"] = self.tables["contact"][rows, sample]
        self.memory["since_switch"] = 1e3
        self.plan["valid"] = 0

    def step(self, observation: NDArray[Any], clocks: NDArray[Any]) -> NDArray[Any]:
        """Commands for the next control step.

        Args:
            observation: (n,) of `OBSERVATION`.
            clocks: (n,) of `CLOCK`.

        Returns:
            (n,) of `COMMAND`; overwritten by the next call.
        """
        control_step(
            self._config,
            self._model,
            self.tables,
            clocks,
            observation,
            self.memory,
            self.command,
            self.plan,
            self._qp,
            self._plan_qp,
            self._scratch,
            self._foresight,
        )
        return self.command
