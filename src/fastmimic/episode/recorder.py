"""Keeps the whole course of episodes."""

from typing import TYPE_CHECKING

import numpy as np

from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.episode.rollout import Log
from fastmimic.episode.scorer import demonstration_in_world
from fastmimic.robot.state import COMMAND, OBSERVATION, READING

if TYPE_CHECKING:
    from fastmimic.episode.loop import ClosedLoop


class EpisodeRecorder:
    """Copies the loop's data into arrays."""

    def __init__(self, loop: "ClosedLoop", steps: int) -> None:
        n = loop.n
        self._loop = loop
        self._observation = np.zeros((n, steps), OBSERVATION)
        self._command = np.zeros((n, steps), COMMAND)
        self._stance = np.zeros((n, steps, 4), np.bool_)
        self._force = np.zeros((n, steps, 4, 3))
        self._solve_time = np.zeros((n, steps))
        self._terms = np.zeros((n, steps, len(REWARD_TERMS)))
        self._sample = np.zeros((n, steps), np.int64)
        self._origin = np.zeros((n, steps, 3))
        self._estimate = np.zeros((n, steps), OBSERVATION) if loop.observer is not None else None
        self._reading = np.zeros((n, steps), READING) if loop.observer is not None else None

    def add(self, step: int) -> None:
        """Copies the state after a control step."""
        loop = self._loop
        self._observation[:, step] = loop.simulation.observation
        self._command[:, step] = loop.controller.command
        self._stance[:, step] = loop.controller.memory["stance"]
        self._force[:, step] = loop.controller.memory["force"]
        self._solve_time[:, step] = loop.controller.memory["solve_time"]
        alive = loop.scorer.tallies["fallen"] == 0
        self._terms[alive, step] = loop.scorer.terms[alive]
        self._sample[:, step] = loop.clocks["sample"]
        self._origin[:, step] = loop.clocks["origin"]
        if self._estimate is not None and loop.observer is not None:
            self._estimate[:, step] = loop.observer.estimator.observation
        if self._reading is not None and loop.observer is not None:
            self._reading[:, step] = loop.observer.sensors.reading

    def log(self) -> Log:
        demonstration = demonstration_in_world(self._loop.table, self._sample, self._origin)
        return Log(
            rate_hz=self._loop.controller.config.rate_hz,
            observation=self._observation,
            command=self._command,
            stance=self._stance,
            wanted=demonstration["contact"].astype(bool),
            force=self._force,
            solve_time=self._solve_time,
            terms=self._terms,
            demonstration=demonstration,
            estimate=self._estimate,
            reading=self._reading,
        )
