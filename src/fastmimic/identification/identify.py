"""From a log to the controller's parameters: friction and payload, and a file that every command takes.

Friction: a sliding foot is pushed back along the ground by μ times the normal force (Coulomb); a foot that holds says
only that μ is above its force ratio. Payload: what the feet bear beyond the robot alone, by the motors' torques through
the legs and by the feet's force sensors, each only as good as its gains. The log of the same robot without a payload
takes the gains out.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Flags, stretches
from fastmimic.base.configuration import changed
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import LogError
from fastmimic.base.files import write_json
from fastmimic.control.config import FILE_FORMAT, ControllerConfig, controller_config
from fastmimic.identification.forces import GroundForces, ground_forces
from fastmimic.robot import Robot
from fastmimic.robot.state import RunLog

FRICTION_MARGIN: Final = 0.85
"""Share of the identified coefficient that the controller assumes: its friction pyramid's corners reach 1.08 times as
far as its sides, and the coefficient is an estimate."""

SLIDING_SPEED: Final = 0.15  # m/s; five times the estimator's velocity error
OPPOSED: Final = 0.9  # least cosine between the force along the ground and the direction from which the foot slides
EVENT_S: Final = 0.01  # shortest slide that counts
EDGE_S: Final = 0.01  # left out at both ends of a contact, where the smoothing mixes it with the swing
PRESSED: Final = 0.1  # least normal force, multiples of the robot's weight
EVENTS: Final = 3  # fewer slides count as none
HELD: Final = 0.95  # quantile of the holding feet's force ratios that is the lower bound
TORQUE_GAIN_ERROR: Final = 0.05  # standard deviation of a motor's torque constant, a fraction
_RESAMPLED: Final = 400

FOOT_GAIN_ERROR: Final = 0.1  # standard deviation of a foot sensor's gain, a fraction
STANDING_S: Final = 0.04  # stance required before and after a sample, to leave impacts out
SWINGING_S: Final = 0.01
SAMPLES: Final = 50
LEG_ERROR_KG: Final = 0.2  # kg; standard deviation of a weight by torques, from joint friction and rotors
TARED: Final = 0.01  # remaining gain error with an unloaded run, standard deviation as a share of the robot's mass
_INDEPENDENT_S: Final = 0.1  # time after which a weight is a new one


@dataclass(frozen=True)
class Friction:
    """The ground's coefficient of friction by a log; without a slide there is no value, only a lower bound."""

    value: float | None
    lower: float  # end of the 95 % interval
    upper: float | None
    slides: int  # of a foot
    slid_s: float  # in all


@dataclass(frozen=True)
class Payload:
    """The mass on the trunk by a log, kg beyond the robot's model, with its 95 % interval."""

    mass: float  # below 0 for a lighter robot
    lower: float
    upper: float
    tared: bool  # whether a run without payload took the sensors' gains out

    @property
    def certain(self) -> float:
        """For the controller, kg: the mass if the 95 % interval lies above 0, else 0."""
        return self.mass if self.lower > 0 else 0.0


@dataclass(frozen=True)
class Identification:
    """Friction and payload identified from a run."""

    robot: str
    motion: str
    duration_s: float  # of the log
    friction: Friction
    payload: Payload | None  # None if the feet never stood long enough to weigh the robot, as in a fall

    def stance_friction(self, config: ControllerConfig) -> float:
        """The coefficient to assume: a share of the identified one, at most the present one; that if no foot slid."""
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
        return changed(config, self.changes(config), "what was identified")

    def save(self, path: str | Path, base: str = "default") -> None:
        """Writes a controller's configuration (`fastmimic.control.config`) with its origin to a `.json` file; `base` is
        the one that it changes. Raises `ConfigError` if there is none of that name, `OutputError`."""
        content = {**FILE_FORMAT, "base": base, **self.changes(controller_config(base)), "identified": asdict(self)}
        write_json(path, content)


def identify(log: RunLog, robot: Robot, unloaded: RunLog | None = None) -> Identification:
    """Friction and payload from the log of a run; raises `LogError` if it is of another robot, too short, or the robot
    never stands. `robot` is the model without payload; `unloaded`, its log without, takes the sensors' gains out."""
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


def identify_friction(forces: GroundForces, robot: Robot) -> Friction:
    """The coefficient of friction with a 95 % interval: scatter of the slides and the torque sensors' gains."""
    events, bound = _slides(forces, robot), _bound(forces, robot)
    nothing = Friction(None, bound, None, 0, 0.0)
    if len(events) < EVENTS:
        return nothing

    def coefficient(gain: Array | float) -> float:
        return _weighted_median(*_of_events(forces.force(gain), events))

    value, rng = coefficient(1.0), np.random.default_rng(0)
    ratios, weights = _of_events(forces.force(), events)
    drawn = rng.integers(len(events), size=(_RESAMPLED, len(events)))
    scatter = float(np.std([_weighted_median(ratios[d], weights[d]) for d in drawn]))
    by_motors = _gain_error(coefficient, TORQUE_GAIN_ERROR, 4, 3)
    spread = 1.96 * float(np.hypot(scatter, by_motors))
    if value + spread < bound:  # feet held at more: what seemed to slide did not
        return nothing
    seconds = forces.dt * sum(len(rows) for rows, _ in events)
    return Friction(value, max(0.0, value - spread), value + spread, len(events), seconds)


def _pressed(forces: GroundForces, force: Array, robot: Robot) -> Flags:
    """(t, 4) where a ratio of forces means anything."""
    pressed = forces.loaded & (forces.settled_s >= EDGE_S) & forces.usable[:, None]
    return np.asarray(pressed & (force[..., 2] > PRESSED * robot.mass * GRAVITY))


