"""Rows of runs as CSV, their means and deviations, and these as Markdown."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.text import NONE, markdown_table, number
from fastmimic.episode.metrics import TRACKED
from fastmimic.episode.plan import JOINT_NOISE, VELOCITY_NOISE
from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.experiments.ablations import ABLATED, ablation_named
from fastmimic.experiments.comparison_run import Row
from fastmimic.imitation.methods import METHODS, RL, method_named

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

PAPER: Final = (
    "For context only, not a row of ours: for its turn, another clip in another simulator, the paper reports RL 0.483 ±"
    " 0.195, Raibert 0.453, MBC 0.223, LH 0.39, MBC-DMP 0.803 ± 0.012 and LH-DMP 0.831 ± 0.004."
)


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
        return self.variant or method_named(self.method).label


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
    return "\n".join([_title(rows, expected), "", *markdown_table(header, body), "", _caption(rows), "", PAPER, ""])


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
    return "\n".join([_title(rows, expected), "", *markdown_table(header, body), "", _caption(rows), "", *legend, ""])


def _line(s: Summary) -> list[str]:
    return [
        *(f"`{s.motion}`", s.label, f"**{spread(s, 'reward_mean')}**", _spread_of_episodes(s), _count(s, "fell")),
        *(_percent(s.mean("fell_perturbed")), _percent(s.mean("success_perturbed")), number(s.mean("mpjpe_mm"), 1)),
        _percent(s.mean(_CLEARANCE)),
        *(number(s.mean(name), 2) for name in ("style_distance", "style_distance_realised", "drift_m_per_s")),
        *(number(s.mean("early_contacts_per_s"), 1), number(s.mean("stance_slip_m"), 1, 1e3)),
        *(number(s.mean("wall_s"), 1), number(s.mean("cpu_s"), 1), number(s.mean("evaluations"), 0)),
    ]


def _title(rows: Sequence[Row], expected: int) -> str:
    missing = "" if len(rows) >= expected else f" **Unfinished: {len(rows)} of {expected} runs.**"
    robots, configs = (" and ".join(sorted({row[k] for row in rows})) for k in ("robot", "config"))
    return f"{robots}, `{configs}` configuration.{missing}"


def _caption(rows: Sequence[Row]) -> str:
    def all_of(column: str) -> str:
        return " or ".join(f"{value:g}" for value in sorted({row[column] for row in rows}))

    optimised = [row for row in rows if row["iterations"]]
    search = ""
    if optimised:
        counts = sorted({len(s.rows) for s in summaries(optimised)})
        seeds = " to ".join(str(n) for n in dict.fromkeys((counts[0], counts[-1])))
        seeds += " seeds" if counts[-1] > 1 else " seed"
        iterations = " or ".join(str(i) for i in sorted({row["iterations"] for row in optimised}))
        search = (
            f" Where something is optimised: mean ± sample standard deviation over {seeds}"
            f" of CMA-ES, {iterations} iterations of {all_of('population')} candidates,"
            f" episodes of {all_of('duration_s')} s. The other methods are deterministic and were run once."
        )
    if any(row["method"] == RL for row in rows):
        search += (
            f" {method_named(RL).label}: one policy a motion, trained beforehand, a row for each seed of the training;"
            " its time and its episodes are those of the training as well, on whatever machine that was."
        )
    return (
        f"*Reward*: one episode of {all_of('evaluation_s')} s from the motion's start, scored against the retargeted"
        f" motion.{search} *Perturbed starts*: mean ± standard deviation over {all_of('perturbed_episodes')} episodes"
        f" from random phases with joints ± {JOINT_NOISE:g} rad and base velocity ± {VELOCITY_NOISE:g} m/s, the same"
        " ones for every run. *Success*: share of them without a fall and never more than 0.5 m or 1 rad from the"
        " reference. *Mpjpe*: mean distance of trunk, hips, knees and feet from it."
        " *Least clearance*: smallest share of the demonstration's swing clearance that a leg"
        " realises, mean over the seeds. *Style distance*: of the optimised reference from the retargeted one, 0 if"
        " they are the same and 1 if the feet are not lifted; *realised*: of what the robot's feet did until a fall."
        " *Wall time* and *processor time*: of one run in one process, optimisation and evaluation."
    )


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
