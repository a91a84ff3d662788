"""The controller's parameters: one set for all motions and robots, its variants by name or file, its form for kernels.

Forces are multiples of the robot's weight, and gains of the trunk act on accelerations and angles: neither depends on
the robot. The rest has the values of an A1 and is scaled to another robot (`fastmimic.robot.robot`): joint gains by
what the joints move, R by the mass squared, lengths by the leg.

A file names a set ("default" if absent) and the changes to it; "identified" is a note for people:

    {"format": "fastmimic controller", "version": 1, "base": "default",
     "robot": "a1", "stance": {"friction": 0.4}, "load": {"mass": 2.0}}
"""

import dataclasses
import json
import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from fastmimic.base.arrays import Records
from fastmimic.base.configuration import changed, check, pack, record_fields, tabulated
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError, unknown
from fastmimic.base.files import packaged, read_json
from fastmimic.base.jit import record_dtype
from fastmimic.base.text import plain
from fastmimic.reference.regulator_config import RegulatorConfig, Vector3
from fastmimic.robot import Robot
from fastmimic.robot.robot import combined, joint_ratio, length_ratio, mass_ratio

FILE_FORMAT: Final = {"format": "fastmimic controller", "version": 1}

Vector6 = tuple[float, float, float, float, float, float]

MAX_HORIZON_STEPS: Final = 20


@tabulated
@dataclass(frozen=True)
class GaitConfig:
    """Which leg stands and which swings (paper, §III-B1)."""

    planner: Literal["schedule", "full"] = "full"
    contact_threshold: float = 0.3
    release_threshold: float = 0.02
    min_switch_time: float = 0.1
    early_takeoff_time: float = 0.08
    early_takeoff_force: float = 0.1
    early_touchdown_from: float = 0.5
    step_reach: tuple[float, float] = (0.3, 0.15)
    least_step_time: float = 0.05
    most_haste: float = 0.5
    follow_ground: bool = True
    ground_time: float = 0.3
    rough_lift: float = 3.0
    reach_speed: float = 0.6
    recovery_steps: bool = True
    recovery_reach: tuple[float, float, float] = (0.33, 0.22, 0.055)
    recovery_top_speed: float = 1.8
    recovery_switch_time: float = 0.03


@tabulated
@dataclass(frozen=True)
class StanceConfig:
    """Forces of the standing legs (paper, eq. 1 and 2). Axes: x, y, z, roll, pitch, yaw in the heading frame."""

    forces: Literal["instant", "horizon"] = "instant"
    feedback: Literal["regulator", "constant"] = "regulator"
    position_gain: Vector6 = (40.0, 40.0, 300.0, 600.0, 600.0, 600.0)
    velocity_gain: Vector6 = (20.0, 20.0, 35.0, 75.0, 75.0, 75.0)
    acceleration_weight: Vector6 = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    disturbance_time: float = 0.5
    reference_acceleration: float = 1.0
    leg_momentum: bool = True
    acceleration_limit: Vector6 = (15.0, 15.0, 25.0, 150.0, 150.0, 150.0)
    force_weight: float = 1e-4
    friction: float = 0.6
    friction_sides: int = 8
    friction_time: float = 0.1
    min_force: float = 0.02
    max_force: float = 3.0
    adaptation: Literal["off", "paper", "full"] = "full"
    joint_stiffness: float = 30.0
    joint_damping: float = 2.5
    leg_dynamics: bool = True


@tabulated
@dataclass(frozen=True)
class HorizonConfig:
    """Convex model predictive control (Di Carlo et al. 2018), used where `StanceConfig.forces` is "horizon". Axes: x,
    y, z, roll, pitch, yaw in the heading frame. Forces are multiples of the weight, so the weights do not depend on the
    robot's mass. Friction and the bounds on f_z are those of `StanceConfig`."""

    steps: int = 10
    step_s: float = 0.03
    solve_rate_hz: float = 50.0
    position_weight: Vector6 = (100.0, 100.0, 1000.0, 1000.0, 1000.0, 30.0)
    velocity_weight: Vector6 = (2.0, 2.0, 0.5, 0.02, 0.02, 1.0)
    force_weight: float = 1e-2