def _slides(forces: GroundForces, robot: Robot) -> list[tuple[NDArray[np.intp], int]]:
    """Samples and leg of each slide."""
    force = forces.force()
    speed = np.linalg.norm(forces.velocity, axis=-1)
    along = np.linalg.norm(force[..., :2], axis=-1)
    opposed = -np.einsum("tli,tli->tl", force[..., :2], forces.velocity) > OPPOSED * along * speed
    sliding = _pressed(forces, force, robot) & (speed > SLIDING_SPEED) & opposed
    found = []
    for leg in range(4):
        slid = stretches(sliding[:, leg])
        found += [(np.arange(a, b), leg) for a, b in slid if (b - a) * forces.dt >= EVENT_S - 1e-9]
    return found


def _of_events(force: Array, events: list[tuple[NDArray[np.intp], int]]) -> tuple[Array, Array]:
    """Ratio of the impulses along the ground and normal to it in each slide, and the latter, its weight."""
    along = np.array([np.linalg.norm(force[rows, leg, :2], axis=-1).sum() for rows, leg in events])
    normal = np.array([force[rows, leg, 2].sum() for rows, leg in events])
    return along / normal, normal


def _weighted_median(values: Array, weights: Array) -> float:
    return float(np.quantile(values, 0.5, weights=weights, method="inverted_cdf"))


def _gain_error(estimate: Callable[[Array], float], error: float, *shape: int) -> float:
    """Standard deviation of an estimate by independent relative errors of the gains, an array of this shape."""
    nominal, total = estimate(np.ones(shape)), 0.0
    for one in np.ndindex(shape):
        gain = np.ones(shape)
        gain[one] += error
        total += (estimate(gain) - nominal) ** 2
    return float(np.sqrt(total))


def _bound(forces: GroundForces, robot: Robot) -> float:
    """Force ratio at which feet held, less the effect of the torque sensors' gains; 0 if none was pressed."""
    held = _pressed(forces, forces.force(), robot) & (np.linalg.norm(forces.velocity, axis=-1) < SLIDING_SPEED)
    if not held.any():
        return 0.0

    def bound(gain: Array | float) -> float:
        force = forces.force(gain)[held]
        return float(np.quantile(np.linalg.norm(force[:, :2], axis=-1) / np.maximum(force[:, 2], 1.0), HELD))

    return max(0.0, bound(1.0) - 1.96 * _gain_error(bound, TORQUE_GAIN_ERROR, 4, 3))


def identify_payload(forces: GroundForces, robot: Robot, unloaded: GroundForces | None = None) -> Payload:
    """The mass that the feet bear beyond the robot's without payload; raises `LogError` if they stood too short.
    `unloaded` is from a run of the same robot without payload."""
    found, spreads = np.transpose([_weighed(forces, by_feet, robot, unloaded) for by_feet in (False, True)])
    weights = 1.0 / np.square(spreads)
    mass = float(np.average(found, weights=weights))
    spread = 1.96 * float(weights.sum() ** -0.5)
    return Payload(mass, mass - spread, mass + spread, unloaded is not None)


def _weighed(forces: GroundForces, by_feet: bool, robot: Robot, unloaded: GroundForces | None) -> tuple[float, float]:
    """The payload by the feet's sensors or by the motors' torques, and its standard deviation, kg."""
    mass, scatter = _excess(forces, by_feet)
    if unloaded is not None:
        before, noise = _excess(unloaded, by_feet)
        mass = robot.mass * (robot.mass + mass) / (robot.mass + before) - robot.mass
        return mass, float(np.hypot(np.hypot(scatter, noise), TARED * (robot.mass + mass)))

    def by_gain(gain: Array) -> float:
        return _excess(forces, by_feet, gain)[0]

    if by_feet:
        return mass, float(np.hypot(scatter, _gain_error(by_gain, FOOT_GAIN_ERROR, 4)))
    error = np.hypot(_gain_error(by_gain, TORQUE_GAIN_ERROR, 4, 3), LEG_ERROR_KG)
    return mass, float(np.hypot(scatter, error))


def _standing(forces: GroundForces) -> Flags:
    """(t,) samples in which every foot either stands or swings, at least two stand, and none has just switched."""
    least = np.where(forces.loaded, STANDING_S, SWINGING_S)
    sure = (forces.settled_s >= least).all(axis=1) & (forces.loaded.sum(axis=1) >= 2) & forces.usable
    if int(sure.sum()) < SAMPLES:
        stand = f"feet stand in only {int(sure.sum())} control steps of the log"
        raise LogError(f"{stand}; {SAMPLES} are needed to weigh the robot. Log a longer run, or a slower motion")
    return np.asarray(sure)


def _excess(forces: GroundForces, by_feet: bool, gain: Array | float = 1.0) -> tuple[float, float]:
    """Median mass beyond the robot's while it stands, and its deviation by the scatter, kg."""
    sure, vertical = _standing(forces), forces.sensed * gain if by_feet else forces.force(gain)[..., 2]
    borne = (vertical * forces.loaded)[sure].sum(axis=1)
    mass = (borne - forces.need[sure]) / forces.lift[sure]
    independent = max(1.0, len(mass) * forces.dt / _INDEPENDENT_S)
    scatter = 1.4826 * float(np.median(np.abs(mass - np.median(mass))))
    return float(np.median(mass)), 1.2533 * scatter / float(np.sqrt(independent))
