"""A training run: its folder, iterations, evaluations in the common metric, checkpoints and logs."""

import io
import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.errors import CheckpointError
from fastmimic.base.files import replace_file, write_text
from fastmimic.base.machine import versions
from fastmimic.base.text import csv_text, plain
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import episode_duration
from fastmimic.imitation.evaluate import EVALUATION_S, PERTURBED_EPISODES, unseen_start
from fastmimic.learning.learner import Iteration, Learner, TrainingSettings
from fastmimic.learning.policy import POLICY_FILE, Policy, controlled_by
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.work_folder import CONFIG, WorkFolder

CHECKPOINT: Final = "checkpoint.pt"
ONNX: Final = "policy.onnx"
EVALUATIONS: Final = "evaluations.csv"
EVENTS: Final = "tensorboard"
_VERSION: Final = 3
_FILES: Final = (CHECKPOINT, ONNX, EVALUATIONS, POLICY_FILE, f"{EVENTS}/events.out.tfevents.*")
CHECKPOINT_S: Final = 60.0  # s of wall time between checkpoints
EVALUATION_STEPS: Final = 500_000  # policy steps between evaluations


@dataclass(frozen=True)
class TrainingFolder(WorkFolder):
    @classmethod
    def at(cls, path: Path) -> "TrainingFolder":
        return cls(path, "a training", CONFIG, "training", _FILES)

    def save(self, state: Mapping[str, Any]) -> None:
        import torch

        out = io.BytesIO()
        torch.save({"version": _VERSION, **state}, out)
        replace_file(self.path / CHECKPOINT, lambda file: file.write(out.getbuffer()))

    def load(self) -> dict[str, Any]:
        """Reads the checkpoint, without executing code in it; raises `CheckpointError` if it is missing or damaged."""
        import torch

        path = self.path / CHECKPOINT
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except FileNotFoundError:
            raise CheckpointError(f"{path}: no checkpoint to resume from; leave out --resume to start anew") from None
        except Exception as error:  # noqa: BLE001  whatever a damaged archive makes PyTorch raise
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise CheckpointError(f"{path}: damaged checkpoint ({reason}); --overwrite starts anew") from None
        if not isinstance(state, dict) or state.get("version") != _VERSION:
            raise CheckpointError(f"{path}: not a checkpoint of this release; --overwrite starts anew")
        return state


@dataclass(frozen=True)
class Evaluated:
    """An evaluation of a policy under training; figures have the names of `Metrics`."""

    steps: int
    wall_s: float  # of the training so far
    cpu_s: float
    reward_mean: float  # of a nominal episode
    reward_mean_perturbed: float  # mean over episodes from perturbed starts
    fell: float
    fell_perturbed: float  # share of falls among those


@dataclass(frozen=True)
class Advance:
    """Progress: `steps` of `total`, `steps_per_s`, and the last iteration and evaluation."""

    steps: int
    total: int
    steps_per_s: float
    iteration: Iteration
    evaluated: Evaluated | None


def train(
    robot: Robot,
    motion: Motion,
    steps: int,
    folder: TrainingFolder,
    settings: TrainingSettings = TrainingSettings(),
    *,
    device: str = "cpu",
    threads: int = 1,
    resume: bool = False,
    evaluate_every: int = EVALUATION_STEPS,
    evaluate: Callable[..., Evaluated] | None = None,
    progress: Callable[[Advance], None] | None = None,
) -> list[Evaluated]:
    """Trains a policy to imitate a motion's demonstration; keeps the best one as `policy.npz` and `policy.onnx`.
    The folder also holds `evaluations.csv`, TensorBoard's logs and a checkpoint. A resumed training equals an
    uninterrupted one to the bit on the same machine; a finished one continues if `steps` is greater.

    `steps` are those of the policy, all robots together, rounded up to whole iterations; so are `evaluate_every`, those
    between evaluations, of which the last iteration always has one. `evaluate` makes them, by default `evaluate_policy`
    does. The result does not depend on `threads`.

    Raises `ConfigError` for a missing library or as `Learner`, `CheckpointError` for a damaged checkpoint, and
    `OutputError` if a file cannot be written. Ctrl-C leaves a checkpoint of the last minute.
    """
    with closing(Learner(robot, motion, settings, device=device, threads=threads)) as learner:
        return _Training(learner, folder, evaluate_every, evaluate or evaluate_policy, progress).run(steps, resume)


