"""The 24 coordinates that are fitted: exact both ways, and periodic whatever the turn."""

import numpy as np
import pytest

from fastmimic.base.errors import MotionError
from fastmimic.motion.motion import Motion
from fastmimic.primitive.motion_dmp import NAMES, root_from_coordinates, to_coordinates, twist_of
from fastmimic.robot import Robot
from primitive.motions import cyclic_motion

CYCLES = {
    "straight": (0.6, 0.0, 0.0),
    "slight turn": (0.6, 0.02, 1e-9),
    "turn": (0.4, 0.1, -0.67),
    "sharp turn": (0.05, 0.1, 1.72),
    "side-step and back": (0.0, 0.0, 0.0),
    "half turn": (0.2, 0.1, np.pi),
    "whole turn": (0.2, 0.1, 2 * np.pi),
    "spin": (0.1, -0.1, -5.5),
}


@pytest.mark.parametrize("cycle", CYCLES.values(), ids=CYCLES.keys())
def test_the_way_there_and_back_is_exact(robot: Robot, cycle: tuple[float, float, float]) -> None:
    motion = cyclic_motion(robot, cycle)
    twist = twist_of(motion)
    position, quat, lin_vel, ang_vel = root_from_coordinates(to_coordinates(motion, twist), twist, motion.period_s)
    np.testing.assert_allclose(position, motion.root_pos_w, atol=1e-12)
    alignment = np.abs(np.sum(quat * motion.root_quat_wxyz, axis=1))
    np.testing.assert_allclose(alignment, 1.0, atol=1e-12)
    np.testing.assert_allclose(lin_vel, motion.root_lin_vel_w, atol=1e-12)
    np.testing.assert_allclose(ang_vel, motion.root_ang_vel_w, atol=1e-12)


@pytest.mark.parametrize("cycle", CYCLES.values(), ids=CYCLES.keys())
def test_coordinates_have_no_jump_at_the_wrap(robot: Robot, cycle: tuple[float, float, float]) -> None:
    """A jump would make the step from the last sample to the first differ from its neighbours."""
    y = to_coordinates(motion := cyclic_motion(robot, cycle), twist_of(motion))[:, :12]
    steps = np.diff(y, axis=0, append=y[:1])
    bends = np.abs(np.roll(steps, -1, axis=0) - steps)
    assert np.all(bends[-2:] <= 1.5 * bends[:-2].max(axis=0) + 1e-9)


def test_a_straight_drift_would_jump_where_the_gait_turns(robot: Robot) -> None:
    """Why the constant twist is removed and not the mean velocity: the check above can fail."""
    motion = cyclic_motion(robot, CYCLES["sharp turn"])
    world = np.column_stack([motion.root_lin_vel_w[:, :2], motion.root_pos_w[:, 2]])
    steps = np.diff(world, axis=0, append=world[:1])
    bends = np.abs(np.roll(steps, -1, axis=0) - steps)
    assert np.any(bends[-2:] > 1.5 * bends[:-2].max(axis=0) + 1e-9)


def test_a_constant_twist_leaves_nothing(robot: Robot) -> None:
    motion = cyclic_motion(robot, (0.5, 0.1, 0.8), wobble=0.0)
    y = to_coordinates(motion, twist_of(motion))
    planar = [NAMES.index(f"root_{c}") for c in ("x", "y", "yaw", "vx", "vy", "vz", "wx", "wy", "wz")]
    np.testing.assert_allclose(y[:, planar], 0, atol=1e-8)  # velocities come from differences


@pytest.mark.parametrize("cycle", [CYCLES["straight"], CYCLES["sharp turn"], CYCLES["whole turn"]])
def test_linear_velocities_are_the_rates_of_the_positions(robot: Robot, cycle: tuple[float, float, float]) -> None:
    motion = cyclic_motion(robot, cycle)
    y = to_coordinates(motion, twist_of(motion))
    k = np.fft.rfftfreq(motion.n_samples, 1 / motion.rate_hz)[:, None]
    rates = np.fft.irfft(2j * np.pi * k * np.fft.rfft(y[:, :3], axis=0), motion.n_samples, axis=0)
    np.testing.assert_allclose(y[:, 6:9], rates, atol=1e-6)


def test_a_motion_that_does_not_repeat_is_seen_from_where_it_begins(robot: Robot) -> None:
    motion = cyclic_motion(robot)
    once = Motion(**{**motion.__dict__, "cycle": None})
    y = to_coordinates(once, twist_of(once))
    np.testing.assert_allclose(y[0, [0, 1, 5]], 0, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.norm(y[:, :2], axis=1), np.linalg.norm(once.root_pos_w[:, :2] - once.root_pos_w[0, :2], axis=1)
    )
    for found, wanted in zip(
        root_from_coordinates(y, twist_of(once), once.period_s),
        (once.root_pos_w, once.root_quat_wxyz, once.root_lin_vel_w, once.root_ang_vel_w),
        strict=True,
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_a_trunk_that_points_up_is_refused(robot: Robot) -> None:
    motion = cyclic_motion(robot)
    quat = motion.root_quat_wxyz.copy()
    quat[10] = np.array([np.sqrt(0.5), 0, -np.sqrt(0.5), 0])
    rearing = Motion(**{**motion.__dict__, "root_quat_wxyz": quat})
    with pytest.raises(MotionError, match=r"pitches to -90° at sample 10"):
        to_coordinates(rearing, twist_of(rearing))
