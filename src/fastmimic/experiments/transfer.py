"""Zero-shot transfer: a motion optimised in one simulator, run under other conditions.

The paper runs its motions on a real robot and reports three trials each. Here a simulated robot differs in what a real
one differs in: another engine's contacts, the manufacturer's masses and inertias, motors with delay and friction, a
more slippery floor, and sensors in place of the true state.
"""

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from fastmimic.base.configuration import check, parameter
from fastmimic.base.errors import LogError
from fastmimic.base.files import packaged
from fastmimic.base.text import markdown_table
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.plan import Start, episode_duration, perturbed_start
from fastmimic.episode.rollout import run_log
from fastmimic.experiments.comparison_run import Row
from fastmimic.experiments.experiment import Subject, all_parts
from fastmimic.experiments.measurement import CAPTIONS
from fastmimic.identification.identify import identify
from fastmimic.imitation.methods import METHODS
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions, Disturbance

_LOG: Final = logging.getLogger(__name__)
PARTS: Final = "trials"
COLUMNS: Final = ("motion", "method", "stage", "trial", "reward_mean", "fell", "robot", "duration_s", "seed")
_FIGURES: Final = ("reward_mean", "fell", "duration_s")  # of `Metrics`, over the one episode of a trial


@dataclass(frozen=True)
class TransferStage:
    """One set of conditions; `simulator`, `observe` and `disturbances` as in `Conditions`."""

    name: str
    label: str
    simulator: str
    observe: str
    disturbances: tuple[Disturbance, ...] = ()

    def conditions(self, seed: int) -> Conditions:
        return Conditions(self.simulator, self.observe, seed, self.disturbances)

    def __str__(self) -> str:
        return ", ".join([self.simulator, self.observe, *map(str, self.disturbances)])


STAGES: Final = packaged("fastmimic.experiments", "stages.json", tuple[TransferStage, ...])
"""From the simulator of the optimisation to a robot that differs in everything: its motors by values of the magnitude
measured on robots of this class, not identified on one."""
IDENTIFIED: Final = replace(STAGES[-1], name="identified", label="(c) identified")
"""The last stage, with friction and payload identified from a run in it."""

PAPER: Final = ("MBC-DMP", 0.803, 0.012, 0.627, 0.096), ("RL", 0.483, 0.195, 0.17, 0.095)
"""The paper's turn: method, reward and its deviation in simulation, then on the robot over three trials."""


@dataclass(frozen=True)
class TransferSettings:
    """Settings of all trials."""

    trials: int = parameter(3, low=1)
    duration_s: float = 10.0  # of each, s; at most a motion that does not repeat
    seed: int = 0  # of the starts and the sensors
    config: str = "default"
    iterations: int | None = None
    population: int = 10
    identify: bool = False  # whether to run `IDENTIFIED` as well
    identification_s: float = parameter(5.0, low=0)  # length of the run that it comes from, s

    def __post_init__(self) -> None:
        check(self, "")


def trial_starts(trials: int, seed: int) -> Start:
    """Starts near the motion's start, like a robot placed by hand: joints ± 0.05 rad, base velocity ± 0.1 m/s."""
    start = perturbed_start(trials + 1, 1, np.random.default_rng(seed)).part(slice(1, None))
    return Start(start.sample, start.joint_offset, start.velocity_offset)


def run_trials(subject: Subject, robot: Robot, settings: TransferSettings) -> list[Row]:
    """Trials of one method on one motion in all stages, from the same starts: `COLUMNS`. Raises `FastMimicError`."""
    motion = subject.motion
    rows: list[Row] = []
    seconds = episode_duration(motion, settings.duration_s)
    start = trial_starts(settings.trials, settings.seed)
    for stage in (*STAGES, IDENTIFIED) if settings.identify else STAGES:
        config = identified_config(subject, robot, settings) if stage is IDENTIFIED else subject.config
        rollout = subject.run(robot, seconds, start, stage.conditions(settings.seed), config=config)
        rows += [
            {
                "motion": motion.name,
                "method": subject.method.name,
                "stage": stage.name,
                "trial": trial,
                **Metrics.of(rollout.episodes(slice(trial, trial + 1))).named(_FIGURES),
                "robot": robot.name,
                "seed": settings.seed,
            }
            for trial in range(settings.trials)
        ]
    return rows


