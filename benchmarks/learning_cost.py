"""What a reward costs: the course of trainings and of searches over simulated time and over processor time."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import OutputError
from fastmimic.experiments.comparison_run import RUNS, Row, finished_row
from fastmimic.experiments.measurement import NONE, Summary, spread, summaries
from fastmimic.imitation.methods import METHODS, RL
from fastmimic.optimize.cma_es import Checkpoint
from fastmimic.runs.work_folder import CHECKPOINT

if TYPE_CHECKING:
    from fastmimic.learning.training import Evaluated


CONTROL_RATE_HZ: Final = 500.0
"""Of the control steps that are counted, those of the model-based controller and of a policy's joint targets alike."""
PAPER_STEPS: Final = 100_000_000
"""Policy steps of the paper's learned baseline (Peng et al. 2018)."""


@dataclass(frozen=True, eq=False)
class Course:
    """How the reward of one training, or of one search, grew with what was spent on it.

    Attributes:
        row: what came out: `motion`, `method`, `seed`, `reward_mean`, `reward_mean_perturbed`, `fell`,
            `fell_perturbed`, `wall_s`, `cpu_s`, `simulated_s`, as a comparison has them; `cpu_s` is None where it is
            not known.
        simulated_s: (k,) time that robots were simulated for, s.
        cpu_s: (k,) processor time, s; NaN where it is not known.
        reward: (k,) of a training: the nominal episode of the policy as it was then; of a search: the best objective so
            far, the reward less the penalty for lost swing clearance, in the search's episode.
    """

    row: Row
    simulated_s: Array
    cpu_s: Array
    reward: Array


def training_course(folder: Path) -> Course:
    """The course of a training by `fastmimic train`; its row is of the policy that it kept, at the cost of all of it.

    Raises:
        OutputError: the folder holds no training, or a damaged one.
        PolicyError: likewise, of its policy.
    """
    from fastmimic.learning.policy import POLICY_FILE, Policy

    policy = Policy.load(folder / POLICY_FILE)
    found = read_evaluations(folder)
    kept = max(found, key=lambda e: e.reward_mean + e.reward_mean_perturbed)
    last = found[-1]
    steps = np.array([e.steps for e in found], dtype=np.float64)
    row = {
        "motion": policy.motion,
        "method": RL,
        "variant": "",
        "seed": policy.seed,
        "reward_mean": kept.reward_mean,
        "reward_mean_perturbed": kept.reward_mean_perturbed,
        "fell": kept.fell,
        "fell_perturbed": kept.fell_perturbed,
        "wall_s": last.wall_s,
        "cpu_s": last.cpu_s,
        "simulated_s": last.steps / policy.config.rate_hz,
        "steps": last.steps,
    }
    return Course(
        row,
        steps / policy.config.rate_hz,
        np.array([e.cpu_s for e in found]),
        np.array([e.reward_mean for e in found]),
    )


