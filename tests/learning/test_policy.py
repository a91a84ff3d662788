"""A policy's file and its answers."""

from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import PolicyError
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE
from fastmimic.learning.policy import ACTIVATIONS, Policy
from fastmimic.robot import load_robot
from fastmimic.runs.loading import load_motion
from learning.hand_made import actions_of, follower, random_policy

FUNCTIONS = {
    "none": lambda x: x,
    "relu": lambda x: np.maximum(x, 0),
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
    "tanh": np.tanh,
}


def plain(policy: Policy, seen: np.ndarray) -> np.ndarray:
    x = (seen - policy.mean) / policy.deviation
    for weight, bias in zip(policy.weights[:-1], policy.biases[:-1], strict=True):
        x = FUNCTIONS[policy.activation](x @ weight + bias)
    return np.asarray(x @ policy.weights[-1] + policy.biases[-1])


@pytest.mark.nojit
@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("hidden", [(), (8,), (24, 16, 8)])
def test_a_policy_answers_as_its_layers_say(activation: str, hidden: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    policy = random_policy(rng, hidden, activation)
    seen = rng.normal(size=(3, OBSERVATION_SIZE)).astype(np.float32)
    assert actions_of(policy, seen) == pytest.approx(plain(policy, seen.astype(float)), rel=1e-9, abs=1e-9)
    assert np.array_equal(actions_of(policy, seen)[1:2], actions_of(policy, seen[1:2]))  # whoever stands beside


def test_a_file_holds_the_whole_policy(tmp_path: Path) -> None:
    policy = random_policy(np.random.default_rng(1))
    policy.save(tmp_path / "policy.npz")
    again = Policy.load(tmp_path / "policy.npz")
    assert all(np.array_equal(a, b) for a, b in zip(policy.weights, again.weights, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(policy.biases, again.biases, strict=True))
    for name in ("robot", "motion", "samples", "activation", "config", "seed", "about", "digest", "sizes", "training"):
        assert getattr(again, name) == getattr(policy, name)
    assert again.training["steps"] == 7
    other = random_policy(np.random.default_rng(2))
    assert other.digest != policy.digest
    with np.load(tmp_path / "policy.npz", allow_pickle=False) as file:  # nothing in it needs a pickle
        assert {"format_version", "meta_json", "mean", "deviation", "weight0", "bias0"} <= set(file.files)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, "not readable"),
        ({"weight0": None}, "not a FastMimic policy"),
        ({"mean": None}, "'mean' is missing"),
        ({"meta_json": np.str_("{}")}, "'robot' is missing"),
        ({"meta_json": np.str_("{")}, "Expecting property name"),
        ({"format_version": np.int64(9)}, "format version 9; this release reads version 2"),
        ({"format_version": np.float64("inf")}, "cannot convert float infinity to integer"),
        ({"meta_json": np.str_('{"seed": Infinity}')}, "Infinity is no finite number"),
        ({"weight1": np.zeros((3, 3), np.float32)}, "do not fit together"),
        ({"bias0": np.full(24, np.nan, np.float32)}, "not finite"),
    ],
)
def test_a_damaged_file_is_named_with_what_is_wrong(
    tmp_path: Path, change: dict[str, np.ndarray | None], message: str
) -> None:
    path = tmp_path / "policy.npz"
    random_policy(np.random.default_rng(3)).save(path)
    if not change:
        path.write_bytes(path.read_bytes()[:500])
        message = "not a readable policy"
    else:
        with np.load(path) as file:
            arrays = {**file, **change}
        np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(PolicyError, match=message) as error:
        Policy.load(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_policy_of_another_release_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    random_policy(np.random.default_rng(4), hidden=()).save(path)
    with np.load(path) as file:
        arrays = dict(file)
    size = OBSERVATION_SIZE + 5
    arrays |= {"weight0": np.zeros((size, ACTION_SIZE)), "mean": np.zeros(size), "deviation": np.ones(size)}
    np.savez(path, **arrays)
    with pytest.raises(PolicyError, match=f"takes observations of {size} numbers.* have {OBSERVATION_SIZE} and 12"):
        Policy.load(path)
    with pytest.raises(PolicyError, match="no such file"):
        Policy.load(tmp_path / "none.npz")


def test_a_policy_is_for_one_robot_and_one_motion() -> None:
    robot, other = load_robot("a1"), load_robot("go1")
    motion, another = load_motion("side-step", robot), load_motion("trot", robot)
    policy = follower(robot, motion)
    policy.check(robot, motion)
    with pytest.raises(PolicyError, match="for robot 'a1', not for 'go1'"):
        policy.check(other, load_motion("side-step", other))
    with pytest.raises(PolicyError, match="imitates 'side-step', not 'trot'"):
        policy.check(robot, another)
    slower = load_motion("side-step", robot, speed=0.3)
    if slower.n_samples != motion.n_samples:
        with pytest.raises(PolicyError, match="samples"):
            policy.check(robot, slower)
