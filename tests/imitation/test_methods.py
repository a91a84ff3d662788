"""The registry of methods: what each changes, and that every name is known where a method can be given."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.control.config import CONFIGS, ControllerConfig, controller_config
from fastmimic.control.controller import Controller
from fastmimic.episode.loop import run_episodes
from fastmimic.imitation.evaluate import evaluate
from fastmimic.imitation.imitate import imitate
from fastmimic.imitation.methods import (
    METHODS,
    NOTHING,
    PAPER_METHODS,
    Method,
    controller_for,
    made_with,
)
from fastmimic.imitation.stitch import stitch
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import MadeWith, Provenance
from fastmimic.optimize.parameters import FOOT_HEIGHT
from fastmimic.primitive import MotionDmp
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from searches import QUICK_CHOICE


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
    own = {"stance.leg_momentum": base.stance.leg_momentum, "stance.feedback": base.stance.feedback == "regulator"}
    raibert = {"swing.foothold", *(name for name, differs in own.items() if differs)}
    claims = {"raibert": raibert, "lh": {"stance.forces"}, "lh-dmp": {"stance.forces"}}
    for name, method in METHODS.items():
        if name == "rl":
            continue
        assert differences(base, method.configure(base)) == claims.get(name, set())


def test_what_is_optimised() -> None:
    assert {name: METHODS[name].parameters for name in PAPER_METHODS} == {
        "raibert": NOTHING,
        "mbc": NOTHING,
        "lh": NOTHING,
        "mbc-dmp": FOOT_HEIGHT,
        "lh-dmp": FOOT_HEIGHT,
    }
    assert all(m.optimises == (m.parameters != NOTHING) for m in METHODS.values())


def test_a_method_before_its_optimisation() -> None:
    found = {name: method.unoptimised.name for name, method in METHODS.items() if method.optimises}
    assert found == {"mbc-dmp": "mbc", "lh-dmp": "lh", "mbc-dmp-path": "mbc", "mbc-dmp-body": "mbc"}
    assert all(method.unoptimised is method for method in METHODS.values() if not method.optimises)


class TestUsersMethods:
    @pytest.fixture(autouse=True)
    def registered(self) -> Iterator[None]:
        """A change of the model-based controller, and a controller of one's own that commands nothing else."""

        def stiff(config: ControllerConfig) -> ControllerConfig:
            swing = dataclasses.replace(config.swing, foothold="raibert")
            return dataclasses.replace(config, swing=swing)

        def copied(robot: Robot, demonstration: Motion, n: int, config: ControllerConfig) -> Controller:
            return Controller(robot, [demonstration], n, config)

        METHODS.register(Method("mine", "Mine", "another foothold", change=stiff))
        METHODS.register(Method("copy", "Copy", "mbc under another name", controller=copied))
        yield
        METHODS.pop("mine")
        METHODS.pop("copy")

    def test_they_are_imitated_and_evaluated_with(self) -> None:
        mine, copy, mbc = (evaluate("trot", method=name, duration_s=0.4) for name in ("mine", "copy", "mbc"))
        assert mine.config.swing.foothold == "raibert"
        assert copy.rollout.reward[0] == mbc.rollout.reward[0] != mine.rollout.reward[0]
        assert imitate("trot", method="copy", duration_s=0.4).after.reward[0] == mbc.rollout.reward[0]

    def test_a_controller_of_ones_own_follows_the_demonstration_alone(self) -> None:
        with pytest.raises(ConfigError, match="cannot optimise"):
            Method("x", "X", "", FOOT_HEIGHT, controller=METHODS["copy"].controller)


def test_an_unknown_method_is_refused_with_the_closest() -> None:
    with pytest.raises(ConfigError, match=r"unknown method 'lhdmp'; there are rl, raibert, .*mean 'lh-dmp'"):
        METHODS["lhdmp"]
    with pytest.raises(ConfigError, match="unknown parameters 'everything'; there are none, foot-height"):
        Method("x", "X", "", "everything", lambda config: config)