@tabulated
@dataclass(frozen=True)
class SwingConfig:
    """Feet in the air (paper, eq. 3)."""

    foothold: Literal["regulator", "reference", "raibert"] = "regulator"
    velocity_feedback: tuple[float, float] = (0.03, 0.03)
    joint_stiffness: float = 120.0
    joint_damping: float = 3.5
    leg_dynamics: bool = True
    level: float = 1.0
    liftoff_blend_time: float = 0.03
    swing_time: float = 0.2
    swing_height: float = 0.05


@tabulated
@dataclass(frozen=True)
class LoadConfig:
    """A payload that the controller knows of."""

    mass: float = 0.0
    position: Vector3 = (0.0, 0.0, 0.0)


@tabulated
@dataclass(frozen=True)
class ControllerConfig:
    """All parameters of the controller; its parts are described at their classes."""

    name: str = "default"
    rate_hz: float = 500.0
    joint_margin: float = 0.01
    gait: GaitConfig = dataclasses.field(default_factory=GaitConfig)
    stance: StanceConfig = dataclasses.field(default_factory=StanceConfig)
    horizon: HorizonConfig = dataclasses.field(default_factory=HorizonConfig)
    swing: SwingConfig = dataclasses.field(default_factory=SwingConfig)
    regulator: RegulatorConfig = dataclasses.field(default_factory=RegulatorConfig)
    robot: str = ""  # the only robot that the set is for; empty for all
    load: LoadConfig = dataclasses.field(default_factory=LoadConfig)

    def __post_init__(self) -> None:
        where = f"controller configuration '{self.name}': "
        check(self, where)
        for ok, message in _rules(self):
            if not ok:
                raise ConfigError(where + message)

    @property
    def samples_ahead(self) -> int:
        """Samples of the reference that the controller reads: the present one, or those that it plans ahead too."""
        if self.stance.forces != "horizon":
            return 1
        return math.ceil((self.horizon.steps + 1) * self.horizon.step_s * self.rate_hz) + 2

    def release_force(self, robot: Robot) -> float:
        """Vertical force above which plots, videos and pages show a foot as loaded, N."""
        return self.gait.release_threshold * robot.mass * GRAVITY

    def as_dict(self) -> dict[str, Any]:
        """JSON-serialisable."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, record: Any) -> "ControllerConfig":
        """Inverse of `as_dict`; raises `ConfigError` if the record is damaged or of another release."""
        with suppress(ConfigError, TypeError, AttributeError):
            config = changed(cls(), record, "controller")
            if plain(config.as_dict()) == plain(record):
                return config
        raise ConfigError("the controller's parameters are those of another release")


def _rules(config: ControllerConfig) -> tuple[tuple[bool, str], ...]:
    """(ok, message) of each rule for several values together; the horizon's rates matter only where it is used."""
    gait, stance, horizon = config.gait, config.stance, config.horizon
    rate_hz, used, ratio = config.rate_hz, stance.forces == "horizon", config.rate_hz / horizon.solve_rate_hz
    whole = ratio >= 1 - 1e-9 and abs(ratio - round(ratio)) < 1e-6
    solved = f"rate_hz = {rate_hz:g} or a whole fraction of it, not {horizon.solve_rate_hz:g}"
    long_enough = horizon.step_s * rate_hz >= 1 - 1e-9
    weighed = any(w > 0 for w in (*horizon.position_weight, *horizon.velocity_weight))
    return (
        (gait.release_threshold <= gait.contact_threshold, "gait.release_threshold must be in [0, contact_threshold]"),
        (stance.min_force < stance.max_force, "stance.min_force must be in [0, max_force)"),
        (
            not used or long_enough,
            f"horizon.step_s must be at least one control step, {1 / rate_hz:g} s, not {horizon.step_s:g}",
        ),
        (not used or whole, f"horizon.solve_rate_hz must be {solved}"),
        (weighed, "horizon.position_weight and velocity_weight must not all be 0"),
    )


