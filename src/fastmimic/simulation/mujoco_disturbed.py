"""MuJoCo with a robot or a ground that is not as expected: the disturbances of `fastmimic.simulation.disturbances`."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import matrix_from_quat, rotate_planar, yaw_from_quat
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.disturbances import (
    PAYLOAD_HEIGHT_M,
    PAYLOAD_SIDE_M,
    Disturbance,
    driving_limit,
    make_world,
)
from fastmimic.simulation.mujoco_sim import DEFAULT_PHYSICS_RATE_HZ, FLOOR, HeightField, MujocoSimulation, actuate
from fastmimic.simulation.terrain import HALF_SIDE_M, rough_ground, turns


class DisturbedMujocoSimulation(MujocoSimulation):
    """A batch of robots that differ from each other and from the model that their controllers know."""

    def __init__(
        self,
        robot: Robot,
        n: int,
        disturbances: Sequence[Disturbance],
        *,
        seed: int = 0,
        control_rate_hz: float = 500.0,
        physics_rate_hz: float = DEFAULT_PHYSICS_RATE_HZ,
        threads: int = 1,
    ) -> None:
        """
        Args:
            robot: what they are without the disturbances.
            n: how many.
            disturbances: each with one value, or one for each robot.
            seed: of uneven ground.
            control_rate_hz, physics_rate_hz, threads: as for `MujocoSimulation`.

        Raises:
            ConfigError: as `make_world`, or the physics rate is not a multiple of the control rate.
        """
        self.world = make_world(disturbances, n, "mujoco")
        self._seed = seed
        rough = self.world.has("roughness")
        super().__init__(
            robot,
            n,
            control_rate_hz=control_rate_hz,
            physics_rate_hz=physics_rate_hz,
            threads=threads,
            ground=HeightField(rough_ground(self.world["roughness"][0], seed), HALF_SIDE_M) if rough else None,
        )
        self._limit = robot.torque_limit
        self._physics_rate = physics_rate_hz
        self._trunk = int(self.model.jnt_bodyid[0])
        self._forces = self.batch.bind("xfrc_applied")
        self._change_model()
        self._range = (
            self.batch.expand("actuator_forcerange") if self.world.has("motor-strength", "top-speed") else None
        )
        late = np.round(self.world["delay"] * physics_rate_hz).astype(np.int64)
        self._late = late if late.any() else None
        self._sent = np.zeros((int(late.max()) // self.substeps + 2, n), COMMAND)
        self._due = np.zeros(n, COMMAND)
        self._steps = 0
        self._directions: Array | None = None

    def _change_model(self) -> None:
        """Writes the robots' own values into the batch's model fields."""
        batch, world, n = self.batch, self.world, self.world.n
        if world.has("friction"):
            batch.expand("geom_friction")[:, :, 0] = world["friction"][:, None]
        if world.has("restitution", "softness"):
            stiffness = 1.0 / world["softness"] ** 2
            # of a linear oscillator that rebounds with this share of its speed
            rebound = np.log(np.maximum(world["restitution"], 1e-9))
            damping = 2.0 * np.sqrt(stiffness) * -rebound / np.hypot(np.pi, rebound)
            damping = np.where(world["restitution"] > 0, damping, 2.0 * np.sqrt(stiffness))
            batch.expand("geom_solref")[:] = -np.column_stack([stiffness, damping])[:, None]
        if world.has("slope", "side-slope"):
            batch.expand("opt.gravity")[:] = GRAVITY * world.gravity
        if world.has("roughness"):
            floor, turn = self.model.geom(FLOOR).id, turns(n, self._seed)
            quat = np.column_stack([np.cos(turn / 2), np.zeros((n, 2)), np.sin(turn / 2)])
            batch.expand("geom_quat")[:, floor] = quat
            batch.expand("geom_sameframe")[:, floor] = 0  # it is no longer parallel to the world
        if world.has("joint-friction"):
            batch.expand("dof_frictionloss")[:, self._index[12:]] = world["joint-friction"][:, None]
        if world.has("joint-damping"):
            batch.expand("dof_damping")[:, self._index[12:]] = world["joint-damping"][:, None]
        if world.has("payload", "com-x", "com-y"):
            self._load_trunk()
        if world.has("slope", "side-slope", "payload", "com-x", "com-y", "joint-friction", "joint-damping"):
            batch.set_const()

    def _load_trunk(self) -> None:
        """The trunk with its payload and its shifted centre of mass, as one body."""
        model, trunk, world = self.model, self._trunk, self.world
        mass = float(model.body_mass[trunk])
        axes = matrix_from_quat(np.array(model.body_iquat[trunk]))
        inertia = axes @ np.diag(model.body_inertia[trunk]) @ axes.T
        fields = ("body_mass", "body_ipos", "body_iquat", "body_inertia", "body_sameframe")
        masses, positions, quats, inertias, same = (self.batch.expand(name) for name in fields)
        same[:, trunk] = 0  # the inertial frame is no longer the body's, if it was
        for i in range(world.n):
            com = model.body_ipos[trunk] + [world["com-x"][i], world["com-y"][i], 0.0]
            load = float(world["payload"][i])
            total, centre, about = loaded(mass, com, inertia, load)
            moments, frame = np.linalg.eigh(about)
            frame[:, 2] *= np.sign(np.linalg.det(frame))
            masses[i, trunk], positions[i, trunk], inertias[i, trunk] = total, centre, moments
            mujoco.mju_mat2Quat(quats[i, trunk], frame.flatten())

    def reset(
        self, root_pos: Array, root_quat: Array, joint_pos: Array, lin_vel: Array, ang_vel_b: Array, joint_vel: Array
    ) -> None:
        """As `MujocoSimulation.reset`; the clock of the pushes and of the delay starts anew."""
        self._steps = 0
        self._directions = None
        self._forces[:] = 0.0
        super().reset(root_pos, root_quat, joint_pos, lin_vel, ang_vel_b, joint_vel)

    def step(self, commands: NDArray[Any]) -> NDArray[Any]:
        """Applies commands (n,) of `COMMAND` for one control step and returns the new observation."""
        self._push()
        self._sent[self._steps % len(self._sent)] = commands
        if self._late is None and not self.world.has("top-speed"):
            self._drive(commands)
            self.batch.step(nstep=self.substeps)
        else:
            for substep in range(self.substeps):
                self._drive(self._arrived(substep))
                self.batch.step(nstep=1)
        self._steps += 1
        return self.observe()

    def _drive(self, commands: NDArray[Any]) -> None:
        """Gives the motors their commands, as strong as they are."""
        actuate(commands, self._ctrl, self._bias)
        if self._range is None:
            return
        strength = self.world["motor-strength"][:, None]
        self._ctrl *= strength
        self._bias[:, :, 1:3] *= strength[..., None]
        most = np.broadcast_to(self._limit, self._ctrl.shape)
        driving = most
        joint_vel = self._qvel[:, self._index[12:]]
        if self.world.has("top-speed"):
            driving = driving_limit(self._limit, self.world["top-speed"][:, None], joint_vel)
        self._range[:, :, 0] = -strength * np.where(joint_vel < 0, driving, most)
        self._range[:, :, 1] = strength * np.where(joint_vel > 0, driving, most)

    def _arrived(self, substep: int) -> NDArray[Any]:
        """The commands (n,) that have reached the motors by now; the first ones are there from the start."""
        if self._late is None:
            return self._sent[self._steps % len(self._sent)]
        sent = np.maximum(0, (self._steps * self.substeps + substep - self._late) // self.substeps)
        self._due[:] = self._sent[sent % len(self._sent), np.arange(len(self._due))]
        return self._due

    def _push(self) -> None:
        """Sets the force on the trunks; the heading is that at the beginning of a push."""
        if not self.world.has("push", "side-push"):
            return
        force = self.world.push(self._steps * self.substeps / self._physics_rate)
        self._forces[:, self._trunk] = 0.0
        if force is None:
            self._directions = None
            return
        if self._directions is None:
            self._directions = yaw_from_quat(self._qpos[:, 3:7])
        self._forces[:, self._trunk, :2] = rotate_planar(self._directions, force)


def loaded(mass: float, com: Array, inertia: Array, payload: float) -> tuple[float, Array, Array]:
    """A trunk with a payload.

    Args:
        mass: of the trunk, kg.
        com: (3,) its centre of mass in its frame, m.
        inertia: (3, 3) about it, kg·m².
        payload: kg.

    Returns:
        Mass, centre of mass and inertia about it of the two.
    """
    at = np.array([0.0, 0.0, PAYLOAD_HEIGHT_M])
    total = mass + payload
    centre = (mass * com + payload * at) / total
    about = inertia + payload * PAYLOAD_SIDE_M**2 / 6.0 * np.eye(3)
    for m, position in ((mass, com), (payload, at)):
        d = position - centre
        about = about + m * (d @ d * np.eye(3) - np.outer(d, d))
    return total, centre, about
