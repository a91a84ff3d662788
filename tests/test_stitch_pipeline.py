"""`fm.stitch`: from motions, files and folders of runs to one optimised motion."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import fastmimic as fm
from control.motions import gait
from fastmimic.errors import ConfigError
from fastmimic.motion.motion import Motion
from fastmimic.optimize import cma_es
from fastmimic.primitive import MotionDmp
from fastmimic.robot import Robot, load_robot
from fastmimic.stitching import usual_population

FEW = {"iterations": 1, "population": 4, "part_iterations": 1, "workers": 1}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("a1")


@pytest.fixture(scope="module")
def walk(robot: Robot) -> Motion:
    motion = gait(robot, (0.3, 0.0), n_samples=200)
    return dataclasses.replace(motion, meta={**motion.meta, "name": "walk"})


@pytest.fixture(scope="module")
def optimised(robot: Robot) -> Motion:
    """As if it had been optimised: its feet lift higher."""
    motion = gait(robot, (0.2, 0.0), 0.5, n_samples=220)
    dmp = MotionDmp.fit(dataclasses.replace(motion, meta={**motion.meta, "name": "turn"}), robot)
    amplitude = dmp.amplitude
    amplitude[[14, 17, 20, 23]] = 1.25
    return dmp.motion(dmp.goal, amplitude)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cma_es, "VALIDATED", 1)
    monkeypatch.setattr(cma_es, "VALIDATION_EPISODES", 1)
    monkeypatch.setattr(cma_es, "VALIDATION_S", 0.4)


def test_motions_are_optimised_by_themselves_unless_they_are_already(
    walk: Motion, optimised: Motion, robot: Robot, tmp_path: Path
) -> None:
    run = tmp_path / "turn-run"
    optimised.save(run / "motion.npz")
    said: list[str] = []
    result = fm.stitch([walk, run, walk], robot, cycles=3, stage=said.append, **FEW)
    assert said == ["stitching walk, turn, walk", "walk by itself, 1 of 2", "all together"]
    assert [s["motion"] for s in result.metrics()["segments"]] == ["walk", "turn", "walk"]
    assert len(result.parameters) == 24
    names = [p.name for p in result.parameters]
    # scored against the motion as it was retargeted, begun from where it was optimised to
    assert result.parameters[names.index("2:turn/FR_foot_z.amplitude")].initial == 1.0
    assert not result.after.fell[0]
    assert result.motion.demonstration is not None
    assert [part.name for part in result.demonstration.parts] == ["walk", "turn"]
    np.testing.assert_array_equal(result.demonstration.parts[1].joint_pos, optimised.target.joint_pos)
    assert result.individual.reward[0] != result.before.reward[0]
    lift = result.individual.parts[1].clearance[0] / result.before.parts[1].clearance[0]
    assert lift.mean() > 1.1


def test_without_an_optimisation_it_is_the_demonstration_that_runs(
    walk: Motion, optimised: Motion, robot: Robot
) -> None:
    result = fm.stitch([walk, optimised], robot, cycles=[3, 4], method="mbc")
    assert result.history is None
    assert result.motion is result.demonstration
    assert result.metrics()["individual_optima"]["reward"] == result.metrics()["reward"]["before"]
    assert [s["cycles"] for s in result.metrics()["segments"]] == [3, 4]
    assert result.duration_s == pytest.approx((result.motion.n_samples - 1) / 500)


class TestBadInput:
    def test_a_name_instead_of_a_list(self) -> None:
        with pytest.raises(ConfigError, match="takes a list of motions, found 'trot'"):
            fm.stitch("trot")

    def test_settings_are_refused_before_anything_takes_long(self, walk: Motion) -> None:
        said: list[str] = []
        with pytest.raises(ConfigError, match="iterations must be at least 1"):
            fm.stitch([walk, walk], iterations=0, part_iterations=1000, stage=said.append)
        assert said == []


def test_the_usual_population() -> None:
    assert [usual_population(k) for k in (8, 24)] == [10, 13]
