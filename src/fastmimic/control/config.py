"""The controller's parameters: one set for all motions and robots, its variants by name or file, its form for kernels.

A file names a set ("default" if absent) and the changes to it; "identified" is a note for people:

    {"format": "fastmimic controller", "version": 1, "base": "default",
     "robot": "a1", "stance": {"friction": 0.4}, "load": {"mass": 2.0}}
"""

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.configuration import changed, check, documented, pack, parameter, record_fields
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError, unknown
from fastmimic.base.files import packaged, read_json
from fastmimic.base.jit import record_dtype
from fastmimic.base.text import plain
from fastmimic.control.config_parts import GaitConfig, HorizonConfig, LoadConfig, StanceConfig, SwingConfig
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.robot import Robot
from fastmimic.robot.robot import combined, joint_ratio, length_ratio, mass_ratio

FILE_FORMAT: Final = {"format": "fastmimic controller", "version": 1}


@documented
@dataclass(frozen=True)
class ControllerConfig:
    """All parameters of the controller; its parts are described at their classes."""

    name: str = "default"
    rate_hz: float = parameter(500.0, unit="Hz", above=0.0, high=10_000.0, key="", about="control steps a second")
    joint_margin: float = parameter(
        0.01, unit="rad", about="distance from the joint limits that commanded positions keep"
    )
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
        try:
            config: ControllerConfig = changed(cls(), record, "controller")
            complete = plain(config.as_dict()) == plain(record)
        except (ConfigError, TypeError, AttributeError):
            complete = False
        if not complete:
            raise ConfigError("the controller's parameters are those of another release")
        return config


def _rules(config: ControllerConfig) -> tuple[tuple[bool, str], ...]:
    """(ok, message) of each rule for several values together; the horizon's rates matter only where it is used."""
    gait, stance, horizon = config.gait, config.stance, config.horizon
    rate_hz, used, ratio = config.rate_hz, stance.forces == "horizon", config.rate_hz / horizon.solve_rate_hz
    return (
        (gait.release_threshold <= gait.contact_threshold, "gait.release_threshold must be in [0, contact_threshold]"),
        (stance.min_force < stance.max_force, "stance.min_force must be in [0, max_force)"),
        (
            not used or horizon.step_s * rate_hz >= 1 - 1e-9,
            f"horizon.step_s must be at least one control step, {1 / rate_hz:g} s, not {horizon.step_s:g}",
        ),
        (
            not used or (ratio >= 1 - 1e-9 and abs(ratio - round(ratio)) < 1e-6),
            f"horizon.solve_rate_hz must be rate_hz = {rate_hz:g} or a whole fraction of it, not"
            f" {horizon.solve_rate_hz:g}",
        ),
        (
            any(w > 0 for w in (*horizon.position_weight, *horizon.velocity_weight)),
            "horizon.position_weight and velocity_weight must not all be 0",
        ),
    )


def default_config() -> ControllerConfig:
    """The full controller with the project's gains."""
    return ControllerConfig()


def paper_config() -> ControllerConfig:
    """The paper's form: no feed-forward of accelerations or leg dynamics, eq. 2 and 3 as printed."""
    changes = packaged("fastmimic.control", "paper.json", dict[str, Any])
    found: ControllerConfig = changed(ControllerConfig(), changes, "paper")
    return found


CONFIGS: Final = {"default": default_config, "paper": paper_config}


def controller_config(name: str) -> ControllerConfig:
    """A configuration by its name, or from a `.json` file; raises `ConfigError` if there is none."""
    if name.endswith(".json"):
        return read_config(name)
    if name not in CONFIGS:
        raise unknown("configuration", name, (*CONFIGS, "or a file (.json)"))
    return CONFIGS[name]()


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
    config: ControllerConfig = changed(CONFIGS[base](), {"name": Path(path).name, **changes}, str(path))
    return config


_PACKED: Final = (ControllerConfig, GaitConfig, StanceConfig, HorizonConfig, SwingConfig)
_RECORD: Final = record_dtype(
    [
        ("dt", "f8"),
        ("horizon_interval", "i8"),
        *(field for part in _PACKED for field in record_fields(part)),
    ]
)


def pack_config(config: ControllerConfig, robot: Robot) -> NDArray[Any]:
    """(1,) structured array for the kernels, scaled to the robot."""
    scales = {
        "weight": robot.mass * GRAVITY,
        "joint": joint_ratio(robot),
        "force_weight": mass_ratio(robot) ** 2,
        "length": length_ratio(robot),
    }
    record = np.zeros(1, _RECORD)
    for part in (config, config.gait, config.stance, config.horizon, config.swing):
        pack(part, record, scales)
    # other forces and footholds have no urgency
    regulated = config.stance.feedback == "regulator" and config.swing.foothold == "regulator"
    record["recovery_steps"] *= regulated and config.stance.forces == "instant"
    record["dt"] = 1.0 / config.rate_hz
    record["horizon_interval"] = round(config.rate_hz / config.horizon.solve_rate_hz)
    return record


def loaded_robot(robot: Robot, load: LoadConfig) -> Robot:
    """The robot with a point mass on its trunk; its specification, from which simulations are built, is unchanged."""
    if load.mass == 0:
        return robot
    place, point = np.array(load.position), np.zeros((3, 3))
    mass, com_b, inertia_b = combined([(robot.mass, robot.com_b, robot.inertia_b), (load.mass, place, point)])
    trunk_mass, trunk_com_b, _ = combined([(robot.trunk_mass, robot.trunk_com_b, point), (load.mass, place, point)])
    return dataclasses.replace(
        robot, mass=mass, com_b=com_b, inertia_b=inertia_b, trunk_mass=trunk_mass, trunk_com_b=trunk_com_b
    )
