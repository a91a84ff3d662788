"""All disturbances as data, each with unit, range and realisation; `disturbances.json` has ours. To add one:

    DISTURBANCES.register(DisturbanceKind("wind", unit="N", lower=-50.0, upper=50.0, about="…", each_step=blow))

A realisation changes the simulated robots, not what their controllers know. `apply` changes the simulator's model;
`each_step` sets `simulation.trunk_force` before each control step, in every simulator. A simulator realises some
disturbances by itself (`fastmimic.simulation.simulators`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.files import packaged
from fastmimic.base.registry import Registry
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.robot.robot import combined
from fastmimic.simulation.simulators import SIMULATORS

PUSH_TIME_S: Final = 2.0  # after the start of an episode, when the robot has settled into its gait
PUSH_DURATION_S: Final = 0.1
PAYLOAD_HEIGHT_M: Final = 0.1  # of the payload's centre above the base's origin
PAYLOAD_SIDE_M: Final = 0.1  # of the payload, a cube

Apply = Callable[[Any, Array], None]  # (simulation, (n,) values): changes the built models of the n robots
EachStep = Callable[[Any, Array, float], None]  # (simulation, (n,) values, time in s), before each control step


@dataclass(frozen=True)
class DisturbanceKind:
    """A kind of disturbance. `usual` is the range to expect of a robot of this class, for randomisation: an order of
    magnitude, not identified on a robot; None if the robots of a batch cannot differ in it."""

    name: str
    unit: str = ""  # of its value; empty for a plain number
    lower: float = -math.inf
    upper: float = math.inf
    about: str = ""
    nominal: float = 0.0  # the value that disturbs nothing
    levels: tuple[float, ...] = ()  # what `fastmimic stress` runs, and nominal; empty for five from lower to upper
    usual: tuple[float, float] | None = None
    differs: bool = False  # whether it never matches a robot's model
    per_robot: bool = True  # whether each robot of a batch may have its own value
    timed: bool = False  # whether it happens at a time
    sensed: bool = False  # whether it changes the readings of sensors only, in every simulator
    apply: Mapping[str, Apply] = field(default_factory=dict)  # by simulator
    each_step: EachStep | None = None  # the same function for every simulator

    def __post_init__(self) -> None:
        levels = self.levels
        if not levels and math.isfinite(self.upper - self.lower):
            levels = tuple(np.linspace(self.lower, self.upper, 5).tolist())
        if levels:
            object.__setattr__(self, "levels", tuple(sorted({self.nominal, *levels})))

    def realized_in(self, simulator: str) -> bool:
        everywhere = self.sensed or self.each_step is not None
        return everywhere or simulator in self.apply or self.name in SIMULATORS[simulator].realizes

    @property
    def limits(self) -> str:
        """The lowest and the highest value, in words."""
        return f"{self.show(self.lower)} to {self.show(self.upper)}"

    def show(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:g} {self.unit}".strip()


def _friction(simulation: Any, values: Array) -> None:
    simulation.batch.expand("geom_friction")[:, :, 0] = values[:, None]


def _contact(simulation: Any, _: Array) -> None:
    """Stiffness and damping of all contacts, from softness and restitution together."""
    softness, restitution = simulation.world["softness"], simulation.world["restitution"]
    stiffness = 1.0 / softness**2
    # of a linear oscillator that rebounds with this share of its speed
    rebound = np.log(np.maximum(restitution, 1e-9))
    damping = 2.0 * np.sqrt(stiffness) * -rebound / np.hypot(np.pi, rebound)
    damping = np.where(restitution > 0, damping, 2.0 * np.sqrt(stiffness))
    simulation.batch.expand("geom_solref")[:] = -np.column_stack([stiffness, damping])[:, None]


def _joints(field: str, simulation: Any, values: Array) -> None:
    simulation.batch.expand(field)[:, simulation.joint_dofs] = values[:, None]
    simulation.constants_changed = True


def _trunk_load(simulation: Any, _: Array) -> None:
    """The trunk with its payload and its shifted centre of mass, as one body."""
    import mujoco

    model, trunk, world = simulation.model, simulation.trunk, simulation.world
    mass = float(model.body_mass[trunk])
    axes = matrix_from_quat(np.array(model.body_iquat[trunk]))
    inertia = axes @ np.diag(model.body_inertia[trunk]) @ axes.T
    fields = ("body_mass", "body_ipos", "body_iquat", "body_inertia", "body_sameframe")
    masses, positions, quats, inertias, same = (simulation.batch.expand(name) for name in fields)
    same[:, trunk] = 0  # the inertial frame is no longer the body's, if it was
    for i in range(world.n):
        com = model.body_ipos[trunk] + [world["com-x"][i], world["com-y"][i], 0.0]
        total, centre, about = loaded(mass, com, inertia, float(world["payload"][i]))
        moments, frame = np.linalg.eigh(about)
        frame[:, 2] *= np.sign(np.linalg.det(frame))
        masses[i, trunk], positions[i, trunk], inertias[i, trunk] = total, centre, moments
        mujoco.mju_mat2Quat(quats[i, trunk], frame.flatten())
    simulation.constants_changed = True


def loaded(mass: float, com: Array, inertia: Array, payload: float) -> tuple[float, Array, Array]:
    """Mass (kg), centre of mass (3,) (m) and inertia (3, 3) about it (kg·m²) of a trunk with a `payload` (kg). `mass`,
    `com` and `inertia` are those of the trunk alone, in its frame."""
    at, cube = np.array([0.0, 0.0, PAYLOAD_HEIGHT_M]), payload * PAYLOAD_SIDE_M**2 / 6.0 * np.eye(3)
    return combined([(mass, com, inertia + cube), (payload, at, np.zeros((3, 3)))])


_APPLIED: Final[dict[str, Apply]] = {
    "friction": _friction,
    "restitution": _contact,
    "softness": _contact,
    "payload": _trunk_load,
    "com-x": _trunk_load,
    "com-y": _trunk_load,
    "joint-friction": partial(_joints, "dof_frictionloss"),
    "joint-damping": partial(_joints, "dof_damping"),
}
"""What MuJoCo's model is changed by."""


def _built_in(said: dict[str, Any]) -> DisturbanceKind:
    """A disturbance of `disturbances.json`; a level of null has no bound."""
    levels = tuple(math.inf if level is None else level for level in said.pop("levels", ()))
    apply = {"mujoco": _APPLIED[said["name"]]} if said["name"] in _APPLIED else {}
    return DisturbanceKind(**said, levels=levels, apply=apply)


_Said = dict[str, str | bool | float | tuple[float | None, ...]]
_SAID: Final = packaged("fastmimic.simulation", "disturbances.json", list[_Said])
DISTURBANCES: Final = Registry("disturbance", map(_built_in, _SAID))
"""All disturbances, in the order in which their random values are drawn."""
