"""MuJoCo: n robots on the ground, also with disturbances, stepped as one batch on native threads.

The motor law τ + k_p (q* − q) + k_d (q̇* − q̇), clipped to the torque limit, runs at physics rate inside MuJoCo: each
joint has an affine actuator with the gains in its bias, per robot and per step.
"""

from collections.abc import Sequence
from typing import Any, Final

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY, GROUND_FRICTION, LEGS
from fastmimic.base.jit import floats, kernel, record_dtype
from fastmimic.base.vectors import copy, quat_turned
from fastmimic.robot import Robot
from fastmimic.robot.mjcf import warn_by_log
from fastmimic.simulation.conditions import Disturbance, Disturbed, make_world
from fastmimic.simulation.disturbance_kinds import DISTURBANCES
from fastmimic.simulation.simulators import PHYSICS_RATE_HZ, Placement
from fastmimic.simulation.terrain import Terrain

FLOOR: Final = "fastmimic_floor"
WORLD: Final = "world"  # the body that the floor belongs to
FOOT_FIRST: Final = 0.3  # foot radii by which the rest of its link has to be higher than a standing foot,
SINKS_M: Final = 0.012  # and at least as far as a foot sinks in when it lands
STANDING_LEANS_DEG: Final = (-60.0, -30.0, 0.0, 30.0, 60.0)  # of the calf from the vertical, in stance
SLIDING: Final = 3  # MuJoCo's condim: a normal force and friction against slipping


def build_model(robot: Robot, ground: Terrain | None = None, *, ideal: bool = False) -> mujoco.MjModel:
    """The robot on a floor (`ground`; None for flat), with motors that take stiffness and damping, and foot sensors.

    The floor collides with the robot and, unless `ideal`, thighs, calves and feet with those of other legs. Feet
    have the file's sliding friction and MuJoCo's usual stiffness: a loaded one sinks in by up to 2 cm. Left out is what
    a controller cannot count on: resistance to rolling (in one elliptic cone, a foot that rolls at a calf's rate has
    little friction left against slipping) and more softness. Geoms of the last link that would touch the ground before
    a standing foot do not collide.
    """
    warn_by_log()
    spec, plain = robot.spec(), mujoco.MjSpec().default.geom
    for group in (spec.actuators, spec.sensors, spec.keys):
        for element in list(group):
            spec.delete(element)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, int(bool(geom.contype or geom.conaffinity))
        if geom.name in robot.foot_geoms:
            geom.condim, geom.margin, geom.gap = SLIDING, 0.0, 0.0
            geom.solref, geom.solimp = plain.solref, plain.solimp
    for i, hip in enumerate(() if ideal else robot.joint_names[1::3]):
        for geom in spec.joint(hip).parent.find_all("geom"):
            if geom.conaffinity:
                geom.contype = 2 << i  # bit 0 is the floor's, 1 to 4 are the legs'
                geom.conaffinity = 0b11111 ^ geom.contype
    for name, shape in floor_shapes(spec, ground).items():
        spec.worldbody.add_geom(name=name, friction=[GROUND_FRICTION, 0.005, 0.0001], contype=1, conaffinity=0, **shape)
    motor = {"trntype": mujoco.mjtTrn.mjTRN_JOINT, "forcelimited": True}
    motor |= {"gaintype": mujoco.mjtGain.mjGAIN_FIXED, "biastype": mujoco.mjtBias.mjBIAS_AFFINE}
    for joint, limit in zip(robot.joint_names, robot.torque_limit, strict=True):
        actuator = spec.add_actuator(name=joint, target=joint, forcerange=[-limit, limit], **motor)
        actuator.gainprm[0] = 1.0
    found = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
    wanted = found | 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)  # (1) and the net force in the world frame (3)
    body, sphere = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_GEOM
    touched = {"type": mujoco.mjtSensor.mjSENS_CONTACT, "objtype": body, "objname": WORLD}
    for leg, geom in zip(LEGS, robot.foot_geoms, strict=True):  # 3: the net force
        spec.add_sensor(name=f"{leg}_ground_force", **touched, reftype=sphere, refname=geom, intprm=[wanted, 3, 1])
    floating = next(joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE)  # the trunk's
    trunk = {} if ground is None else {"reftype": body, "refname": str(floating.parent.name)}
    spec.add_sensor(name="ground_contacts", **touched, **trunk, intprm=[found, 3, 1])
    spec.compiler.discardvisual = True  # geoms that only decorate would be moved at every step
    spec.compiler.fusestatic = True  # a foot welded to its calf as a body of its own would sink in several times deeper
    spec.option.gravity = [0, 0, -GRAVITY]
    spec.option.timestep = 1.0 / PHYSICS_RATE_HZ
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # a simulation that has exploded must be seen as such, not be put back into the default pose without a word
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model = spec.compile()
    if ground is None:
        model.geom_conaffinity[_before_feet(model, robot)] = 0
    else:
        level = build_model(robot, ideal=ideal)
        model.geom_conaffinity[model.geom_bodyid > 0] = level.geom_conaffinity[level.geom_bodyid > 0]
    return model


