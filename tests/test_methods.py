"""The registry of methods: what each changes, and that every name is known where a method can be given."""

import dataclasses

import pytest

from fastmimic.control.config import CONFIGS, controller_config
from fastmimic.errors import ConfigError
from fastmimic.imitation.rollout import run_episodes
from fastmimic.methods import FOOT_HEIGHT, METHODS, NOTHING, Method, method_named
from fastmimic.optimize import cma_es
from fastmimic.pipeline import evaluate, imitate, load_motion
from fastmimic.robot import load_robot


def differences(a: object, b: object, prefix: str = "") -> set[str]:
    """The fields in which two configurations differ, by their path."""
    found = set()
    for field in dataclasses.fields(a):  # type: ignore[arg-type]
        one, other = getattr(a, field.name), getattr(b, field.name)
        if dataclasses.is_dataclass(one):
            found |= differences(one, other, f"{prefix}{field.name}.")
        elif one != other:
            found.add(prefix + field.name)
    return found


@pytest.mark.parametrize("config", sorted(CONFIGS))
def test_each_method_changes_only_what_its_name_claims(config: str) -> None:
    base = controller_config(config)
    raibert = {"swing.foothold"} | ({"stance.leg_momentum"} if base.stance.leg_momentum else set())
    claims = {"raibert": raibert, "lh": {"stance.forces"}, "lh-dmp": {"stance.forces"}}
    for name, method in METHODS.items():
        assert differences(base, method.configure(base)) == claims.get(name, set())


def test_what_is_optimised() -> None:
    assert {name: m.parameters for name, m in METHODS.items()} == {
        "raibert": NOTHING,
        "mbc": NOTHING,
        "lh": NOTHING,
        "mbc-dmp": FOOT_HEIGHT,
        "lh-dmp": FOOT_HEIGHT,
    }
    assert all(m.optimises == (m.parameters != NOTHING) for m in METHODS.values())


def test_an_unknown_method_is_refused_with_the_closest() -> None:
    with pytest.raises(ConfigError, match=r"unknown method 'lhdmp'; there are raibert, mbc, .*did you mean 'lh-dmp'"):
        method_named("lhdmp")
    with pytest.raises(ConfigError, match="unknown parameters 'everything'; there are none, foot-height"):
        Method("x", "X", "", "everything", lambda config: config)


@pytest.mark.parametrize("name", sorted(METHODS))
def test_imitation_by_every_method(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cma_es, "VALIDATION_S", 0.4)
    robot = load_robot("a1")
    motion = load_motion("trot", robot)
    result = imitate(motion, robot, method=name, duration_s=0.6, iterations=2, population=4, workers=1)
    method = METHODS[name]
    assert result.method == name
    assert result.config == method.configure(controller_config("default"))
    assert (result.history is not None) == method.optimises
    again = evaluate(result.motion, robot, method=name, duration_s=0.6)
    assert again.rollout.reward[0] == result.after.reward[0]
    if not method.optimises:
        assert result.motion is motion
        alone = run_episodes(robot, motion, duration_s=0.6, config=result.config)
        assert alone.reward[0] == result.before.reward[0]


def test_an_evaluation_takes_the_methods_controller() -> None:
    rewards = {name: evaluate("trot", method=name, duration_s=0.6).rollout.reward[0] for name in METHODS}
    assert rewards["mbc"] == rewards["mbc-dmp"]
    assert rewards["lh"] == rewards["lh-dmp"]
    assert len(set(rewards.values())) == 3


@pytest.mark.parametrize("gait", ["trot", "pace", "turn", "side-step", "walk", "bound", "backward-trot", "spin"])
def test_raibert_runs_every_built_in_gait_whether_it_falls_or_not(gait: str) -> None:
    episode = evaluate(gait, method="raibert", duration_s=2.0).rollout
    assert 0 < episode.reward[0] < 1
    assert episode.qp_failures[0] == 0
