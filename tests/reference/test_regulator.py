"""The regulator's gains: what the linear model says of a robot, and what follows from it in the closed loop."""

import dataclasses

import numpy as np
import pytest

from control.motions import gait, standing
from control.rig import Rig, on_reference
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.control.config import ControllerConfig
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator import STATES, _Model, motion_gains, regulator_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.table import GAIN_SAMPLES, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

CONFIG = RegulatorConfig()
PACE = (0.0, 0.5, 0.0, 0.5)  # touch-downs: the legs of a side together


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return gait(robot, (0.4, 0.1), 0.5)


def model(motion: Motion, robot: Robot, config: RegulatorConfig = CONFIG) -> _Model:
    turn = None if motion.cycle is None else float(motion.cycle[2])
    return _Model(reference_table(motion, robot), robot, config, motion.dt, turn)


def test_a_body_on_one_sides_feet_falls_like_an_inverted_pendulum(robot: Robot) -> None:
    """Left alone, errors about the line of the feet grow as cosh(t √(m g h / (m h² + I)))."""
    motion = gait(robot, touchdown=PACE, duty=0.5)
    found = model(motion, robot)
    table = reference_table(motion, robot)
    right = np.flatnonzero(table["contact"][::GAIN_SAMPLES, 0] & table["contact"][::GAIN_SAMPLES, 2])
    k = int(right[len(right) // 2])
    arm = np.mean(table["foot_pos"][0, [0, 2]], axis=0) - robot.com_b
    height = -arm[2] + robot.foot_radius
    # a rotation about the line of the feet, in which no force of theirs does work
    about_com = float(robot.inertia_b[0, 0])
    rotation = np.zeros(STATES)
    rotation[3], rotation[1], rotation[2] = 1.0, -height, -arm[1]
    after = found.state[k] @ rotation
    sideways, turning = after[7] / found.step[k], after[9] / found.step[k]
    work = robot.mass * (sideways * -height) + about_com * turning
    np.testing.assert_allclose(work, robot.mass * GRAVITY * height, rtol=0.1)


def test_forces_of_standing_feet_accelerate_the_body_by_newton_and_euler(robot: Robot) -> None:
    found = model(standing(robot), robot)
    push = np.zeros(20)
    push[[2, 5, 8, 11]] = 3.0  # N, upwards
    change = found.control[0] @ push / found.step[0]
    np.testing.assert_allclose(change[8], 12.0 / robot.mass)
    np.testing.assert_allclose(change[[6, 7]], 0.0, atol=1e-12)


def test_a_foot_in_stance_keeps_its_place_and_one_in_the_air_is_moved(robot: Robot, trot: Motion) -> None:
    found, contact = model(trot, robot), trot.contact[::GAIN_SAMPLES]
    k = int(np.flatnonzero(contact.sum(axis=1) == 2)[5])
    for leg in range(4):
        moved = found.control[k][12 + 2 * leg : 14 + 2 * leg, 12 + 2 * leg : 14 + 2 * leg]
        assert np.any(moved) == (not contact[k, leg])
        assert np.any(found.control[k][:, 3 * leg : 3 * leg + 3]) == contact[k, leg]


def test_the_gains_make_every_error_vanish_within_some_cycles(robot: Robot, trot: Motion) -> None:
    found, gains = model(trot, robot), motion_gains(trot, robot, CONFIG)
    value = np.eye(STATES)
    for _ in range(6):
        for k in range(len(gains)):
            # the forces that give the trunk the wanted acceleration best
            by_force = found.control[k][6:12, :12] / found.step[k]
            root = np.linalg.cholesky(gains[k]["weight"]).T
            force = np.linalg.pinv(root @ by_force, rcond=1e-6) @ root @ -gains[k]["trunk"]
            value = (found.state[k] + found.control[k] @ np.vstack([force, -gains[k]["feet"]])) @ value
    moved = value[:12, :12]
    assert np.abs(np.linalg.eigvals(moved)).max() < 0.5


def test_a_robot_that_falls_to_a_side_steps_to_that_side(robot: Robot, trot: Motion) -> None:
    """The shift of the next footholds is what the capture point says, √(h/g) for each m/s, give or take a half."""
    gains, contact = motion_gains(trot, robot, CONFIG), trot.contact
    config = ControllerConfig()
    start = int(np.flatnonzero(contact[:, 0] & ~np.roll(contact[:, 0], -1))[0]) + 1  # leg FR lifts off
    rig = Rig(robot, [trot], np.array([start]), config)
    last = start
    while not contact[last % trot.n_samples, 0]:
        at = np.array([last % trot.n_samples])
        rig.clocks["sample"] = at
        observation = on_reference(trot, at)
        observation["lin_vel"][:, 1] += 0.3
        rig.step(observation)
        last += 1
    shift = rig.controller.memory["foot_shift"][0, 0, 1] + 0.3 * (last - start) / 500  # the trunk moved on, too
    expected = 0.3 * np.sqrt(robot.leg_length / GRAVITY)
    assert 0.5 * expected < shift < 2.0 * expected
    assert gains.shape == (-(-trot.n_samples // GAIN_SAMPLES),)


def test_gains_belong_to_a_demonstration_and_are_made_once(robot: Robot, trot: Motion) -> None:
    gains = motion_gains(trot, robot, CONFIG)
    assert motion_gains(dataclasses.replace(trot, demonstration=trot), robot, CONFIG) is gains
    other = motion_gains(trot, robot, dataclasses.replace(CONFIG, foot_cost=1e-3))
    assert np.abs(other["feet"]).max() < np.abs(gains["feet"]).max()


def test_the_heading_does_not_matter(robot: Robot) -> None:
    one, other = (motion_gains(gait(robot, (0.4, 0.1), 0.5, yaw0=yaw), robot, CONFIG) for yaw in (0.0, 2.0))
    for name in one.dtype.names or ():
        np.testing.assert_allclose(one[name], other[name], rtol=1e-6, atol=1e-6)


def test_a_motion_that_ends_has_gains_to_its_end(robot: Robot, trot: Motion) -> None:
    table = reference_table(trot, robot)
    gains = regulator_gains(table[:101], robot, CONFIG, trot.dt, None)
    assert len(gains) == 26
    assert np.isfinite(gains["trunk"]).all()


def test_the_disturbance_is_what_the_forces_do_not_explain(robot: Robot) -> None:
    """A push of 1 m/s² that lasts is known after some time constants, and made up for."""
    stand = standing(robot)
    rig = Rig(robot, [stand], np.array([0]), ControllerConfig())
    observation = on_reference(stand, np.array([0]))
    rig.step(observation)
    for _ in range(2000):
        expected = rig.controller.memory["expected"][0]
        observation["lin_vel"][0] += (expected[:3] + np.array([0.0, 1.0, 0.0])) / 500.0
        rig.step(observation)
        observation["lin_vel"][0] = 0.0
        rig.controller.memory["velocity"][0] = 0.0
    np.testing.assert_allclose(rig.controller.memory["disturbance"][0][:3], [0.0, 1.0, 0.0], atol=0.05)
    assert np.abs(foot_positions(robot, observation["joint_pos"])).max() < 1.0


def test_nonsense_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"regulator\.foot_cost must be positive"):
        ControllerConfig(regulator=dataclasses.replace(CONFIG, foot_cost=0.0))