@pytest.mark.parametrize("name", sorted(PAPER_METHODS))
def test_imitation_by_every_method(name: str) -> None:
    robot = load_robot("a1")
    motion = load_motion("trot", robot)
    few = {"duration_s": 0.6, "iterations": 2, "population": 4, "choice": QUICK_CHOICE}
    result = imitate(motion, robot, method=name, workers=1, **few)  # type: ignore[arg-type]
    method = METHODS[name]
    assert result.method == name
    assert result.config == method.configure(controller_config("default"))
    assert (result.history is not None) == method.optimises
    again = evaluate(result.motion, robot, method=name, duration_s=0.6)
    assert again.rollout.reward[0] == result.after.reward[0]
    assert result.demonstration.provenance.made_with is None, "a demonstration is nobody's"
    if method.optimises:
        assert result.motion.provenance.made_with == MadeWith(name, "default")
        alike = evaluate(result.motion, robot, duration_s=0.6)
        assert alike.rollout.reward[0] == result.after.reward[0], "what nothing is said of is as it was made"
        assert (alike.method, alike.config) == (name, result.config)
    else:
        assert result.motion is motion
        alone = run_episodes(robot, motion, duration_s=0.6, config=result.config)
        assert alone.reward[0] == result.before.reward[0]


def test_an_evaluation_takes_the_methods_controller() -> None:
    rewards = {name: evaluate("trot", method=name, duration_s=0.6).rollout.reward[0] for name in PAPER_METHODS}
    assert rewards["mbc"] == rewards["mbc-dmp"]
    assert rewards["lh"] == rewards["lh-dmp"]
    assert len(set(rewards.values())) == 3


@pytest.mark.parametrize("gait", ["trot", "pace", "turn", "side-step", "walk", "bound", "backward-trot", "spin"])
def test_raibert_runs_every_built_in_gait_whether_it_falls_or_not(gait: str) -> None:
    episode = evaluate(gait, method="raibert", duration_s=2.0).rollout
    assert 0 < episode.reward[0] < 1
    assert episode.qp_failures[0] == 0


@pytest.fixture(scope="module")
def trot() -> Motion:
    return load_motion("trot")


class TestMadeWith:
    """A motion remembers with which method and controller it was optimised."""

    def test_a_motion_that_says_nothing_is_run_by_mbc_and_the_default_controller(self, trot: Motion) -> None:
        assert controller_for(trot) == (METHODS["mbc"], controller_config("default"))

    def test_what_is_given_goes_before_what_the_motion_says(self, trot: Motion) -> None:
        of = made_with(trot, "lh-dmp", METHODS["lh-dmp"].configure(controller_config("paper")))
        assert trot.provenance == dataclasses.replace(of.provenance, made_with=None)
        assert controller_for(of) == (METHODS["lh-dmp"], METHODS["lh"].configure(controller_config("paper")))
        assert controller_for(of, "mbc") == (METHODS["mbc"], controller_config("paper"))
        assert controller_for(of, config="default")[1] == METHODS["lh"].configure(controller_config("default"))

    def test_it_survives_the_file(self, trot: Motion, tmp_path: Path) -> None:
        of = made_with(trot, "lh-dmp", METHODS["lh-dmp"].configure(controller_config("default")))
        of.save(tmp_path / "motion.npz")
        assert controller_for(Motion.load(tmp_path / "motion.npz")) == controller_for(of)

    def test_parameters_that_no_set_has_are_not_replaced_by_others(self, trot: Motion) -> None:
        config = controller_config("default")
        own = dataclasses.replace(config, stance=dataclasses.replace(config.stance, friction=0.3))
        of = made_with(trot, "mbc-dmp", own)
        with pytest.raises(ConfigError, match=r"'trot' was optimised with .* of its own.*default, p"):
            controller_for(of)
        assert controller_for(of, config=own) == (METHODS["mbc-dmp"], own)
        assert controller_for(of, config="default")[1] == config

    @pytest.mark.parametrize("record", ["mbc", {}, {"method": "mbc"}])
    def test_a_damaged_record_is_one_clear_error(self, trot: Motion, record: object) -> None:
        with pytest.raises(MotionError, match=r"provenance: .*made_with"):
            Provenance.from_dict(trot.provenance.as_dict() | {"made_with": record})

    @pytest.mark.slow
    def test_a_stitched_motion_that_nothing_was_optimised_of_remembers_the_run(self, trot: Motion) -> None:
        robot = load_robot("a1")
        dmp = MotionDmp.fit(trot, robot)
        optimised = made_with(dmp.motion(dmp.goal, dmp.amplitude), "mbc-dmp", controller_config("default"))
        result = stitch([optimised, trot], robot, cycles=2, method="lh")
        assert result.motion.provenance.made_with == MadeWith("lh", "default")
        assert result.demonstration.provenance.made_with is None
        assert all(part.provenance.made_with is None for part in result.demonstration.parts)
        assert stitch([trot, trot], robot, cycles=2, method="lh").motion.provenance.made_with is None
        alike = evaluate(result.motion, robot)
        assert alike.rollout.reward[0] == pytest.approx(result.after.reward[0], abs=1e-12)