@dataclass(eq=False)
class _Training:
    learner: Learner
    folder: TrainingFolder
    every: int
    evaluate: Callable[..., Evaluated]
    progress: Callable[[Advance], None] | None
    iterations: int = 0
    episodes: int = 0
    evaluations: list[Evaluated] = field(default_factory=list)
    best: float = -math.inf
    began_wall_s: float = field(default_factory=time.perf_counter)  # as if it had never been interrupted
    began_cpu_s: float = field(default_factory=time.process_time)

    @property
    def _steps(self) -> int:
        return self.iterations * self.learner.settings.steps_per_iteration

    def run(self, steps: int, resume: bool) -> list[Evaluated]:
        from torch.utils.tensorboard import SummaryWriter

        if resume:
            self._restore(self.folder.load())
        per = self.learner.settings.steps_per_iteration
        total = -(-steps // per)
        first, began, saved = self._steps, time.perf_counter(), time.perf_counter()
        with SummaryWriter(str(self.folder.path / EVENTS), purge_step=self._steps if resume else None) as log:
            while self.iterations < total:
                done = self.learner.iterate()
                self.iterations += 1
                self.episodes += len(done.scores)
                _write(log, done, self._steps)
                last = self.iterations == total
                if last or self._steps // self.every > (self._steps - per) // self.every:
                    found = self._evaluate()
                    for name in ("reward_mean", "reward_mean_perturbed", "fell_perturbed"):
                        log.add_scalar(f"evaluation/{name}", getattr(found, name), found.steps)
                if last or time.perf_counter() - saved > CHECKPOINT_S:
                    self.folder.save(self._state())
                    saved = time.perf_counter()
                if self.progress is not None:
                    pace = (self._steps - first) / (time.perf_counter() - began)
                    evaluated = self.evaluations[-1] if self.evaluations else None
                    self.progress(Advance(self._steps, total * per, pace, done, evaluated))
        return self.evaluations

    def _evaluate(self) -> Evaluated:
        policy, episodes = self.learner.policy(self._about()), self.learner.episodes
        found = self.evaluate(policy, episodes.robot, episodes.motion, self._steps, self._times())
        self.evaluations = [e for e in self.evaluations if e.steps != found.steps] + [found]
        worth = 0.5 * (found.reward_mean + found.reward_mean_perturbed)
        if worth > self.best:
            self.best = worth
            policy.save(self.folder.path / POLICY_FILE)
            network = self.learner.onnx()
            replace_file(self.folder.path / ONNX, lambda file: file.write(network))
        table = csv_text(list(Evaluated.__dataclass_fields__), map(asdict, self.evaluations))
        write_text(self.folder.path / EVALUATIONS, table)
        return found

    def _about(self) -> dict[str, Any]:
        provenance = self.learner.episodes.motion.provenance
        return {
            "library": "rsl-rl",
            "source": provenance.as_dict().get("source"),
            "licence": provenance.licence,
            "versions": {**versions(), **{name: metadata.version(name) for name in ("torch", "rsl-rl-lib")}},
            "training": {
                "steps": self._steps,
                "episodes": self.episodes,
                "simulated_s": self._steps / self.learner.settings.policy.rate_hz,
                **self._times(),
                "device": self.learner.device,
                "settings": plain(self.learner.settings),
            },
        }

    def _state(self) -> dict[str, Any]:
        return {
            "learner": self.learner.state(),
            "iterations": self.iterations,
            "episodes": self.episodes,
            "evaluations": [asdict(e) for e in self.evaluations],
            "best": float(self.best),
            **self._times(),
        }

    def _restore(self, state: dict[str, Any]) -> None:
        self.learner.restore(state["learner"])
        self.iterations, self.episodes = state["iterations"], state["episodes"]
        self.evaluations = [Evaluated(**e) for e in state["evaluations"]]
        self.best = state["best"]
        self.began_wall_s = time.perf_counter() - state["wall_s"]
        self.began_cpu_s = time.process_time() - state["cpu_s"]

    def _times(self) -> dict[str, float]:
        """Wall and processor time so far, s."""
        return {"wall_s": time.perf_counter() - self.began_wall_s, "cpu_s": time.process_time() - self.began_cpu_s}


def evaluate_policy(
    policy: Policy,
    robot: Robot,
    motion: Motion,
    steps: int,
    times: Mapping[str, float],
    *,
    duration_s: float = EVALUATION_S,
    perturbed_episodes: int = PERTURBED_EPISODES,
) -> Evaluated:
    """One nominal episode and several from the perturbed starts of a comparison; `times` are those of the training."""
    seconds = episode_duration(motion, duration_s)
    start = unseen_start(motion, seconds, perturbed_episodes)
    rollout = run_episodes(robot, motion, start=start, duration_s=seconds, controller=controlled_by(policy))
    return Evaluated(
        steps=steps,
        **times,
        reward_mean=float(rollout.reward[0]),
        reward_mean_perturbed=float(rollout.reward[1:].mean()),
        fell=float(rollout.fell[0]),
        fell_perturbed=float(rollout.fell[1:].mean()),
    )


def _write(log: Any, done: Iteration, steps: int) -> None:
    figures = {
        "train/reward_per_step": done.reward,
        "train/action_deviation": done.deviation,
        "train/learning_rate": done.learning_rate,
        "time/collect_s": done.collect_s,
        "time/update_s": done.update_s,
        **{f"loss/{name}": value for name, value in done.losses.items()},
    }
    if done.scores:
        figures["train/episode_reward"] = float(np.mean(done.scores))
        figures["train/episode_steps"] = float(np.mean(done.lengths))
        figures["train/fall_share"] = done.falls / len(done.scores)
    for name, value in figures.items():
        log.add_scalar(name, value, steps)
