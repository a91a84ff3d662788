"""Built-in animal-like gaits and jumps: keypoints of a dog-sized animal, made by formula.

They replace recordings that cannot be shipped. The trunk bobs, sways, rolls and pitches with its steps. The paws roll
over the toes before lift-off, swing in an asymmetric arc, front higher than hind, and reach back a little before
touch-down. All paths are twice continuously differentiable in time. A jump goes from standing to standing.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import FRONT, GRAVITY, LEFT
from fastmimic.base.errors import ConfigError, unknown
from fastmimic.base.files import packaged
from fastmimic.base.rotations import planar_exp, quat_rotate, rotate_planar, trunk_quaternion
from fastmimic.clips.clip import Clip, ClipOrigin

RATE_HZ: Final = 120.0
ANIMAL: Final = 1.0 / 0.825  # speeds and lifts are given at the A1's size; the animal is larger by the published scale

# A dog, m: means over the public recordings (points against the middle of the neck–pelvis line).
ROOT_HEIGHT: Final = 0.443
SPINE: Final = np.array([0.265, 0.0, 0.025])
HIP: Final = np.stack(
    [np.where(FRONT, 0.176, -0.255), np.where(LEFT, 0.045, -0.045), np.where(FRONT, -0.045, -0.07)], axis=-1
)
TOE_MARKER_HEIGHT: Final = 0.015
SIDE: Final = np.where(LEFT, 1.0, -1.0)


@dataclass(frozen=True)
class GaitSpec:
    """A gait. Lengths and speeds at the A1's size; legs FR, FL, RR, RL; phases are shares of the period."""

    about: str = ""
    speed: float = 0.0  # forwards, m/s
    lateral_speed: float = 0.0  # to the left, m/s
    yaw_rate: float = 0.0  # to the left, rad/s
    period: float = 0.5  # s
    duty: float = 0.55  # share of the period in stance
    phase: tuple[float, float, float, float] = (0.0, 0.5, 0.5, 0.0)  # when each leg touches down
    lift: float = 0.06  # height of the front feet's swing, m
    hind_lift: float = 0.85  # the hind feet's share of it
    half_width: float = 0.03  # lateral distance of the footholds from the midline, m
    bob: float = 0.008  # amplitude of the trunk's vertical motion, m
    bob_harmonic: int = 2  # how often that repeats in a period
    sway: float = 0.0  # amplitude towards the standing side, once a period, m
    roll: float = 0.0  # amplitude, once a period, rad
    pitch: float = 0.01  # amplitude, with the bob, rad
    yaw: float = 0.02  # amplitude, once a period, rad


GAITS: Final = packaged("fastmimic.clips", "gaits.json", dict[str, GaitSpec])
"""The built-in gaits by name."""


_RANGES: Final = {"speed": (-2.5, 2.5, "m/s"), "yaw_rate": (-4.0, 4.0, "rad/s"), "duty": (0.3, 0.85, "of the period")}


def gait(name: str, **changes: float) -> GaitSpec:
    """A built-in gait with some of its parameters replaced: `speed`, m/s at the A1's size, is along the gait's own
    direction (sideways for a side-step); `yaw_rate`, rad/s, is positive to the left; `duty` is the share of the period
    in stance. Raises `ConfigError`: no such gait, or a value out of range."""
    if name not in GAITS:
        raise unknown("gait", name, GAITS)
    spec = GAITS[name]
    for what, value in changes.items():
        low, high, unit = _RANGES[what]
        if not low <= value <= high:
            raise ConfigError(f"{what} must be between {low:g} and {high:g} {unit}, found {value}")
        sideways = what == "speed" and spec.lateral_speed
        change: dict[str, Any] = {"lateral_speed" if sideways else what: value}
        spec = replace(spec, **change)
    return spec


def generate(name: str, **changes: float | None) -> Clip:
    """One cycle of a built-in gait as an animal's keypoints; for the errors, and the changes that are not None, see
    `gait`."""
    given = {what: value for what, value in changes.items() if value is not None}
    return keypoints(gait(name, **given), built_in(name, given))


