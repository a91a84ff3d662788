"""What can be different from the robot and the ground of the optimisation: each by name, with a unit and a range.

A disturbance is a property of the world, not something that the controller is told. On the command line it is written
`name=value`, a push also `name=value@time`.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, did_you_mean

PUSH_TIME_S: Final = 2.0
"""After the start of an episode, if nothing is said: a push hits a robot that has settled into its gait."""
PUSH_DURATION_S: Final = 0.1
PAYLOAD_HEIGHT_M: Final = 0.1
"""Of the payload's centre above the base's origin."""
PAYLOAD_SIDE_M: Final = 0.1
"""Of the cube that the payload is."""


@dataclass(frozen=True)
class DisturbanceKind:
    """What one disturbance is.

    Attributes:
        name: as on the command line.
        unit: of its value; empty for a number without.
        nominal: the value at which nothing is disturbed.
        lower, upper: the values that make sense.
        about: one line.
        levels: what `fastmimic stress` runs, the nominal value among them.
        per_robot: whether each robot of a batch may have a value of its own.
        simulators: in which it is realised.
        timed: whether it happens at a time.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    about: str
    levels: tuple[float, ...]
    per_robot: bool = True
    simulators: tuple[str, ...] = ("mujoco", "pybullet")
    timed: bool = False

    def show(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:g} {self.unit}".strip()


def _both(*levels: float) -> tuple[float, ...]:
    return (*(-level for level in reversed(levels)), 0.0, *levels)


_KINDS: Final = (
    DisturbanceKind(
        "friction",
        "",
        0.8,
        0.05,
        2.0,
        "coefficient of friction between the robot and the ground",
        (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.2),
    ),
    DisturbanceKind(
        "restitution",
        "",
        0.0,
        0.0,
        0.9,
        "share of the approach speed with which a contact rebounds",
        (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7),
        simulators=("mujoco",),
    ),
    DisturbanceKind(
        "softness",
        "s",
        0.02,
        0.02,
        0.2,
        "time constant of the contact, MuJoCo's solref; the longer, the deeper a foot sinks in",
        (0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1),
        simulators=("mujoco",),
    ),
    DisturbanceKind(
        "slope",
        "deg",
        0.0,
        -30.0,
        30.0,
        "of the ground along the world's x axis, positive uphill; frames turn with the ground, so gravity leans",
        _both(2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0),
    ),
    DisturbanceKind(
        "side-slope",
        "deg",
        0.0,
        -30.0,
        30.0,
        "of the ground along the world's y axis, positive if it rises to the left",
        _both(2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0),
    ),
    DisturbanceKind(
        "roughness",
        "m",
        0.0,
        0.0,
        0.1,
        "greatest height and depth of uneven ground: a random height field of 0.15 m cells, flat where episodes begin",
        (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04),
        per_robot=False,
    ),
    DisturbanceKind(
        "payload",
        "kg",
        0.0,
        0.0,
        20.0,
        "on the trunk: a cube of 0.1 m whose centre is 0.1 m above the base's origin",
        (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0),
    ),
    DisturbanceKind(
        "com-x",
        "m",
        0.0,
        -0.15,
        0.15,
        "shift of the trunk's centre of mass forwards",
        _both(0.02, 0.04, 0.06, 0.08, 0.1),
    ),
    DisturbanceKind(
        "com-y",
        "m",
        0.0,
        -0.15,
        0.15,
        "shift of the trunk's centre of mass to the left",
        _both(0.01, 0.02, 0.03, 0.04, 0.05, 0.06),
    ),
    DisturbanceKind(
        "motor-strength",
        "",
        1.0,
        0.1,
        2.0,
        "share of the torque asked for, and of the torque limit, that the motors give",
        (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3),
    ),
    DisturbanceKind(
        "top-speed",
        "rad/s",
        math.inf,
        5.0,
        math.inf,
        "of the motors without load: the driving torque that is there falls in a line from the limit at half this"
        " speed to nothing at it",
        (15.0, 18.0, 20.0, 22.0, 25.0, 30.0, 40.0, 60.0, math.inf),
    ),
    DisturbanceKind(
        "delay",
        "s",
        0.0,
        0.0,
        0.05,
        "between the controller's command and the motors, whose own law goes on at physics rate meanwhile",
        (0.0, 0.002, 0.004, 0.006, 0.008, 0.01, 0.012, 0.016, 0.02),
    ),
    DisturbanceKind(
        "joint-friction",
        "N·m",
        0.0,
        0.0,
        10.0,
        "dry friction of every joint",
        (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0),
    ),
    DisturbanceKind(
        "joint-damping",
        "N·m·s/rad",
        0.0,
        0.0,
        5.0,
        "viscous friction of every joint",
        (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8),
    ),
    DisturbanceKind(
        "push",
        "N·s",
        0.0,
        -100.0,
        100.0,
        f"impulse on the trunk within {PUSH_DURATION_S:g} s along its heading, {PUSH_TIME_S:g} s after the start unless"
        " said otherwise (@time)",
        _both(2.0, 4.0, 6.0, 8.0, 10.0, 14.0, 18.0, 24.0),
        timed=True,
    ),
    DisturbanceKind(
        "side-push",
        "N·s",
        0.0,
        -100.0,
        100.0,
        "the same to the left of its heading",
        _both(2.0, 4.0, 6.0, 8.0, 10.0, 14.0, 18.0),
        timed=True,
    ),
)

