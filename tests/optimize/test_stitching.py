"""All segments' parameters at once, over the whole of a stitched motion."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from control.motions import gait
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.plan import nominal_start
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings, optimize
from fastmimic.optimize.parameters import needed_group
from fastmimic.optimize.problem import ImitationProblem, Problem, clearance_penalty
from fastmimic.optimize.stitched import (
    StitchedProblem,
    make_problem,
    parameters_of,
    segment_clearance,
)
from fastmimic.primitive import MotionDmp
from fastmimic.reference.table import reference_table
from fastmimic.robot import Robot
from fastmimic.stitching.join import stitch_motions
from fastmimic.stitching.transition import Layout
from searches import QUICK_CHOICE

LEGS_Z = 8  # parameters of a segment


@pytest.fixture(scope="module")
def stitched(robot: Robot) -> Motion:
    """Two short segments of a slow trot and a turning one."""
    walk = gait(robot, (0.3, 0.0), n_samples=200)
    turn = gait(robot, (0.2, 0.0), 0.6, n_samples=220)
    named = [
        dataclasses.replace(m, provenance=dataclasses.replace(m.provenance, name=n))
        for m, n in ((walk, "walk"), (turn, "turn"))
    ]
    return stitch_motions(robot, named, [3, 3])


@pytest.fixture(scope="module")
def make(robot: Robot, stitched: Motion) -> Callable[..., StitchedProblem]:
    def problem(workers: int = 1, **given: object) -> StitchedProblem:
        return StitchedProblem(robot, stitched, workers=workers, **given)  # type: ignore[arg-type]

    return problem


@pytest.fixture(scope="module")
def whole(make: Callable[..., StitchedProblem]) -> StitchedProblem:
    return make()


def candidates(problem: Problem, n: int, seed: int = 0) -> np.ndarray:
    lower, upper = problem.bounds
    return lower + np.random.default_rng(seed).uniform(0.3, 0.7, (n, len(lower))) * (upper - lower)


def named(problem: StitchedProblem, x: np.ndarray) -> list[dict[str, float]]:
    """Each segment's parameters by name."""
    return [
        {p.name: float(v) for p, v in zip(segment.parameters, own, strict=True)}
        for segment, own in zip(problem.segments, problem.of_segments(x), strict=True)
    ]


class TestParameters:
    def test_each_segment_has_its_own(self, whole: StitchedProblem) -> None:
        assert len(whole.parameters) == 2 * LEGS_Z
        assert whole.parameters[0].name == "1:walk/FR_foot_z.goal"
        assert whole.parameters[LEGS_Z + 4].name == "2:turn/FR_foot_z.amplitude"

    def test_occurrences_of_one_motion_are_told_apart(self, robot: Robot, stitched: Motion) -> None:
        walk = stitched.parts[0]
        twice = StitchedProblem(robot, stitch_motions(robot, [walk, walk], [2, 2]), workers=1)
        assert len({p.name for p in twice.parameters}) == 2 * LEGS_Z

    def test_the_search_begins_where_it_is_told(self, make: Callable[..., StitchedProblem]) -> None:
        x = candidates(make(), 1)[0]
        np.testing.assert_array_equal(make(start=named(make(), x)).start, x)
        np.testing.assert_array_equal(make().start, make().initial)
        _, upper = make().bounds
        np.testing.assert_array_equal(make(start=named(make(), upper + 1)).start, upper)
        assert make(start=named(make(), x)).identity != make().identity

    def test_a_start_of_something_else(self, make: Callable[..., StitchedProblem]) -> None:
        with pytest.raises(ConfigError, match="the start is of 1 segments; the motion has 2"):
            make(start=[{}])
        with pytest.raises(ConfigError, match=r"names 2:.*/FR_foot_x.goal, which is not optimised here"):
            make(start=[{}, {"FR_foot_x.goal": 0.1}])

    def test_a_group_opens_more_of_each_segment(self, make: Callable[..., StitchedProblem]) -> None:
        assert len(make(group="foot-path").parameters) == 2 * 24
        with pytest.raises(ConfigError, match=r"unknown parameters 'foot-paths'; .*did you mean 'foot-path'"):
            make(group="foot-paths")