def built_in(name: str, parameters: dict[str, float] | None = None) -> ClipOrigin:
    """The origin of a clip that is made by formula."""
    licence = "no recording: made by formula, free to use"
    return ClipOrigin(name, "built in", "built-in", parameters=parameters or {}, licence=licence)


def keypoints(spec: GaitSpec, origin: ClipOrigin | None = None) -> Clip:
    """One cycle of a gait as an animal's keypoints, world frame, z up."""
    n = max(8, round(spec.period * RATE_HZ))
    share = np.arange(n) / n
    period = n / RATE_HZ
    twist = np.array([spec.speed * ANIMAL * period, spec.lateral_speed * ANIMAL * period, spec.yaw_rate * period])
    position, quat = _trunk(spec, share, twist)
    points = [position + quat_rotate(quat, -SPINE), position + quat_rotate(quat, SPINE)]
    points += [position + quat_rotate(quat, hip) for hip in HIP]
    points += [_toe(spec, leg, share, twist) for leg in range(4)]
    return Clip(points_w=np.stack(points, axis=1), rate_hz=RATE_HZ, is_cycle=True, origin=origin or ClipOrigin())


def _trunk(spec: GaitSpec, share: Array, twist: Array) -> tuple[Array, Array]:
    """Middle of the neck–pelvis line (t, 3) and the trunk's orientation (t, 4)."""
    xy, heading = planar_exp(twist, share)
    # from mid-stance of the left hind leg, which is on the loaded side, and of the right front leg
    left = 2 * np.pi * (share - (spec.phase[3] + spec.duty / 2))
    front = 2 * np.pi * spec.bob_harmonic * (share - (spec.phase[0] + spec.duty / 2))
    sway = spec.sway * ANIMAL * np.cos(left)
    xy = xy + rotate_planar(heading, np.stack([np.zeros_like(sway), sway], axis=-1))
    z = ROOT_HEIGHT - spec.bob * ANIMAL * np.cos(front)  # lowest in the middle of a stance
    roll, pitch = -spec.roll * np.cos(left - 0.4), spec.pitch * np.cos(front - 0.6)  # the standing side is down
    quat = trunk_quaternion(heading + spec.yaw * np.sin(left), np.stack([roll, pitch], axis=-1))
    return np.concatenate([xy, z[:, None]], axis=1), quat


def _toe(spec: GaitSpec, leg: int, share: Array, twist: Array) -> Array:
    """World path (t, 3) of one toe marker."""
    since = np.mod(share - spec.phase[leg], 1.0)  # since touch-down
    step = np.round(share - since - spec.phase[leg])  # index of the present or last stance
    middle = step + spec.phase[leg] + spec.duty / 2
    here, there = (_foothold(spec, leg, at, twist) for at in (middle, middle + 1.0))
    u = np.clip((since - spec.duty) / (1.0 - spec.duty), 0.0, 1.0)
    xy = here + forward_in_swing(u)[:, None] * (there - here)
    lift = spec.lift * ANIMAL * (1.0 if FRONT[leg] else spec.hind_lift)
    z = TOE_MARKER_HEIGHT + lift * arc(u, 0.42 if FRONT[leg] else 0.5)
    return np.concatenate([xy, z[:, None]], axis=1)


def _foothold(spec: GaitSpec, leg: int, middle: Array, twist: Array) -> Array:
    """Foothold (t, 2): under the hip at mid-stance (t,), at the gait's half width."""
    xy, heading = planar_exp(twist, middle)
    under = np.array([HIP[leg, 0], SIDE[leg] * spec.half_width * ANIMAL])
    return xy + rotate_planar(heading, np.broadcast_to(under, xy.shape))


