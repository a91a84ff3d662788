"""The nearest executable motion: it keeps every limit, stays near the animal's, and says what gave."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.arrays import Array, stretches
from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.synthesis import generate
from fastmimic.episode.feasibility import demands
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import Metrics
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.trajectory import solved
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.executable import Executable, nearest_executable
from fastmimic.trajectory.ipopt import DIVERGED
from fastmimic.trajectory.program import Program, Solution


@pytest.fixture(scope="module")
def animal(a1: Robot) -> Motion:
    return retarget(generate("turn"), a1, executable=False)[0]


@pytest.fixture(scope="module")
def turn(a1: Robot, animal: Motion) -> Executable:
    return nearest_executable(a1, animal)


def test_it_keeps_every_limit_by_mujocos_inverse_dynamics(a1: Robot, animal: Motion, turn: Executable) -> None:
    asked, found = demands(a1, animal), demands(a1, turn.motion)
    assert asked.lacking > 0.05  # the animal's motion asks for what the feet cannot give
    assert found.lacking < 0.05
    assert found.torque <= 1.0
    assert found.torque_at_speed <= 1.0
    assert found.joint_speed <= 1.0
    assert found.friction <= 0.6
    assert found.slide_m < 2e-3
    assert found.body_clearance_m > 0.0


def test_a_gallop_keeps_the_motors_limits_between_the_nodes(a1: Robot, data_folder: Path) -> None:
    """Its legs swing at full speed in both directions, and feet touch down a few milliseconds after one another."""
    run = open_clip(data_folder / "dog_keypoints" / "dog_run00_joint_pos.txt", frames=(427, 454))
    motion, report = retarget(run, a1, cycle=True)
    assert report.executable is not None
    assert report.executable.active["torque at speed"] > 0.1
    highest = demands(a1, motion, sample_s=motion.dt, percentile=100)
    assert highest.torque <= 1.0
    assert highest.torque_at_speed <= 1.01
    assert highest.joint_speed <= 0.97
    assert demands(a1, motion, sample_s=motion.dt, percentile=99).friction <= 0.6


def test_solution_is_consistent_and_within_its_bounds(a1: Robot, animal: Motion, turn: Executable) -> None:
    solution = turn.solution
    program = Program(a1, animal, TrajectoryConfig())
    low, high = program.bounds_of_rows()
    assert solution.converged
    rows = program.rows(solution.variables)
    assert np.nanmax(np.maximum(low - rows, rows - high)) < 1e-4
    modes = program.modes
    assert (solution.force[~modes.loaded] == 0.0).all()
    assert (solution.force[modes.loaded][:, 2] > 0.0).all()
    total = solution.force.sum(axis=1)[:, 2]
    steps = np.diff(solution.time)
    mean = (total * 0.5 * (steps + np.roll(steps, 1))).sum() / solution.time[-1]
    assert mean == pytest.approx(1.0, abs=0.02)  # over a cycle the ground carries the weight


def test_it_repeats_and_stays_near_the_animal(animal: Motion, turn: Executable) -> None:
    motion = turn.motion
    assert motion.cycle is not None
    assert motion.cycle[2] == animal.cycle[2]
    step = motion.root_pos_w[1] - motion.root_pos_w[0]
    assert np.linalg.norm(step - motion.root_lin_vel_w[0] * motion.dt) < 1e-4
    np.testing.assert_allclose(motion.joint_pos, turn.motion.animal.joint_pos, atol=0.35)
    assert max(turn.figures.trunk_m) < 0.04
    assert turn.figures.speed_share == pytest.approx(1.0, abs=0.02)
    # velocities are those of the positions
    differences = np.diff(motion.root_pos_w, axis=0) / motion.dt
    middle = 0.5 * (motion.root_lin_vel_w[1:] + motion.root_lin_vel_w[:-1])
    np.testing.assert_allclose(differences, middle, atol=5e-3)
    last = motion.root_pos_w[-1] + motion.root_lin_vel_w[-1] * motion.dt
    heading = float(yaw_from_quat(motion.root_quat_wxyz[0]))
    following = motion.root_pos_w[0, :2] + rotate_planar(heading, motion.cycle[:2])
    assert np.linalg.norm(last[:2] - following) < 2e-3


@pytest.mark.slow
def test_the_same_problem_has_the_same_solution_bit_for_bit(
    a1: Robot, animal: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # neither the package nor the user's folder knows the solution
    monkeypatch.setattr(solved, "_packaged", lambda general: [])
    found = []
    for folder in ("once", "again"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / folder))
        found.append(Program(a1, animal, TrajectoryConfig()).solve().variables)
    np.testing.assert_array_equal(*found)


def test_animal_at_the_same_phases(a1: Robot, animal: Motion) -> None:
    kept = nearest_executable(a1, animal, TrajectoryConfig(keep_time=True, keep_speed=True))
    assert kept.motion.n_samples == animal.n_samples
    aligned = kept.motion.animal
    assert aligned is not None
    np.testing.assert_allclose(aligned.joint_pos, animal.joint_pos, atol=1e-9)
    np.testing.assert_allclose(aligned.root_lin_vel_w, animal.root_lin_vel_w, atol=1e-9)
    np.testing.assert_array_equal(aligned.contact, animal.contact)
    np.testing.assert_allclose(kept.motion.cycle, animal.cycle, atol=0.01)


def test_scored_against_the_animal_as_well(a1: Robot, turn: Executable) -> None:
    found = Metrics.of(run_episodes(a1, turn.motion, duration_s=1.5))
    assert found.fell == 0.0
    assert found.reward_mean > 0.98
    assert found.reward_animal is not None
    assert 0.95 < found.reward_animal < found.reward_mean
    # an animal that is the motion itself has the same reward
    itself = replace(turn.motion, animal=replace(turn.motion, animal=None))
    same = Metrics.of(run_episodes(a1, itself, duration_s=1.5))
    assert same.reward_animal == pytest.approx(same.reward_mean, abs=1e-12)
    assert Metrics.of(run_episodes(a1, replace(turn.motion, animal=None), duration_s=0.2)).reward_animal is None


def test_feet_roll_as_the_robots_do(a1: Robot) -> None:
    still, _ = retarget(generate("trot"), a1, executable=False)
    rolling, _ = retarget(generate("trot"), a1)
    for motion, least, most in ((still, 0.0, 1e-6), (rolling, 0.012, 0.025)):  # its calves turn by 0.87 rad
        ends = [(leg, *ends) for leg in range(4) for ends in stretches(motion.contact[:, leg])]
        leg, first, end = max(ends, key=lambda found: found[2] - found[1])
        way = np.linalg.norm(motion.foot_pos_w[end - 1, leg, :2] - motion.foot_pos_w[first, leg, :2])
        assert least <= way <= most
        assert demands(a1, motion).slide_m < 2e-3
    rewards = [Metrics.of(run_episodes(a1, motion, duration_s=3.0)).reward_mean for motion in (still, rolling)]
    assert rewards[1] > rewards[0] + 0.005, "where the reference's feet do not roll, the robot runs ahead of it"


def test_the_animal_is_saved_with_the_motion(tmp_path: Path, turn: Executable) -> None:
    optimised = replace(turn.motion, animal=None, demonstration=turn.motion)
    optimised.save(tmp_path / "motion.npz")
    target = Motion.load(tmp_path / "motion.npz").target
    assert target.animal is not None
    assert turn.motion.animal is not None
    np.testing.assert_array_equal(target.animal.joint_pos, turn.motion.animal.joint_pos)


@pytest.mark.slow
def test_what_no_motion_keeps_is_refused_with_its_limit(a1: Robot, animal: Motion) -> None:
    weak = replace(a1, torque_limit=0.1 * a1.torque_limit)
    with pytest.raises(MotionError, match=r"no motion of a1 near 'turn' keeps the limits: .* by .* at \d"):
        nearest_executable(weak, animal, TrajectoryConfig(iterations=2))


@pytest.mark.slow
@pytest.mark.parametrize("diverges", [True, False])
def test_no_margin_helps_where_the_solver_diverges_with_all_and_without(
    a1: Robot, animal: Motion, monkeypatch: pytest.MonkeyPatch, diverges: bool
) -> None:
    solve, tried = Program.solve, list[tuple[float, float]]()

    def diverging(problem: Program, start: Array | None = None, first: int = 0) -> Solution:
        tried.append((problem.config.clearance_share, problem.config.friction))
        found = solve(problem, start, first)
        return replace(found, status=DIVERGED) if len(tried) == 1 or diverges else found

    monkeypatch.setattr(Program, "solve", diverging)
    weak, config = replace(a1, torque_limit=0.1 * a1.torque_limit), TrajectoryConfig(iterations=2)
    with pytest.raises(MotionError, match="keeps the limits"):
        nearest_executable(weak, animal, config)
    whole, least = (config.clearance_share, config.friction), (0.3, 0.5)
    in_order = [whole, (0.3, config.friction), least]
    assert tried == ([whole, least] if diverges else [whole, least, *in_order])


def test_a_passage_that_does_not_repeat(a1: Robot) -> None:
    kinematic = retarget(generate("trot"), a1, cycle=False, executable=False)[0]
    motion, report = retarget(generate("trot"), a1, cycle=False)
    assert motion.cycle is None
    assert motion.animal is not None
    assert motion.animal.cycle is None
    assert motion.n_samples == motion.animal.n_samples
    assert report.executable is not None
    assert "executable: speed × " in "\n".join(report.lines())
    assert motion.provenance.retarget is not None
    assert motion.provenance.retarget["executable"]["speed_share"] == report.executable.speed_share
    assert set(report.executable.peak) == {"torque", "torque at speed", "joint speed", "friction"}
    assert all(0.0 < value <= 1.0 for value in report.executable.peak.values())
    duration = report.executable.period_s[1]
    assert motion.n_samples == round(duration * motion.rate_hz) + 1
    assert duration == pytest.approx(kinematic.period_s - kinematic.dt, abs=0.01)
    # the ends have one neighbour alone, and no dynamics
    needs, asked = demands(a1, motion), demands(a1, kinematic)
    assert needs.torque <= 1.0
    assert needs.slide_m < 2e-3
    assert needs.lacking < 0.5 * asked.lacking
    found = Metrics.of(run_episodes(a1, motion, duration_s=(motion.n_samples - 1) * motion.dt))
    assert found.fell == 0.0
    assert found.reward_animal is not None
    assert found.reward_animal > 0.9


def test_a_run_that_is_cut_in_mid_stride_does_not_sink_there(a1: Robot, data_folder: Path) -> None:
    """Held to the animal's joint speeds at its end, the trunk sank by 6 cm in the last quarter of a second."""
    run = open_clip(data_folder / "dog_keypoints" / "dog_run00_joint_pos.txt", frames=(470, 500), cycle=False)
    motion, _ = retarget(run, a1)
    animal = motion.animal
    assert animal is not None
    assert np.abs(motion.root_pos_w[-1, 2] - animal.root_pos_w[-1, 2]) < 0.01
    assert motion.root_lin_vel_w[-1, 0] > 2.0
