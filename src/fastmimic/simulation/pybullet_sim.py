"""PyBullet: the manufacturer's own description of the robot in another physics engine, behind the same interface.

Masses, inertias, collision shapes and torque limits are those of Unitree's URDF in `pybullet_data`, which differ from
our MJCF's; it has no rotor inertia. Contacts are Bullet's: rigid, by sequential impulses.
"""

import contextlib
import ctypes
import io
import itertools
import os
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY, LEGS
from fastmimic.base.errors import ConfigError
from fastmimic.base.machine import optional
from fastmimic.base.rotations import quat_conjugate, quat_multiply, quat_rotate
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import commanded_torque
from fastmimic.simulation.conditions import Disturbance, Disturbed, driving_limit, make_world
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PAYLOAD_HEIGHT_M, PAYLOAD_SIDE_M
from fastmimic.simulation.simulators import PHYSICS_RATE_HZ, PYBULLET_URDFS
from fastmimic.simulation.terrain import Terrain

_TRUNK: Final = "trunk"
_JOINTS: Final = tuple(f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "upper", "lower"))
_TOES: Final = tuple(f"{leg}_toe" for leg in LEGS)
_FIT_M: Final = 2e-3  # largest difference of the feet from those of our model


class PybulletSimulation(Disturbed):
    """n robots, each alone in its own physics client, stepped one after another. One thread at a time."""

    def __init__(
        self,
        robot: Robot,
        n: int,
        disturbances: Sequence[Disturbance] = (),
        *,
        ground: Terrain | None = None,
        control_rate_hz: float = 500.0,
        ideal: bool = False,
    ) -> None:
        """Bullet and the motor law step at `PHYSICS_RATE_HZ`; `ground` is a plane or a height field, flat if None;
        `ideal` as in `Conditions`. Raises `ConfigError` as `make_world`, if PyBullet is missing or the robot none of
        `PYBULLET_URDFS`, or if the physics rate is not a multiple of the control rate."""
        pybullet, BulletClient = require_pybullet()
        description = read_description(robot)
        super().__init__(world := make_world(disturbances, n, "pybullet"), control_rate_hz)
        self._ideal, self._ground = ideal, ground
        self._clients: list[Any] = []
        for _ in range(n):
            with quiet():  # it tells its arguments
                bullet = BulletClient(pybullet.DIRECT)
            if not bullet.isConnected():
                raise ConfigError(f"PyBullet has room for {len(self._clients)} robots at a time; {n} were asked for")
            self._clients.append(bullet)
        loads = np.column_stack([world[name] for name in ("payload", "com-x", "com-y")])
        self._descriptions = [changed_description(description, *load) for load in loads.tolist()]
        self._bodies = [_Body(self._clients[0], self._descriptions[0], ideal)]  # the others come with each reset
        self._limit = np.minimum(self._bodies[0].torque_limit, robot.torque_limit)
        self._top_speed = np.full(12, np.inf) if ideal and not world.has("top-speed") else robot.joint_speed_limit
        _check_fit(self._bodies[0], robot)

    def close(self) -> None:
        """Ends the physics clients; garbage collection does so otherwise."""
        while self._clients:
            self._clients.pop().disconnect()

    def reset(self, *state: Array) -> None:
        """Puts the robots into given states, the arrays of `Placement`. Reloads everything: Bullet remembers contacts,
        and the same start must lead to the same course."""
        n = len(self._clients)
        wide = [np.broadcast_to(np.asarray(a, dtype=np.float64), (n, np.shape(a)[-1])) for a in state]
        self._restart()
        self._bodies = [self._loaded(i) for i in range(n)]
        for body, position, quat, joints, velocity, turning, speeds in zip(self._bodies, *wide, strict=True):
            body.place(position, quat, joints, velocity, quat_rotate(quat, turning), speeds)
        for name in self.world.given:
            change = DISTURBANCES[name].apply.get("pybullet")
            if change is not None:
                change(self, self.world[name])
        for i, body in enumerate(self._bodies):
            body.observe(self.observation[i])

    def step(self, commands: Records) -> Records:
        self.push(self.observation["root_quat"])
        self._delay.send(commands, self._steps)
        arrived = [self._delay.arrived(self._steps, substep) for substep in range(self.substeps)]
        for i, body in enumerate(self._bodies):
            strength, top_speed = self.world["motor-strength"][i], self._top_speed * self.world["top-speed"][i]
            for present in arrived:
                body.drive(present[i], self._limit, strength, top_speed)
                if self.trunk_force[i].any():
                    body.pull(self.trunk_force[i])
                self._clients[i].stepSimulation()
            body.observe(self.observation[i])
        self._steps += 1
        return self.observation

    def _loaded(self, i: int) -> "_Body":
        """A robot, alone with its ground in an empty world."""
        bullet, world = self._clients[i], self.world
        bullet.resetSimulation()
        bullet.setTimeStep(1.0 / PHYSICS_RATE_HZ)
        bullet.setGravity(0.0, 0.0, -GRAVITY)
        bullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
        body = _Body(bullet, self._descriptions[i], self._ideal)
        body.ground, body.level = _ground(bullet, self._ground), self._ground is None
        # Bullet multiplies the coefficients of the two bodies: the ground has them, the robot 1
        bullet.changeDynamics(body.ground, -1, lateralFriction=float(world["friction"][i]))
        body.prepare(float(world["joint-friction"][i]), float(world["joint-damping"][i]))
        return body


