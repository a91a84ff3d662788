"""The controller feels the ground by its feet: it follows slopes, lifts feet on rough ground, and sees level ground as
it is."""

from dataclasses import replace

import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.control.config import ControllerConfig, pack_config
from fastmimic.episode.loop import ClosedLoop, run_episodes
from fastmimic.episode.plan import Start
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, parse_terrain

ROBOTS = 6


def blind() -> ControllerConfig:
    config = ControllerConfig()
    return replace(config, gait=replace(config.gait, follow_ground=False))


def starts(n_samples: int) -> Start:
    sample = np.arange(ROBOTS) * n_samples // ROBOTS
    return Start(sample, np.zeros((ROBOTS, 12)), np.zeros((ROBOTS, 3)), np.arange(ROBOTS))


def walked(robot: Robot, terrain: str, config: ControllerConfig) -> ClosedLoop:
    motion = load_motion("trot", robot)
    loop = ClosedLoop(robot, motion, ROBOTS, config, conditions=Conditions(terrain=parse_terrain(terrain)))
    loop.place(starts(motion.n_samples))
    for _ in range(1500):
        loop.apply(loop.control())
        loop.score()
    return loop


@pytest.mark.parametrize(("terrain", "axis"), [("slope=12", 0), ("side-slope=10", 1), ("slope=-12", 0)])
def test_the_plane_under_the_feet_is_found(robot: Robot, terrain: str, axis: int) -> None:
    loop = walked(robot, terrain, ControllerConfig())
    assert loop.scorer.tallies["fallen"].sum() == 0
    memory, rise = loop.controller.memory, np.tan(np.radians(float(terrain.partition("=")[2])))
    np.testing.assert_allclose(memory["slope"][:, axis], rise, atol=0.02)
    np.testing.assert_allclose(memory["slope"][:, 1 - axis], 0.0, atol=0.02)
    root = loop.simulation.observation["root_pos"]
    np.testing.assert_allclose(memory["ground"], rise * root[:, axis], atol=0.01)


@pytest.mark.slow
def test_a_robot_that_does_not_feel_a_slope_falls(robot: Robot) -> None:
    assert walked(robot, "slope=26", blind()).scorer.tallies["fallen"].sum() >= ROBOTS - 1
    assert not walked(robot, "slope=26", ControllerConfig()).scorer.tallies["fallen"].any()


def held(robot: Robot, name: str, config: ControllerConfig) -> tuple[ClosedLoop, np.ndarray]:
    """Robots at the start of a motion, and their observation, to be changed."""
    motion = load_motion(name, robot)
    loop = ClosedLoop(robot, motion, ROBOTS, config)
    loop.place(starts(motion.n_samples))
    return loop, loop.simulation.observation.copy()


@pytest.mark.parametrize(
    ("force", "roughness_m", "lowered_m"), [(0.0, 0.05, 0.6 * 0.002), (0.0, 0.0, 0.0), (100.0, 0.05, 0.0)]
)
def test_a_foot_that_should_stand_and_finds_no_ground_is_lowered_where_it_is_rough(
    robot: Robot, force: float, roughness_m: float, lowered_m: float
) -> None:
    config, found = ControllerConfig(), []
    for speed in (0.0, 0.6):
        loop, observation = held(robot, "walk", replace(config, gait=replace(config.gait, reach_speed=speed)))
        observation["foot_force"][..., 2] = force
        for _ in range(10):
            command = loop.controller.step(observation, loop.clocks)
            loop.controller.memory["roughness"] = roughness_m
        found.append(foot_positions(robot, command["joint_pos"])[loop.controller.memory["stance"] == 1])
    height, lower = (feet[:, 2] for feet in found)
    np.testing.assert_allclose(height - lower, lowered_m, atol=1e-4)


@pytest.mark.parametrize(("steps", "raised_m"), [(10, 0.02), (60, 0.05)])
def test_a_swinging_foot_that_catches_on_the_ground_is_raised(robot: Robot, steps: int, raised_m: float) -> None:
    found, swings = [], []
    for load in (0.0, 0.5):
        loop, observation = held(robot, "trot", ControllerConfig())
        observation["foot_force"][..., 2] = load * robot.mass * GRAVITY
        for _ in range(steps):
            command = loop.controller.step(observation, loop.clocks)
        found.append(foot_positions(robot, command["joint_pos"])[..., 2])
        swings.append(loop.controller.memory["stance"] == 0)
    free, caught = found
    swings = swings[0] & swings[1]
    assert swings.sum() > 3
    np.testing.assert_allclose((caught - free)[swings], raised_m, atol=2e-3)


