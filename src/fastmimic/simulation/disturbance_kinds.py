"""All disturbances as data, each with unit, range and realisation. To add one, register one entry:

    DISTURBANCES.register(DisturbanceKind("wind", unit="N", lower=-50.0, upper=50.0, about="…", each_step=blow))

A realisation changes the simulated robots, not what their controllers know. `apply` changes the simulator's model;
`each_step` sets `simulation.trunk_force` before each control step, in every simulator. A simulator realises some
disturbances by itself (`fastmimic.simulation.simulators`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
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
    levels: tuple[float, ...] = ()  # what `fastmimic stress` runs; empty for five from lower to upper
    usual: tuple[float, float] | None = None
    randomized: bool = False  # whether randomisation varies it by default
    per_robot: bool = True  # whether each robot of a batch may have its own value
    timed: bool = False  # whether it happens at a time
    sensed: bool = False  # whether it changes the readings of sensors only, in every simulator
    apply: Mapping[str, Apply] = field(default_factory=dict)  # by simulator
    each_step: EachStep | None = None  # the same function for every simulator

    def __post_init__(self) -> None:
        if not self.levels and math.isfinite(self.upper - self.lower):
            levels = {self.nominal, *np.linspace(self.lower, self.upper, 5).tolist()}
            object.__setattr__(self, "levels", tuple(sorted(levels)))

    def realized_in(self, simulator: str) -> bool:
        everywhere = self.sensed or self.each_step is not None
        return everywhere or simulator in self.apply or self.name in SIMULATORS[simulator].realizes

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


def symmetric(*levels: float) -> tuple[float, ...]:
    """Levels to both sides of 0."""
    return (*(-level for level in reversed(levels)), 0.0, *levels)


_COM_X: Final = DisturbanceKind(
    "com-x",
    unit="m",
    lower=-0.15,
    upper=0.15,
    about="shift of the trunk's centre of mass forwards",
    levels=symmetric(0.02, 0.04, 0.06, 0.08, 0.1),
    usual=(-0.03, 0.03),
    randomized=True,
    apply={"mujoco": _trunk_load},
)
_PUSH: Final = DisturbanceKind(
    "push",
    unit="N·s",
    lower=-100.0,
    upper=100.0,
    about=f"impulse on the trunk within {PUSH_DURATION_S:g} s along its heading, {PUSH_TIME_S:g} s after the start"
    " unless a time is given (@time)",
    levels=symmetric(2.0, 4.0, 6.0, 8.0, 10.0, 14.0, 18.0, 24.0),
    usual=(-5.0, 5.0),
    timed=True,
)
DISTURBANCES: Final = Registry(
    "disturbance",
    [
        DisturbanceKind(
            "friction",
            lower=0.05,
            upper=2.0,
            about="coefficient of friction between the robot and the ground",
            nominal=0.8,
            levels=(0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.2),
            usual=(0.5, 1.0),
            randomized=True,
            apply={"mujoco": _friction},
        ),
        DisturbanceKind(
            "restitution",
            lower=0.0,
            upper=0.9,
            about="share of the approach speed with which a contact rebounds",
            levels=(0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7),
            usual=(0.0, 0.3),
            randomized=True,
            apply={"mujoco": _contact},
        ),
        DisturbanceKind(
            "softness",
            unit="s",
            lower=0.02,
            upper=0.2,
            about="time constant of the contact, MuJoCo's solref; the longer, the deeper a foot sinks in",
            nominal=0.02,
            levels=(0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1),
            usual=(0.02, 0.04),
            apply={"mujoco": _contact},
        ),
        DisturbanceKind(
            "payload",
            unit="kg",
            lower=0.0,
            upper=20.0,
            about="on the trunk: a cube of 0.1 m with its centre 0.1 m above the base's origin",
            levels=(0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0),
            usual=(0.0, 2.0),
            randomized=True,
            apply={"mujoco": _trunk_load},
        ),
        _COM_X,
        replace(
            _COM_X,
            name="com-y",
            about="shift of the trunk's centre of mass to the left",
            levels=symmetric(0.01, 0.02, 0.03, 0.04, 0.05, 0.06),
            usual=(-0.015, 0.015),
        ),
        DisturbanceKind(
            "motor-strength",
            lower=0.1,
            upper=2.0,
            about="share of the commanded torque, and of the torque limit, that the motors give",
            nominal=1.0,
            levels=(0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3),
            usual=(0.85, 1.1),
            randomized=True,
        ),
        DisturbanceKind(
            "top-speed",
            lower=0.3,
            about="of the motors, share of the robot's joint speed limits: their driving torque falls linearly from the"
            " torque limit at half of it to nothing",
            nominal=1.0,
            levels=(0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, math.inf),
            usual=(0.9, 1.1),
            randomized=True,
        ),
        DisturbanceKind(
            "delay",
            unit="s",
            lower=0.0,
            upper=0.05,
            about="between the controller's command and the motors, which follow the previous one meanwhile",
            levels=(0.0, 0.002, 0.004, 0.006, 0.008, 0.01, 0.012, 0.016, 0.02),
            usual=(0.0, 0.004),
            randomized=True,
        ),
        DisturbanceKind(
            "joint-friction",
            unit="N·m",
            lower=0.0,
            upper=10.0,
            about="dry friction of every joint",
            levels=(0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0),
            usual=(0.0, 0.4),
            randomized=True,
            apply={"mujoco": partial(_joints, "dof_frictionloss")},
        ),
        DisturbanceKind(
            "joint-damping",
            unit="N·m·s/rad",
            lower=0.0,
            upper=5.0,
            about="viscous friction of every joint",
            levels=(0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8),
            usual=(0.0, 0.04),
            randomized=True,
            apply={"mujoco": partial(_joints, "dof_damping")},
        ),
        _PUSH,
        replace(
            _PUSH,
            name="side-push",
            about="the same to the left of its heading",
            levels=symmetric(2.0, 4.0, 6.0, 8.0, 10.0, 14.0, 18.0),
            usual=(-1.5, 1.5),
        ),
        DisturbanceKind(
            "foot-force-scale",
            lower=0.0,
            upper=100.0,
            about="what the foot sensors' readings are multiplied by: another unit, or dead sensors",
            nominal=1.0,
            levels=(0.0, 0.1, 0.5, 1.0, 2.0, 10.0),
            sensed=True,
        ),
        DisturbanceKind(
            "foot-force-offset",
            unit="N",
            lower=-500.0,
            upper=500.0,
            about="added to the foot sensors' readings",
            levels=(-60.0, 0.0, 60.0),
            sensed=True,
        ),
    ],
)
"""All disturbances, in the order in which their random values are drawn."""