class _Body:
    """One robot in its client."""

    def __init__(self, bullet: Any, description: str, ideal: bool) -> None:
        """Thighs, calves and feet collide with those of other legs, unless `ideal`."""
        self._bullet = bullet
        flags = bullet.URDF_USE_INERTIA_FROM_FILE | (0 if ideal else bullet.URDF_USE_SELF_COLLISION)
        self.ground, self.level = -1, True
        with tempfile.TemporaryDirectory() as folder:  # PyBullet reads files only
            path = Path(folder) / "robot.urdf"
            path.write_text(description, encoding="utf-8")
            with quiet():
                self.id = bullet.loadURDF(str(path), useFixedBase=False, flags=flags)
        about = [bullet.getJointInfo(self.id, index) for index in range(bullet.getNumJoints(self.id))]
        joints = [joint[1].decode() for joint in about]
        links = [joint[12].decode() for joint in about]
        self.joints = [joints.index(name) for name in _JOINTS]
        self.toes = [links.index(name) for name in _TOES]
        self.torque_limit = np.array([about[joint][10] for joint in self.joints])
        parts = {links.index(f"{leg}_{part}"): leg for leg in LEGS for part in ("upper", "lower", "toe")}
        for a, b in itertools.combinations(range(-1, len(links)), 2):
            apart = not ideal and a in parts and b in parts and parts[a] != parts[b]
            bullet.setCollisionFilterPair(self.id, self.id, a, b, int(apart))
        trunk = bullet.getDynamicsInfo(self.id, -1)
        # the base is reported as the trunk's inertial frame, given here in the trunk's own, w first
        self.com_b = np.array(trunk[3])
        self.frame_b = np.roll(trunk[4], 1)

    def prepare(self, friction: float, damping: float) -> None:
        """Motors off but for the joints' own friction; no air drag, which Bullet has by default."""
        bullet = self._bullet
        for link in range(-1, bullet.getNumJoints(self.id)):  # with the base
            # each in a call of its own: together with the damping, a link's friction would be ignored
            bullet.changeDynamics(self.id, link, lateralFriction=1.0)
            bullet.changeDynamics(self.id, link, linearDamping=0.0, angularDamping=0.0)
        for joint in self.joints:
            bullet.setJointMotorControl2(self.id, joint, bullet.VELOCITY_CONTROL, targetVelocity=0, force=friction)
            if damping > 0:
                bullet.changeDynamics(self.id, joint, jointDamping=damping)

    def place(
        self, position: Array, quat: Array, joint_pos: Array, lin_vel: Array, ang_vel: Array, joint_vel: Array
    ) -> None:
        """Sets the state of the trunk's frame and the joints, world frame."""
        bullet = self._bullet
        arm = quat_rotate(quat, self.com_b)
        frame = quat_multiply(quat, self.frame_b)
        bullet.resetBasePositionAndOrientation(self.id, position + arm, frame[[1, 2, 3, 0]])
        bullet.resetBaseVelocity(self.id, lin_vel + np.cross(ang_vel, arm), ang_vel)
        for joint, angle, speed in zip(self.joints, joint_pos, joint_vel, strict=True):
            bullet.resetJointState(self.id, joint, angle, speed)

    def drive(self, command: Any, limit: Array, strength: float, top_speed: Array) -> None:
        """The motor law for one physics step."""
        bullet = self._bullet
        positions, velocities, *_ = zip(*bullet.getJointStates(self.id, self.joints), strict=True)
        position, velocity = np.array(positions), np.array(velocities)
        torque = commanded_torque(command, position, velocity)
        most = np.where(torque * velocity > 0, driving_limit(limit, top_speed, velocity), limit)
        torque = strength * np.clip(torque, -most, most)
        bullet.setJointMotorControlArray(self.id, self.joints, bullet.TORQUE_CONTROL, forces=torque.tolist())

    def pull(self, force_w: Array) -> None:
        """A force (3,) on the trunk's centre of mass, world frame, for one physics step."""
        bullet = self._bullet
        at, _ = bullet.getBasePositionAndOrientation(self.id)
        bullet.applyExternalForce(self.id, -1, force_w, at, bullet.WORLD_FRAME)

    def observe(self, out: Any) -> None:
        """Writes the state, and the ground reaction forces of the last physics step, into a record of `OBSERVATION`."""
        bullet = self._bullet
        at, frame = bullet.getBasePositionAndOrientation(self.id)
        velocity, turning = (np.array(v) for v in bullet.getBaseVelocity(self.id))
        quat = quat_multiply(np.roll(frame, 1), quat_conjugate(self.frame_b))
        arm = quat_rotate(quat, self.com_b)
        out["root_pos"] = np.array(at) - arm
        out["root_quat"] = quat
        out["lin_vel"] = velocity - np.cross(turning, arm)
        out["ang_vel"] = turning
        out["joint_pos"], out["joint_vel"], *_ = zip(*bullet.getJointStates(self.id, self.joints), strict=True)
        forces, others = np.zeros((4, 3)), 0
        for contact in bullet.getContactPoints(bodyA=self.id, bodyB=self.ground) if self.ground >= 0 else ():
            force = contact[9] * np.array(contact[7]) + contact[10] * np.array(contact[11])
            force += contact[12] * np.array(contact[13])
            if contact[3] in self.toes:
                forces[self.toes.index(contact[3])] += force
            elif contact[9] > 0:  # Bullet also reports what is near without touching
                others += self.level or contact[3] < 0
        out["foot_force"] = forces
        out["other_contact"] = others

    def feet(self, joint_pos: Array) -> Array:
        """Feet in the trunk's frame at given joint angles, (4, 3) m; leaves the robot there."""
        self.place(np.zeros(3), np.array([1.0, 0, 0, 0]), joint_pos, np.zeros(3), np.zeros(3), np.zeros(12))
        links = self._bullet.getLinkStates(self.id, self.toes, computeForwardKinematics=1)
        return np.array([link[4] for link in links])


