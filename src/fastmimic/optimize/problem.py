"""The optimisation problem: DMP parameters of a motion, scored by running the robot with its controller.

Paper, §III-C: the baselines g and amplitudes a of the four feet's z vary, the weights w (the style) stay fixed.
`fastmimic.optimize.parameters` can open more of the 24 dimensions. An unconstrained optimiser lowers the feet, because
short lifts disturb the body less; so swing clearance below a share of the demonstration's is penalised.
"""

import hashlib
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import check_positive
from fastmimic.base.machine import available_cores
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import ClosedLoop
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.plan import Start, episode_steps, nominal_start, perturbed_start
from fastmimic.episode.reward import N_TERMS, REWARD_TERMS
from fastmimic.episode.rollout import Rollout
from fastmimic.executors import check_workers
from fastmimic.motion.motion import Motion
from fastmimic.optimize.parameters import FOOT_HEIGHT, Parameter, parameters_of_group
from fastmimic.primitive import MotionDmp
from fastmimic.primitive.motion_dmp import FEET, rate_of
from fastmimic.reference.table import put_root, reference_table
from fastmimic.robot import Robot

_CYCLES: Final = 3  # in an episode of the search, if it is to be that long
_LEAST_S: Final = 1.2
_LEAST_CYCLES: Final = 1.5  # if the requested length does not hold one cycle


@dataclass(frozen=True)
class Objective:
    """How a candidate is scored: mean reward of an episode minus the penalty for lost swing clearance. A foot is
    penalised below `clearance_floor`, a share of the demonstration's clearance: above the share that a result must
    reach, because the realised clearance varies from step to step."""

    duration_s: float = 5.0  # of an episode at the most; three cycles do, and 1.2 s
    clearance_floor: float = 0.87
    clearance_weight: float = 1.0  # penalty per foot and per unit of the missing share

    def __post_init__(self) -> None:
        check_positive(self.duration_s, "the duration")


