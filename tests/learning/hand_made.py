"""Policies without any training."""

from itertools import pairwise

import numpy as np

from fastmimic.learning.config import ACTION_SIZE, FRAME_SIZE, HISTORY, IMU_SIZE, OBSERVATION_SIZE, PolicyConfig
from fastmimic.learning.policy import Policy, infer
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

FRAMES_AT = HISTORY * (IMU_SIZE + 24)
"""Where the target frames begin in an observation."""
JOINTS_AT = 7
"""Where the joints begin in a frame."""


def follower(robot: Robot, motion: Motion, seed: int = 0) -> Policy:
    """A linear policy whose joint targets are the reference's, extrapolated from its next two frames by another one,
    because the low-pass filter is late by about as much."""
    config = PolicyConfig()
    weight = np.zeros((OBSERVATION_SIZE, ACTION_SIZE), np.float32)
    for j in range(ACTION_SIZE):
        weight[FRAMES_AT + JOINTS_AT + j, j] = -1 / config.action_scale
        weight[FRAMES_AT + FRAME_SIZE + JOINTS_AT + j, j] = 2 / config.action_scale
    return Policy(
        (weight,),
        ((-robot.home_joint_pos / config.action_scale).astype(np.float32),),
        np.zeros(OBSERVATION_SIZE, np.float32),
        np.ones(OBSERVATION_SIZE, np.float32),
        robot.name,
        motion.name,
        motion.n_samples,
        activation="none",
        config=config,
        seed=seed,
    )


def actions_of(policy: Policy, seen: np.ndarray) -> np.ndarray:
    """Actions (n, 12) for observations (n, `OBSERVATION_SIZE`)."""
    actions = np.zeros((len(seen), ACTION_SIZE))
    infer(policy.network(), seen, actions)
    return actions


def random_policy(rng: np.random.Generator, hidden: tuple[int, ...] = (24, 16), activation: str = "elu") -> Policy:
    """For a robot and a motion that nobody has."""
    sizes = (OBSERVATION_SIZE, *hidden, ACTION_SIZE)
    layers = [rng.normal(0, 0.2, pair).astype(np.float32) for pair in pairwise(sizes)]
    return Policy(
        tuple(layers),
        tuple(rng.normal(0, 0.2, layer.shape[1]).astype(np.float32) for layer in layers),
        rng.normal(size=OBSERVATION_SIZE).astype(np.float32),
        rng.uniform(0.5, 2, OBSERVATION_SIZE).astype(np.float32),
        "nobody",
        "nothing",
        100,
        activation=activation,
        about={"library": "none", "training": {"steps": 7, "wall_s": 1.5}},
    )