class TestReferences:
    def test_candidates_are_the_motions_that_they_stand_for(self, whole: StitchedProblem, robot: Robot) -> None:
        x = candidates(whole, 2)
        tables = whole.tables(x)
        for i in range(2):
            expected = reference_table(whole.motion(x[i]), robot)
            for name in expected.dtype.names or ():
                np.testing.assert_allclose(tables[i][name], expected[name], atol=1e-9, err_msg=name)

    def test_the_initial_candidate_is_the_demonstration_but_for_the_fit(
        self, whole: StitchedProblem, stitched: Motion
    ) -> None:
        motion = whole.motion(whole.initial)
        np.testing.assert_allclose(motion.joint_pos, stitched.joint_pos, atol=0.03)
        np.testing.assert_allclose(motion.root_pos_w, stitched.root_pos_w, atol=1e-3)
        np.testing.assert_array_equal(motion.contact, stitched.contact)
        assert motion.demonstration is stitched
        assert motion.cycle is None

    def test_a_segments_parameters_move_its_own_feet_and_no_others(self, whole: StitchedProblem) -> None:
        x = whole.initial
        x[LEGS_Z + 5] = 1.3  # FL's amplitude in the second
        changed, original = whole.tables(np.stack([x, whole.initial]))
        moved = np.abs(changed["foot_pos"] - original["foot_pos"]).max(axis=-1)
        second = whole.layout.segments[1]
        assert second.feet is not None
        assert moved[: second.feet[1].start].max() == 0
        assert moved[second.feet[1].end :, 1].max() > 3e-3
        assert moved[:, [0, 2, 3]].max() == 0

    def test_in_a_segment_it_is_the_single_motions_candidate(
        self, whole: StitchedProblem, robot: Robot, stitched: Motion
    ) -> None:
        x = candidates(whole, 1)
        table, segment = whole.tables(x)[0], whole.layout.segments[0]
        part = stitched.parts[0]
        single = ImitationProblem(robot, part, MotionDmp.fit(part, robot), workers=1).tables(x[:, :LEGS_Z])[0]
        at = np.arange(part.n_samples, 2 * part.n_samples)
        assert whole.layout.segments[1].rebuilt is not None
        at = at[at < whole.layout.segments[1].rebuilt.start]
        own = (at - segment.shift) % part.n_samples
        assert len(at) > 50
        np.testing.assert_allclose(table["foot_pos"][at], single["foot_pos"][own], atol=1e-12)
        np.testing.assert_allclose(table["joint_pos"][at], single["joint_pos"][own], atol=1e-9)


class TestScore:
    def test_it_is_the_segments_mean_by_their_length(self, whole: StitchedProblem) -> None:
        (rollout,) = whole.rollout(whole.tables(whole.initial[None]), nominal_start(1), whole.steps)
        assert len(rollout.parts) == 2
        lengths = np.array([p.duration_s for p in rollout.parts])
        rewards = np.array([p.reward[0] for p in rollout.parts])
        assert lengths.sum() == pytest.approx(rollout.duration_s)
        assert rewards @ lengths / lengths.sum() == pytest.approx(rollout.reward[0])
        penalty = [
            clearance_penalty(whole.objective, p, w)[0] for p, w in zip(rollout.parts, whole._clearance, strict=True)
        ]
        expected = rollout.reward[0] - np.array(penalty) @ lengths / lengths.sum()
        assert whole.score(rollout)[0] == pytest.approx(expected)

    def test_a_shuffle_in_one_segment_is_seen(self, whole: StitchedProblem) -> None:
        """Though the feet's mean clearance over the whole would pass."""
        x = whole.initial
        x[4:LEGS_Z], x[LEGS_Z + 4 :] = 0.7, 1.6
        (rollout,) = whole.rollout(whole.tables(x[None]), nominal_start(1), whole.steps)
        first, _ = (
            clearance_penalty(whole.objective, p, w)[0] for p, w in zip(rollout.parts, whole._clearance, strict=True)
        )
        assert first > 0.1
        assert whole.score(rollout)[0] < rollout.reward[0] - 0.05

    def test_who_falls_early_has_no_clearance_later_either(self, whole: StitchedProblem) -> None:
        (rollout,) = whole.rollout(whole.tables(whole.initial[None]), nominal_start(1), whole.steps)
        parts = list(rollout.parts)
        gone = np.zeros(1)
        parts[1] = dataclasses.replace(
            parts[1], reward=gone, steps=np.zeros(1, np.int64), clearance=np.full((1, 4), np.nan)
        )
        fell = dataclasses.replace(rollout, parts=tuple(parts), fell=np.array([True]))
        share = parts[1].duration_s / rollout.duration_s
        lost = whole.score(rollout)[0] - whole.score(fell)[0]
        assert lost > share * 4 * whole.objective.clearance_floor * whole.objective.clearance_weight

    def test_workers_do_not_matter(self, make: Callable[..., StitchedProblem], whole: StitchedProblem) -> None:
        x = candidates(whole, 4)
        assert make(workers=3).evaluate(x).tobytes() == whole.evaluate(x).tobytes()

    def test_validation_begins_at_the_beginning(self, whole: StitchedProblem, stitched: Motion) -> None:
        start, steps = whole.validation(3, 10.0, np.random.default_rng(0))
        np.testing.assert_array_equal(start.sample, 0)
        assert steps == stitched.n_samples - 1
        assert not start.joint_offset[0].any()
        assert np.abs(start.joint_offset[1:]).max() > 0


