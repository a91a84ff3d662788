"""MuJoCo with disturbances (`fastmimic.simulation.disturbance_kinds`)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.conditions import HALF_SIDE_M, Disturbance, driving_limit, make_world, rough_ground, turns
from fastmimic.simulation.disturbance_kinds import DISTURBANCES
from fastmimic.simulation.mujoco_sim import FLOOR, HeightField, MujocoSimulation, actuate
from fastmimic.simulation.simulators import DEFAULT_PHYSICS_RATE_HZ


class DisturbedMujocoSimulation(MujocoSimulation):
    """A batch of robots that differ from each other and from the model that their controllers know. For disturbances:
    `model`, `batch` (its fields by robot), `world` (all values), `trunk` (body), `joint_dofs` (12,), `trunk_force` (n,
    3) in N, world frame, for this control step; and `constants_changed`, to be set after changes of masses, inertias,
    gravity or joints."""

    def __init__(
        self,
        robot: Robot,
        n: int,
        disturbances: Sequence[Disturbance],
        *,
        seed: int = 0,
        control_rate_hz: float = 500.0,
        threads: int = 1,
    ) -> None:
        """`robot` is without the disturbances; `seed` is for uneven ground; the rest as for `MujocoSimulation`. Raises
        `ConfigError` as `make_world`, or if the control rate does not divide the physics rate."""
        self.world = make_world(disturbances, n, "mujoco")
        rough = self.world.has("roughness")
        super().__init__(
            robot,
            n,
            control_rate_hz=control_rate_hz,
            threads=threads,
            ground=HeightField(rough_ground(self.world["roughness"][0], seed), HALF_SIDE_M) if rough else None,
        )
        self.joint_dofs = self._index[12:]
        self.trunk = int(self.model.jnt_bodyid[0])
        self.trunk_force = np.zeros((n, 3))
        self.constants_changed = False
        for name in DISTURBANCES:
            change = DISTURBANCES[name].apply.get("mujoco")
            if change is not None and self.world.has(name):
                change(self, self.world[name])
        if rough:
            floor, half = self.model.geom(FLOOR).id, turns(n, seed) / 2  # about the origin
            self.batch.expand("geom_quat")[:, floor] = np.column_stack([np.cos(half), np.zeros((n, 2)), np.sin(half)])
            self.batch.expand("geom_sameframe")[:, floor] = 0  # it is no longer parallel to the world
        if self.constants_changed:
            self.batch.set_const()
        self._limit = robot.torque_limit
        self._forces = self.batch.bind("xfrc_applied")
        self._range = (
            self.batch.expand("actuator_forcerange") if self.world.has("motor-strength", "top-speed") else None
        )
        late = np.round(self.world["delay"] * DEFAULT_PHYSICS_RATE_HZ).astype(np.int64)
        self._late = late if late.any() else None
        self._sent = np.zeros((int(late.max()) // self.substeps + 2, n), COMMAND)
        self._due = np.zeros(n, COMMAND)
        self._steps = 0
        self._directions: Array | None = None
        self._pushed = bool(self.world.at_each_step) or self.world.has("push", "side-push")

    def reset(self, *state: Array) -> None:
        """As `MujocoSimulation.reset`; the clocks of pushes and delay restart."""
        self._steps = 0
        self._directions = None
        self._forces[:] = 0.0
        super().reset(*state)

    def step(self, commands: NDArray[Any]) -> NDArray[Any]:
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
        """Sends the motors their commands, limited by motor strength and top speed."""
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
        """Sets the force on the trunks; a push keeps the heading of its beginning."""
        if not self._pushed:
            return
        time_s = self._steps * self.substeps / DEFAULT_PHYSICS_RATE_HZ
        self.trunk_force[:] = 0.0
        for act, values in self.world.at_each_step:
            act(self, values, time_s)
        force = self.world.push(time_s)
        if force is None:
            self._directions = None
        else:
            if self._directions is None:
                self._directions = yaw_from_quat(self._qpos[:, 3:7])
            self.trunk_force[:, :2] += rotate_planar(self._directions, force)
        self._forces[:, self.trunk, :3] = self.trunk_force