def _check_fit(body: _Body, robot: Robot) -> None:
    """Refuses a robot of the same name with other legs."""
    rng = np.random.default_rng(0)
    for _ in range(3):
        joints = rng.uniform(robot.joint_lower, robot.joint_upper)
        apart = float(np.abs(body.feet(joints) - foot_positions(robot, joints)).max())
        if apart > _FIT_M:
            said = f"PyBullet's description of '{robot.name}' has other legs than the given model"
            raise ConfigError(f"{said}: its feet are {1e3 * apart:.0f} mm apart; run it in mujoco")


def _ground(bullet: Any, ground: Terrain | None) -> int:
    if ground is None or ground.field is None:
        quat = [1.0, 0.0, 0.0, 0.0] if ground is None else ground.plane(np.zeros(()), np.zeros(())).quat
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE)
        return int(bullet.createMultiBody(0, plane, -1, [0.0, 0.0, 0.0], np.roll(quat, -1)))
    heights = ground.field.heights
    shape = bullet.createCollisionShape(
        bullet.GEOM_HEIGHTFIELD,
        meshScale=[ground.field.cell, ground.field.cell, 1.0],
        heightfieldData=heights.ravel().tolist(),
        numHeightfieldRows=heights.shape[1],
        numHeightfieldColumns=heights.shape[0],
    )
    middle = [0.0, 0.0, float(heights.max() + heights.min()) / 2]  # Bullet centres the heights about their range
    return int(bullet.createMultiBody(0, shape, -1, middle))


