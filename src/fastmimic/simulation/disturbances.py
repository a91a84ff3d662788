"""Disturbances with their strengths: deviations from robot and ground of the optimisation, unknown to the controller.

On the command line: `name=value`, a push also `name=value@time`.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PUSH_DURATION_S, PUSH_TIME_S, DisturbanceKind, EachStep


@dataclass(frozen=True)
class Disturbance:
    """A disturbance with its strength.

    Attributes:
        name: one of `DISTURBANCES`.
        values: one for all robots, or one for each.
        at_s: time of a timed disturbance, s after the start; None for a lasting one.
    """

    name: str
    values: tuple[float, ...]
    at_s: float | None = None

    def __post_init__(self) -> None:
        kind = DISTURBANCES[self.name]
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
        return DISTURBANCES[self.name]

    def __str__(self) -> str:
        shown = self.kind.show(self.values[0]) if len(self.values) == 1 else f"{len(self.values)} values"
        return f"{self.name} {shown}" + (f" at {self.at_s:g} s" if self.at_s is not None else "")


def parse_disturbance(text: str) -> Disturbance:
    """A disturbance from `name=value` or `name=value@time` (s); raises `ConfigError` for any other text."""
    found = re.fullmatch(r"\s*([\w-]+)\s*=\s*([^@]+?)\s*(?:@\s*([^@]+?)\s*)?", text)
    if found is None:
        raise ConfigError(
            f"a disturbance is written name=value, such as payload=2 or push=10@2.5; found '{text}'."
            f" There are {', '.join(DISTURBANCES)}"
        )
    name, value, at = found.groups()
    kind = DISTURBANCES[name]
    try:
        return Disturbance(name, (float(value),), None if at is None else float(at))
    except ValueError:
        raise ConfigError(f"'{text}' is not a number{f' of {kind.unit}' if kind.unit else ''}: {kind.about}") from None


@dataclass(frozen=True, eq=False)
class World:
    """The values of all disturbances for n robots, nominal where nothing is disturbed.

    Attributes:
        given: names of the disturbances present.
        values: by name, (n,) in the disturbance's unit.
        times: by name, s after the start, of those that happen at a time.
    """

    n: int
    given: frozenset[str]
    values: dict[str, Array]
    times: dict[str, float]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    def has(self, *names: str) -> bool:
        """Whether any of these is given."""
        return any(name in self.given for name in names)

    @cached_property
    def at_each_step(self) -> list[tuple[EachStep, Array]]:
        """What acts at each control step, with its values."""
        kinds = [kind for kind in DISTURBANCES.values() if kind.name in self.given]
        return [(kind.each_step, self.values[kind.name]) for kind in kinds if kind.each_step is not None]

    @property
    def gravity(self) -> Array:
        """(n, 3) unit vectors of gravity in the ground's frame, z normal to it."""
        x, y = (np.tan(np.radians(self.values[name])) for name in ("slope", "side-slope"))
        down = -np.column_stack([x, y, np.ones(self.n)])
        return down / np.linalg.norm(down, axis=1, keepdims=True)

    def push(self, elapsed_s: float) -> Array | None:
        """(n, 2) present push on the trunks, forwards and to the left, N; None without any."""
        force, pushed = np.zeros((self.n, 2)), False
        for axis, name in enumerate(("push", "side-push")):
            if name in self.given and 0 <= elapsed_s - self.times[name] + 1e-9 < PUSH_DURATION_S:
                force[:, axis] = self.values[name] / PUSH_DURATION_S
                pushed = True
        return force if pushed else None


def make_world(disturbances: Sequence[Disturbance], n: int, simulator: str) -> World:
    """The world of n robots; raises `ConfigError` for disturbances given twice, not realised in the simulator, or of
    neither 1 nor n values."""
    values = {name: np.full(n, kind.nominal) for name, kind in DISTURBANCES.items()}
    given: set[str] = set()
    for d in disturbances:
        if d.name in given:
            raise ConfigError(f"disturbance '{d.name}' is given twice")
        if not d.kind.realized_in(simulator):
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
    return [name for name, kind in DISTURBANCES.items() if kind.realized_in(simulator)]


def driving_limit(limit: Array, top_speed: Array, joint_vel: Array) -> Array:
    """Motor torque (n, 12) available in the direction of motion, N·m: full to half the top speed, then linear to 0.
    `limit` is (12,) N·m, `top_speed` (n, 1) rad/s, `joint_vel` (n, 12) rad/s."""
    with np.errstate(invalid="ignore"):
        share = 2.0 * (1.0 - np.abs(joint_vel) / top_speed)
    return limit * np.clip(share, 0.0, 1.0)


def names_of(disturbances: Iterable[Disturbance]) -> str:
    """The disturbances in one line; empty without any."""
    return ", ".join(str(d) for d in disturbances)
