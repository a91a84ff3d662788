"""The ground's friction from a log: by the forces on sliding feet, or else a lower bound.

A sliding foot is pushed back along the ground by μ times the normal force (Coulomb). A foot that holds says only that μ
is above its force ratio.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.identification.forces import GroundForces
from fastmimic.robot import Robot

SLIDING_SPEED: Final = 0.15  # m/s; five times the estimator's velocity error
OPPOSED: Final = 0.9  # least cosine between the force along the ground and the direction from which the foot slides
EVENT_S: Final = 0.01  # shortest slide that counts
EDGE_S: Final = 0.01  # left out at both ends of a contact, where the smoothing mixes it with the swing
PRESSED: Final = 0.1  # least normal force, multiples of the robot's weight
EVENTS: Final = 3  # fewer slides count as none
HELD: Final = 0.95  # quantile of the holding feet's force ratios that is the lower bound
TORQUE_GAIN_ERROR: Final = 0.05  # standard deviation of a motor's torque constant, a fraction
_RESAMPLED: Final = 400


@dataclass(frozen=True)
class Friction:
    """The ground's coefficient of friction by a log.

    Attributes:
        value: the estimate; None if no foot slid.
        lower: end of the 95 % interval; without a slide a lower bound.
        upper: the other end; None if no foot slid.
        slides: how many slides of a foot it is taken from.
        slid_s: their time in all, s.
    """

    value: float | None
    lower: float
    upper: float | None
    slides: int
    slid_s: float


def identify_friction(forces: GroundForces, robot: Robot) -> Friction:
    """The coefficient of friction with a 95 % interval: scatter of the slides and the torque sensors' gains."""
    events, bound = _slides(forces, robot), _bound(forces, robot)
    nothing = Friction(None, bound, None, 0, 0.0)
    if len(events) < EVENTS:
        return nothing
    value = _coefficient(forces.force(), events)
    rng = np.random.default_rng(0)
    ratios, weights = _of_events(forces.force(), events)
    drawn = rng.integers(len(events), size=(_RESAMPLED, len(events)))
    scatter = float(np.std([_weighted_median(ratios[d], weights[d]) for d in drawn]))
    spread = 1.96 * float(np.hypot(scatter, _gain_error(forces, lambda f: _coefficient(f, events))))
    if value + spread < bound:  # feet held at more: what seemed to slide did not
        return nothing
    seconds = forces.dt * sum(len(rows) for rows, _ in events)
    return Friction(value, max(0.0, value - spread), value + spread, len(events), seconds)


def _pressed(forces: GroundForces, force: Array, robot: Robot) -> NDArray[np.bool_]:
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
        edges = np.flatnonzero(np.diff(sliding[:, leg].astype(np.int8), prepend=0, append=0))
        found += [(np.arange(a, b), leg) for a, b in edges.reshape(-1, 2) if (b - a) * forces.dt >= EVENT_S - 1e-9]
    return found


def _of_events(force: Array, events: list[tuple[NDArray[np.intp], int]]) -> tuple[Array, Array]:
    """Ratio of the impulses along the ground and normal to it in each slide, and the latter, its weight."""
    along = np.array([np.linalg.norm(force[rows, leg, :2], axis=-1).sum() for rows, leg in events])
    normal = np.array([force[rows, leg, 2].sum() for rows, leg in events])
    return along / normal, normal


def _coefficient(force: Array, events: list[tuple[NDArray[np.intp], int]]) -> float:
    return _weighted_median(*_of_events(force, events))


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _gain_error(forces: GroundForces, estimate: Callable[[Array], float]) -> float:
    """Standard deviation of an estimate by independent errors of the motors' torque constants."""
    nominal, total = estimate(forces.force()), 0.0
    for leg in range(4):
        for joint in range(3):
            gain = np.ones((4, 3))
            gain[leg, joint] += TORQUE_GAIN_ERROR
            total += (estimate(forces.force(gain)) - nominal) ** 2
    return float(np.sqrt(total))


def _bound(forces: GroundForces, robot: Robot) -> float:
    """Force ratio at which feet held, less the effect of the torque sensors' gains; 0 if none was pressed."""
    force = forces.force()
    held = _pressed(forces, force, robot) & (np.linalg.norm(forces.velocity, axis=-1) < SLIDING_SPEED)
    if not held.any():
        return 0.0

    def bound(force: Array) -> float:
        ratio = np.linalg.norm(force[..., :2], axis=-1)[held] / np.maximum(force[..., 2][held], 1.0)
        return float(np.quantile(ratio, HELD))

    return max(0.0, bound(force) - 1.96 * _gain_error(forces, bound))
