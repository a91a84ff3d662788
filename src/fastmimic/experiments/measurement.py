"""The common evaluation of all methods and motions; its rows, their means and deviations, and these as Markdown."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.files import packaged
from fastmimic.base.text import NONE, markdown_table, number, plain
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.metrics import TRACKED, Metrics, style_distance, swing_clearance
from fastmimic.episode.plan import JOINT_NOISE, VELOCITY_NOISE, episode_duration
from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.episode.rollout import Rollout
from fastmimic.experiments.ablations import ABLATED, ablation_named
from fastmimic.imitation.evaluate import EVALUATION_S, PERTURBED_EPISODES, unseen_start
from fastmimic.imitation.imitate import Imitation, imitate
from fastmimic.imitation.methods import METHODS, RL
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

Row = dict[str, Any]

_BEFORE: Final = ("reward_animal", "reward_mean", "fell", "foot_z_rmse_m", "foot_x_rmse_m")
_STEPS: Final = ("drift_m_per_s", "mean_clearance_m", "early_contacts_per_s", "stance_slip_m")
_NOMINAL: Final = (*_BEFORE, *_STEPS, *TRACKED)
_PERTURBED: Final = ("reward_animal", "reward_mean", "reward_std", "fell", "success", "mpjpe_mm")
_OF_SEARCH: Final = ("config", "duration_s", "iterations", "population", "seed", "choice")
_SHOWN_CYCLES: Final = 2
_SHOWN_TRANSITION_S: Final = 2.0  # of a stitched motion

CAPTIONS: Final = packaged("fastmimic.experiments", "captions.json", dict[str, str])
"""What stands below and above the tables."""

COLUMNS: Final = (
    *("motion", "method", "variant", "seed", "reward_mean", "reward_mean_perturbed", "reward_std_perturbed"),
    *("reward_animal", "reward_animal_perturbed", "reward_animal_before"),
    *("reward_mean_before", "fell", "fell_perturbed", "fell_before", "drift_m_per_s", "mean_clearance_m"),
    *("swing_clearance_least_share", "early_contacts_per_s", "stance_slip_m"),
    *(*TRACKED, "success_perturbed", "mpjpe_mm_perturbed"),
    *("style_distance", "style_distance_realised"),
    *("foot_z_rmse_m_before", "foot_z_rmse_m", "foot_x_rmse_m_before", "foot_x_rmse_m"),
    *(f"components_{name}" for name in REWARD_TERMS),
    *("wall_s", "cpu_s", "evaluations", "iterations", "simulated_s", "robot", "config", "duration_s", "population"),
    *("evaluation_s", "perturbed_episodes", "parameters", "digest"),
    *(f"{name}_version" for name in ("fastmimic", "python", "mujoco", "daqp", "cma", "numba", "numpy")),
)
"""Columns of `results.csv`; figures of episodes have the names of `Metrics`, of the nominal episode unless a name says
more. `*_perturbed`: over the perturbed episodes; `*_before`: nominal episode of the unoptimised motion with the same
controller; `cpu_s`: processor time of an uninterrupted run; SI units."""

_CLEARANCE: Final = "swing_clearance_least_share"


@dataclass(frozen=True, eq=False)
class Measured:
    """Metrics of a motion."""

    figures: Row  # by column name, JSON-serialisable
    before: Rollout  # nominal episode of the demonstration, logged
    after: Rollout  # that of the motion
    seconds: float  # length of each episode, s
    simulated_s: float  # total simulated time, s


def searched(demonstration: Motion, robot: Robot, settings: Any, checkpoint: Path, **others: Any) -> Imitation:
    """The result of `imitate` with what settings say of the search, continued from its checkpoint if there is one;
    `others` are further arguments. Raises `KeyboardInterrupt` if the search was interrupted."""
    known = {name: getattr(settings, name) for name in _OF_SEARCH if hasattr(settings, name)}
    result = imitate(demonstration, robot, checkpoint=checkpoint, resume=checkpoint.is_file(), **known | others)
    if result.interrupted:
        raise KeyboardInterrupt
    return result


def measure(
    result: Imitation,
    evaluation_s: float = EVALUATION_S,
    perturbed_episodes: int = PERTURBED_EPISODES,
    controller: MakeController | None = None,
) -> Measured:
    """Evaluates the result of a method in one nominal episode and in episodes from perturbed starts, of `evaluation_s`,
    s, each, or the length of a motion that does not repeat. The perturbed starts are the same for every motion; no
    optimisation has seen them. `controller` is that of a learned method."""
    robot, demonstration = result.robot, result.demonstration
    method = METHODS[result.method]
    controller = controller or method.controller
    seconds = episode_duration(demonstration, evaluation_s)

    def episodes(motion: Motion, **others: Any) -> Rollout:
        return run_episodes(robot, motion, duration_s=seconds, config=result.config, controller=controller, **others)

    after = episodes(result.motion, log=True)
    before = episodes(demonstration, log=True) if method.optimises else after
    start = unseen_start(demonstration, seconds, perturbed_episodes).part(slice(1, None))
    nominal, unoptimised = Metrics.of(after), Metrics.of(before)
    perturbed = Metrics.of(episodes(result.motion, start=start))
    share = after.clearance[0] / swing_clearance(demonstration, robot.foot_radius)
    style = None if method.own_feet else style_distance(result.motion.foot_pos_b, demonstration.foot_pos_b)
    figures = {
        **nominal.named(_NOMINAL),
        **unoptimised.named(_BEFORE, "before"),
        **perturbed.named(_PERTURBED, "perturbed"),
        "swing_clearance_least_share": np.nanmin(share) if np.isfinite(share).any() else None,
        "style_distance": style,
        "style_distance_realised": _realised_style(after, demonstration, robot),
        **{f"components_{name}": value for name, value in nominal.components.items()},
    }
    simulated_s = seconds * (1 + method.optimises + perturbed_episodes)
    return Measured(plain(figures), before, after, seconds, simulated_s)


def named_values(result: Imitation) -> str:
    """The optimised parameters by name, with all digits."""
    return " ".join(f"{p.name}={v!r}" for p, v in zip(result.parameters, result.values.tolist(), strict=True))


def foot_courses(rollout: Rollout, robot: Robot) -> tuple[Array, Array]:
    """Feet in the first episode, (t, 4, 3) body frame, m: the reference's, and the realised ones, NaN after a fall."""
    feet = foot_positions(robot, rollout.course.observation["joint_pos"][0])
    feet[rollout.steps[0] :] = np.nan
    return rollout.course.demonstration["foot_pos"][0], feet


