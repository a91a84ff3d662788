"""A search over several robots: the same for all candidates of an iteration, and others to choose and measure by."""

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import CheckpointError, ConfigError
from fastmimic.imitation.methods import METHODS, randomization
from fastmimic.motion.motion import Motion
from fastmimic.optimize import cma_es
from fastmimic.optimize.cma_es import CmaSettings, Optimum, Progress, optimize
from fastmimic.optimize.parameters import FinalChoice
from fastmimic.optimize.problem import ImitationProblem, Objective
from fastmimic.optimize.randomization import CRITERIA, HELD_OUT_ROBOTS, Randomization, usual_randomization
from fastmimic.optimize.stitched import StitchedProblem
from fastmimic.reference.table import reference_table
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Disturbance, Range
from fastmimic.stitching.join import stitch_motions
from optimize.conftest import EPISODE_S
from optimize.test_cma_es import KilledError, assert_same, stop_after

CHOICE = FinalChoice(candidates=4, robots=3, duration_s=0.4)
SETTINGS = CmaSettings(iterations=3, population=4, seed=3, choice=CHOICE)
OVER_TWO = Randomization(robots=2, over=("payload=1:4", "friction"))  # type: ignore[arg-type]
OVER_THREE = Randomization(robots=3, over=("payload=1:4", "delay"))  # type: ignore[arg-type]

Make = Callable[..., ImitationProblem]


@pytest.fixture(scope="module")
def make(make_problem: Callable[..., ImitationProblem]) -> Make:
    def over(randomized: Randomization | None = OVER_TWO, workers: int = 1) -> ImitationProblem:
        return make_problem(workers, randomization=randomized)

    return over


@pytest.fixture(scope="module")
def some(make: Make) -> np.ndarray:
    """Two candidates, the second of them twice."""
    problem = make()
    lower, upper = problem.bounds
    u = np.random.default_rng(0).uniform(0.3, 0.7, (2, len(lower)))
    return (lower + u * (upper - lower))[[0, 1, 1]]


@pytest.fixture(scope="module")
def straight(make: Make) -> Optimum:
    """The uninterrupted run that others are compared with."""
    return optimize(make(), SETTINGS)


def values(robots: object) -> set[float]:
    return {v for d in robots for v in d.values}  # type: ignore[attr-defined]


class TestRobots:
    def test_the_first_is_the_robot_as_it_is(self) -> None:
        for robots in (OVER_TWO.of_iteration(0, 0), OVER_TWO.of_choice(0, 4)):
            assert {d.name: d.values[0] for d in robots} == {"friction": 0.8, "payload": 0.0}
            assert all(d.values[1] != d.values[0] for d in robots)

    def test_every_iteration_and_seed_has_others(self) -> None:
        drawn = [OVER_TWO.of_iteration(seed, i)[1].values[1] for seed in range(3) for i in range(4)]
        assert len(set(drawn)) == 12

    def test_none_that_is_measured_or_chosen_by_was_searched_with(self) -> None:
        for seed in (0, 3):
            met = set().union(*(values(OVER_TWO.of_iteration(seed, i)) for i in range(200))) - {0.8, 0.0}
            choice, held_out = values(OVER_TWO.of_choice(seed, 8)), values(OVER_TWO.held_out())
            assert not met & choice
            assert not met & held_out
            assert not choice & held_out
        assert len(OVER_TWO.held_out()[0].values) == HELD_OUT_ROBOTS

    def test_those_measured_by_are_the_same_for_all_criteria_and_numbers(self) -> None:
        other = dataclasses.replace(OVER_TWO, robots=7, criterion="worst")
        assert other.held_out() == OVER_TWO.held_out()

    def test_what_is_drawn_does_not_depend_on_the_order_of_the_names(self) -> None:
        turned = Randomization(robots=2, over=("friction", "payload=1:4"))  # type: ignore[arg-type]
        assert turned == OVER_TWO
        assert turned.of_iteration(1, 1) == OVER_TWO.of_iteration(1, 1)

    def test_the_usual_ones_differ_in_ground_load_and_motors(self) -> None:
        assert Randomization().over == usual_randomization()
        assert randomization(METHODS["mbc-dmp"], 6) == Randomization(robots=6)
        assert randomization(METHODS["mbc-dmp"], None) is None