def _before_feet(model: mujoco.MjModel, robot: Robot) -> list[int]:
    """Geoms on the feet's links about as low as the foot, in postures in which it stands on a level floor."""
    data, points, floor = mujoco.MjData(model), np.zeros(6), model.geom(FLOOR).id
    joints = [model.joint(name).qposadr[0] for name in robot.joint_names]
    free = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE][0]
    links = model.body_weldid[model.geom_bodyid]
    found: set[int] = set()
    for foot_name, calf in zip(robot.foot_geoms, robot.calf_vector, strict=True):
        foot = model.geom(foot_name).id
        others = [int(g) for g in np.flatnonzero((links == links[foot]) & (model.geom_conaffinity != 0)) if g != foot]
        for lean in np.radians(STANDING_LEANS_DEG):
            # all joints at zero, and the trunk turned about y so that the calf leans by that
            pitch = np.arctan2(calf[0], -calf[2]) + lean
            data.qpos[joints] = 0.0
            data.qpos[free : free + 7] = 0.0, 0.0, 1.0, np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0
            mujoco.mj_kinematics(model, data)
            data.qpos[free + 2] -= data.geom_xpos[foot, 2] - robot.foot_radius
            mujoco.mj_kinematics(model, data)
            near = max(FOOT_FIRST * robot.foot_radius, SINKS_M)
            found |= {g for g in others if mujoco.mj_geomDistance(model, data, floor, g, 1.0, points) < near}
    return sorted(found)


def floor_shapes(spec: mujoco.MjSpec, ground: Terrain | None) -> dict[str, dict[str, Any]]:
    """The floor's geoms by name; a height field is added to the model's assets."""
    if ground is not None and len(ground.boxes):
        kind = {"type": mujoco.mjtGeom.mjGEOM_BOX}
        return {f"{FLOOR}{i}": {**kind, "pos": box[:3], "size": box[3:]} for i, box in enumerate(ground.boxes)}
    if ground is None or ground.field is None:
        tilt = {} if ground is None else {"quat": ground.plane(np.zeros(()), np.zeros(())).quat}
        return {FLOOR: {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [0, 0, 0.05], **tilt}}
    heights = ground.field.heights
    lowest, rise = float(heights.min()), max(float(np.ptp(heights)), 1e-6)
    size, (rows, columns) = [*ground.field.half, rise, 0.1], heights.shape
    spec.add_hfield(name=FLOOR, size=size, nrow=rows, ncol=columns, userdata=((heights - lowest) / rise).ravel())
    return {FLOOR: {"type": mujoco.mjtGeom.mjGEOM_HFIELD, "hfieldname": FLOOR, "pos": [0, 0, lowest]}}


@kernel
def _observe(qpos: Array, qvel: Array, sensors: Array, index: Any, out: Any) -> None:
    """From MuJoCo's state to observations; `index` is (25,): addresses of the joints in qpos, then in qvel, and whether
    the contacts that the last sensor counts are the feet's, too."""
    for i in range(out.shape[0]):
        o = out[i]
        copy(qpos[i, :3], o.root_pos)
        copy(qpos[i, 3:7], o.root_quat)
        copy(qvel[i, :3], o.lin_vel)
        spin = (qvel[i, 3], qvel[i, 4], qvel[i, 5])  # the free joint's angular velocity, in the body frame
        o.ang_vel[0], o.ang_vel[1], o.ang_vel[2] = quat_turned(o.root_quat, spin)
        for j in range(12):
            o.joint_pos[j] = qpos[i, index[j]]
            o.joint_vel[j] = qvel[i, index[12 + j]]
        found = 0.0
        for leg in range(4):
            found += sensors[i, 4 * leg]
            copy(sensors[i, 4 * leg + 1 : 4 * leg + 4], o.foot_force[leg])
        o.other_contact = sensors[i, 16] - found * index[24]


@kernel
def actuate(commands: Any, qvel: Array, index: Any, motors: Any, ctrl: Array, bias: Array, torques: Array) -> None:
    """Writes joint commands as the affine actuators' control and gains, and the torques (n, 12, 2) that their `motors`,
    (n,) of `MOTORS`, can give at the present speed: all to half of their top speed, then linearly less to none."""
    for i in range(commands.shape[0]):
        c, motor = commands[i], motors[i]
        for j in range(12):
            ctrl[i, j] = c.torque[j] + c.stiffness[j] * c.joint_pos[j] + c.damping[j] * c.joint_vel[j]
            ctrl[i, j] *= motor.strength
            bias[i, j, 1] = -motor.strength * c.stiffness[j]
            bias[i, j, 2] = -motor.strength * c.damping[j]
            most, speed = motor.strength * motor.limit[j], 2.0 * qvel[i, index[12 + j]] / motor.top_speed[j]
            torques[i, j, 0] = -most * min(max(2.0 + speed, 0.0), 1.0)
            torques[i, j, 1] = most * min(max(2.0 - speed, 0.0), 1.0)


