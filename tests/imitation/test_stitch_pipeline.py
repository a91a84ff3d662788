"""`fm.stitch`: from motions, files and folders of runs to one optimised motion."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fastmimic as fm
from control.motions import gait
from fastmimic.base.errors import CheckpointError, ConfigError
from fastmimic.motion.motion import Motion
from fastmimic.optimize.parameters import FinalChoice
from fastmimic.optimize.stitched import segment_clearance
from fastmimic.primitive import MotionDmp
from fastmimic.robot import Robot
from fastmimic.stitching.transition import Layout
from searches import PART_DURATION_S

FEW: dict[str, Any] = {
    "iterations": 1,
    "population": 4,
    "part_iterations": 1,
    "workers": 1,
    "choice": FinalChoice(1, 1, duration_s=0.4),
    "part_duration_s": PART_DURATION_S,
}


@pytest.fixture(scope="module")
def walk(robot: Robot) -> Motion:
    motion = gait(robot, (0.3, 0.0), n_samples=200)
    return dataclasses.replace(motion, provenance=dataclasses.replace(motion.provenance, name="walk"))


@pytest.fixture(scope="module")
def optimised(robot: Robot) -> Motion:
    """As if it had been optimised: its feet lift higher."""
    motion = gait(robot, (0.2, 0.0), 0.5, n_samples=220)
    provenance = dataclasses.replace(motion.provenance, name="turn")
    dmp = MotionDmp.fit(dataclasses.replace(motion, provenance=provenance), robot)
    amplitude = dmp.amplitude
    amplitude[[14, 17, 20, 23]] = 1.25
    return dmp.motion(dmp.goal, amplitude)


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("method", ["mbc", "raibert"])
def test_without_an_optimisation_optimised_motions_keep_their_parameters(
    walk: Motion, optimised: Motion, robot: Robot, method: str
) -> None:
    result = fm.stitch([walk, optimised], robot, cycles=[3, 4], method=method)
    assert result.history is None
    found = {p.name: v for p, v in zip(result.parameters, result.values, strict=True)}
    assert found["1:walk/FR_foot_z.amplitude"] == 1.0
    assert found["2:turn/FR_foot_z.amplitude"] == 1.25
    assert result.motion.provenance.stitched.parameters == found
    assert result.motion.demonstration is result.demonstration
    lift = result.motion.foot_pos_b[..., 2].max() - result.demonstration.foot_pos_b[..., 2].max()
    assert lift > 0.005, "the feet of what is saved lift as high as they were optimised to"
    metrics = result.metrics()
    assert metrics["reward"]["before"] == metrics["reward"]["after"] == metrics["individual_optima"]["reward"]
    if method == "mbc":  # what ran is what is saved
        clearance = result.after.parts[1].clearance[0] / segment_clearance_of(result.demonstration, robot)[1]
        assert clearance.mean() > 1.1
    assert result.after.log is not None


def segment_clearance_of(motion: Motion, robot: Robot) -> np.ndarray:
    return segment_clearance(motion, robot.foot_radius, Layout.of(motion))


def test_without_an_optimisation_at_all_it_is_the_demonstration_that_runs(walk: Motion, robot: Robot) -> None:
    result = fm.stitch([walk, walk], robot, cycles=[3, 4], method="mbc")
    assert result.history is None
    assert result.motion is result.demonstration
    assert result.metrics()["individual_optima"]["reward"] == result.metrics()["reward"]["before"]
    assert [s["cycles"] for s in result.metrics()["segments"]] == [3, 4]
    assert result.duration_s == pytest.approx((result.motion.n_samples - 1) / 500)


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def finished(walk: Motion, robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run. Not to be changed."""
    folder = tmp_path_factory.mktemp("finished")
    fm.stitch([walk, walk], robot, cycles=3, folder=folder, **FEW)
    return folder


class TestResume:
    @pytest.fixture
    def run(self, finished: Path, tmp_path: Path) -> Path:
        return Path(shutil.copytree(finished, tmp_path / "run"))

    @pytest.mark.slow
    def test_the_time_before_it_counts(self, walk: Motion, robot: Robot, run: Path) -> None:
        for name, elapsed in (("checkpoint-1.npz", 1000.0), ("checkpoint.npz", 5000.0)):
            with np.load(run / name) as file:
                arrays = {key: file[key] for key in file.files}
            np.savez(run / name, **(arrays | {"elapsed_s": np.float64(elapsed)}))
        result = fm.stitch([walk, walk], robot, cycles=3, folder=run, resume=True, **FEW)
        assert 6000.0 < result.wall_s < 7000.0

    @pytest.mark.slow
    def test_more_iterations_of_the_whole_do_not_change_where_it_begins(
        self, walk: Motion, robot: Robot, run: Path
    ) -> None:
        before = files(run)
        more = FEW | {"iterations": 2, "part_iterations": None}
        result = fm.stitch([walk, walk], robot, cycles=3, folder=run, resume=True, **more)
        assert result.iterations == 2
        assert files(run)["checkpoint-1.npz"] == before["checkpoint-1.npz"]

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"cycles": 4}, r"checkpoint\.npz: this checkpoint is of another problem"),
            ({"seed": 1}, r"checkpoint-1\.npz: this checkpoint is of another problem"),
            ({"part_iterations": 2}, "the whole was begun from 1 iterations of 'walk' by itself, not 2"),
        ],
    )
    def test_with_other_arguments_every_checkpoint_stays(
        self, walk: Motion, robot: Robot, run: Path, changes: dict[str, Any], message: str
    ) -> None:
        before = files(run)
        with pytest.raises(CheckpointError, match=message) as caught:
            fm.stitch([walk, walk], robot, folder=run, resume=True, **({"cycles": 3} | FEW | changes))
        assert files(run) == before
        if "checkpoint" in message:
            assert str(caught.value).startswith(str(run)), "the file that was given, not a copy"

    @pytest.mark.slow
    def test_a_run_begun_anew_leaves_nothing_of_the_old_one_to_resume(
        self, walk: Motion, robot: Robot, run: Path
    ) -> None:
        def stop(progress: object) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fm.stitch([walk, walk], robot, cycles=4, folder=run, progress=stop, **FEW)
        assert [path.name for path in run.iterdir()] == ["checkpoint-1.npz"]
        assert fm.stitch([walk, walk], robot, cycles=4, folder=run, resume=True, **FEW).iterations == 1


class TestBadInput:
    def test_a_name_instead_of_a_list(self) -> None:
        with pytest.raises(ConfigError, match="takes a list of motions, found 'trot'"):
            fm.stitch("trot")

    def test_settings_are_refused_before_anything_takes_long(self, walk: Motion) -> None:
        said: list[str] = []
        with pytest.raises(ConfigError, match="iterations must be at least 1"):
            fm.stitch([walk, walk], iterations=0, part_iterations=1000, stage=said.append)
        assert said == []

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"workers": 0}, "workers must be at least 1, found 0"),
            ({"cycles": 0}, "every motion needs at least one cycle, found 0$"),
            ({"cycles": [2, -1]}, "every motion needs at least one cycle, found -1 for 'walk'"),
            ({"cycles": 751}, "would be longer than 600 s: fewer cycles than 751, 751"),
            ({"cycles": 10**400}, "would be longer than 600 s"),
        ],
    )
    def test_numbers_that_cannot_be(self, walk: Motion, given: dict[str, Any], message: str, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match=message):
            fm.stitch([walk, walk], folder=tmp_path / "out", **given)
        assert not (tmp_path / "out").exists()
