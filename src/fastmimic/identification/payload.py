"""A payload from a log: what the feet bear beyond the robot alone.

Two kinds of sensors tell, the motors' torques through the legs and the feet's force sensors; each is only as good as
its gains. The log of the same robot without a payload takes the gains out.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import LogError
from fastmimic.identification.forces import GroundForces
from fastmimic.identification.friction import TORQUE_GAIN_ERROR
from fastmimic.robot import Robot

FOOT_GAIN_ERROR: Final = 0.1  # standard deviation of a foot sensor's gain, a fraction
STANDING_S: Final = 0.04  # stance required before and after a sample, to leave impacts out
SWINGING_S: Final = 0.01
SAMPLES: Final = 50
LEG_ERROR_KG: Final = 0.2  # kg; standard deviation of a weight by torques, from joint friction and rotors
TARED: Final = 0.01  # remaining gain error with an unloaded run, standard deviation as a share of the robot's mass
_INDEPENDENT_S: Final = 0.1  # time after which a weight is a new one


@dataclass(frozen=True)
class Payload:
    """The mass on the trunk by a log.

    Attributes:
        mass: kg beyond the robot's model; below 0 for a lighter robot.
        lower, upper: 95 % interval, kg.
        tared: whether a run without payload took the sensors' gains out.
    """

    mass: float
    lower: float
    upper: float
    tared: bool

    @property
    def certain(self) -> float:
        """For the controller, kg: the mass if the 95 % interval lies above 0, else 0."""
        return self.mass if self.lower > 0 else 0.0


def identify_payload(forces: GroundForces, robot: Robot, unloaded: GroundForces | None = None) -> Payload:
    """The mass that the feet bear beyond the robot's without payload; raises `LogError` if they stood too short.
    `unloaded` is from a run of the same robot without payload."""
    found, spreads = [], []
    for weigh, error in (
        (_by_torque, np.hypot(_torque_gain_error(forces), LEG_ERROR_KG)),
        (_by_feet, _foot_gain_error(forces)),
    ):
        mass, scatter = _weighed(forces, weigh(forces))
        if unloaded is not None:
            before, noise = _weighed(unloaded, weigh(unloaded))
            mass = robot.mass * (robot.mass + mass) / (robot.mass + before) - robot.mass
            scatter, error = float(np.hypot(scatter, noise)), TARED * (robot.mass + mass)
        found.append(mass)
        spreads.append(float(np.hypot(scatter, error)))
    weights = 1.0 / np.square(spreads)
    mass = float(np.average(found, weights=weights))
    spread = 1.96 * float(weights.sum() ** -0.5)
    return Payload(mass, mass - spread, mass + spread, unloaded is not None)


def _standing(forces: GroundForces) -> NDArray[np.bool_]:
    """(t,) samples in which every foot either stands or swings, at least two stand, and none has just switched."""
    least = np.where(forces.loaded, STANDING_S, SWINGING_S)
    sure = (forces.settled_s >= least).all(axis=1) & (forces.loaded.sum(axis=1) >= 2) & forces.usable
    if int(sure.sum()) < SAMPLES:
        raise LogError(
            f"feet stand in only {int(sure.sum())} control steps of the log; {SAMPLES} are needed to weigh the robot."
            " Log a longer run, or a slower motion"
        )
    return np.asarray(sure)


def _by_torque(forces: GroundForces, gain: Array | None = None) -> Array:
    """(t, 4) vertical forces by the motors' torques, N."""
    return np.asarray(forces.force(gain)[..., 2] * forces.loaded)


def _by_feet(forces: GroundForces) -> Array:
    """(t, 4) vertical forces by the foot sensors, N."""
    return np.asarray(forces.sensed * forces.loaded)


def _excess(forces: GroundForces, borne: Array) -> Array:
    """Mass beyond the robot's in each sample in which it stands, kg."""
    sure = _standing(forces)
    return np.asarray((borne[sure].sum(axis=1) - forces.need[sure]) / forces.lift[sure])


def _weighed(forces: GroundForces, borne: Array) -> tuple[float, float]:
    """Median mass beyond the robot's and its standard deviation by the samples' scatter, kg."""
    mass = _excess(forces, borne)
    independent = max(1.0, len(mass) * forces.dt / _INDEPENDENT_S)
    scatter = 1.4826 * float(np.median(np.abs(mass - np.median(mass))))
    return float(np.median(mass)), 1.2533 * scatter / float(np.sqrt(independent))


def _torque_gain_error(forces: GroundForces) -> float:
    """Standard deviation of the mass by independent errors of the motors' torque constants, kg."""
    changed = []
    for motor in range(12):
        gain = np.ones(12)
        gain[motor] += TORQUE_GAIN_ERROR
        changed.append(_by_torque(forces, gain.reshape(4, 3)))
    return _spread(forces, _by_torque(forces), changed)


def _foot_gain_error(forces: GroundForces) -> float:
    """As `_torque_gain_error`, for the foot sensors' gains."""
    borne = _by_feet(forces)
    return _spread(forces, borne, [borne * (1 + FOOT_GAIN_ERROR * (np.arange(4) == foot)) for foot in range(4)])


def _spread(forces: GroundForces, borne: Array, changed: list[Array]) -> float:
    nominal = np.median(_excess(forces, borne))
    return float(np.sqrt(sum((np.median(_excess(forces, other)) - nominal) ** 2 for other in changed)))