class TestScores:
    """Common random numbers: what two candidates of an iteration meet is the same."""

    def test_the_same_candidate_has_the_same_score(self, make: Make, some: np.ndarray) -> None:
        a, b, c = make().evaluate(some, OVER_TWO.of_iteration(0, 0))
        assert b == c
        assert a != b

    def test_a_candidates_score_does_not_depend_on_the_others(self, make: Make, some: np.ndarray) -> None:
        robots = OVER_TWO.of_iteration(0, 0)
        together, alone = make().evaluate(some, robots), make().evaluate(some[1:2], robots)
        assert together[1] == alone[0]

    def test_every_candidate_meets_every_robot(self, make: Make, some: np.ndarray) -> None:
        """Scores over m robots are those of m episodes with one of them each."""
        problem = make()
        robots = OVER_TWO.of_iteration(0, 0)
        each = []
        for i in range(2):
            one = tuple(dataclasses.replace(d, values=d.values[i : i + 1]) for d in robots)
            each.append(problem.evaluate(some, one))
        np.testing.assert_array_equal(problem.evaluate(some, robots), np.mean(each, axis=0))
        assert np.all(each[0] != each[1])

    def test_the_robot_as_it_is_scores_as_without_randomisation(self, make: Make, some: np.ndarray) -> None:
        problem = make(Randomization())
        first = tuple(dataclasses.replace(d, values=d.values[:1]) for d in Randomization().of_iteration(0, 0))
        np.testing.assert_allclose(problem.evaluate(some, first), problem.evaluate(some), atol=2e-3)

    def test_the_worst_is_no_better_than_the_mean(self, make: Make, some: np.ndarray) -> None:
        robots = OVER_THREE.of_iteration(0, 0)
        mean = make(OVER_THREE).evaluate(some, robots)
        worst = make(dataclasses.replace(OVER_THREE, criterion="worst")).evaluate(some, robots)
        assert np.all(worst < mean)

    def test_criteria_are_over_the_last_axis(self) -> None:
        scores = np.array([[0.1, 0.5, 0.9], [0.4, 0.4, 0.4]])
        np.testing.assert_allclose(CRITERIA["mean"](scores), [0.5, 0.4])
        np.testing.assert_array_equal(CRITERIA["worst"](scores), [0.1, 0.4])

    def test_other_robots_give_other_scores(self, make: Make, some: np.ndarray) -> None:
        problem = make()
        one, two = (problem.evaluate(some, OVER_TWO.of_iteration(0, i)) for i in range(2))
        assert np.all(one != two)
        np.testing.assert_array_equal(problem.evaluate(some, OVER_TWO.of_iteration(0, 0)), one, "and back")

    def test_three_workers_divide_a_candidates_robots_without_a_trace(self, make: Make, some: np.ndarray) -> None:
        robots = OVER_TWO.of_iteration(0, 0)
        divided = make(workers=4).evaluate(some, robots)  # 6 episodes: some begin in the middle of a candidate
        np.testing.assert_array_equal(divided, make().evaluate(some, robots))

    def test_a_stitched_motion_is_scored_over_several_robots(self, robot: Robot, demonstration: Motion) -> None:
        whole = stitch_motions(robot, [demonstration, demonstration], [2, 2])
        problem = StitchedProblem(robot, whole, objective=Objective(randomization=OVER_TWO), workers=1)
        assert problem.randomization == OVER_TWO
        scores = problem.evaluate(np.stack([problem.initial] * 2), OVER_TWO.of_iteration(0, 0))
        assert scores[0] == scores[1] != problem.evaluate(problem.initial[None])[0]