MOTORS: Final = record_dtype(floats(strength=(), limit=12, top_speed=12))
"""One robot's motors: share of the commanded torque that they give, torque limits, N·m, and top speeds, rad/s."""


class MujocoSimulation(Disturbed):
    """A batch of identical robots, or of robots that disturbances make differ from each other and from the model that
    their controllers know. For disturbances: `model`, `batch` (its fields by robot), `world` (all values), `trunk`
    (body), `joint_dofs` (12,), `trunk_force` (n, 3) in N, world frame, for this control step; and `constants_changed`,
    to be set after changes of masses, inertias, gravity or joints. Not for several Python threads at once."""

    def __init__(
        self,
        robot: Robot,
        n: int,
        disturbances: Sequence[Disturbance] = (),
        *,
        control_rate_hz: float = 500.0,
        threads: int = 1,
        ground: Terrain | None = None,
        ideal: bool = False,
    ) -> None:
        """`robot` is without the disturbances; `ideal` as in `Conditions`. Raises `ConfigError` as `make_world`, or if
        the physics rate is not a multiple of the control rate."""
        super().__init__(make_world(disturbances, n, "mujoco"), control_rate_hz)
        self.ground = ground
        self.model = build_model(robot, ground, ideal=ideal)
        self.batch = Batch(self.model, n, nthread=threads)
        self._qpos = self.batch.bind("qpos")
        self._qvel = self.batch.bind("qvel")
        self._ctrl = self.batch.bind("ctrl")
        self._sensors = self.batch.bind("sensordata")
        self._bias = self.batch.expand("actuator_biasprm")
        self._torques = self.batch.expand("actuator_forcerange")
        joints = [self.model.joint(name).id for name in robot.joint_names]
        addresses = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints], [ground is None]
        self._index = np.concatenate(addresses).astype(np.int64)
        self.joint_dofs = self._index[12:24]
        self.trunk = int(self.model.jnt_bodyid[0])
        self.constants_changed = False
        for name in DISTURBANCES:
            change = DISTURBANCES[name].apply.get("mujoco")
            if change is not None and self.world.has(name):
                change(self, self.world[name])
        if self.constants_changed:
            self.batch.set_const()
        self.motors = np.zeros(n, MOTORS)
        self.motors["strength"], self.motors["limit"] = self.world["motor-strength"], robot.torque_limit
        self.motors["top_speed"] = np.inf if ideal else robot.joint_speed_limit
        if self.world.has("top-speed"):
            self.motors["top_speed"] = robot.joint_speed_limit * self.world["top-speed"][:, None]
        self._pushed = bool(self.world.at_each_step) or self.world.has("push", "side-push")
        self._forces = self.batch.bind("xfrc_applied") if self._pushed else np.zeros(0)
        self.by_hand = np.zeros((n, 3))  # force on the trunk, world, N, besides the disturbances'

    def reset(self, *state: Array) -> None:
        """Puts the robots into given states, the arrays of `Placement`; the clocks of pushes and delay restart."""
        self._restart()
        self._forces[:] = 0.0
        self.batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._set(np.arange(len(self.observation)), Placement(*state))
        self.batch.forward()
        self.observe()

    def place(self, rows: NDArray[np.int64], *state: Array) -> None:
        """Puts robots `rows` (k,) into states (k, …) as in `reset`; their contact forces are 0 until the next step."""
        self.batch.reset(rows, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._set(rows, Placement(*state))
        self.observe()
        self.observation["foot_force"][rows] = 0.0
        self.observation["other_contact"][rows] = 0.0

    def _set(self, rows: NDArray[np.int64], state: Placement) -> None:
        self._qpos[rows, :3], self._qpos[rows, 3:7] = state.root_pos, state.root_quat
        self._qpos[rows[:, None], self._index[:12]] = state.joint_pos
        self._qvel[rows, :3], self._qvel[rows, 3:6] = state.lin_vel, state.ang_vel_b
        self._qvel[rows[:, None], self.joint_dofs] = state.joint_vel
        self._ctrl[rows] = 0.0
        self._bias[rows, :, 1:3] = 0.0

    def observe(self) -> Records:
        """The present states, (n,) of `OBSERVATION`; contact forces are those of the last substep."""
        _observe(self._qpos, self._qvel, self._sensors, self._index, self.observation)
        return self.observation

    def step(self, commands: Records) -> Records:
        """Applies commands (n,) of `COMMAND` for one control step; returns the new observation."""
        if self._pushed:
            self.push(self._qpos[:, 3:7])
            self._forces[:, self.trunk, :3] = self.trunk_force + self.by_hand
        if self._delay.delays:
            self._delay.send(commands, self._steps)
            for substep in range(self.substeps):
                self.drive(self._delay.arrived(self._steps, substep))
                self.batch.step(nstep=1)
        else:
            self.drive(commands)
            self.batch.step(nstep=self.substeps)
        self._steps += 1
        return self.observe()

    def drive(self, commands: Records) -> None:
        """Sends the motors their commands."""
        actuate(commands, self._qvel, self._index, self.motors, self._ctrl, self._bias, self._torques)