def read_evaluations(folder: Path) -> "list[Evaluated]":
    """The evaluations of a training so far, at least one.

    Raises:
        OutputError: there are none, or they cannot be read.
    """
    from fastmimic.learning.training import EVALUATIONS, Evaluated

    path = folder / EVALUATIONS
    try:
        with path.open(newline="", encoding="utf-8") as file:
            found = [
                Evaluated(
                    steps=int(line["steps"]),
                    **{
                        name: float(line[name])
                        for name in (
                            "wall_s",
                            "cpu_s",
                            "reward_mean",
                            "reward_mean_perturbed",
                            "fell",
                            "fell_perturbed",
                        )
                    },
                )
                for line in csv.DictReader(file)
            ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: no readable evaluations of a training ({error})") from None
    if not found:
        raise OutputError(f"{path}: no evaluation yet; train on with --resume")
    return found


def search_courses(comparison: Path, method: str, motions: Iterable[str]) -> list[Course]:
    """The courses of a method's finished runs in the folder of a comparison; nothing is written.

    What a run spent is spread evenly over its iterations, all of which run the same number of episodes. A method that
    optimises nothing has a course without any points.

    Raises:
        OutputError: a run cannot be read.
        CheckpointError: likewise, of its search.
    """
    wanted = list(motions)
    found = []
    for folder in sorted((comparison / RUNS).glob("*")):
        row = finished_row(folder) if folder.is_dir() else None
        if row is None or row["method"] != method or row["variant"] or row["motion"] not in wanted:
            continue
        evaluated_s = row["evaluation_s"] * (1 + METHODS[method].optimises + row["perturbed_episodes"])
        row["simulated_s"] -= evaluated_s  # what the search took, without the evaluation of its result
        none = np.zeros(0)
        if not METHODS[method].optimises:
            row["simulated_s"] = 0.0
            found.append(Course(row, none, none, none))
            continue
        scores = Checkpoint.load(folder / CHECKPOINT).scores
        share = np.arange(1, len(scores) + 1) / len(scores)
        cpu_s = np.nan if row["cpu_s"] is None else row["cpu_s"]
        best = np.maximum.accumulate(scores.max(axis=1))
        found.append(Course(row, share * row["simulated_s"], share * cpu_s, best))
    return sorted(found, key=lambda course: (wanted.index(course.row["motion"]), course.row["seed"]))


def cost_table(courses: Sequence[Course]) -> str:
    """What each method reached on each motion, and what it took, as Markdown, with what more steps would take.

    Args:
        courses: of all methods.
    """
    header = (
        *("motion", "method", "runs", "control steps, million", "simulated, s", "processor time, s", "wall time, s"),
        *("reward", "perturbed starts", "fell, nominal", "fell, perturbed"),
    )
    found = summaries([course.row for course in courses])
    lines = [header, ["---"] * len(header), *(_line(s) for s in found)]
    table = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([*table, "", *_trained(found)])


def paper_cost(courses: Iterable[Course]) -> tuple[float, float]:
    """Simulated time and processor time, s, of the paper's number of policy steps, at the pace of these trainings."""
    rows = [course.row for course in courses if course.row["method"] == RL]
    share = PAPER_STEPS / sum(row["steps"] for row in rows)
    return share * sum(row["simulated_s"] for row in rows), share * sum(row["cpu_s"] for row in rows)


def _line(s: Summary) -> list[str]:
    simulated = s.mean("simulated_s") or 0.0
    perturbed = f"{100 * (s.mean('fell_perturbed') or 0.0):.0f} %"
    return [
        *(f"`{s.motion}`", s.label, f"{len(s.rows)}", f"{CONTROL_RATE_HZ * simulated / 1e6:.2f}"),
        *(_whole(simulated), _whole(s.mean("cpu_s")), _whole(s.mean("wall_s"))),
        *(f"**{spread(s, 'reward_mean')}**", spread(s, "reward_mean_perturbed")),
        *(f"{sum(bool(row['fell']) for row in s.rows)} of {len(s.rows)}", perturbed),
    ]


def _trained(found: Sequence[Summary]) -> list[str]:
    """For each motion that was trained: how much, and what the paper's number of steps would take at that pace."""
    notes = []
    for s in found:
        steps, cpu_s = (s.mean(name) if s.method == RL else None for name in ("steps", "cpu_s"))
        if steps and cpu_s:
            whole_s = cpu_s / steps * PAPER_STEPS
            notes.append(
                f"- `{s.motion}`: {steps:,.0f} policy steps in {cpu_s:,.0f} s of processor time,"
                f" {1e3 * cpu_s / steps:.2f} ms each; {PAPER_STEPS:,} at that pace: {whole_s:,.0f} s,"
                f" {whole_s / 3600:.0f} hours of one core."
            )
    return notes


def _whole(value: float | None) -> str:
    return NONE if value is None else f"{value:,.0f}"