def identified_config(subject: Subject, robot: Robot, settings: TransferSettings) -> ControllerConfig:
    """The controller with friction and payload identified from one run under the conditions of `IDENTIFIED`. The run
    has another start and other sensor errors than the trials. If the robot falls too early for an identification,
    returns the controller unchanged, with a warning."""
    motion, conditions = subject.motion, IDENTIFIED.conditions(settings.seed)
    start = trial_starts(settings.trials + 1, settings.seed).part(slice(settings.trials, None))
    rollout = subject.run(robot, episode_duration(motion, settings.identification_s), start, conditions, log=True)
    latency_s = conditions.estimator.latency_s
    log = run_log(rollout.course, 0, robot=robot.name, motion=motion.name, latency_s=latency_s)
    try:
        return identify(log, robot).configure(subject.config)
    except LogError as error:
        _LOG.warning("%s, %s: nothing was identified: %s", motion.name, subject.method.name, error)
        return subject.config


def all_trials(out: Path) -> list[Row]:
    """The rows of all finished trials, methods in the order of their list; raises `OutputError` for a damaged file."""
    order = list(METHODS)
    return sorted(all_parts(out / PARTS), key=lambda row: order.index(row["method"]))


@dataclass(frozen=True)
class Transferred:
    motion: str
    method: str
    rewards: np.ndarray  # (stages, trials), in the order of `stages_of`
    falls: np.ndarray  # (stages,) number of trials that ended in a fall

    @property
    def drop(self) -> float:
        """Share of the reward lost from the simulation to the last stage."""
        means = self.rewards.mean(axis=1)
        return float(1.0 - means[-1] / means[0]) if means[0] > 0 else float("nan")


def stages_of(rows: Iterable[Row]) -> tuple[TransferStage, ...]:
    """The stages of some rows: `IDENTIFIED` is not always among them."""
    return (*STAGES, IDENTIFIED) if any(row["stage"] == IDENTIFIED.name for row in rows) else STAGES


def transferred(rows: Sequence[Row]) -> list[Transferred]:
    """The rows by motion and method, in their order."""
    stages = stages_of(rows)
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["motion"], row["method"]), []).append(row)
    motions = list(dict.fromkeys(motion for motion, _ in groups))
    found = []
    for motion, method in sorted(groups, key=lambda key: motions.index(key[0])):
        by = [[row for row in groups[motion, method] if row["stage"] == stage.name] for stage in stages]
        rewards = np.array([[row["reward_mean"] for row in stage] for stage in by])
        falls = np.array([sum(row["fell"] > 0 for row in stage) for stage in by])
        found.append(Transferred(motion, method, rewards, falls))
    return found


def transfer_table(rows: Sequence[Row], missing: int) -> str:
    """Rewards by motion, method and stage beside the paper's, as Markdown; `missing` counts unfinished pairs."""
    found, stages = transferred(rows), stages_of(rows)
    last = "(c)" if stages[-1] is STAGES[-1] else stages[-1].label
    header = ["motion", "method", *(stage.label for stage in stages), f"change to {last}"]
    body = []
    for t in found:
        cells = []
        for rewards, falls in zip(t.rewards, t.falls, strict=True):
            fell = f", {falls} of {len(rewards)} fell" if falls else ""
            cells.append(f"{rewards.mean():.3f} ± {rewards.std():.3f}{fell}")
        body.append([f"`{t.motion}`", METHODS[t.method].label, *cells, f"{-100 * t.drop:+.0f} %"])
    for label, simulated, deviation, real, spread in PAPER:
        cells = [f"{simulated:.3f} ± {deviation:.3f}", *[""] * (len(stages) - 2)]
        change = f"{100 * (real / simulated - 1):+.0f} %"
        body.append(["turn (paper)", label, *cells, f"on the robot {real:.3f} ± {spread:.3f}", change])
    but = " but what was identified" if IDENTIFIED in stages else ""
    about = CAPTIONS["transfer"].format(trials=found[0].rewards.shape[1], but=but, **rows[0])
    notes = [
        about + (f" **Unfinished: {missing} of motion and method are missing.**" if missing else ""),
        *(f"{stage.label}: {stage}." for stage in STAGES),
        *([CAPTIONS["identified"].format(label=IDENTIFIED.label)] if IDENTIFIED in stages else []),
        CAPTIONS["transfer of the paper"],
    ]
    return "\n".join([*markdown_table(header, body), "", *(f"- {note}" for note in notes), ""])
