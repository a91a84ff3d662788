"""A built-in jump of a dog-sized animal, made by formula: it crouches, leaves the ground, lands and stands."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.clips.clip import Clip
from fastmimic.clips.synthesis import (
    HIP,
    RATE_HZ,
    ROBOT_SCALE,
    ROOT_HEIGHT,
    SIDE,
    SPINE,
    TOE_MARKER_HEIGHT,
    arc,
    forward_in_swing,
)

_STAND_S: Final = 0.2  # before and after
_HALF_WIDTH: Final = 0.03  # lateral distance of the feet from the midline, m
_SPEED_IN_FLIGHT: Final = 0.7  # share of the whole way that is covered in flight


@dataclass(frozen=True)
class JumpSpec:
    """A jump. Lengths at the A1's size, m: `forward` is its way, `rise` that of the trunk in flight, `tuck` that of the
    feet towards it, and `deep` how far the trunk sinks before and after, within `sink_s`, s."""

    about: str
    forward: float
    rise: float
    tuck: float
    deep: float = 0.04
    sink_s: float = 0.2


JUMPS: Final = {"jump": JumpSpec("a jump forwards from standing to standing", forward=0.4, rise=0.16, tuck=0.16)}
"""The built-in jumps by name."""


def jump(spec: JumpSpec, meta: dict[str, object] | None = None) -> Clip:
    """A jump as an animal's keypoints, world frame, z up."""
    from scipy.interpolate import CubicHermiteSpline

    animal = 1.0 / ROBOT_SCALE
    way, deep, speed = spec.forward * animal, spec.deep * animal, np.sqrt(2 * GRAVITY * spec.rise * animal)
    flight, push = 2 * speed / GRAVITY, 2 * deep / speed
    # at rest, at rest, lowest, leaving the ground, landing, lowest, at rest, at rest
    knots = np.cumsum([0.0, _STAND_S, spec.sink_s, push, flight, push, spec.sink_s, _STAND_S])
    time = np.arange(round(knots[-1] * RATE_HZ) + 1) / RATE_HZ
    in_air = (time > knots[3]) & (time < knots[4])
    air = np.clip((time - knots[3]) / flight, 0.0, 1.0)
    sunk, rising = np.array([[0, 0, -1, 0, 0, -1, 0, 0], [0, 0, 0, 1, -1, 0, 0, 0]])
    height = CubicHermiteSpline(knots, deep * sunk, speed * rising)
    up = np.where(in_air, flight * air * (speed - 0.5 * GRAVITY * flight * air), height(time))
    covered, moving = np.array([[0, 0, 0, 0.15, 0.85, 1, 1, 1], [0, 0, 0, 1, 1, 0, 0, 0]])
    ahead = way * CubicHermiteSpline(knots, covered, _SPEED_IN_FLIGHT / flight * moving)(time)
    trunk = np.column_stack([ahead, np.zeros_like(up), ROOT_HEIGHT + up])
    lift = np.where(in_air, up, 0.0) + spec.tuck * animal * arc(air, 0.5)

    def toe(leg: int) -> Array:
        x, y = HIP[leg, 0] + way * forward_in_swing(air), SIDE[leg] * _HALF_WIDTH * animal
        return np.column_stack([x, np.full_like(lift, y), TOE_MARKER_HEIGHT + lift])

    points = [trunk - SPINE, trunk + SPINE, *(trunk + hip for hip in HIP), *(toe(leg) for leg in range(4))]
    return Clip(points_w=np.stack(points, axis=1), rate_hz=RATE_HZ, is_cycle=False, meta=dict(meta or {}))
