"""A long passage is solved in windows: each goes on where the one before is held, and the whole keeps every limit."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fastmimic.base.errors import MotionError
from fastmimic.clips.clip import Clip
from fastmimic.clips.synthesis import generate
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.executable import nearest_executable
from fastmimic.trajectory.ipopt import DIVERGED
from fastmimic.trajectory.program import Program, Solution
from fastmimic.trajectory.windows import Guess, windows_of

SHORT = TrajectoryConfig(window_s=0.4, overlap_s=0.15)


def trotting(a1: Robot, cycles: int, clip: Clip | None = None) -> Motion:
    """Cycles of a trot, done once."""
    clip = clip or generate("trot")
    travel = clip.points_w[-1] - clip.points_w[0] + clip.points_w[-1] - clip.points_w[-2]
    step = travel.mean(axis=0) * np.array([1.0, 1.0, 0.0])
    points = np.concatenate([clip.points_w + k * step for k in range(cycles)])
    return retarget(replace(clip, points_w=points), a1, cycle=False, executable=False)[0]


def excess(program: Program, solution: Solution) -> float:
    """By how much a solution exceeds a bound of its rows."""
    low, high = program.bounds_of_rows()
    rows = program.rows(solution.variables)
    return float(np.nanmax(np.maximum(low - rows, rows - high)))


@pytest.fixture(scope="module")
def passage(a1: Robot) -> Motion:
    return trotting(a1, 2)


def test_windows_overlap_and_cover_the_whole(a1: Robot, passage: Motion) -> None:
    program = Program(a1, passage, SHORT)
    windows = windows_of(program.modes, program.animal_steps, SHORT)
    assert len(windows) >= 3
    nodes = np.concatenate([window.nodes for window in windows])
    np.testing.assert_array_equal(np.unique(nodes), np.arange(program.modes.n_nodes))
    for before, after in pairwise(windows):
        shared = before.ends_s - after.begins_s
        assert 0.1 < shared < 0.2
        assert before.nodes[0] < after.nodes[0] <= before.nodes[-1] < after.nodes[-1]
    assert len(windows_of(program.modes, program.animal_steps, TrajectoryConfig())) == 1
    cycle = Program(a1, retarget(generate("walk"), a1, executable=False)[0], SHORT)
    assert len(windows_of(cycle.modes, cycle.animal_steps, SHORT)) == 1


@pytest.mark.slow
def test_a_long_passage_that_diverges_in_one_piece_is_tried_in_shorter_windows(
    a1: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve, tried = Program.solve, list[tuple[float, float]]()

    def diverging(problem: Program, start: Guess | None = None, first: int = 0) -> Solution:
        tried.append((problem.config.window_s, problem.config.friction))
        return replace(solve(problem, start, first), status=DIVERGED)

    monkeypatch.setattr(Program, "solve", diverging)
    with pytest.raises(MotionError, match="keeps the limits"):
        nearest_executable(a1, trotting(a1, 5), TrajectoryConfig(iterations=1))
    assert tried == [(4.0, 0.42), (2.0, 0.42), (2.0, 0.42), (2.0, 0.5)]


def test_the_whole_keeps_every_limit_and_is_near_that_of_one_piece(a1: Robot, passage: Motion) -> None:
    program = Program(a1, passage, SHORT)
    solution = program.solve()
    assert solution.converged
    assert excess(program, solution) < 1e-4
    whole = nearest_executable(a1, passage, replace(SHORT, window_s=10.0)).motion
    parts = nearest_executable(a1, passage, SHORT).motion
    n = min(whole.n_samples, parts.n_samples)
    assert abs(whole.n_samples - parts.n_samples) <= 3
    assert np.abs(whole.root_pos_w[:n] - parts.root_pos_w[:n]).max() < 0.02
    assert np.sqrt(np.mean((whole.joint_pos[:n] - parts.joint_pos[:n]) ** 2)) < 0.05


def test_a_passage_is_tried_again_from_the_window_before_the_one_without_a_solution(a1: Robot, passage: Motion) -> None:
    """What is solved stays as it is, and the rest keeps the other margins."""
    solved = Program(a1, passage, SHORT).solve()
    assert solved.so_far is not None
    windows = windows_of(Program(a1, passage, SHORT).modes, Program(a1, passage, SHORT).animal_steps, SHORT)
    assert solved.first == windows[-2].nodes[0] > 0
    program = Program(a1, passage, replace(SHORT, contact_m_per_s=0.5))
    again = program.solve(solved.so_far, solved.first)
    assert again.converged
    assert again.iterations < solved.iterations
    np.testing.assert_array_equal(again.coordinates[: solved.first + 1], solved.coordinates[: solved.first + 1])
    assert np.abs(again.coordinates[solved.first + 1 :] - solved.coordinates[solved.first + 1 :]).max() > 1e-4
    assert excess(program, again) < 1e-4


def test_a_passage_with_which_the_robot_falls_goes_on_from_what_was_found(a1: Robot, passage: Motion) -> None:
    """What helped stays, and the solver takes fewer iterations than from the animal's motion."""
    shares = iter([0.5, 0.25, 0.0])
    found = nearest_executable(a1, passage, falls=lambda robot, motion: next(shares))
    assert found.figures.margins["least_force"] == 0.08
    assert found.figures.margins["capture_weight"] > 0
    assert found.figures.fell == 0.0
    config = replace(TrajectoryConfig(), **found.figures.margins)
    anew = Program(a1, passage, config).solve()
    assert found.figures.iterations < anew.iterations


def test_windows_have_strides_of_their_own(a1: Robot) -> None:
    """Each follows the animal's way on from where the one before has led it, and the whole keeps every limit."""
    passage = trotting(a1, 2, generate("trot", speed=2.5))
    config = replace(SHORT, window_strides=True, stride_weight=0.1, keep_time=True, speed_share=0.85)
    program = Program(a1, passage, config)
    solution = program.solve()
    assert solution.converged
    assert excess(program, solution) < 1e-4
    animal = program.animal["position"][:, :2]
    strides = np.diff(solution.way[:, 0]) / np.diff(animal[:, 0])
    firsts = [window.nodes[0] for window in windows_of(program.modes, program.animal_steps, config)]
    assert (np.flatnonzero(abs(np.diff(strides)) > 1e-6) + 1).tolist() == firsts[1:]
    assert abs(solution.way[-1, 0] - animal[-1, 0]) > 0.003
    assert solution.stride == pytest.approx(solution.way[-1, 0] / animal[-1, 0], abs=1e-3)
    assert np.abs(solution.coordinates[:, :2] - solution.way).max() < 0.03
