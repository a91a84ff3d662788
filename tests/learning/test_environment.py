"""Gymnasium's environments."""

import warnings

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError, FastMimicError

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed: pip install 'fastmimic[rl]'")

import fastmimic.learning  # noqa: E402, F401  registers the environment
from fastmimic.episode.reward import TERMS, WEIGHTS  # noqa: E402
from fastmimic.learning.environment import ImitationEnv, ImitationVectorEnv  # noqa: E402

ENVIRONMENT = "fastmimic/Imitation-v0"


@pytest.mark.slow
def test_it_is_registered_and_passes_gymnasiums_checks() -> None:
    from gymnasium.utils.env_checker import check_env

    env = gymnasium.make(ENVIRONMENT, motion="trot", robot="a1").unwrapped
    assert isinstance(env, ImitationEnv)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env)
    advice = ("recommend using a symmetric", "probably too low", "probably too high")
    assert all(any(text in str(w.message) for text in advice) for w in caught), [str(w.message) for w in caught]


@pytest.mark.parametrize("randomize", [(), ("friction=0.4:1.2", "com-x=-0.03:0.03")])
def test_a_seed_gives_the_same_episode_again(randomize: tuple[str, ...]) -> None:
    env = gymnasium.make(ENVIRONMENT, motion="side-step", randomize=randomize)
    env.action_space.seed(0)
    actions = [0.2 * env.action_space.sample() for _ in range(8)]

    def episode(seed: int | None) -> list[tuple[np.ndarray, float]]:
        seen, _ = env.reset(seed=seed)
        return [(seen, 0.0), *((step[0], float(step[1])) for step in map(env.step, actions))]

    first, again, other = episode(1), episode(1), episode(None)
    assert all(np.array_equal(a[0], b[0]) and a[1] == b[1] for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[-1][0], other[-1][0])


def test_a_step_says_what_the_reward_is_made_of() -> None:
    env = gymnasium.make(ENVIRONMENT, motion="side-step", perturbed=False)
    env.reset(seed=0)
    _, reward, fell, ended, info = env.step(np.zeros(12, np.float32))
    assert set(info["terms"]) == set(TERMS)
    assert 0 < reward <= 1
    assert sum(w * info["terms"][t] for w, t in zip(WEIGHTS, TERMS, strict=True)) == pytest.approx(reward, abs=0.3)
    assert (fell, ended) == (False, False)


def test_n_robots_at_once() -> None:
    n = 4
    env = gymnasium.make_vec(ENVIRONMENT, num_envs=n, motion="side-step", threads=2, duration_s=0.3)
    assert isinstance(env.unwrapped, ImitationVectorEnv)
    seen, info = env.reset(seed=3)
    assert seen.shape == (n, 160)
    assert seen in env.observation_space
    assert info == {}
    for step in range(9):
        seen, reward, fell, ended, info = env.step(np.zeros((n, 12), np.float32))
        assert reward.shape == fell.shape == ended.shape == (n,)
        assert seen in env.observation_space
        assert bool(info) == (step == 8)
    assert ended.all()
    assert info["final_obs"].shape == (n, 160)
    assert info["_final_obs"].all()
    assert np.all(info["episode"]["score"] > 0)
    assert info["episode"]["steps"].tolist() == [9] * n
    env.close()


def test_bad_input_is_one_line() -> None:
    with pytest.raises(ConfigError, match="did you mean 'friction'"):
        ImitationEnv("trot", randomize=("fricton=0:1",))
    with pytest.raises(FastMimicError, match="trott"):
        ImitationEnv("trott")
    with pytest.raises(FastMimicError, match="a2"):
        ImitationVectorEnv(2, "trot", "a2")
