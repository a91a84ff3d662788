"""The search: reproducible to the bit, resumable to the bit, and usable whenever it is stopped."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import CheckpointError, ConfigError, OutputError
from fastmimic.episode.plan import Start, nominal_start
from fastmimic.episode.rollout import Rollout
from fastmimic.optimize import cma_es
from fastmimic.optimize.cma_es import Checkpoint, CmaSettings, Optimum, Progress, optimize
from fastmimic.optimize.parameters import FinalChoice
from fastmimic.optimize.problem import ImitationProblem
from fastmimic.runs.work_folder import CHECKPOINT
from searches import QUICK_CHOICE

SETTINGS = CmaSettings(iterations=5, population=4, seed=3, choice=QUICK_CHOICE, checkpoint_every=2)


class KilledError(Exception):
    """Stands for `kill -9`: nothing after it runs."""


def stop_after(iteration: int, error: type[BaseException]) -> Callable[[Progress], None]:
    def progress(state: Progress) -> None:
        if state.iteration == iteration:
            raise error

    return progress


def assert_same(a: Optimum, b: Optimum) -> None:
    """All that is found, bit for bit."""
    assert a.x.tobytes() == b.x.tobytes()
    assert (a.score, a.validation, a.evaluations, a.interrupted) == (
        b.score,
        b.validation,
        b.evaluations,
        b.interrupted,
    )
    for name in ("best", "mean", "std", "sigma"):
        assert getattr(a.history, name).tobytes() == getattr(b.history, name).tobytes(), name
    assert a.history.baseline == b.history.baseline


@pytest.fixture(scope="module")
def straight(problem: ImitationProblem) -> Optimum:
    """The uninterrupted run that others are compared with."""
    return optimize(problem, SETTINGS)


class Counting:
    """Counts the candidates that a problem is asked to score."""

    def __init__(self, problem: ImitationProblem, monkeypatch: pytest.MonkeyPatch) -> None:
        self.candidates = 0
        evaluate = problem.evaluate

        def counting(x: np.ndarray) -> np.ndarray:
            self.candidates += len(x)
            return evaluate(x)

        monkeypatch.setattr(problem, "evaluate", counting)


class TestSearch:
    def test_the_result_lies_within_the_bounds(self, straight: Optimum, problem: ImitationProblem) -> None:
        lower, upper = problem.bounds
        assert np.all((straight.x >= lower) & (straight.x <= upper))
        assert not straight.interrupted

    def test_the_history_has_an_entry_for_each_iteration(self, straight: Optimum, problem: ImitationProblem) -> None:
        history = straight.history
        for values in (history.best, history.mean, history.std, history.sigma):
            assert values.shape == (SETTINGS.iterations,)
            assert np.isfinite(values).all()
        assert np.all(history.best >= history.mean)
        assert history.baseline == problem.evaluate(problem.initial[None])[0]

    def test_evaluations_are_all_episodes_that_were_run(
        self, make_problem: Callable[..., ImitationProblem], straight: Optimum
    ) -> None:
        """The unmodulated motion, every candidate, and the validation of at most two of them and the unmodulated."""
        searched = 1 + SETTINGS.iterations * SETTINGS.population
        validated = straight.evaluations - searched
        assert validated in (2, 4, 6)
        duration = make_problem().objective.duration_s
        assert straight.simulated_s == pytest.approx(searched * duration + validated * 0.4)

    def test_the_result_is_no_worse_than_doing_nothing(self, straight: Optimum, problem: ImitationProblem) -> None:
        """The unmodulated motion competes in the validation as well."""
        alone = optimize_nothing(problem)
        assert straight.validation >= alone.validation
        assert straight.score >= straight.history.baseline

    def test_the_score_is_the_results_own(self, straight: Optimum, problem: ImitationProblem) -> None:
        assert straight.score == problem.evaluate(straight.x[None])[0]

    def test_progress_is_told_after_each_iteration(self, problem: ImitationProblem, straight: Optimum) -> None:
        told: list[Progress] = []
        optimize(problem, SETTINGS, progress=told.append)
        assert [p.iteration for p in told] == [1, 2, 3, 4, 5]
        assert {p.iterations for p in told} == {5}
        best = np.maximum(np.maximum.accumulate(straight.history.best), straight.history.start)
        np.testing.assert_array_equal([p.best for p in told], best, "the unmodulated motion is a candidate as well")
        assert all(p.evaluations_per_s > 0 for p in told)
        assert told[-1].remaining_s == 0
        assert told[0].remaining_s > 0

    def test_many_iterations_climb(self) -> None:
        """On a score that is known: the distance from a point within the bounds."""
        problem = Bowl()
        optimum = optimize(problem, replace(SETTINGS, iterations=80, population=10, seed=0))  # type: ignore[arg-type]
        np.testing.assert_allclose(
            optimum.x, problem.optimum, atol=1e-2 * (problem.bounds[1] - problem.bounds[0]).max()
        )
        assert optimum.history.best[-1] > optimum.history.best[0]
        assert optimum.history.sigma[-1] < optimum.history.sigma[0]

    @pytest.mark.parametrize(("score", "share"), [(0.89, 1.0), (0.91, 0.25)])
    def test_looks_near_a_motion_that_is_tracked_as_it_is(
        self, score: float, share: float, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        problem, asked = Bowl(), list[np.ndarray]()
        span = problem.bounds[1] - problem.bounds[0]

        def evaluate(x: np.ndarray) -> np.ndarray:
            asked.append((x - problem.initial) / span)
            return np.full(len(x), score)

        monkeypatch.setattr(problem, "evaluate", evaluate)
        monkeypatch.setattr(problem, "initial", problem.bounds[0] + 0.5 * span)
        monkeypatch.setattr(problem, "start", problem.initial)
        optimize(problem, replace(SETTINGS, iterations=1, population=200))  # type: ignore[arg-type]
        assert np.std(asked[1]) == pytest.approx(0.2 * share, rel=0.1)

    def test_ends_when_the_best_scores_have_settled(self) -> None:
        """With the bits of a search of as many iterations; a given number is run in any case."""
        problem, told = Bowl(), list[Progress]()
        free = replace(SETTINGS, iterations=None, population=10)
        optimum = optimize(problem, free, progress=told.append)  # type: ignore[arg-type]
        done = len(optimum.history.best)
        assert 40 < done < cma_es.MOST_ITERATIONS
        assert np.ptp(optimum.history.best[-20:]) < 5e-4 <= np.ptp(optimum.history.best[-21:-1])
        assert told[-2].iterations == cma_es.MOST_ITERATIONS
        assert told[-1].iterations == done, "says that it was the last"
        assert told[-1].remaining_s == 0
        counted = optimize(problem, replace(free, iterations=done))  # type: ignore[arg-type]
        assert_same(optimum, counted)
        longer = optimize(problem, replace(free, iterations=done + 5))  # type: ignore[arg-type]
        assert len(longer.history.best) == done + 5

    def test_a_search_that_ended_by_itself_is_resumed_as_it_is(self, tmp_path: Path) -> None:
        problem, file = Bowl(), tmp_path / "checkpoint.npz"
        free = replace(SETTINGS, iterations=None, population=10)
        first = optimize(problem, free, checkpoint=file)  # type: ignore[arg-type]
        assert_same(first, optimize(problem, free, checkpoint=file, resume=True))  # type: ignore[arg-type]
        longer = replace(free, iterations=len(first.history.best) + 3)
        again = optimize(problem, longer, checkpoint=file, resume=True)  # type: ignore[arg-type]
        assert_same(again, optimize(problem, longer))  # type: ignore[arg-type]

    @pytest.mark.parametrize("lucky", [True, False])
    def test_what_is_better_by_chance_is_not_taken(self, lucky: bool, monkeypatch: pytest.MonkeyPatch) -> None:
        problem = Bowl()
        luck = np.array([0.9, -0.1, -0.1, 0.1] if lucky else [0.3, 0.2, 0.2, 0.1])  # both 0.2 in the mean

        def scores(tables: np.ndarray, start: object, steps: int) -> np.ndarray:
            return luck * (not np.array_equal(tables[0], problem.initial))

        monkeypatch.setattr(problem, "scores", scores)
        optimum = optimize(problem, replace(SETTINGS, choice=FinalChoice()))  # type: ignore[arg-type]
        assert np.array_equal(optimum.x, problem.initial) == lucky
        assert optimum.validation == (0.0 if lucky else pytest.approx(0.2))


class Bowl:
    """Stands in for an imitation problem: one sharp maximum, at no cost."""

    class Config:
        rate_hz = 500.0

    config, identity, steps = Config(), "bowl", 500

    def __init__(self) -> None:
        self.bounds = np.full(8, -0.03), np.array([0.03] * 4 + [1.8] * 4)
        self.initial = self.start = np.array([0.0] * 4 + [1.0] * 4)
        self.optimum = np.array([0.01, -0.02, 0.0, 0.02, 0.5, 1.2, 0.9, 1.6])

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        return -np.sum(((x - self.optimum) / (self.bounds[1] - self.bounds[0])) ** 2, axis=1)

    def tables(self, x: np.ndarray) -> np.ndarray:
        return x

    def scores(self, tables: np.ndarray, start: object, steps: int) -> np.ndarray:
        return self.evaluate(tables)

    def validation(self, episodes: int, duration_s: float, rng: np.random.Generator) -> tuple[Start, int]:
        return nominal_start(episodes), 500


def optimize_nothing(problem: ImitationProblem) -> Optimum:
    """What comes out if the search is stopped before its first generation is over."""
    evaluate, calls = problem.evaluate, 0

    def interrupted(x: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls > 1:
            raise KeyboardInterrupt
        return evaluate(x)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem, "evaluate", interrupted)
        return optimize(problem, SETTINGS)


class TestReproducible:
    def test_the_same_seed_gives_the_same_bits(self, problem: ImitationProblem, straight: Optimum) -> None:
        assert_same(optimize(problem, SETTINGS), straight)

    def test_at_any_number_of_workers(self, make_problem: Callable[..., ImitationProblem], straight: Optimum) -> None:
        assert_same(optimize(make_problem(workers=2), SETTINGS), straight)

    def test_another_seed_searches_elsewhere(self, problem: ImitationProblem, straight: Optimum) -> None:
        other = optimize(problem, replace(SETTINGS, iterations=2, seed=4))
        assert not np.array_equal(other.history.best, straight.history.best[:2])

    def test_numpys_global_generator_is_neither_used_nor_moved(
        self, problem: ImitationProblem, straight: Optimum
    ) -> None:
        np.random.seed(5)  # noqa: NPY002
        before = np.random.get_state()[1].copy()  # noqa: NPY002
        optimum = optimize(problem, SETTINGS)
        np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
        assert_same(optimum, straight)


class TestResume:
    def test_after_a_kill_gives_the_same_bits_as_an_uninterrupted_run(
        self, make_problem: Callable[..., ImitationProblem], straight: Optimum, tmp_path: Path
    ) -> None:
        path = tmp_path / CHECKPOINT
        with pytest.raises(KilledError):
            optimize(make_problem(), SETTINGS, checkpoint=path, progress=stop_after(3, KilledError))
        kept = Checkpoint.load(path, cma_es._Search(make_problem(), SETTINGS, None).identity)
        assert len(kept.scores) == 2, "the checkpoint is of the second of three iterations"
        resumed = optimize(make_problem(workers=2), SETTINGS, checkpoint=path, resume=True)
        assert_same(resumed, straight)

    def test_twice(self, make_problem: Callable[..., ImitationProblem], straight: Optimum, tmp_path: Path) -> None:
        path = tmp_path / CHECKPOINT
        for iteration, resume in ((2, False), (4, True)):
            with pytest.raises(KilledError):
                optimize(
                    make_problem(),
                    SETTINGS,
                    checkpoint=path,
                    resume=resume,
                    progress=stop_after(iteration, KilledError),
                )
        assert_same(optimize(make_problem(), SETTINGS, checkpoint=path, resume=True), straight)

    def test_runs_no_episode_twice(
        self, make_problem: Callable[..., ImitationProblem], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        problem, path = make_problem(), tmp_path / CHECKPOINT
        with pytest.raises(KilledError):
            optimize(problem, SETTINGS, checkpoint=path, progress=stop_after(4, KilledError))
        counting = Counting(problem, monkeypatch)
        optimize(problem, SETTINGS, checkpoint=path, resume=True)
        assert counting.candidates == 1 + SETTINGS.population, "the unmodulated motion and the last generation"

    def test_of_a_finished_run_gives_its_result_again(
        self, problem: ImitationProblem, straight: Optimum, tmp_path: Path
    ) -> None:
        path = tmp_path / CHECKPOINT
        first = optimize(problem, SETTINGS, checkpoint=path)
        again = optimize(problem, SETTINGS, checkpoint=path, resume=True)
        assert_same(first, straight)
        assert_same(again, straight)
        assert again.elapsed_s > first.elapsed_s, "time before counts"

    def test_with_more_iterations_goes_on(self, problem: ImitationProblem, straight: Optimum, tmp_path: Path) -> None:
        path = tmp_path / CHECKPOINT
        optimize(problem, replace(SETTINGS, iterations=2), checkpoint=path)
        assert_same(optimize(problem, SETTINGS, checkpoint=path, resume=True), straight)

    def test_with_fewer_iterations_takes_the_first_ones(
        self, problem: ImitationProblem, straight: Optimum, tmp_path: Path
    ) -> None:
        path = tmp_path / CHECKPOINT
        optimize(problem, SETTINGS, checkpoint=path)
        whole = path.read_bytes()
        fewer = optimize(problem, replace(SETTINGS, iterations=3), checkpoint=path, resume=True)
        np.testing.assert_array_equal(fewer.history.best, straight.history.best[:3])
        assert path.read_bytes() == whole, "the longer course is still there"

    def test_without_a_checkpoint_there_is_nothing_to_resume(self, problem: ImitationProblem, tmp_path: Path) -> None:
        with pytest.raises(CheckpointError, match="no checkpoint to resume from"):
            optimize(problem, SETTINGS, checkpoint=tmp_path / CHECKPOINT, resume=True)

    def test_another_problem_or_other_settings_are_refused_and_the_file_kept(
        self, make_problem: Callable[..., ImitationProblem], tmp_path: Path
    ) -> None:
        path = tmp_path / CHECKPOINT
        optimize(make_problem(), SETTINGS, checkpoint=path)
        content = path.read_bytes()
        for problem, settings in (
            (make_problem(duration_s=0.7), SETTINGS),
            (make_problem(), replace(SETTINGS, seed=4)),
            (make_problem(), replace(SETTINGS, population=5)),
            (make_problem(), replace(SETTINGS, step_size=0.1)),
        ):
            with pytest.raises(CheckpointError, match="of another problem"):
                optimize(problem, settings, checkpoint=path, resume=True)
        assert path.read_bytes() == content

    def test_candidates_that_this_installation_would_not_have_asked_for_are_refused(
        self, problem: ImitationProblem, tmp_path: Path
    ) -> None:
        """Another version of the optimiser would silently search somewhere else."""
        path = tmp_path / CHECKPOINT
        optimize(problem, SETTINGS, checkpoint=path)
        identity = cma_es._Search(problem, SETTINGS, None).identity
        kept = Checkpoint.load(path, identity)
        candidates = kept.candidates.copy()
        candidates[1, 0, 0] = np.nextafter(candidates[1, 0, 0], 2.0)
        Checkpoint(identity, candidates, kept.scores, kept.elapsed_s).save(path)
        with pytest.raises(CheckpointError, match="does not reproduce the recorded candidates"):
            optimize(problem, SETTINGS, checkpoint=path, resume=True)


class TestInterrupted:
    """Ctrl-C ends the search early and leaves what was found until then."""

    def test_the_best_so_far_is_the_result(self, problem: ImitationProblem, straight: Optimum) -> None:
        optimum = optimize(problem, SETTINGS, progress=stop_after(2, KeyboardInterrupt))
        assert optimum.interrupted
        np.testing.assert_array_equal(optimum.history.best, straight.history.best[:2])
        assert optimum.score >= optimum.history.baseline
        assert optimum.score == problem.evaluate(optimum.x[None])[0]

    def test_before_anything_was_found_it_is_the_unmodulated_motion(self, problem: ImitationProblem) -> None:
        optimum = optimize_nothing(problem)
        assert optimum.interrupted
        np.testing.assert_array_equal(optimum.x, problem.initial)
        assert optimum.history.best.shape == (0,)
        assert optimum.score == optimum.history.baseline

    @pytest.mark.parametrize("validated", [0, 1])
    def test_during_the_final_choice_it_is_the_best_of_those_validated(
        self, make_problem: Callable[..., ImitationProblem], validated: int
    ) -> None:
        problem, calls = make_problem(workers=1), 0
        rollout, evaluate = problem.rollout, problem.evaluate

        def poor_baseline(x: np.ndarray) -> np.ndarray:
            return evaluate(x) - (1.0 if len(x) == 1 else 0.0)

        def interrupted(tables: np.ndarray, start: Start, steps: int) -> list[Rollout]:
            nonlocal calls
            if start.joint_offset.any():  # only the episodes of the final choice are perturbed
                calls += 1
                if calls > validated:
                    raise KeyboardInterrupt
            return rollout(tables, start, steps)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(problem, "evaluate", poor_baseline)
            patch.setattr(problem, "rollout", interrupted)
            optimum = optimize(problem, SETTINGS)
        assert calls == validated + 1
        assert optimum.interrupted
        if validated == 0:
            assert np.isnan(optimum.validation)
            assert optimum.score == optimum.history.best.max()
            assert optimum.score == evaluate(optimum.x[None])[0]
        else:
            assert np.isfinite(optimum.validation)
            np.testing.assert_array_equal(optimum.x, problem.initial)

    def test_it_can_be_resumed(
        self, make_problem: Callable[..., ImitationProblem], straight: Optimum, tmp_path: Path
    ) -> None:
        path = tmp_path / CHECKPOINT
        optimize(make_problem(), SETTINGS, checkpoint=path, progress=stop_after(3, KeyboardInterrupt))
        assert_same(optimize(make_problem(), SETTINGS, checkpoint=path, resume=True), straight)


class TestRefused:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"iterations": 0}, "iterations must be at least 1, found 0"),
            ({"population": 3}, "population must be at least 4, found 3"),
            ({"seed": -1}, "seed must not be negative, found -1"),
            ({"step_size": 0.0}, "step_size must be"),
        ],
    )
    def test_settings_out_of_range(self, settings: dict[str, float], message: str) -> None:
        with pytest.raises(ConfigError, match=message):
            CmaSettings(**settings)  # type: ignore[arg-type]

    def test_a_checkpoint_that_cannot_be_written(self, problem: ImitationProblem, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("in the way")
        with pytest.raises(OutputError, match="cannot be written"):
            optimize(problem, SETTINGS, checkpoint=tmp_path / "file" / CHECKPOINT)

    def test_resuming_without_saying_from_where(self, problem: ImitationProblem) -> None:
        with pytest.raises(CheckpointError, match="checkpoint"):
            optimize(problem, SETTINGS, resume=True)
