"""The conditions of episodes: simulator, ground, what the controller observes, and disturbances with their strengths.

A disturbance is a deviation from robot and ground of the optimisation, unknown to the controller. On the command line:
`name=value`, a push also `name=value@time`. For each of a batch of robots it can be drawn from `name=lower:upper`.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError, did_you_mean, unknown
from fastmimic.base.registry import Registry
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.robot.state import COMMAND, OBSERVATION
from fastmimic.simulation.config import SensorConfig
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PUSH_DURATION_S, PUSH_TIME_S, DisturbanceKind, EachStep
from fastmimic.simulation.simulators import FIRST_SIMULATOR, PHYSICS_RATE_HZ, SIMULATORS, substeps_of
from fastmimic.simulation.terrain import TERRAINS, Terrain, TerrainKind, terrain_kind

OBSERVED: Final = ("truth", "sensors")

GROUND_PURPOSE: Final = 71  # of the random stream
_OTHERS: Final = 4  # the random stream of other robots


@dataclass(frozen=True)
class Disturbance:
    """A disturbance with its strength: `name` is one of `DISTURBANCES`; `values` are one for all robots, or one for
    each; `at_s` is the time of a timed one, s after the start, None for a lasting one."""

    name: str
    values: tuple[float, ...]
    at_s: float | None = None
    among: ClassVar[Registry[Any]] = DISTURBANCES

    def __post_init__(self) -> None:
        kind = self.kind
        if not self.values:
            raise ConfigError(f"disturbance '{self.name}' has no value")
        for value in self.values:
            if math.isnan(value) or not kind.lower <= value <= kind.upper:
                takes = f"{self.among.kind} '{self.name}' takes {kind.limits}"
                raise ConfigError(f"{takes}, found {value:g}: {kind.about}")
        if len(self.values) > 1 and not kind.per_robot:
            raise ConfigError(f"{self.among.kind} '{self.name}' has one value for all robots, found {len(self.values)}")
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

    def check_realized(self, simulator: str) -> None:
        """Raises `ConfigError` if a simulator does not have it."""
        if not self.kind.realized_in(simulator):
            said = f"{self.among.kind} '{self.name}' is not realised in {simulator}"
            raise ConfigError(f"{said}; those that are: {', '.join(known(simulator, self.among))}")

    def __str__(self) -> str:
        shown = self.kind.show(self.values[0]) if len(self.values) == 1 else f"{len(self.values)} values"
        return f"{self.name} {shown}" + (f" at {self.at_s:g} s" if self.at_s is not None else "")


def parse_disturbance(text: str) -> Disturbance:
    """A disturbance from `name=value` or `name=value@time` (s); raises `ConfigError` for any other text."""
    found = re.fullmatch(r"\s*([\w-]+)\s*=\s*([^@]+?)\s*(?:@\s*([^@]+?)\s*)?", text)
    if found is None:
        said = f"a disturbance is written name=value, such as payload=2 or push=10@2.5; found '{text}'"
        raise ConfigError(f"{said}. There are {', '.join(DISTURBANCES)}")
    name, value, at = found.groups()
    kind = DISTURBANCES[name]
    try:
        return Disturbance(name, (float(value),), None if at is None else float(at))
    except ValueError:
        raise ConfigError(f"'{text}' is not a number{f' of {kind.unit}' if kind.unit else ''}: {kind.about}") from None


@dataclass(frozen=True)
class TerrainLevel(Disturbance):
    """A terrain with its level, the one of its `values`; `name` is one of `TERRAINS` or a file (`terrain_kind`)."""

    among: ClassVar[Registry[Any]] = TERRAINS

    @property
    def kind(self) -> TerrainKind:
        return terrain_kind(self.name)


def parse_terrain(text: str) -> TerrainLevel:
    """A terrain from `name=level`, or `file`, `file@cell`, `file@cell=factor`; raises `ConfigError` for other texts."""
    name, _, level = (part.strip() for part in text.partition("="))
    try:
        return TerrainLevel(name, (float(level or terrain_kind(name).given),))
    except ValueError:
        forms = "name=level, such as stairs-up=0.05, or as a file of heights, such as hills.npy or hills.png@0.05=0.3"
        said = f"a terrain is written {forms}; found '{text}'"
        raise ConfigError(f"{said}. There are {', '.join(TERRAINS)}") from None


@dataclass(frozen=True, eq=False)
class World:
    """The `values` of all disturbances for n robots by name, (n,) in the disturbance's unit, nominal where nothing is
    disturbed. `given` are those present; `times`, s after the start, of those that happen at a time."""

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


def make_world(disturbances: Sequence[Disturbance], n: int, simulator: str) -> World:
    """The world of n robots; raises `ConfigError` for disturbances given twice, not realised in the simulator, or of
    neither 1 nor n values."""
    values = {name: np.full(n, kind.nominal) for name, kind in DISTURBANCES.items()}
    given: set[str] = set()
    for d in disturbances:
        if d.name in given:
            raise ConfigError(f"disturbance '{d.name}' is given twice")
        d.check_realized(simulator)
        if len(d.values) not in (1, n):
            raise ConfigError(f"disturbance '{d.name}' has {len(d.values)} values for {n} robots; expected 1 or {n}")
        values[d.name][:] = d.values
        given.add(d.name)
    times = {d.name: d.at_s for d in disturbances if d.at_s is not None}
    return World(n, frozenset(given), values, times)


class Delay:
    """Commands on their way to the motors of robots, each `delay_s` (n,) late. `steps_hz` is how often a motor may take
    a new one: `substeps` times in a control step. `delays` says whether any command is late."""

    def __init__(self, delay_s: Array, steps_hz: float, substeps: int = 1) -> None:
        self.late = np.round(delay_s * steps_hz).astype(np.int64)
        self._substeps, self.delays = substeps, bool(self.late.any())
        self._sent = np.zeros((int(self.late.max()) // substeps + 2, len(self.late)), COMMAND)

    def send(self, commands: Records, step: int) -> None:
        """Takes the commands (n,) of a control step, which are counted from 0 in each episode."""
        self._sent[step % len(self._sent)] = commands

    def arrived(self, step: int, substep: int = 0) -> Records:
        """The commands (n,) that have reached the motors by now; the first ones are there from the start."""
        if not self.delays:
            return self._sent[step % len(self._sent)]
        sent = np.maximum(0, (step * self._substeps + substep - self.late) // self._substeps)
        return np.asarray(self._sent[sent % len(self._sent), np.arange(len(sent))])


class Disturbed:
    """What a simulation's robots share: the `world` of n of them, the delay of their commands, and what pushes their
    trunks, `trunk_force` (n, 3), N, world frame, for a control step."""

    def __init__(self, world: World, control_rate_hz: float) -> None:
        self.world, self.substeps = world, substeps_of(control_rate_hz)
        self.observation = np.zeros(world.n, OBSERVATION)
        self.trunk_force = np.zeros((world.n, 3))
        self._delay = Delay(world["delay"], PHYSICS_RATE_HZ, self.substeps)
        self._restart()

    def _restart(self) -> None:
        """Restarts the clocks of pushes and delay."""
        self._steps = 0
        self._headings: Array | None = None  # of the trunks when the present push began, which keeps them

    def push(self, root_quat: Array) -> None:
        """Sets the force of the control step that begins now with the trunks at `root_quat` (n, 4)."""
        time_s = self._steps * self.substeps / PHYSICS_RATE_HZ
        self.trunk_force[:] = 0.0
        for act, values in self.world.at_each_step:
            act(self, values, time_s)
        begun = [time_s - self.world.times.get(name, math.inf) + 1e-9 for name in ("push", "side-push")]
        acting = [0 <= since_s < PUSH_DURATION_S for since_s in begun]
        if not any(acting):
            self._headings = None
            return
        if self._headings is None:
            self._headings = yaw_from_quat(root_quat)
        impulse = np.column_stack([self.world["push"], self.world["side-push"]]) * acting
        self.trunk_force[:, :2] += rotate_planar(self._headings, impulse / PUSH_DURATION_S)


def known(simulator: str, among: Mapping[str, DisturbanceKind] = DISTURBANCES) -> list[str]:
    """Names of the disturbances, or of the terrains, that a simulator realises."""
    return [name for name, kind in among.items() if kind.realized_in(simulator)]


def check_felt(kind: DisturbanceKind, observe: str) -> None:
    """Raises `ConfigError` if a controller that observes this does not notice the disturbance."""
    if kind.sensed and observe != "sensors":
        raise ConfigError(f"disturbance '{kind.name}' changes what sensors read; add --observe sensors")


def driving_limit(limit: Array, top_speed: Array, joint_vel: Array) -> Array:
    """Motor torque (12,) available in the direction of motion, N·m: full to half the top speed, then linear to 0.
    `limit` is (12,) N·m, `top_speed` and `joint_vel` (12,) rad/s."""
    return limit * np.clip(2.0 - 2.0 * np.abs(joint_vel) / top_speed, 0.0, 1.0)


@dataclass(frozen=True)
class Range:
    """A disturbance drawn uniformly from a range, once for each robot; bounds are in the disturbance's unit."""

    name: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        kind = DISTURBANCES[self.name]
        if kind.usual is None:
            raise ConfigError(f"'{self.name}' cannot differ between robots; what can: {', '.join(usual_ranges())}")
        finite = math.isfinite(self.lower) and math.isfinite(self.upper)
        if not (finite and kind.lower <= self.lower <= self.upper <= kind.upper):
            found = f"{self.lower:g} to {self.upper:g}"
            raise ConfigError(f"'{self.name}' takes a range within {kind.limits}, found {found}: {kind.about}")

    def __str__(self) -> str:
        unit = DISTURBANCES[self.name].unit
        return f"{self.name} {self.lower:g} … {self.upper:g} {unit}".strip()


