"""Margins that a robot needs: feet load gradually, and the capture point stays inside the feet of one side."""

from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.synthesis import generate
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.trajectory import executable
from fastmimic.trajectory import solve as solve_module
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.executable import nearest_executable
from fastmimic.trajectory.margins import heaviest
from fastmimic.trajectory.node import GIVEN
from fastmimic.trajectory.program import Program

STEADY = {"capture_weight": 1000.0, "acceleration_weight": 3e-3, "capture_m": 0.06}


@pytest.fixture(scope="module")
def pace(a1: Robot) -> Motion:
    return retarget(generate("pace"), a1, executable=False)[0]


def test_forces_grow_from_touch_down_and_fade_to_lift_off(a1: Robot, pace: Motion) -> None:
    config = TrajectoryConfig(loading=2.0)
    program = Program(a1, pace, config)
    modes, step = program.modes, program.animal_steps
    force = heaviest(modes, step, config)
    for k, hold in enumerate(modes.footholds):
        node = np.flatnonzero((modes.foothold[:, hold.leg] == k) & modes.stands[:, hold.leg])
        node = node[np.argsort(modes.laps[node, hold.leg], kind="stable")]
        after = force[node, hold.leg]
        assert after[0] == after[-1] == config.least_force
        peak = int(np.argmax(after))
        assert (np.diff(after[: peak + 1]) >= 0).all()
        assert (np.diff(after[peak:]) <= 0).all()
    solved = program.solve()
    assert (solved.force[..., 2] <= force + 1e-6)[modes.loaded].all()
    # twice a half sine's slope that carries half of the weight on two feet, for a stance of T
    stance = float(modes.contact[modes.mode][:, 0] @ step)
    inside = (force[:, 0] > config.least_force) & (force[:, 0] < config.most_force)
    slopes = np.abs(np.diff(force[:, 0]) / step[:-1])[inside[1:] & inside[:-1]]
    feet = modes.contact[modes.mode][modes.stands[:, 0]].sum(axis=1).mean()
    assert np.median(slopes) == pytest.approx(2 * np.pi**2 / (2 * feet * stance), rel=0.02)


def test_a_margin_is_asked_for_where_one_side_stands_alone(a1: Robot, pace: Motion) -> None:
    asked = Program(a1, pace, TrajectoryConfig(capture_m=0.04)).given[:, GIVEN["capture"]]
    left = a1.hip_pos_b[:, 1] > 0
    assert set(np.unique(asked)) == {-1.0, 0.04}
    assert (asked[:, left] == asked[:, left][:, :1]).all()
    assert 0.3 < (asked[:, left] > 0).mean() < 0.7
    trot = retarget(generate("trot"), a1, executable=False)[0]
    assert (Program(a1, trot, TrajectoryConfig()).given[:, GIVEN["capture"]] == -1.0).all()


def inside(a1: Robot, motion: Motion) -> float:
    """Least distance of the capture point from the left feet while they stand, m."""
    yaw = yaw_from_quat(motion.root_quat_wxyz)
    velocity = rotate_planar(-yaw, motion.root_lin_vel_w[:, :2])[:, 1]
    feet = motion.foot_pos_w - motion.root_pos_w[:, None]
    left = [leg for leg in range(4) if a1.hip_pos_b[leg, 1] > 0]
    side = rotate_planar(-yaw[:, None], feet[..., :2])[..., 1]
    capture = velocity * np.sqrt(motion.root_pos_w[:, 2] / 9.81)
    return float(min((side[:, leg] - capture)[motion.contact[:, left].all(axis=1)].min() for leg in left))


def test_the_capture_point_stays_further_inside(a1: Robot, pace: Motion) -> None:
    near, steady = (nearest_executable(a1, pace, TrajectoryConfig(**given)).motion for given in ({}, STEADY))
    assert inside(a1, steady) > inside(a1, near) + 0.005