class TestSearch:
    def test_it_searches_elsewhere(self, make: Make, straight: Optimum) -> None:
        plain = optimize(make(None), SETTINGS)
        assert not plain.history.randomized
        assert straight.history.randomized
        # the first candidates are the same
        assert straight.history.best[0] != plain.history.best[0], "with kilograms more"
        assert not np.array_equal(plain.history.mean, straight.history.mean)

    def test_each_iteration_is_scored_on_its_own_robots(self, make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
        problem = make()
        evaluate, met = problem.evaluate, []

        def noted(x: np.ndarray, robots: tuple[object, ...]) -> np.ndarray:
            met.append((len(x), robots))
            return evaluate(x, robots)  # type: ignore[arg-type]

        monkeypatch.setattr(problem, "evaluate", noted)
        optimize(problem, SETTINGS)
        of = [OVER_TWO.of_iteration(SETTINGS.seed, i) for i in range(3)]
        assert met == [(1, of[0]), (4, of[0]), (4, of[1]), (4, of[2]), (4, of[0])]

    def test_the_result_is_chosen_on_robots_that_the_search_has_not_met(
        self, make: Make, straight: Optimum, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        problem = make()
        rollout, met = problem.rollout, []

        def noted(*args: object) -> list[object]:
            met.append(args[3])
            return rollout(*args)  # type: ignore[arg-type, return-value]

        monkeypatch.setattr(problem, "rollout", noted)
        assert_same(optimize(problem, SETTINGS), straight)
        choice = OVER_TWO.of_choice(SETTINGS.seed, 3)
        assert met[-5:] == [choice] * 5, "the unmodulated motion, and of two iterations the mean and the best"
        assert choice not in met[:-5]

    def test_the_score_and_the_baseline_are_with_the_first_iterations_robots(
        self, make: Make, straight: Optimum
    ) -> None:
        problem, robots = make(), OVER_TWO.of_iteration(SETTINGS.seed, 0)
        assert straight.score == problem.evaluate(straight.x[None], robots)[0]
        assert straight.history.baseline == problem.evaluate(problem.initial[None], robots)[0]

    def test_evaluations_are_all_episodes_that_were_run(self, straight: Optimum) -> None:
        searched = (1 + 3 * 4 + 4) * 2
        validated = 5 * 3
        assert straight.evaluations == searched + validated
        assert straight.simulated_s == pytest.approx(searched * EPISODE_S + validated * 0.4)

    def test_the_means_of_the_search_compete(self, make: Make) -> None:
        search = cma_es._Search(make(), SETTINGS, None)
        search.run(False, None)
        rows, _ = search._last()
        span = search.span
        np.testing.assert_allclose((rows[0] - search.lower) / span, search.means[-1])
        assert len(rows) == 4
        weights = search.strategy.sp.weights.positive_weights  # of the better half of a generation, by rank
        better = np.argsort(-search.scores[-1])[: len(weights)]
        np.testing.assert_allclose(search.means[-1], weights @ search.candidates[-1][better], atol=1e-3)

    def test_the_best_of_progress_is_of_the_iteration(self, make: Make, straight: Optimum) -> None:
        told: list[Progress] = []
        optimize(make(), SETTINGS, progress=told.append)
        np.testing.assert_array_equal([p.best for p in told], straight.history.best)

    def test_at_any_number_of_workers(self, make: Make, straight: Optimum) -> None:
        assert_same(optimize(make(workers=3), SETTINGS), straight)


class TestInterrupted:
    @staticmethod
    def stopped_at(problem: ImitationProblem, call: int) -> Optimum:
        """Ctrl-C when candidates are scored for the `call`-th time."""
        evaluate, calls = problem.evaluate, 0

        def interrupted(x: np.ndarray, robots: tuple[Disturbance, ...]) -> np.ndarray:
            nonlocal calls
            calls += 1
            if calls == call:
                raise KeyboardInterrupt
            return evaluate(x, robots)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(problem, "evaluate", interrupted)
            return optimize(problem, SETTINGS)

    def test_before_anything_was_found_it_is_the_unmodulated_motion(self, make: Make) -> None:
        problem = make()
        optimum = self.stopped_at(problem, 2)
        assert optimum.interrupted
        np.testing.assert_array_equal(optimum.x, problem.initial)
        assert optimum.history.best.shape == (0,)
        assert optimum.score == optimum.history.baseline

    def test_before_the_final_choice_it_is_what_scored_best(self, make: Make, straight: Optimum) -> None:
        optimum = self.stopped_at(make(), 5)
        assert optimum.interrupted
        assert np.isnan(optimum.validation)
        np.testing.assert_array_equal(optimum.history.best, straight.history.best)
        assert optimum.score == max(straight.history.baseline, *straight.history.best[-2:])


class TestResume:
    def test_gives_the_same_bits(self, make: Make, straight: Optimum, tmp_path: Path) -> None:
        path = tmp_path / "checkpoint.npz"
        often = dataclasses.replace(SETTINGS, checkpoint_every=1)
        with pytest.raises(KilledError):
            optimize(make(), often, checkpoint=path, progress=stop_after(2, KilledError))
        assert_same(optimize(make(workers=2), SETTINGS, checkpoint=path, resume=True), straight)

    def test_after_ctrl_c_goes_on(self, make: Make, straight: Optimum, tmp_path: Path) -> None:
        path = tmp_path / "checkpoint.npz"
        stopped = optimize(make(), SETTINGS, checkpoint=path, progress=stop_after(2, KeyboardInterrupt))
        assert stopped.interrupted
        assert np.isfinite(stopped.validation)
        assert_same(optimize(make(), SETTINGS, checkpoint=path, resume=True), straight)

    @pytest.mark.parametrize(
        "other",
        [
            None,
            dataclasses.replace(OVER_TWO, robots=3),
            dataclasses.replace(OVER_TWO, criterion="worst"),
            dataclasses.replace(OVER_TWO, over=(Range("payload", 1.0, 4.0),)),
            dataclasses.replace(OVER_TWO, over=("payload=1:3", "friction")),
        ],
    )
    def test_another_randomisation_is_refused(self, other: Randomization | None, make: Make, tmp_path: Path) -> None:
        path = tmp_path / "checkpoint.npz"
        search = cma_es._Search(make(), SETTINGS, path)
        search._tell(np.array(search.strategy.ask()), np.arange(4.0))
        search._save(1.0)
        with pytest.raises(CheckpointError, match=r"of another problem \(.*randomisation"):
            optimize(make(other), SETTINGS, checkpoint=path, resume=True)

    def test_checkpoints_of_searches_without_it_are_as_before(self, make: Make) -> None:
        """The digest is of the settings that there were before there was any randomisation."""
        plain = make(None)
        digest = hashlib.sha256()
        digest.update(plain.tables(plain.initial[None]).tobytes())
        digest.update(reference_table(plain.demonstration, plain.robot).tobytes())
        digest.update(plain.robot.xml.encode())
        settings = {
            "config": plain.config.as_dict(),
            "objective": {"duration_s": EPISODE_S, "clearance_floor": 0.87, "clearance_weight": 1.0},
            "parameters": [dataclasses.asdict(p) for p in plain.parameters],
            "start": plain.start.tolist(),
            "steps": plain.steps,
        }
        digest.update(json.dumps(settings, sort_keys=True).encode())
        assert plain.identity == digest.hexdigest()
        assert make().identity != plain.identity


class TestRefused:
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"robots": 1}, "at least 2 robots, found 1: the robot as it is, and one that differs"),
            ({"criterion": "wurst"}, "unknown criterion 'wurst'; there are mean, worst; did you mean 'worst'"),
            ({"over": ()}, "needs at least one disturbance"),
            ({"over": ("fricton",)}, "did you mean 'friction'"),
            ({"over": ("friction", "friction=0.4:0.9")}, "the range of 'friction' is given twice"),
        ],
    )
    def test_settings_that_cannot_be(self, given: dict[str, object], message: str) -> None:
        with pytest.raises(ConfigError, match=message):
            Randomization(**given)  # type: ignore[arg-type]

    def test_an_episode_that_ends_before_its_push(self, make: Make) -> None:
        pushed = Randomization(robots=2, over=("push",))  # type: ignore[arg-type]
        with pytest.raises(ConfigError, match=r"an episode of 0.6 s may end before a push, which comes until 3.1 s"):
            optimize(make(pushed), SETTINGS)
        pushed.check(3.5)

    def test_one_name_stands_for_itself(self) -> None:
        assert Randomization(over="friction") == Randomization(over=("friction",))  # type: ignore[arg-type]