@pytest.mark.parametrize(
    ("load", "roughness_m", "share"), [(0.5, 0.0, 1.0), (0.5, 0.015, 0.5), (0.5, 0.03, 0.0), (0, 0.03, 1.0)]
)
def test_a_leg_that_bears_weight_is_not_held_to_its_way_where_it_is_rough(
    robot: Robot, load: float, roughness_m: float, share: float
) -> None:
    """It may lean on its shin; an unloaded one looks for the ground with all of its feedback."""
    config = ControllerConfig()
    loop, observation = held(robot, "walk", config)
    observation["foot_force"][..., 2] = load * robot.mass * GRAVITY
    for _ in range(10):
        command = loop.controller.step(observation, loop.clocks)
        loop.controller.memory["roughness"] = roughness_m
    stands = np.repeat(loop.controller.memory["stance"] == 1, 3, axis=1)
    level = pack_config(config, robot)[0]
    np.testing.assert_allclose(
        command["stiffness"][stands], share * level["stance_kp"], rtol=0.05
    )  # it follows the feet
    np.testing.assert_allclose(command["damping"][stands], (0.3 + 0.7 * share) * level["stance_kd"], rtol=0.05)


@pytest.mark.parametrize(("time_s", "roughness_m", "feels"), [(0.1, 0.0, True), (0.0, 0.0, False), (0.1, 0.03, False)])
def test_a_robot_whose_feet_slide_assumes_less_friction(
    robot: Robot, time_s: float, roughness_m: float, feels: bool
) -> None:
    """A trotting robot that moves sideways as a whole, and later does not; on rough ground feet slide off edges."""
    config = ControllerConfig()
    stance, gait = replace(config.stance, friction_time=time_s), replace(config.gait, follow_ground=False)
    loop, observation = held(robot, "trot", replace(config, stance=stance, gait=gait))
    memory = loop.controller.memory
    memory["roughness"] = roughness_m
    observation["foot_force"][..., 2] = 0.5 * robot.mass * GRAVITY
    observation["joint_vel"] = 0.0
    observation["lin_vel"] = (0.0, 0.7, 0.0)
    for _ in range(60):
        loop.controller.step(observation, loop.clocks)
    assert memory["friction"].max() < 0.5 if feels else memory["friction"].min() == 0.6
    observation["lin_vel"] = 0.0
    low = memory["friction"].copy()
    for _ in range(500):
        loop.controller.step(observation, loop.clocks)
    np.testing.assert_allclose(memory["friction"], 0.6 - (0.6 - low) * np.exp(-1.0 / 5.0), atol=1e-3)


def test_a_foot_that_rolls_does_not_slide(robot: Robot) -> None:
    loop = walked(robot, "rough=0", ControllerConfig())
    assert (loop.controller.memory["friction"] == 0.6).all()


def test_a_lost_reading_is_not_felt(robot: Robot) -> None:
    motion = load_motion("trot", robot)
    loop = ClosedLoop(robot, motion, ROBOTS)
    loop.place(starts(motion.n_samples))
    for step in range(600):
        if step == 300:
            loop.simulation.observation["root_pos"] = np.nan
        loop.apply(loop.control())
        loop.score()
    memory = loop.controller.memory
    assert np.isfinite(memory["ground"]).all()
    assert np.isfinite(memory["slope"]).all()
    assert loop.scorer.tallies["fallen"].sum() == 0


@pytest.mark.slow
def test_feet_are_lifted_on_stairs_and_only_there(robot: Robot) -> None:
    assert walked(robot, "stairs-up=0.05", ControllerConfig()).controller.memory["roughness"].max() > 0.01
    assert walked(robot, "slope=10", ControllerConfig()).controller.memory["roughness"].max() < 0.01


@pytest.mark.parametrize("name", ["trot", "walk"])
def test_level_ground_is_seen_as_it_is(robot: Robot, name: str) -> None:
    motion = load_motion(name, robot)
    here, there = (
        run_episodes(robot, motion, start=starts(motion.n_samples), duration_s=3.0, config=config)
        for config in (ControllerConfig(), blind())
    )
    np.testing.assert_array_equal(here.reward, there.reward)