def test_more_margins_while_the_robot_falls(a1: Robot, pace: Motion) -> None:
    asked: list[Motion] = []

    def falls(shares: list[float]):  # type: ignore[no-untyped-def]
        def share(robot: Robot, motion: Motion) -> float:
            asked.append(motion)
            return shares[len(asked) - 1]

        return share

    held = nearest_executable(a1, pace, falls=falls([0.0]))
    assert len(asked) == 1
    assert held.figures.margins == {}
    assert held.figures.fell == 0.0
    asked.clear()
    found = nearest_executable(a1, pace, falls=falls([0.5, 0.375, 0.125, 0.25]))
    assert len(asked) == 4
    assert found.motion is asked[2]
    assert found.figures.margins == STEADY
    text = "\n".join(found.figures.lines())
    assert "margins changed: capture_weight 1000" in text
    assert "falls all the same from 12 %" in text
    asked.clear()
    assert nearest_executable(a1, pace, falls=falls([0.5, 0.0])).figures.margins == {"least_force": 0.08}


def test_more_margin_while_a_limit_is_exceeded_between_the_nodes(
    a1: Robot, pace: Motion, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert nearest_executable(a1, pace).figures.exceeded == []
    uses = iter([{"friction": 1.2}, {"friction": 1.1}, {"friction": 0.9}])
    monkeypatch.setattr(executable, "_most_used", lambda *given: next(uses))
    kept = nearest_executable(a1, pace).figures
    assert kept.margins == {"friction": 0.36, "torque_share": 0.75, "speed_share": 0.9}
    assert kept.most == {"friction": 0.9}
    uses = iter([{"torque": 1.2, "friction": 1.1}, {"torque": 1.3, "friction": 0.8}])
    worst = nearest_executable(a1, pace).figures  # friction alone would not help; of two the one that exceeds it least
    assert worst.margins == {}
    assert "exceeded between the nodes: torque, 1.20 of it" in worst.lines()
    monkeypatch.setattr(executable, "_FURTHER", 0.5)
    uses = iter([{"torque": 1.2}, {"torque": 0.9}])
    assert nearest_executable(a1, pace).figures.margins == {}  # so much further from the animal's: another motion


def test_what_came_of_running_it_is_kept_for_this_packages_own_check(
    a1: Robot, pace: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    asked: list[Motion] = []

    def share(robot: Robot, motion: Motion) -> float:
        asked.append(motion)
        return 0.0

    share.__module__ = "fastmimic.episode.loop"
    for _ in range(2):
        assert nearest_executable(a1, pace, falls=share).figures.fell == 0.0
    assert len(asked) == 1
    share.__module__ = "somebody.elses"
    for _ in range(2):
        nearest_executable(a1, pace, falls=share)
    assert len(asked) == 3


@pytest.mark.slow
def test_a_problem_is_solved_once(a1: Robot, pace: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("fastmimic.trajectory.solved._packaged", lambda general: [])  # as if it were not in the package
    solved: list[object] = []
    make_solver = solve_module.make_solver
    monkeypatch.setattr(solve_module, "make_solver", lambda *given: solved.append(given) or make_solver(*given))
    first = Program(a1, pace, TrajectoryConfig()).solve()
    again = Program(a1, pace, TrajectoryConfig()).solve()
    assert len(solved) == 1
    np.testing.assert_array_equal(first.variables, again.variables)
    assert (first.cost, first.iterations, first.converged) == (again.cost, again.iterations, again.converged)
    Program(a1, pace, TrajectoryConfig(friction=0.41)).solve()
    assert len(solved) == 2
    for path in (tmp_path / "fastmimic" / "executable").glob("*.npz"):
        path.write_bytes(b"damaged")
    Program(a1, pace, TrajectoryConfig()).solve()
    assert len(solved) == 3
    # what did not converge is not kept
    for _ in range(2):
        assert not Program(a1, pace, TrajectoryConfig(iterations=1)).solve().converged
    assert len(solved) == 5