def shown_window(target: Motion, rollouts: Sequence[Rollout]) -> tuple[float, float]:
    """The times shown at first, s: the last cycles that a rollout completed, or a stitched motion's transition."""
    rate_hz, starts = rollouts[0].course.rate_hz, target.segment_starts
    if len(starts) > 1:
        start = max(0.0, starts[1] / rate_hz - _SHOWN_TRANSITION_S / 2)
        return start, min(rollouts[0].course.wanted.shape[1] / rate_hz, start + _SHOWN_TRANSITION_S)
    alive = max(int(rollout.steps[0]) for rollout in rollouts) / rate_hz
    start = max(0.0, alive - _SHOWN_CYCLES * target.period_s)
    return start, max(alive, start + 0.1)


def _realised_style(rollout: Rollout, demonstration: Motion, robot: Robot) -> float | None:
    """Style distance of the realised feet until a fall; None for less than a cycle, or a whole motion without one."""
    if rollout.steps[0] < demonstration.n_samples - (demonstration.cycle is None):
        return None
    wanted, feet = foot_courses(rollout, robot)
    return style_distance(feet, wanted, demonstration.foot_pos_b)


@dataclass(frozen=True)
class Summary:
    """The runs of one method, or variant, on one motion; `rows` by seed."""

    motion: str
    method: str
    variant: str
    rows: tuple[Row, ...]

    def values(self, column: str) -> list[float]:
        """The seeds' existing values."""
        return [float(row[column]) for row in self.rows if row.get(column) is not None]

    def mean(self, column: str) -> float | None:
        """Mean over the seeds; None if there is no value."""
        values = self.values(column)
        return float(np.mean(values)) if values else None

    def std(self, column: str) -> float | None:
        """Sample deviation over the seeds; None with fewer than two."""
        values = self.values(column)
        return float(np.std(values, ddof=1)) if len(values) > 1 else None

    @property
    def label(self) -> str:
        return self.variant or METHODS[self.method].label