DISTURBANCES: Final = {kind.name: kind for kind in _KINDS}
"""All disturbances by name."""


@dataclass(frozen=True)
class Disturbance:
    """A disturbance with its strength.

    Attributes:
        name: one of `DISTURBANCES`.
        values: one for all robots, or one for each.
        at_s: when it happens, s after the start; None for those that are there all the time.
    """

    name: str
    values: tuple[float, ...]
    at_s: float | None = None

    def __post_init__(self) -> None:
        kind = disturbance_named(self.name)
        if not self.values:
            raise ConfigError(f"disturbance '{self.name}' has no value")
        for value in self.values:
            if math.isnan(value) or not kind.lower <= value <= kind.upper:
                raise ConfigError(
                    f"disturbance '{self.name}' takes {kind.show(kind.lower)} to {kind.show(kind.upper)},"
                    f" found {value:g}: {kind.about}"
                )
        if len(self.values) > 1 and not kind.per_robot:
            raise ConfigError(f"disturbance '{self.name}' has one value for all robots, found {len(self.values)}")
        if kind.timed:
            if self.at_s is None:
                object.__setattr__(self, "at_s", PUSH_TIME_S)
            elif not (math.isfinite(self.at_s) and self.at_s >= 0):
                raise ConfigError(f"disturbance '{self.name}': the time must not be negative, found {self.at_s:g} s")
        elif self.at_s is not None:
            raise ConfigError(f"disturbance '{self.name}' is there all the time; only pushes take @time")

    @property
    def kind(self) -> DisturbanceKind:
        """What it is."""
        return DISTURBANCES[self.name]

    def __str__(self) -> str:
        shown = self.kind.show(self.values[0]) if len(self.values) == 1 else f"{len(self.values)} values"
        return f"{self.name} {shown}" + (f" at {self.at_s:g} s" if self.at_s is not None else "")


def disturbance_named(name: str) -> DisturbanceKind:
    """The disturbance of that name.

    Raises:
        ConfigError: there is none; the message lists them.
    """
    if name not in DISTURBANCES:
        raise ConfigError(
            f"unknown disturbance '{name}'; there are {', '.join(DISTURBANCES)}{did_you_mean(name, DISTURBANCES)}"
        )
    return DISTURBANCES[name]


