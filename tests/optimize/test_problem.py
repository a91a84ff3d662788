"""What is optimised: eight numbers in physical units, scored in closed loop against the demonstration."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from control.motions import gait
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.plan import nominal_start, perturbed_start
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.optimize.parameters import PARAMETER_GROUPS, Parameter
from fastmimic.optimize.problem import ImitationProblem, Objective
from fastmimic.primitive import MotionDmp
from fastmimic.reference.table import reference_table
from fastmimic.robot import Robot, load_robot

GOALS, AMPLITUDES = slice(0, 4), slice(4, 8)


def candidates(problem: ImitationProblem, n: int, seed: int = 0) -> np.ndarray:
    """Random ones within the middle half of the bounds."""
    lower, upper = problem.bounds
    u = np.random.default_rng(seed).uniform(0.25, 0.75, (n, len(lower)))
    return lower + u * (upper - lower)


class TestParameters:
    """Paper, §III-C: baseline g and amplitude a of the height of each of the four feet."""

    def test_there_are_eight_in_physical_units(self, problem: ImitationProblem) -> None:
        assert [p.name for p in problem.parameters] == [
            *("FR_foot_z.goal", "FL_foot_z.goal", "RR_foot_z.goal", "RL_foot_z.goal"),
            *("FR_foot_z.amplitude", "FL_foot_z.amplitude", "RR_foot_z.amplitude", "RL_foot_z.amplitude"),
        ]
        assert [p.unit for p in problem.parameters] == ["m"] * 4 + ["1"] * 4

    def test_bounds_allow_centimetres_about_the_fitted_baseline_and_shares_of_the_fitted_amplitude(
        self, problem: ImitationProblem, demonstration: Motion
    ) -> None:
        lower, upper = problem.bounds
        mean = demonstration.foot_pos_b[..., 2].mean(axis=0)
        np.testing.assert_allclose(problem.initial[GOALS], mean, atol=1e-3)
        np.testing.assert_allclose(0.5 * (lower + upper)[GOALS], problem.initial[GOALS])
        assert np.all((upper - lower)[GOALS] < 0.1)
        np.testing.assert_array_equal(problem.initial[AMPLITUDES], 1.0)
        assert np.all(lower[AMPLITUDES] > 0), "a foot lift of the other sign is no style"
        assert np.all(lower[AMPLITUDES] < 1)
        assert np.all(upper[AMPLITUDES] > 1)

    def test_a_parameter_outside_its_own_bounds_is_refused(self) -> None:
        with pytest.raises(ConfigError, match=r"FR_foot_z.goal: 2 is not within \[0, 1\]"):
            Parameter("FR_foot_z.goal", "m", 0.0, 1.0, 2.0)
        with pytest.raises(ConfigError, match="is not within"):
            Parameter("FR_foot_z.goal", "m", 1.0, 0.0, 0.5)


def test_what_scores_are_said_to_depend_on_changes_only_with_what_is_used() -> None:
    """Digests of finished runs and of checkpoints hold it."""
    assert dataclasses.asdict(Objective()) == {"duration_s": 5.0, "clearance_floor": 0.87, "clearance_weight": 1.0}


class TestGroups:
    """More of the 24 dimensions than the paper moves."""

    @pytest.fixture(params=["foot-path", "feet-and-trunk"])
    def wide(self, request: pytest.FixtureRequest, robot: Robot, demonstration: Motion, dmp: MotionDmp) -> object:
        return ImitationProblem(robot, demonstration, dmp, group=request.param, workers=1)

    def test_each_holds_the_one_before(self) -> None:
        names = [{opened.name for opened in group} for group in PARAMETER_GROUPS.values()]
        assert [len(group) for group in names] == [8, 24, 26]
        assert names[0] < names[1] < names[2]

    def test_candidates_are_the_motions_that_they_stand_for(self, wide: ImitationProblem, robot: Robot) -> None:
        x = candidates(wide, 2)
        tables = wide.tables(x)
        for i in range(2):
            expected = reference_table(wide.motion(x[i]), robot)
            for name in tables.dtype.names or ():
                np.testing.assert_allclose(tables[i][name], expected[name], rtol=0, atol=1e-9, err_msg=name)

    def test_every_parameter_moves_what_it_is_called_after(self, wide: ImitationProblem) -> None:
        changed = np.repeat(wide.initial[None], len(wide.parameters) + 1, axis=0)
        for i, (low, high) in enumerate(zip(*wide.bounds, strict=True)):
            changed[i, i] += 0.2 * (high - low)
        *tables, original = wide.tables(changed)
        for parameter, table in zip(wide.parameters, tables, strict=True):
            what, kind = parameter.name.split(".")
            if what == "root_z":
                np.testing.assert_allclose(table["root_pos"] - original["root_pos"], [[0, 0, 0.012]] * len(table))
            elif what == "root_pitch":
                assert np.abs(table["root_quat"] - original["root_quat"])[:, 2].min() > 0.01
            else:
                leg, axis = LEGS.index(what[:2]), "xyz".index(what[-1])
                moved = np.abs(table["foot_pos"] - original["foot_pos"])
                assert moved[:, leg, axis].max() > (0.01 if kind == "goal" else 1e-4)
                moved[:, leg, axis] = 0
                assert moved.max() < 1e-9

    def test_an_unknown_one_is_refused(self, robot: Robot, demonstration: Motion, dmp: MotionDmp) -> None:
        with pytest.raises(ConfigError, match="unknown parameters 'feet'; there are foot-height, foot-path, feet-and"):
            ImitationProblem(robot, demonstration, dmp, group="feet")


class TestReferences:
    def test_the_initial_candidate_is_the_unmodulated_motion(
        self, problem: ImitationProblem, dmp: MotionDmp, robot: Robot
    ) -> None:
        table = problem.tables(problem.initial[None])[0]
        expected = reference_table(dmp.motion(), robot)
        for name in table.dtype.names or ():
            np.testing.assert_allclose(table[name], expected[name], rtol=0, atol=1e-9, err_msg=name)

    def test_candidates_are_the_motions_that_they_stand_for(self, problem: ImitationProblem, robot: Robot) -> None:
        """What the optimiser runs is what `motion(x)` saves."""
        x = candidates(problem, 3)
        tables = problem.tables(x)
        for i in range(3):
            expected = reference_table(problem.motion(x[i]), robot)
            for name in tables.dtype.names or ():
                np.testing.assert_allclose(tables[i][name], expected[name], rtol=0, atol=1e-9, err_msg=name)

    def test_a_candidate_moves_the_feet_up_and_down_and_nothing_else(self, problem: ImitationProblem) -> None:
        x = problem.initial[None].copy()
        x[0, 1] += 0.01
        changed, original = problem.tables(x)[0], problem.tables(problem.initial[None])[0]
        shift = changed["foot_pos"] - original["foot_pos"]
        np.testing.assert_allclose(shift[:, 1, 2], 0.01, atol=1e-9)
        shift[:, 1, 2] = 0
        np.testing.assert_allclose(shift, 0, atol=1e-9)
        np.testing.assert_array_equal(changed["root_pos"], original["root_pos"])
        np.testing.assert_array_equal(changed["contact"], original["contact"])

    def test_motions_carry_the_demonstration(self, problem: ImitationProblem, demonstration: Motion) -> None:
        x = candidates(problem, 1)[0]
        motion = problem.motion(x)
        assert motion.demonstration is demonstration
        record = motion.provenance.as_dict()["dmp"]
        for value, parameter in zip(x, problem.parameters, strict=True):
            dimension, kind = parameter.name.split(".")
            assert record[kind][record["names"].index(dimension)] == value


class TestScore:
    def test_candidates_are_scored_by_an_episode_from_the_start(self, problem: ImitationProblem, robot: Robot) -> None:
        x = np.vstack([problem.initial, candidates(problem, 2)])
        rollouts = problem.rollout(problem.tables(x), nominal_start(3), problem.steps)
        expected = np.concatenate([problem.score(r) for r in rollouts])
        np.testing.assert_array_equal(problem.evaluate(x), expected)
        motion = problem.motion(problem.initial)
        again = run_episodes(robot, motion, duration_s=problem.objective.duration_s)
        assert rollouts[0].reward[0] == pytest.approx(again.reward[0], abs=1e-6)

    @pytest.mark.parametrize("workers", [2, 3, 9])
    def test_any_number_of_workers_gives_the_same_bits(
        self, make_problem: Callable[..., ImitationProblem], problem: ImitationProblem, workers: int
    ) -> None:
        x = candidates(problem, 5)
        expected = problem.evaluate(x)
        other = make_problem(workers)
        assert other.evaluate(x).tobytes() == expected.tobytes()
        assert other.evaluate(x[::-1])[::-1].tobytes() == expected.tobytes(), "whoever runs it"
        assert len(set(expected)) == 5

    def test_parts_keep_the_order_of_the_starts(
        self, problem: ImitationProblem, make_problem: Callable[..., ImitationProblem]
    ) -> None:
        start = perturbed_start(4, 200, np.random.default_rng(1))
        tables = problem.tables(np.repeat(problem.initial[None], 4, axis=0))
        whole = problem.rollout(tables, start, 100)
        parts = make_problem(2).rollout(tables, start, 100)
        assert [len(r.reward) for r in parts] == [2, 2]
        assert np.concatenate([r.reward for r in parts]).tobytes() == whole[0].reward.tobytes()

    def with_clearance(self, problem: ImitationProblem, robot: Robot, share: np.ndarray) -> Rollout:
        rollout = run_episodes(robot, problem.demonstration, duration_s=0.1)
        clearance = share * swing_clearance(problem.demonstration, robot.foot_radius)
        return dataclasses.replace(rollout, clearance=clearance[None])

    def test_lost_clearance_costs_for_each_foot(
        self, make_problem: Callable[..., ImitationProblem], robot: Robot
    ) -> None:
        problem = make_problem(clearance_floor=0.9, clearance_weight=2.0)
        for share, missing in (
            ([1.0, 1.0, 1.0, 1.0], 0.0),
            ([0.9, 0.95, 2.0, 1.0], 0.0),
            ([0.8, 1.0, 1.0, 1.0], 0.1),
            ([0.8, 0.7, 1.0, 3.0], 0.3),
            ([np.nan, 0.8, 1.0, 1.0], 0.1),
        ):
            rollout = self.with_clearance(problem, robot, np.array(share))
            assert problem.score(rollout)[0] == pytest.approx(rollout.reward[0] - 2.0 * missing)

    def test_a_shuffling_candidate_is_worth_less_than_its_reward(self, problem: ImitationProblem) -> None:
        """The feet lifted as little as the bounds allow, in closed loop."""
        lower, _ = problem.bounds
        shuffle = problem.initial.copy()
        shuffle[AMPLITUDES] = lower[AMPLITUDES]
        x = np.vstack([problem.initial, shuffle])
        (rollout,) = problem.rollout(problem.tables(x), nominal_start(2), problem.steps)
        unmodulated, shuffled = problem.score(rollout)
        assert unmodulated == pytest.approx(rollout.reward[0], abs=0.05), "lifting the feet costs nothing"
        assert shuffled < rollout.reward[1] - 0.2
        assert shuffled < unmodulated

    def test_a_gait_without_swings_has_no_clearance_to_lose(self, robot: Robot) -> None:
        demonstration = gait(robot, duty=1.0, n_samples=200)
        problem = ImitationProblem(
            robot, demonstration, MotionDmp.fit(demonstration, robot), objective=Objective(0.2), workers=1
        )
        assert np.isfinite(problem.evaluate(problem.initial[None])).all()


class TestIdentity:
    """Recognises the checkpoint of the same problem, and no other."""

    def test_is_the_same_for_the_same_problem_at_any_number_of_workers(
        self, make_problem: Callable[..., ImitationProblem], problem: ImitationProblem
    ) -> None:
        assert make_problem(workers=3).identity == problem.identity

    def test_tells_problems_apart(
        self,
        problem: ImitationProblem,
        make_problem: Callable[..., ImitationProblem],
        robot: Robot,
        demonstration: Motion,
        dmp: MotionDmp,
    ) -> None:
        config = dataclasses.replace(ControllerConfig(), joint_margin=0.02)
        other_motion = gait(robot, (0.31, 0.05), 0.4, n_samples=200)
        go1 = load_robot("go1")
        on_go1 = gait(go1, (0.3, 0.05), 0.4, n_samples=200)
        identities = {
            problem.identity,
            make_problem(duration_s=0.7).identity,
            make_problem(clearance_weight=0.5).identity,
            ImitationProblem(robot, demonstration, dmp, objective=problem.objective, config=config).identity,
            ImitationProblem(
                robot, other_motion, MotionDmp.fit(other_motion, robot), objective=problem.objective
            ).identity,
            ImitationProblem(go1, on_go1, MotionDmp.fit(on_go1, go1), objective=problem.objective).identity,
        }
        assert len(identities) == 6


class TestRefused:
    @pytest.mark.parametrize("workers", [0, -1])
    def test_no_workers(self, make_problem: Callable[..., ImitationProblem], workers: int) -> None:
        with pytest.raises(ConfigError, match=f"workers must be at least 1, found {workers}"):
            make_problem(workers=workers)

    @pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf])
    def test_a_duration_that_is_none(self, duration: float) -> None:
        with pytest.raises(ConfigError, match="duration must be positive"):
            Objective(duration_s=duration)


def test_an_episode_holds_a_long_cycle_whole(make_problem: Callable[..., ImitationProblem]) -> None:
    """What no episode reached would be optimised blindly."""
    problem = make_problem(duration_s=0.1)
    assert problem.steps == 1.5 * problem.demonstration.n_samples


def test_an_episode_has_three_cycles_and_is_at_most_as_long_as_asked_for(
    make_problem: Callable[..., ImitationProblem],
) -> None:
    problem = make_problem(duration_s=5.0)
    assert problem.demonstration.n_samples == 200
    assert problem.steps == 3 * 200
    assert make_problem(duration_s=1.0).steps == 500


@pytest.fixture(scope="module")
def once(robot: Robot) -> ImitationProblem:
    motion = dataclasses.replace(gait(robot, (0.3, 0.0), n_samples=200), cycle=None)
    return ImitationProblem(robot, motion, MotionDmp.fit(motion, robot), objective=Objective(5.0), workers=1)


class TestOnce:
    """A motion that does not repeat: its episode is the whole of it."""

    def test_episodes_and_validation_are_the_whole(self, once: ImitationProblem) -> None:
        assert once.steps == once.demonstration.n_samples - 1
        assert once.objective.duration_s == once.steps / once.demonstration.rate_hz
        start, steps = once.validation(3, 10.0, np.random.default_rng(0))
        assert steps == once.steps
        np.testing.assert_array_equal(start.sample, 0)
        assert np.abs(start.joint_offset[1:]).min(axis=1).max() > 0

    def test_tables_are_those_of_the_motions(self, once: ImitationProblem, robot: Robot) -> None:
        x = candidates(once, 2)
        tables = once.tables(x)
        for candidate, table in zip(x, tables, strict=True):
            expected = reference_table(once.motion(candidate), robot)
            for name in expected.dtype.names or ():
                np.testing.assert_allclose(table[name], expected[name], atol=1e-9, err_msg=name)

    def test_the_unmodulated_motion_scores_what_it_earns(self, once: ImitationProblem, robot: Robot) -> None:
        (score,) = once.evaluate(once.initial[None])
        rollout = run_episodes(robot, once.motion(once.initial), duration_s=5.0)
        assert score == pytest.approx(rollout.reward[0], abs=0.02)
        assert score > 0.8