def summaries(rows: Iterable[Row]) -> list[Summary]:
    """Rows grouped by motion, method and variant, the methods in the order of the paper's figure."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["motion"], row["method"], row["variant"]), []).append(row)
    motions = list(dict.fromkeys(motion for motion, _, _ in groups))
    variants = list(dict.fromkeys(variant for _, _, variant in groups))
    order = sorted(groups, key=lambda k: (motions.index(k[0]), variants.index(k[2]), list(METHODS).index(k[1])))
    return [Summary(*key, tuple(groups[key])) for key in order]


def comparison_table(rows: Sequence[Row], expected: int) -> str:
    """The methods on every motion, with their cost, as Markdown; `expected` counts all runs without a variant."""
    header = (
        *("motion", "method", "reward", "perturbed starts", "fell, nominal", "fell, perturbed"),
        *("success, perturbed", "mpjpe, mm"),
        *("least clearance", "style distance", "realised", "drift, m/s", "early contacts, 1/s", "slip, mm"),
        *("wall time, s", "processor time, s", "episodes"),
    )
    body = [_line(summary) for summary in summaries(rows)]
    return _page(rows, expected, markdown_table(header, body), CAPTIONS["paper"])


def ablation_table(rows: Sequence[Row], expected: int) -> str:
    """The variants next to the method itself, as Markdown; `expected` is the total number of their runs."""
    header = (
        *("motion", "variant", "reward", "change", "perturbed starts", "fell, nominal", "fell, perturbed"),
        *("reward before", "least clearance", "style distance", "realised"),
    )
    found = summaries(rows)
    whole = {s.motion: s.mean("reward_mean") for s in found if not s.variant}
    body = []
    for s in found:
        reward, base = s.mean("reward_mean"), whole.get(s.motion)
        change = NONE if not s.variant or reward is None or base is None else f"{reward - base:+.3f}"
        body.append(
            [
                *(f"`{s.motion}`", s.variant or f"{ABLATED}, as it is", spread(s, "reward_mean"), change),
                *(_spread_of_episodes(s), _count(s, "fell"), _percent(s.mean("fell_perturbed"))),
                *(number(s.mean("reward_mean_before")), _percent(s.mean(_CLEARANCE))),
                *(number(s.mean(name), 2) for name in ("style_distance", "style_distance_realised")),
            ]
        )
    kinds = [ablation_named(v) for v in dict.fromkeys(s.variant for s in found) if v]
    legend = [f"- `{kind.name}`: {kind.summary}." for kind in kinds]
    return _page(rows, expected, markdown_table(header, body), *legend)


def _line(s: Summary) -> list[str]:
    return [
        *(f"`{s.motion}`", s.label, f"**{spread(s, 'reward_mean')}**", _spread_of_episodes(s), _count(s, "fell")),
        *(_percent(s.mean("fell_perturbed")), _percent(s.mean("success_perturbed")), number(s.mean("mpjpe_mm"), 1)),
        _percent(s.mean(_CLEARANCE)),
        *(number(s.mean(name), 2) for name in ("style_distance", "style_distance_realised", "drift_m_per_s")),
        *(number(s.mean("early_contacts_per_s"), 1), number(s.mean("stance_slip_m"), 1, 1e3)),
        *(number(s.mean("wall_s"), 1), number(s.mean("cpu_s"), 1), number(s.mean("evaluations"), 0)),
    ]


def _page(rows: Sequence[Row], expected: int, table: Sequence[str], *below: str) -> str:
    missing = "" if len(rows) >= expected else f" **Unfinished: {len(rows)} of {expected} runs.**"
    robots, configs = (" and ".join(sorted({row[k] for row in rows})) for k in ("robot", "config"))
    title = f"{robots}, `{configs}` configuration.{missing}"
    return "\n".join([title, "", *table, "", _caption(rows), "", *below, ""])


def _caption(rows: Sequence[Row]) -> str:
    def all_of(column: str) -> str:
        return " or ".join(f"{value:g}" for value in sorted({row[column] for row in rows}))

    optimised = [row for row in rows if row["iterations"]]
    search = ""
    if optimised:
        counts = sorted({len(s.rows) for s in summaries(optimised)})
        seeds = " to ".join(str(n) for n in dict.fromkeys((counts[0], counts[-1])))
        seeds += " seeds" if counts[-1] > 1 else " seed"
        ran = sorted(row["iterations"] for row in optimised)
        iterations = " to ".join(str(n) for n in dict.fromkeys((ran[0], ran[-1])))
        lengths = {name: all_of(name) for name in ("population", "duration_s")}
        search = CAPTIONS["search"].format(seeds=seeds, iterations=iterations, **lengths)
    if any(row["method"] == RL for row in rows):
        search += CAPTIONS["policies"].format(method=METHODS[RL].label)
    tried = {"evaluation_s": all_of("evaluation_s"), "episodes": all_of("perturbed_episodes")}
    return CAPTIONS["comparison"].format(search=search, **tried, joint=JOINT_NOISE, velocity=VELOCITY_NOISE)


def spread(s: Summary, column: str) -> str:
    """A column's mean over the seeds, with its deviation if there are several."""
    mean, std = s.mean(column), s.std(column)
    if mean is None:
        return NONE
    return f"{mean:.3f}" if std is None else f"{mean:.3f} ± {std:.3f}"


def _spread_of_episodes(s: Summary) -> str:
    means, stds = s.values("reward_mean_perturbed"), s.values("reward_std_perturbed")
    if not means:
        return NONE
    square = np.mean(np.square(stds)) + np.var(means)
    return f"{np.mean(means):.3f} ± {np.sqrt(square):.3f}"


def _count(s: Summary, column: str) -> str:
    return f"{sum(bool(row[column]) for row in s.rows)} of {len(s.rows)}"


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{100 * value:.0f} %"