def usual_ranges() -> dict[str, tuple[float, float]]:
    """Usual lower and upper value by name, of all disturbances in which the robots of a batch can differ."""
    return {name: kind.usual for name, kind in DISTURBANCES.items() if kind.usual is not None}


def usual_range(name: str) -> Range:
    """A disturbance over its usual range; raises `ConfigError` if it is unknown or robots cannot differ in it."""
    return Range(name, *(DISTURBANCES[name].usual or (0.0, 0.0)))


def parse_range(text: str) -> Range:
    """A range from `name=lower:upper`, or the usual one from its name; raises `ConfigError` for anything else."""
    found = re.fullmatch(r"\s*([\w-]+)\s*(?:=\s*([^:]+):([^:]+))?", text)
    try:
        if found is None:
            raise ValueError
        name, lower, upper = found.groups()
        return usual_range(name) if lower is None else Range(name, float(lower), float(upper))
    except ValueError:
        name = re.match(r"\s*([\w-]*)", text)[1]  # type: ignore[index]  # it matches anything
        said = "a range is written name=lower:upper, such as friction=0.4:1.2, or name for the usual one"
        there = f"{', '.join(usual_ranges())}{did_you_mean(name, usual_ranges())}"
        raise ConfigError(f"{said}; found '{text}'. There are {there}") from None


