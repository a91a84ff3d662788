"""Gymnasium environments: one robot (`fastmimic/Imitation-v0`), and n of them as one vectorised environment."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from fastmimic.base.arrays import Flags
from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE, PolicyConfig, action_bounds
from fastmimic.learning.episodes import EPISODE_S, Episodes, Seen
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import parse_range


def _prepared(
    n: int,
    motion: str | Path | Motion,
    robot: str | Robot,
    *,
    config: PolicyConfig | None = None,
    randomize: Sequence[str] = (),
    **options: Any,
) -> tuple[Callable[[int], Episodes], gymnasium.Space[Any], gymnasium.Space[Any]]:
    """A function that makes the episodes of n robots for a seed, and the spaces of one's observation and action."""
    robot = load_robot(robot)
    motion = load_motion(motion, robot)
    config = config if config is not None else PolicyConfig()
    ranges = tuple(parse_range(text) for text in randomize)

    def make(seed: int) -> Episodes:
        return Episodes(robot, motion, n, config, seed=seed, randomize=ranges, **options)

    lower, upper = (bound.astype(np.float32) for bound in action_bounds(config, robot))
    seen = gymnasium.spaces.Box(-np.inf, np.inf, (OBSERVATION_SIZE,), np.float32)
    return make, seen, gymnasium.spaces.Box(lower, upper, (ACTION_SIZE,), np.float32)


class ImitationEnv(gymnasium.Env[Seen, NDArray[np.float32]]):
    """A robot that imitates a motion. `fastmimic.learning.observation` defines the observation. An action is twelve
    joint targets relative to the home pose in units of 0.25 rad, the reward the mean of the common reward over the
    step's control steps. An episode begins at a random phase of the motion, terminates with a fall and is truncated
    after `duration_s` or at the end of a motion that does not repeat. `info["terms"]` has the reward's terms."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        motion: str | Path | Motion = "trot",
        robot: str | Robot = "a1",
        *,
        duration_s: float = EPISODE_S,
        perturbed: bool = True,
        randomize: Sequence[str] = (),
        config: PolicyConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        """`motion` is as in `fastmimic.load_motion`; `robot` is the robot, its name, or its MJCF; `duration_s` is the
        greatest length of an episode, s; if `perturbed`, episodes begin off the reference motion, as in an evaluation.
        `randomize` are ranges for each episode's robot and ground, such as `friction=0.4:1.2`; `render_mode` is None:
        `fastmimic render` makes videos. Raises `FastMimicError` for no such robot, motion or range, or an unfit one."""
        self._make, self.observation_space, self.action_space = _prepared(
            1, motion, robot, config=config, randomize=randomize, duration_s=duration_s, perturbed=perturbed
        )
        self._randomized = bool(randomize)
        self._episodes = self._make(0)
        self.render_mode = render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """Begins an episode; returns the observation and an empty info."""
        super().reset(seed=seed)
        if self._randomized:
            self._episodes = self._make(int(self.np_random.integers(2**31)))
        self._episodes.random = self.np_random
        return self._episodes.reset()[0].copy(), {}

    def step(self, action: NDArray[np.float32]) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """One policy step: observation, reward, whether the robot fell, whether the episode was truncated, info."""
        outcome = self._episodes.step(np.asarray(action, np.float64)[None])
        seen = outcome.final[0] if outcome.done[0] else outcome.seen[0].copy()
        terms = dict(zip(REWARD_TERMS, self._episodes.terms[0].tolist(), strict=True))
        return seen, float(outcome.reward[0]), bool(outcome.fell[0]), bool(outcome.ended[0]), {"terms": terms}


class ImitationVectorEnv(VectorEnv[Seen, NDArray[np.float32], NDArray[Any]]):
    """n robots that imitate the same motion, simulated as one batch; each begins its next episode at once. After the
    end of an episode, `info["final_obs"]` has its last observation and `info["episode"]` its length in steps and its
    mean reward over the full length (0 after a fall), with masks `_final_obs` and `_episode`."""

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        motion: str | Path | Motion = "trot",
        robot: str | Robot = "a1",
        *,
        threads: int = 1,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Arguments, `options` and errors as for `ImitationEnv`. Robots and grounds of `randomize` are drawn at a
        seeded reset; the results do not depend on the number of `threads`."""
        prepared = _prepared(num_envs, motion, robot, threads=threads, **options)
        self._make, self.single_observation_space, self.single_action_space = prepared
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes = self._make(0)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Seen, dict[str, Any]]:
        """Begins all episodes; returns observations (n, …) and an empty info. Of several seeds the first counts."""
        first = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=first)
        if first is not None:
            self._episodes.close()
            self._episodes = self._make(first)
            self._episodes.random = self.np_random
        return self._episodes.reset().copy(), {}

    def step(self, actions: Seen) -> tuple[Seen, NDArray[Any], Flags, Flags, dict[str, Any]]:
        """One policy step of all robots: observations, rewards, falls, truncations (n, …), info."""
        outcome = self._episodes.step(np.asarray(actions, np.float64))
        info: dict[str, Any] = {}
        if (done := outcome.done).any():
            final, score, steps = np.zeros_like(outcome.seen), np.zeros(len(done)), np.zeros(len(done), np.int64)
            final[done], score[done], steps[done] = outcome.final, outcome.score, outcome.steps
            episode = {"score": score, "steps": steps}
            info = {"final_obs": final, "_final_obs": done, "episode": episode, "_episode": done}
        return outcome.seen.copy(), outcome.reward.copy(), outcome.fell.copy(), outcome.ended.copy(), info

    def close_extras(self, **kwargs: Any) -> None:
        self._episodes.close()