def require_pybullet() -> tuple[Any, Any]:
    """PyBullet's module and its client class; raises `ConfigError`, with what to do, if it is not installed."""
    missing = ConfigError("the second simulator needs PyBullet: pip install 'fastmimic[pybullet]'")
    names = ("pybullet", "pybullet_data", "pybullet_utils.bullet_client")
    with contextlib.redirect_stderr(io.StringIO()), quiet():  # it tells when it was built
        pybullet, _, client = (optional(name, missing) for name in names)
    return pybullet, client.BulletClient


def read_description(robot: Robot) -> str:
    """The robot's URDF without visual shapes; raises `ConfigError` if there is none."""
    import pybullet_data

    if robot.name not in PYBULLET_URDFS:
        there = " and ".join(PYBULLET_URDFS)
        raise ConfigError(f"PyBullet has a description of {there}, none of '{robot.name}'; run it in mujoco")
    path = Path(pybullet_data.getDataPath()) / PYBULLET_URDFS[robot.name]
    tree = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    for link in tree.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    return ElementTree.tostring(tree, encoding="unicode")


def changed_description(description: str, payload: float, com_x: float, com_y: float) -> str:
    """The description with a payload on the trunk and the trunk's centre of mass shifted."""
    if not (payload or com_x or com_y):
        return description
    tree = ElementTree.fromstring(description)
    origin = tree.find(f"link[@name='{_TRUNK}']/inertial/origin")
    assert origin is not None, "the trunk has a centre of mass"
    x, y, z = (float(value) for value in origin.get("xyz", "0 0 0").split())
    origin.set("xyz", f"{x + com_x!r} {y + com_y!r} {z!r}")
    if payload:
        i = payload * PAYLOAD_SIDE_M**2 / 6.0
        inertia = f'<inertia ixx="{i!r}" ixy="0" ixz="0" iyy="{i!r}" iyz="0" izz="{i!r}"/>'
        load = f'<link name="payload"><inertial><mass value="{payload!r}"/>{inertia}</inertial></link>'
        joint = f'<parent link="{_TRUNK}"/><child link="payload"/><origin xyz="0 0 {PAYLOAD_HEIGHT_M!r}" rpy="0 0 0"/>'
        tree.append(ElementTree.fromstring(load))
        tree.append(ElementTree.fromstring(f'<joint name="payload_joint" type="fixed">{joint}</joint>'))
    return ElementTree.tostring(tree, encoding="unicode")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silences the terminal output of C code."""
    with open(os.devnull, "wb") as nowhere:
        kept = [(fd, os.dup(fd)) for fd in (1, 2)]
        try:
            for fd, _ in kept:
                os.dup2(nowhere.fileno(), fd)
            yield
        finally:
            ctypes.CDLL(None).fflush(None)  # what C has buffered goes nowhere too
            for fd, copy in kept:
                os.dup2(copy, fd)
                os.close(copy)