CONFIGS: Final[dict[str, ControllerConfig]] = {
    "default": ControllerConfig(),
    "paper": changed(ControllerConfig(), packaged("fastmimic.control", "paper.json", dict[str, Any]), "paper"),
}
"""The full controller with the project's gains, and the paper's form: no feed-forward of accelerations or leg dynamics,
eq. 2 and 3 as printed."""


def controller_config(name: str) -> ControllerConfig:
    """A configuration by its name, or from a `.json` file; raises `ConfigError` if there is none."""
    if name.endswith(".json"):
        return read_config(name)
    if name not in CONFIGS:
        raise unknown("configuration", name, (*CONFIGS, "or a file (.json)"))
    return CONFIGS[name]


def read_config(path: str | Path) -> ControllerConfig:
    """Reads a configuration and names it after the file; raises `ConfigError` for a wrong file, field or value."""
    found = read_json(path)
    changes = {name: value for name, value in found.items() if name not in (*FILE_FORMAT, "base", "identified")}
    if any(found.get(name) != value for name, value in FILE_FORMAT.items()):
        expected = json.dumps(FILE_FORMAT)[1:-1]
        raise ConfigError(f"{path}: not a controller's configuration; expected {expected}")
    base = found.get("base", "default")
    if not isinstance(base, str) or base not in CONFIGS:
        raise ConfigError(f"{path}: {unknown('base', str(base), CONFIGS)}")
    return changed(CONFIGS[base], {"name": Path(path).name, **changes}, str(path))


_PACKED: Final = (ControllerConfig, GaitConfig, StanceConfig, HorizonConfig, SwingConfig)
_RECORD: Final = record_dtype(
    [
        *[("dt", "f8"), ("size", "f8"), ("horizon_interval", "i8")],
        *(field for part in _PACKED for field in record_fields(part)),
    ]
)


def pack_config(config: ControllerConfig, robot: Robot) -> Records:
    """(1,) structured array for the kernels, scaled to the robot."""
    scales = {"weight": robot.mass * GRAVITY, "force_weight": mass_ratio(robot) ** 2}
    scales |= {"joint": joint_ratio(robot), "length": length_ratio(robot)}
    record = np.zeros(1, _RECORD)
    for part in (config, config.gait, config.stance, config.horizon, config.swing):
        pack(part, record, scales)
    # other forces and footholds have no urgency
    regulated = config.stance.feedback == "regulator" and config.swing.foothold == "regulator"
    record["recovery_steps"] *= regulated and config.stance.forces == "instant"
    record["early_touchdown_from"] *= config.swing.foothold != "raibert"  # its swings have a time of their own
    record["dt"], record["size"] = 1.0 / config.rate_hz, scales["length"]
    record["horizon_interval"] = round(config.rate_hz / config.horizon.solve_rate_hz)
    return record


def loaded_robot(robot: Robot, load: LoadConfig) -> Robot:
    """The robot with a point mass on its trunk; its specification, from which simulations are built, is unchanged."""
    if load.mass == 0:
        return robot
    place, point = np.array(load.position), np.zeros((3, 3))
    mass, com_b, inertia_b = combined([(robot.mass, robot.com_b, robot.inertia_b), (load.mass, place, point)])
    trunk_mass, trunk_com_b, _ = combined([(robot.trunk_mass, robot.trunk_com_b, point), (load.mass, place, point)])
    whole = dataclasses.replace(robot, mass=mass, com_b=com_b, inertia_b=inertia_b)
    return dataclasses.replace(whole, trunk_mass=trunk_mass, trunk_com_b=trunk_com_b)