class Problem(ABC):
    """Scores parameter vectors in closed loop, in parallel, with the same bits for any number of workers, in episodes
    of `steps` control steps. The search begins at `start` (k,). Subclasses define what a vector means."""

    steps: int

    def __init__(
        self,
        robot: Robot,
        demonstration: Motion,
        parameters: Sequence[Parameter],
        *,
        objective: Objective,
        config: ControllerConfig = ControllerConfig(),
        workers: int | None = None,
    ) -> None:
        """Arguments as attributes; `workers` are threads (None: one per core). Raises `ConfigError` below one."""
        check_workers(workers)
        self.robot = robot
        self.demonstration = demonstration
        # without the animal's motion, whose reward the search does not ask for
        self._scored = demonstration if demonstration.animal is None else replace(demonstration, animal=None)
        self.parameters = tuple(parameters)
        self.start = self.initial
        self.objective = objective
        self.config = config
        self.workers = workers if workers is not None else available_cores()
        self.divisions: tuple[int, ...] = ()  # control steps that divide episodes into parts
        self._loops: dict[tuple[int, int], ClosedLoop] = {}

    @abstractmethod
    def motion(self, x: Array) -> Motion:
        """The reference motion of one candidate (k,), with its demonstration."""

    @abstractmethod
    def tables(self, x: Array) -> Records:
        """Reference motions of n candidates (n, k) for the controller, (n, t) of `SAMPLE`."""

    @abstractmethod
    def score(self, rollout: Rollout) -> Array:
        """Objective of each episode of a rollout, (n,)."""

    def validation(self, episodes: int, duration_s: float, rng: np.random.Generator) -> tuple[Start, int]:
        """Starts of the validation episodes, the first unperturbed, and their control steps: here whole episodes."""
        return perturbed_start(episodes, 1, rng), self.steps

    @property
    def initial(self) -> Array:
        """(k,) the unmodulated motion."""
        return np.array([p.initial for p in self.parameters])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, (k,) each."""
        return np.array([p.lower for p in self.parameters]), np.array([p.upper for p in self.parameters])

    @cached_property
    def identity(self) -> str:
        """A digest of all that determines scores; identifies checkpoints."""
        tables = self.tables(self.initial[None]), reference_table(self.demonstration, self.robot)
        settings = {
            "config": self.config.as_dict(),
            "objective": asdict(self.objective),
            "parameters": [asdict(p) for p in self.parameters],
            "start": self.start.tolist(),
            "steps": self.steps,
        }
        if len(REWARD_TERMS) > N_TERMS:
            settings["reward"] = {term.name: term.weight for term in REWARD_TERMS.values()}
        content = (*(table.tobytes() for table in tables), self.robot.content)
        return hashlib.sha256(b"".join((*content, json.dumps(settings, sort_keys=True).encode()))).hexdigest()

    def rollout(self, tables: Records, start: Start, steps: int) -> list[Rollout]:
        """Runs one episode per table (n, t) of `SAMPLE` on the workers; returns a result for each part, in order."""
        bounds = np.linspace(0, len(tables), min(self.workers, len(tables)) + 1).astype(int)
        parts = [slice(a, b) for a, b in pairwise(bounds)]
        # compiles and builds before the threads start
        loops = [self._loop(worker, part.stop - part.start) for worker, part in enumerate(parts)]

        def run(loop: ClosedLoop, part: slice) -> Rollout:
            return loop.run(tables[part], start.part(part), steps, divisions=self.divisions)

        if len(parts) == 1:
            return [run(loops[0], parts[0])]
        with ThreadPoolExecutor(len(parts)) as pool:
            return list(pool.map(run, loops, parts))

    def evaluate(self, x: Array) -> Array:
        """Scores of n candidates (n, k), greater is better, (n,)."""
        return self.scores(self.tables(x), nominal_start(len(x)), self.steps)

    def scores(self, tables: Records, start: Start, steps: int) -> Array:
        """Objective of each episode, (n,); arguments as for `rollout`."""
        return np.concatenate([self.score(r) for r in self.rollout(tables, start, steps)])

    def _loop(self, worker: int, n: int) -> ClosedLoop:
        key = worker, n
        if key not in self._loops:
            self._loops[key] = ClosedLoop(self.robot, self._scored, n, self.config)
        return self._loops[key]


class ImitationProblem(Problem):
    """DMP parameters of one motion, scored over its repeated cycle or, if it does not repeat, over the whole."""

    def __init__(
        self,
        robot: Robot,
        demonstration: Motion,
        dmp: MotionDmp,
        *,
        group: str = FOOT_HEIGHT,
        objective: Objective = Objective(),
        config: ControllerConfig = ControllerConfig(),
        workers: int | None = None,
    ) -> None:
        """`dmp` is fitted to the demonstration, `group` one of `PARAMETER_GROUPS`. Raises `ConfigError` for fewer than
        one worker, or no such group."""
        self._repeats = demonstration.cycle is not None
        if not self._repeats:
            objective = replace(objective, duration_s=(demonstration.n_samples - 1) / demonstration.rate_hz)
        parameters = parameters_of_group(group, dmp)
        super().__init__(robot, demonstration, parameters, objective=objective, config=config, workers=workers)
        self.dmp = dmp
        seconds = self.objective.duration_s
        if self._repeats:
            seconds = min(seconds, max(_LEAST_S, _CYCLES * demonstration.period_s))
        self.steps = episode_steps(seconds, self.config.rate_hz)
        if self._repeats and self.steps < demonstration.n_samples:  # each parameter must act within an episode
            self.steps = math.ceil(_LEAST_CYCLES * demonstration.n_samples)
        self._clearance = swing_clearance(demonstration, robot.foot_radius)
        self._base = reference_table(dmp.motion(), robot)
        names = [parameter.name.split(".") for parameter in self.parameters]
        self._moved = [(kind, dmp.index(dimension)) for dimension, kind in names]
        self._moves_root = min(dimension for _, dimension in self._moved) < FEET.start

    def motion(self, x: Array) -> Motion:
        goal, amplitude = self._modulation(x[None])
        return self.dmp.motion(goal[0], amplitude[0])

    def tables(self, x: Array) -> Records:
        goal, amplitude = self._modulation(x)
        feet = self.dmp.foot_table(goal, amplitude)
        tables = np.repeat(self._base[None], len(x), axis=0)
        if self._moves_root:
            for table, g, a in zip(tables, goal, amplitude, strict=True):
                put_root(table, self.demonstration.target, *self.dmp.root(g, a))
        tables["foot_pos"] = feet.foot_pos_b
        tables["joint_pos"] = feet.joint_pos
        tables["joint_vel"] = feet.joint_vel
        tables["joint_acc"] = rate_of(feet.joint_vel, self.config.rate_hz, self._repeats)
        return tables

    def score(self, rollout: Rollout) -> Array:
        return rollout.reward - clearance_penalty(self.objective, rollout, self._clearance)

    def validation(self, episodes: int, duration_s: float, rng: np.random.Generator) -> tuple[Start, int]:
        """The first episode nominal, the others perturbed at random phases; for a motion that ends, all whole."""
        if not self._repeats:
            return super().validation(episodes, duration_s, rng)
        steps = round(duration_s * self.config.rate_hz)
        return perturbed_start(episodes, self.demonstration.n_samples, rng), steps

    def _modulation(self, x: Array) -> tuple[Array, Array]:
        goal = np.repeat(self.dmp.goal[None], len(x), axis=0)
        amplitude = np.repeat(self.dmp.amplitude[None], len(x), axis=0)
        for (kind, dimension), values in zip(self._moved, x.T, strict=True):
            (goal if kind == "goal" else amplitude)[:, dimension] = values
        return goal, amplitude


def clearance_penalty(objective: Objective, rollout: Rollout, wanted: Array) -> Array:
    """Penalty for lost swing clearance in n episodes, (n,); `wanted` (4,) the motion's own, m, NaN without swings."""
    share = rollout.clearance / wanted
    # a foot that never swung because the robot fell has no clearance
    share = np.where(np.isnan(share) & rollout.fell[:, None] & np.isfinite(wanted), 0.0, share)
    missing = np.maximum(0.0, objective.clearance_floor - share)
    return np.asarray(objective.clearance_weight * np.nansum(missing, axis=1))
