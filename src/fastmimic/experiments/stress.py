"""Robustness of a motion: success and reward over the range of each disturbance, and of each terrain.

A sweep runs one method under one of them, over all its levels. Every level has the same episodes, one from the
motion's start and the others from random phases, not perturbed otherwise. An episode without a fall is a success.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import stretches
from fastmimic.base.configuration import check, parameter
from fastmimic.base.errors import ConfigError, unknown
from fastmimic.base.text import markdown_table
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.plan import episode_duration, nominal_start, start_room
from fastmimic.experiments.comparison_run import Row, check_unique
from fastmimic.experiments.experiment import Subject
from fastmimic.experiments.measurement import CAPTIONS
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions, Disturbance, TerrainLevel, check_felt, known
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PUSH_TIME_S, DisturbanceKind
from fastmimic.simulation.simulators import FIRST_SIMULATOR
from fastmimic.simulation.terrain import TERRAINS

SUCCESS: Final = 0.95  # least share of episodes without a fall for a tolerated level
AT_ONCE: Final = 120  # greatest number of robots in a batch
SWEEPS: Final = "sweeps"

COLUMNS: Final = (
    *("motion", "method", "disturbance", "unit", "value", "episodes", "fell", "reward_mean", "reward_std"),
    *("simulator", "observe", "duration_s", "seed"),
)
_FIGURES: Final = ("episodes", "fell", "reward_mean", "reward_std", "duration_s")  # of `Metrics`


@dataclass(frozen=True)
class StressSettings:
    """Settings of all sweeps."""

    robot: str = "a1"  # its name, or the path of its MJCF
    simulator: str = FIRST_SIMULATOR  # as in `Conditions`
    observe: str = "truth"
    ideal: bool = False
    episodes: int = parameter(20, low=1)
    duration_s: float = 6.0  # of an episode, s; at most a motion that does not repeat
    seed: int = 0  # of the starting phases, sensors and uneven ground
    config: str = "default"
    iterations: int | None = None
    population: int = 10

    def __post_init__(self) -> None:
        check(self, "")
        self.conditions()

    def conditions(self, *disturbances: Disturbance) -> Conditions:
        ground = next((d for d in disturbances if isinstance(d, TerrainLevel)), None)
        others = tuple(d for d in disturbances if d is not ground)
        return Conditions(self.simulator, self.observe, self.seed, others, ground, self.ideal)


@dataclass(frozen=True)
class Tolerance:
    """Range of a disturbance that a method tolerates: levels around the nominal one up to the first failure."""

    method: str
    disturbance: str
    lower: float | None  # both are None if the nominal level itself fails
    upper: float | None
    lower_tried: float  # the outermost levels of the sweep
    upper_tried: float
    nominal_success: float  # share of episodes without a fall under no disturbance


def disturbances_of(names: Sequence[str] | None, simulator: str, observe: str = "truth") -> list[str]:
    """The given disturbances and terrains, or all with levels that matter in the simulator with this observation;
    raises `ConfigError` for an unknown or repeated one, or one without levels."""
    if names is None:
        felt = [name for name in known(simulator) if observe == "sensors" or not DISTURBANCES[name].sensed]
        return [name for name in (*felt, *known(simulator, TERRAINS)) if swept(name).levels]
    for name in names:
        if not swept(name).levels:
            raise ConfigError(f"disturbance '{name}' has no levels to sweep; register it with levels, or with bounds")
        at_level(name, swept(name).nominal).check_realized(simulator)
        check_felt(swept(name), observe)
    check_unique("disturbance", names)
    return list(names)


def swept(name: str) -> DisturbanceKind:
    """A disturbance or a terrain; raises `ConfigError` if there is none of this name."""
    if name not in DISTURBANCES and name not in TERRAINS:
        raise unknown("disturbance", name, [*DISTURBANCES, *TERRAINS])
    return TERRAINS[name] if name in TERRAINS else DISTURBANCES[name]


def at_level(name: str, *values: float) -> Disturbance:
    """A disturbance with these values, or a terrain with this level."""
    return TerrainLevel(name, values) if name in TERRAINS else Disturbance(name, values)


def check_length(motion: Motion, names: Sequence[str], settings: StressSettings) -> float:
    """Length of the motion's episodes, s; raises `ConfigError` if they end before a disturbance begins."""
    seconds = episode_duration(motion, settings.duration_s)
    late = [name for name in names if swept(name).timed]
    if late and seconds <= PUSH_TIME_S:
        said = f"an episode of {seconds:g} s ends before the push at {PUSH_TIME_S:g} s"
        raise ConfigError(f"{said}; leave out '{late[0]}', or give a longer --duration")
    return seconds