def draw_uniform(ranges: Sequence[Range], n: int, rng: np.random.Generator) -> tuple[Disturbance, ...]:
    """Draws n robots independently of each other, for a training. Raises `ConfigError` if a disturbance has two ranges,
    happens at a time, or is a delay (commands under way are not in the state from which a training resumes)."""
    names = [r.name for r in ranges]
    possible = [name for name in usual_ranges() if not DISTURBANCES[name].timed and name != "delay"]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"the range of '{name}' is given twice")
        if name not in possible:
            raise ConfigError(f"'{name}' cannot differ between robots; what can: {', '.join(possible)}")
    return tuple(Disturbance(r.name, tuple(rng.uniform(r.lower, r.upper, n).tolist())) for r in ranges)


def other_ranges() -> tuple[Range, ...]:
    """The usual ranges of what never matches a robot's model: ground, load and motors."""
    return tuple(usual_range(name) for name, kind in DISTURBANCES.items() if kind.differs)


def other_robots(n: int) -> tuple[Disturbance, ...]:
    """n robots that differ from their model over `other_ranges`, the same ones each time: a Latin hypercube, one from
    each of n equal parts of each range, so that few robots spread. A disturbance of n values for each range."""
    rng, found = np.random.default_rng([0, _OTHERS]), []
    for r in other_ranges():
        share = (rng.permutation(n) + rng.uniform(size=n)) / n
        values = np.minimum(r.lower + (r.upper - r.lower) * share, r.upper)
        found.append(Disturbance(r.name, tuple(values.tolist())))
    return tuple(found)


@dataclass(frozen=True)
class Conditions:
    """The conditions of episodes. The defaults are those of the optimisation.

    Attributes:
        simulator: one of `SIMULATORS`.
        observe: "truth" for the simulator's state, "sensors" for an estimate from noisy, biased and late sensors.
        seed: of sensors and disturbances. Each episode has its own random stream, independent of the others in a batch.
        disturbances: deviations from robot and ground of the optimisation, as objects or texts such as "payload=2".
        terrain: the ground in place of the flat one, as an object or a text such as "stairs-up=0.05".
        ideal: motors give their torque at any speed, and legs pass through each other.
        sensors, estimator: used where `observe` is "sensors".
    """

    simulator: str = FIRST_SIMULATOR
    observe: str = "truth"
    seed: int = 0
    disturbances: tuple[Disturbance, ...] = ()
    terrain: TerrainLevel | None = None
    ideal: bool = False
    sensors: SensorConfig = field(default_factory=SensorConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)

    def __post_init__(self) -> None:
        _ = SIMULATORS[self.simulator]
        if self.observe not in OBSERVED:
            raise unknown("observation", self.observe, OBSERVED)
        if self.seed < 0:
            raise ConfigError(f"seed must not be negative, found {self.seed}")
        given: tuple[Any, ...] = self.disturbances
        read = tuple(parse_disturbance(d) if isinstance(d, str) else d for d in given)
        object.__setattr__(self, "disturbances", read)
        terrain: Any = parse_terrain(self.terrain) if isinstance(self.terrain, str) else self.terrain
        object.__setattr__(self, "terrain", terrain)
        if terrain is not None:
            terrain.check_realized(self.simulator)
        for d in read:
            check_felt(d.kind, self.observe)

    @cached_property
    def ground(self) -> Terrain | None:
        """The ground, None if it is flat; raises `ConfigError` for a file that holds no heights."""
        if self.terrain is None:
            return None
        return self.terrain.kind.make(self.terrain.values[0], episode_generator(self.seed, 0, GROUND_PURPOSE))


def episode_generator(seed: int, episode: int, purpose: int) -> np.random.Generator:
    """The random stream of one episode for one purpose (each user of randomness has its own number)."""
    return np.random.default_rng(np.random.SeedSequence([seed, episode, purpose]))