def forward_in_swing(u: Array) -> Array:
    """Progress of a swing from rest to rest with continuous acceleration: quick start, slight overshoot."""
    ramp = 0.15
    start, end = np.minimum(u / ramp, 1.0), np.minimum((1.0 - u) / ramp, 1.0)

    def covered(w: Array) -> Array:  # integral of the smooth step 3w² − 2w³
        return ramp * (w**3 - 0.5 * w**4)

    steady = np.clip(u - ramp, 0.0, 1.0 - 2 * ramp)
    travelled = covered(start) + steady + np.where(u > 1 - ramp, covered(np.ones_like(u)) - covered(end), 0.0)
    reach_back = 12.0 * u**6 * (1 - u) ** 3
    return travelled / (1.0 - ramp) + reach_back


def arc(u: Array, top: float) -> Array:
    """Height of a swing, 1 at share `top` of its time; position, velocity and acceleration vanish at both ends."""
    rise = 3.0 * top / (1.0 - top)
    peak = top**rise * (1 - top) ** 3.0
    return np.where((u > 0) & (u < 1), u**rise * (1 - u) ** 3.0 / peak, 0.0)


JUMPS: Final = {"jump": "a jump forwards from standing to standing"}
"""The built-in jumps by name, in words."""

# Of the jump; lengths at the A1's size.
_WAY: Final = 0.4  # m
_RISE: Final = 0.16  # of the trunk in flight, m
_TUCK: Final = 0.16  # of the feet towards it, m
_DEEP: Final = 0.04  # how far the trunk sinks before and after, m
_SINK_S: Final = 0.2
_STAND_S: Final = 0.2  # before and after
_HALF_WIDTH: Final = 0.03  # lateral distance of the feet from the midline, m
_SPEED_IN_FLIGHT: Final = 0.7  # share of the whole way that is covered in flight


def jump(name: str) -> Clip:
    """A built-in jump as an animal's keypoints, world frame, z up."""
    from scipy.interpolate import CubicHermiteSpline

    way, deep, speed = _WAY * ANIMAL, _DEEP * ANIMAL, np.sqrt(2 * GRAVITY * _RISE * ANIMAL)
    flight, push = 2 * speed / GRAVITY, 2 * deep / speed
    # at rest, at rest, lowest, leaving the ground, landing, lowest, at rest, at rest
    knots = np.cumsum([0.0, _STAND_S, _SINK_S, push, flight, push, _SINK_S, _STAND_S])
    time = np.arange(round(knots[-1] * RATE_HZ) + 1) / RATE_HZ
    in_air = (time > knots[3]) & (time < knots[4])
    air = np.clip((time - knots[3]) / flight, 0.0, 1.0)
    sunk, rising = np.array([[0, 0, -1, 0, 0, -1, 0, 0], [0, 0, 0, 1, -1, 0, 0, 0]])
    height = CubicHermiteSpline(knots, deep * sunk, speed * rising)
    up = np.where(in_air, flight * air * (speed - 0.5 * GRAVITY * flight * air), height(time))
    covered, moving = np.array([[0, 0, 0, 0.15, 0.85, 1, 1, 1], [0, 0, 0, 1, 1, 0, 0, 0]])
    ahead = way * CubicHermiteSpline(knots, covered, _SPEED_IN_FLIGHT / flight * moving)(time)
    trunk = np.column_stack([ahead, np.zeros_like(up), ROOT_HEIGHT + up])
    lift = np.where(in_air, up, 0.0) + _TUCK * ANIMAL * arc(air, 0.5)

    def toe(leg: int) -> Array:
        x, y = HIP[leg, 0] + way * forward_in_swing(air), SIDE[leg] * _HALF_WIDTH * ANIMAL
        return np.column_stack([x, np.full_like(lift, y), TOE_MARKER_HEIGHT + lift])

    points = [trunk - SPINE, trunk + SPINE, *(trunk + hip for hip in HIP), *(toe(leg) for leg in range(4))]
    return Clip(points_w=np.stack(points, axis=1), rate_hz=RATE_HZ, is_cycle=False, origin=built_in(name))