def sweep(subject: Subject, disturbance: str, robot: Robot, settings: StressSettings) -> list[Row]:
    """Runs all levels of a disturbance or a terrain; a row of `COLUMNS` for each. Raises `FastMimicError`."""
    kind, motion = swept(disturbance), subject.motion
    seconds = check_length(motion, [disturbance], settings)
    start = nominal_start(settings.episodes)
    random = np.random.default_rng(settings.seed)
    start.sample[1:] = random.integers(start_room(motion, seconds), size=settings.episodes - 1)
    rows = []
    at_once = max(1, AT_ONCE // settings.episodes) if kind.per_robot else 1
    for first in range(0, len(kind.levels), at_once):
        levels = kind.levels[first : first + at_once]
        values = tuple(float(v) for v in np.repeat(levels, settings.episodes)) if kind.per_robot else levels
        conditions = settings.conditions(at_level(disturbance, *values))
        repeated = start.part(np.tile(np.arange(settings.episodes), len(levels)))
        rollout = subject.run(robot, seconds, repeated, conditions)
        for i, level in enumerate(levels):
            own = slice(i * settings.episodes, (i + 1) * settings.episodes)
            rows.append(
                {
                    "motion": motion.name,
                    "method": subject.method.name,
                    "disturbance": disturbance,
                    "unit": kind.unit,
                    "value": level if math.isfinite(level) else str(level),
                    **Metrics.of(rollout.episodes(own)).named(_FIGURES),
                    "simulator": settings.simulator,
                    "observe": settings.observe,
                    "seed": settings.seed,
                }
            )
    return rows


def tolerances(rows: Iterable[Row]) -> list[Tolerance]:
    """Tolerances of each method and disturbance, in the order of the rows."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["method"], row["disturbance"]), []).append(row)
    return [_tolerance(*key, sorted(own, key=lambda row: float(row["value"]))) for key, own in groups.items()]


def _tolerance(method: str, disturbance: str, rows: list[Row]) -> Tolerance:
    values = [float(row["value"]) for row in rows]
    holds = [1.0 - row["fell"] >= SUCCESS - 1e-9 for row in rows]
    nominal = values.index(swept(disturbance).nominal)
    around = [(values[a], values[b - 1]) for a, b in stretches(np.array(holds)) if a <= nominal < b]
    lower, upper = around[0] if around else (None, None)
    return Tolerance(method, disturbance, lower, upper, values[0], values[-1], 1.0 - rows[nominal]["fell"])


def stress_table(rows: Sequence[Row], settings: StressSettings, missing: int) -> str:
    """Tolerances as Markdown: one line per disturbance, one column per method."""
    found = tolerances(rows)
    methods = list(dict.fromkeys(t.method for t in found))
    by = {(t.method, t.disturbance): t for t in found}
    body = []
    for name in dict.fromkeys(t.disturbance for t in found):
        kind = swept(name)
        cells = [by.get((method, name)) for method in methods]
        tried = next(t for t in cells if t is not None)
        unit = f", {kind.unit}" if kind.unit else ""
        range_tried = f"{_number(tried.lower_tried)} … {_number(tried.upper_tried)}"
        body.append([f"{name}{unit}", range_tried, *(_withstood(t) for t in cells)])
    said = []
    for m in methods:
        own = [row for row in rows if row["method"] == m]
        nominal = [row["reward_mean"] for row in own if row["value"] == swept(row["disturbance"]).nominal]
        success = max(t.nominal_success for t in found if t.method == m)
        said.append(f"{METHODS[m].label} {float(np.mean(nominal)):.3f}, {success:.0%} without a fall")
    told = asdict(settings) | {name: rows[0][name] for name in ("motion", "duration_s")}
    unfinished = f" **Unfinished: {missing} sweeps are missing.**" if missing else ""
    caption = CAPTIONS["stress"].format(success=SUCCESS, **told) + unfinished
    table = markdown_table(["disturbance", "tried", *(METHODS[m].label for m in methods)], body)
    undisturbed = f"Undisturbed, mean reward and success over the same starts: {'; '.join(said)}."
    return "\n".join([caption, "", *table, "", undisturbed, ""])


def _withstood(t: Tolerance | None) -> str:
    if t is None:
        return "–"
    if t.lower is None or t.upper is None:
        return "none"
    everything = t.lower == t.lower_tried and t.upper == t.upper_tried
    return f"{_number(t.lower)} … {_number(t.upper)}" + (" (all)" if everything else "")


def _number(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:g}".replace("-", "−")