class TestClearance:
    def test_each_segments_is_its_motions(self, stitched: Motion, robot: Robot) -> None:
        found = segment_clearance(stitched, robot.foot_radius, Layout.of(stitched))
        for own, part in zip(found, stitched.parts, strict=True):
            np.testing.assert_allclose(own, swing_clearance(part, robot.foot_radius), rtol=0.05)


def test_search_goes_on_from_the_motions_parameters(
    robot: Robot, stitched: Motion, whole: StitchedProblem, tmp_path: Path
) -> None:
    """Optimised, saved, loaded, and taken up again."""
    settings = CmaSettings(iterations=2, population=4, step_size=0.1, choice=QUICK_CHOICE)
    optimum = optimize(whole, settings)
    whole.motion(optimum.x).save(tmp_path / "motion.npz")
    loaded = Motion.load(tmp_path / "motion.npz")
    again = make_problem(robot, loaded, workers=1)
    assert isinstance(again, StitchedProblem)
    np.testing.assert_array_equal(again.start, optimum.x)
    np.testing.assert_array_equal(again.initial, whole.initial)
    rollout = run_episodes(robot, loaded, duration_s=100.0)
    assert rollout.duration_s == pytest.approx((stitched.n_samples - 1) / 500)
    (expected,) = whole.rollout(whole.tables(optimum.x[None]), nominal_start(1), whole.steps)
    np.testing.assert_allclose(rollout.reward, expected.reward, atol=1e-6)


def test_the_start_is_a_candidate_for_the_result(
    make: Callable[..., StitchedProblem], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if the search finds nothing."""
    x = candidates(make(), 1)[0]
    problem = make(start=named(make(), x))
    wanted = problem.tables(x[None])[0].tobytes()

    def scores(rows: np.ndarray) -> np.ndarray:
        return np.where((rows == x).all(axis=1), 0.5, np.where((rows == problem.initial).all(axis=1), 0.3, 0.1))

    monkeypatch.setattr(problem, "evaluate", scores)
    monkeypatch.setattr(problem, "scores", lambda tables, *_: np.full(1, float(tables[0].tobytes() == wanted)))
    optimum = optimize(problem, CmaSettings(iterations=1, population=4, choice=QUICK_CHOICE))
    np.testing.assert_array_equal(optimum.x, x)
    assert (optimum.score, optimum.validation, optimum.history.baseline) == (0.5, 1.0, 0.3)


class TestParametersOf:
    def test_an_optimised_motion_has_those_it_was_made_with(self, robot: Robot, stitched: Motion) -> None:
        part = stitched.parts[0]
        problem = ImitationProblem(robot, part, MotionDmp.fit(part, robot), workers=1)
        x = candidates(problem, 1)[0]
        assert parameters_of(problem.motion(x)) == {p.name: v for p, v in zip(problem.parameters, x, strict=True)}
        assert parameters_of(part) == {}

    def test_what_the_motion_was_optimised_by_is_kept_whatever_is_optimised_now(
        self, robot: Robot, stitched: Motion
    ) -> None:
        part = stitched.parts[0]
        dmp = MotionDmp.fit(part, robot)
        problem = ImitationProblem(robot, part, dmp, group="foot-path", workers=1)
        own = parameters_of(problem.motion(candidates(problem, 1)[0]))
        assert needed_group("foot-height", own, {}) == "foot-path"
        assert needed_group("feet-and-trunk", own, {}) == "feet-and-trunk"
        assert needed_group("foot-height", {}) == "foot-height"
        whole = StitchedProblem(robot, stitched, start=[own, {}], group="foot-path", workers=1)
        again = make_problem(robot, whole.motion(whole.start), workers=1)
        np.testing.assert_array_equal(again.start, whole.start)
        with pytest.raises(MotionError, match=r"moves root_vx.goal, which no method optimises"):
            needed_group("foot-height", {"root_vx.goal": 0.1})


def test_a_motion_that_neither_repeats_nor_is_stitched_is_one_episode(robot: Robot, stitched: Motion) -> None:
    once = dataclasses.replace(stitched.parts[0], cycle=None)
    problem = make_problem(robot, once, workers=1)
    assert isinstance(problem, ImitationProblem)
    assert problem.steps == once.n_samples - 1
