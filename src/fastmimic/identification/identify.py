"""From a log to the controller's parameters: friction and payload, and a file that every command takes."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.configuration import changed
from fastmimic.base.errors import LogError
from fastmimic.base.files import write_json
from fastmimic.control.config import FILE_FORMAT, ControllerConfig, controller_config
from fastmimic.episode.run_log import RunLog
from fastmimic.identification.forces import ground_forces
from fastmimic.identification.friction import Friction, identify_friction
from fastmimic.identification.payload import Payload, identify_payload
from fastmimic.robot import Robot

FRICTION_MARGIN: Final = 0.85
"""Share of the identified coefficient that the controller assumes, as its friction pyramid's edges reach √2 times as
far as its sides: about the best for side-steps on floors of 0.4 to 0.6."""


@dataclass(frozen=True)
class Identification:
    """Friction and payload identified from a run.

    Attributes:
        robot, motion: names.
        duration_s: of the log.
        friction: of the ground.
        payload: on the trunk; None if the feet never stood long enough to weigh the robot, as in a fall.
    """

    robot: str
    motion: str
    duration_s: float
    friction: Friction
    payload: Payload | None

    def stance_friction(self, config: ControllerConfig) -> float:
        """The coefficient that the controller should assume: a share of the identified one, at most the present one.
        Unchanged if no foot slid."""
        value = self.friction.value
        return config.stance.friction if value is None else min(config.stance.friction, FRICTION_MARGIN * value)

    def changes(self, config: ControllerConfig) -> dict[str, Any]:
        """Changes to a configuration, in the form of its file."""
        found: dict[str, Any] = {"robot": self.robot}
        friction = round(self.stance_friction(config), 3)
        if friction < config.stance.friction:
            found["stance"] = {"friction": friction}
        if self.payload is not None and self.payload.certain > 0:
            found["load"] = {"mass": round(self.payload.certain, 2)}
        return found

    def configure(self, config: ControllerConfig) -> ControllerConfig:
        """The configuration with the identified values."""
        found: ControllerConfig = changed(config, self.changes(config), "what was identified")
        return found

    def save(self, path: str | Path, base: str = "default") -> None:
        """Writes a controller's configuration (`fastmimic.control.config`) with its origin to a `.json` file. `base` is
        the configuration that it changes. Raises `ConfigError` if there is none of that name, and `OutputError` if the
        file cannot be written."""
        content = {
            **FILE_FORMAT,
            "base": base,
            **self.changes(controller_config(base)),
            "identified": asdict(self),
        }
        write_json(path, content)


def identify(log: RunLog, robot: Robot, unloaded: RunLog | None = None) -> Identification:
    """Friction and payload from the log of a run; raises `LogError` if it is of another robot, too short, or the robot
    never stands. `robot` is the model without payload; the log `unloaded`, of the same robot without payload, takes the
    sensors' gains out of the payload."""
    forces = ground_forces(log, robot)
    before = ground_forces(unloaded, robot) if unloaded is not None else None
    friction = identify_friction(forces, robot)
    payload = None
    try:
        payload = identify_payload(forces, robot, before)
    except LogError:
        if friction.value is None:
            raise
    return Identification(log.robot, log.motion, log.duration_s, friction, payload)
