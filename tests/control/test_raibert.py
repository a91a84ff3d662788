"""The Raibert swing: straight in time from lift-off to the foothold, and nothing of the animal's feet in it."""

import dataclasses

import numpy as np
import pytest

from control.motions import gait
from control.rig import Rig, disturbed, on_reference
from fastmimic.base.errors import ConfigError
from fastmimic.control.config import CONFIGS, ControllerConfig, SwingConfig, controller_config
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

pytestmark = pytest.mark.nojit

VELOCITY = (0.4, 0.1)
SWINGING = 180
"""A sample of the gait in which FR and RL swing."""
LEGS = [0, 3]


def raibert(name: str, **swing: float) -> ControllerConfig:
    config = METHODS["raibert"].configure(controller_config(name))
    return dataclasses.replace(config, swing=dataclasses.replace(config.swing, **swing))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return gait(robot, VELOCITY)


def under_hips(robot: Robot) -> np.ndarray:
    """(4, 2) where the feet stand straight below the hips."""
    return robot.hip_pos_b[:, :2] + np.column_stack([robot.hip_shift[:, 0], robot.lateral_offset])


def commanded_feet(robot: Robot, command: np.ndarray) -> np.ndarray:
    return foot_positions(robot, command["joint_pos"][0])


def lifting_off(robot: Robot, trot: Motion, config: ControllerConfig) -> tuple[Rig, np.ndarray]:
    """A robot just before FR and RL lift off, its clock held from then on; and what it observes in the air."""
    before = int(np.flatnonzero(trot.contact[:-1, 0] & ~trot.contact[1:, 0])[0])
    rig = Rig(robot, [trot], np.array([before]), config)
    observation = on_reference(trot, np.array([before]))
    rig.step(observation)
    rig.clocks["sample"] = before + 1
    observation["foot_force"][:, LEGS] = 0.0
    return rig, observation


def test_only_the_swing_differs_from_the_controller_of_its_neighbour() -> None:
    for name in ("default", "paper"):
        config = controller_config(name)
        changed = METHODS["raibert"].configure(config)
        assert changed != config
        swing = dataclasses.replace(changed.swing, foothold=config.swing.foothold)
        stance = dataclasses.replace(
            changed.stance, leg_momentum=config.stance.leg_momentum, feedback=config.stance.feedback
        )
        assert dataclasses.replace(changed, swing=swing, stance=stance) == config


@pytest.mark.parametrize("error", [(0.0, 0.0), (0.2, -0.1)])
def test_the_foothold_is_that_of_the_formula(robot: Robot, trot: Motion, error: tuple[float, float]) -> None:
    config = raibert("paper")
    rig = Rig(robot, [trot], np.array([SWINGING]), config)  # long after lift-off
    observation = on_reference(trot, np.array([SWINGING]))
    observation["lin_vel"][0, :2] -= error
    feet = commanded_feet(robot, rig.step(observation))
    v = np.array(VELOCITY) - error
    feedback = np.array(config.swing.velocity_feedback) * error
    wanted = under_hips(robot) + 0.5 * config.swing.swing_time * v - feedback
    np.testing.assert_allclose(feet[LEGS, :2], wanted[LEGS], atol=1e-9)
    height = float(observation["root_pos"][0, 2])
    np.testing.assert_allclose(feet[LEGS, 2], robot.foot_radius - height, atol=1e-9)


def test_the_path_is_straight_in_time_and_its_apex_the_configured_one(robot: Robot, trot: Motion) -> None:
    config = raibert("default", swing_time=0.1, swing_height=0.06)
    rig, observation = lifting_off(robot, trot, config)
    feet = np.array([commanded_feet(robot, rig.step(observation)) for _ in range(60)])
    start = foot_positions(robot, observation["joint_pos"][0])
    np.testing.assert_allclose(feet[0, LEGS], start[LEGS], atol=1e-9)
    share = np.minimum(np.arange(60) * config_dt(config) / 0.1, 1.0)[:, None, None]
    straight = feet[0, LEGS, :2] + share * (feet[-1, LEGS, :2] - feet[0, LEGS, :2])
    np.testing.assert_allclose(feet[:, LEGS, :2], straight, atol=1e-9)
    ground = robot.foot_radius - float(observation["root_pos"][0, 2])
    np.testing.assert_allclose(feet[:, LEGS, 2].max(axis=0), ground + 0.06, atol=1e-6)
    np.testing.assert_allclose(feet[50:, LEGS, 2], ground, atol=1e-9)


def test_the_commanded_joint_velocity_is_that_of_the_path(robot: Robot, trot: Motion) -> None:
    config = raibert("default")
    rig, observation = lifting_off(robot, trot, config)
    commands = [rig.step(observation)[0] for _ in range(90)]
    joints = np.array([c["joint_pos"] for c in commands])[:, [0, 1, 2, 9, 10, 11]]
    speed = np.array([c["joint_vel"] for c in commands])[:, [0, 1, 2, 9, 10, 11]]
    np.testing.assert_allclose(speed[1:-1], (joints[2:] - joints[:-2]) / (2 * config_dt(config)), atol=1e-6)


def test_the_path_stays_level_under_a_tilted_trunk(robot: Robot, trot: Motion) -> None:
    config = raibert("default")
    rig = Rig(robot, [trot], np.array([SWINGING]), config)
    observation = on_reference(trot, np.array([SWINGING]))
    pitch = 0.1
    observation["root_quat"] = (np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0)
    feet = commanded_feet(robot, rig.step(observation))
    height = observation["root_pos"][0, 2] - np.sin(pitch) * feet[:, 0] + np.cos(pitch) * feet[:, 2]
    np.testing.assert_allclose(height[LEGS], robot.foot_radius, atol=1e-9)


@pytest.mark.parametrize("name", ["default", "paper"])
def test_nothing_of_the_animals_feet_reaches_a_swing_leg(robot: Robot, trot: Motion, name: str) -> None:
    rng = np.random.default_rng(0)
    other = gait(robot, VELOCITY, lift=0.09)
    observation = disturbed(on_reference(trot, np.array([SWINGING])), rng)
    observation["foot_force"] = 0.0
    observation["foot_force"][:, [1, 2], 2] = 60.0
    a, b = (Rig(robot, [m], np.array([SWINGING]), raibert(name)).step(observation) for m in (trot, other))
    joints = [3 * leg + j for leg in LEGS for j in range(3)]
    for field in ("joint_pos", "joint_vel"):
        np.testing.assert_array_equal(a[field][:, joints], b[field][:, joints])
    animal = [Rig(robot, [m], np.array([SWINGING]), controller_config(name)).step(observation) for m in (trot, other)]
    assert not np.array_equal(animal[0]["joint_pos"][:, joints], animal[1]["joint_pos"][:, joints])


@pytest.mark.parametrize(
    ("swing", "message"),
    [
        ({"foothold": "capture"}, "swing.foothold must be one of reference, raibert"),
        ({"swing_time": 0.0}, "swing.swing_time must be positive"),
        ({"swing_height": -0.01}, "swing.swing_height must not be negative"),
    ],
)
def test_nonsense_is_refused(swing: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ControllerConfig(swing=SwingConfig(**swing))  # type: ignore[arg-type]


def test_the_default_is_the_regulators_foothold() -> None:
    assert ControllerConfig().swing.foothold == "regulator"
    assert CONFIGS["paper"].swing.foothold == "reference"


def config_dt(config: ControllerConfig) -> float:
    return 1.0 / config.rate_hz