def parse_disturbance(text: str) -> Disturbance:
    """A disturbance from `name=value` or `name=value@time`, the time in s.

    Raises:
        ConfigError: it does not read so, or there is no such disturbance or value.
    """
    found = re.fullmatch(r"\s*([\w-]+)\s*=\s*([^@]+?)\s*(?:@\s*([^@]+?)\s*)?", text)
    if found is None:
        raise ConfigError(
            f"a disturbance is written name=value, such as payload=2 or push=10@2.5; found '{text}'."
            f" There are {', '.join(DISTURBANCES)}"
        )
    name, value, at = found.groups()
    kind = disturbance_named(name)
    try:
        return Disturbance(name, (float(value),), None if at is None else float(at))
    except ValueError:
        raise ConfigError(f"'{text}' is not a number{f' of {kind.unit}' if kind.unit else ''}: {kind.about}") from None


@dataclass(frozen=True, eq=False)
class World:
    """The values of all disturbances for n robots: (n,) arrays, the nominal value where nothing is disturbed.

    Attributes:
        n: number of robots.
        given: the names of the disturbances that there are.
        values: by name, (n,) in the disturbance's unit.
        times: by name, when those that happen at a time do, s after the start.
    """

    n: int
    given: frozenset[str]
    values: dict[str, Array]
    times: dict[str, float]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    def has(self, *names: str) -> bool:
        """Whether any of these is there."""
        return any(name in self.given for name in names)

    @property
    def gravity(self) -> Array:
        """(n, 3) unit vectors of gravity in the frame of the ground, z normal to it."""
        x, y = (np.tan(np.radians(self.values[name])) for name in ("slope", "side-slope"))
        down = -np.column_stack([x, y, np.ones(self.n)])
        return down / np.linalg.norm(down, axis=1, keepdims=True)

    def push(self, elapsed_s: float) -> Array | None:
        """(n, 2) the present force of the pushes on the trunk, forwards and to the left, N; None without any."""
        force, pushed = np.zeros((self.n, 2)), False
        for axis, name in enumerate(("push", "side-push")):
            if name in self.given and 0 <= elapsed_s - self.times[name] + 1e-9 < PUSH_DURATION_S:
                force[:, axis] = self.values[name] / PUSH_DURATION_S
                pushed = True
        return force if pushed else None


def make_world(disturbances: Sequence[Disturbance], n: int, simulator: str) -> World:
    """What the disturbances amount to for n robots.

    Raises:
        ConfigError: one is given twice, is not realised in the simulator, or has neither one value nor n.
    """
    values = {name: np.full(n, kind.nominal) for name, kind in DISTURBANCES.items()}
    given: set[str] = set()
    for d in disturbances:
        if d.name in given:
            raise ConfigError(f"disturbance '{d.name}' is given twice")
        if simulator not in d.kind.simulators:
            raise ConfigError(
                f"disturbance '{d.name}' is not realised in {simulator}; those that are: {', '.join(known(simulator))}"
            )
        if len(d.values) not in (1, n):
            raise ConfigError(f"disturbance '{d.name}' has {len(d.values)} values for {n} robots; expected 1 or {n}")
        values[d.name][:] = d.values
        given.add(d.name)
    times = {d.name: d.at_s for d in disturbances if d.at_s is not None}
    return World(n, frozenset(given), values, times)


def known(simulator: str) -> list[str]:
    """Names of the disturbances that a simulator realises."""
    return [name for name, kind in DISTURBANCES.items() if simulator in kind.simulators]


def driving_limit(limit: Array, top_speed: Array, joint_vel: Array) -> Array:
    """Torque that motors have in the direction of their motion: all of it up to half their top speed, then less in a
    line until there is none.

    Args:
        limit: (12,) N·m.
        top_speed: (n, 1) rad/s.
        joint_vel: (n, 12) rad/s.

    Returns:
        (n, 12) N·m.
    """
    with np.errstate(invalid="ignore"):
        share = 2.0 * (1.0 - np.abs(joint_vel) / top_speed)
    return limit * np.clip(share, 0.0, 1.0)


def names_of(disturbances: Iterable[Disturbance]) -> str:
    """The disturbances in one line; empty without any."""
    return ", ".join(str(d) for d in disturbances)
