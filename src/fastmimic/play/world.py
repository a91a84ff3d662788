"""Changes to robot and ground during a session: pushes, friction, payload."""

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError
from fastmimic.simulation.mujoco_sim import GROUND_FRICTION

if TYPE_CHECKING:
    from fastmimic.simulation.mujoco_sim import MujocoSimulation


PUSH_S: Final = 0.1  # duration of a push
MAX_IMPULSE: Final = 100.0
FRICTION: Final = (0.2, 1.5)
MAX_PAYLOAD_KG: Final = 10.0


class LiveWorld:
    """The ground and the trunk's load of one simulated robot.

    Attributes:
        friction: coefficient between every foot and the ground.
        payload_kg: mass at the trunk's centre of mass, unknown to the controller.
    """

    def __init__(self, simulation: "MujocoSimulation") -> None:
        import mujoco

        model = simulation.model
        self._batch = simulation.batch
        self._step_s = simulation.substeps * float(model.opt.timestep)
        free = int(np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))[0])
        self.trunk = int(model.jnt_bodyid[free])
        self._applied = self._batch.bind("xfrc_applied")
        self._mass = self._batch.expand("body_mass")
        self._sliding = self._batch.expand("geom_friction")
        self._own_mass = float(model.body_mass[self.trunk])
        self._push = np.zeros(3)
        self._push_steps = 0
        self.friction, self.payload_kg = GROUND_FRICTION, 0.0

    def push(self, impulse: float, direction: float, yaw: float = 0.0) -> None:
        """Pushes the trunk's centre of mass horizontally, for `PUSH_S` from now.

        Args:
            impulse: N·s, in 0 … `MAX_IMPULSE`; raises `ConfigError` for others.
            direction: rad, from the heading, positive to the left; raises `ConfigError` unless finite.
            yaw: the heading, rad.
        """
        if not (math.isfinite(impulse) and 0.0 <= impulse <= MAX_IMPULSE and math.isfinite(direction)):
            raise ConfigError(f"a push has 0 to {MAX_IMPULSE:g} N·s, found {impulse:g} N·s")
        self._push_steps = max(1, round(PUSH_S / self._step_s))
        force = impulse / (self._push_steps * self._step_s)
        self._push[:] = force * math.cos(yaw + direction), force * math.sin(yaw + direction), 0.0

    @property
    def force(self) -> Array:
        """The present push, (3,) world, N."""
        return self._push if self._push_steps > 0 else np.zeros(3)

    def apply(self) -> None:
        """Applies the push; call before each control step."""
        self._applied[0, self.trunk, :3] = self.force
        self._push_steps = max(0, self._push_steps - 1)

    def set_friction(self, coefficient: float) -> None:
        """Sets the friction of every contact; raises `ConfigError` outside `FRICTION`."""
        if not FRICTION[0] <= coefficient <= FRICTION[1]:
            raise ConfigError(f"friction must be {FRICTION[0]:g} to {FRICTION[1]:g}, found {coefficient:g}")
        self._sliding[0, :, 0] = coefficient  # MuJoCo takes the greater one of two surfaces
        self.friction = coefficient

    def set_payload(self, mass_kg: float) -> None:
        """Sets the trunk's payload; raises `ConfigError` outside 0 … `MAX_PAYLOAD_KG`."""
        if not 0.0 <= mass_kg <= MAX_PAYLOAD_KG:
            raise ConfigError(f"the payload must be 0 to {MAX_PAYLOAD_KG:g} kg, found {mass_kg:g}")
        self._mass[0, self.trunk] = self._own_mass + mass_kg
        self._batch.set_const()
        self.payload_kg = mass_kg
