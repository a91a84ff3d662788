"""The controller as a whole: batches, frames, the laws of the paper, limits, and what is refused."""

import dataclasses

import numpy as np
import pytest

from control.motions import gait, standing
from control.rig import Rig, disturbed, on_reference
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.rotations import (
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    rotate_planar,
)
from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.control.controller import Controller
from fastmimic.control.stance import _HOLD_STEPS
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

FIELDS = ("joint_pos", "joint_vel", "stiffness", "damping", "torque")


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return gait(robot, (0.4, 0.1), 0.5)


@pytest.fixture(scope="module")
def stand(robot: Robot) -> Motion:
    return standing(robot)


def assert_same(a: np.ndarray, b: np.ndarray, atol: float = 0.0) -> None:
    for name in FIELDS:
        np.testing.assert_allclose(a[name], b[name], rtol=0, atol=atol, err_msg=name)


class TestBatch:
    """n = 1 is the same code as any n, bit for bit."""

    SAMPLES = np.array([0, 30, 77, 140, 249])

    def courses(self, motion: Motion, steps: int = 8) -> list[np.ndarray]:
        rng = np.random.default_rng(0)
        return [disturbed(on_reference(motion, self.SAMPLES), rng) for _ in range(steps)]

    @pytest.mark.parametrize("name", ["default", "paper"])
    def test_n_robots_in_one_call_are_n_single_calls(self, robot: Robot, trot: Motion, name: str) -> None:
        config = controller_config(name)
        together = Rig(robot, [trot], self.SAMPLES, config)
        alone = [Rig(robot, [trot], self.SAMPLES[i : i + 1], config) for i in range(5)]
        for observation in self.courses(trot):
            commands = together.step(observation)
            for i, rig in enumerate(alone):
                assert rig.step(observation[i : i + 1]).tobytes() == commands[i : i + 1].tobytes()

    def test_each_robot_follows_its_own_reference(self, robot: Robot, trot: Motion) -> None:
        motions = [trot, *(gait(robot, (0.4, 0.1), 0.5, lift=h) for h in (0.03, 0.04, 0.06, 0.07))]
        together = Rig(robot, motions, self.SAMPLES, ControllerConfig())
        alone = [Rig(robot, [m], self.SAMPLES[i : i + 1], ControllerConfig()) for i, m in enumerate(motions)]
        for observation in self.courses(trot):
            commands = together.step(observation)
            for i, rig in enumerate(alone):
                assert rig.step(observation[i : i + 1]).tobytes() == commands[i : i + 1].tobytes()

    def test_a_reset_forgets_everything(self, robot: Robot, trot: Motion) -> None:
        used, fresh = (Rig(robot, [trot], self.SAMPLES, ControllerConfig()) for _ in range(2))
        for observation in self.courses(trot):
            used.step(observation)
        used.controller.reset(self.SAMPLES)
        last = self.courses(trot)[-1]
        assert used.step(last).tobytes() == fresh.step(last).tobytes()

    def test_legs_start_in_the_state_that_the_reference_wants(self, robot: Robot, trot: Motion) -> None:
        rig = Rig(robot, [trot], self.SAMPLES, ControllerConfig())
        np.testing.assert_array_equal(rig.controller.memory["stance"], trot.contact[self.SAMPLES])


class TestFrames:
    """Nothing depends on where the robot is in the world or which way it looks."""

    @pytest.mark.parametrize("name", ["default", "paper"])
    @pytest.mark.parametrize(("yaw", "shift"), [(0.8, (0.0, 0.0)), (-2.9, (5.0, -3.0)), (np.pi, (1.0, 1.0))])
    def test_the_world_turned_and_shifted_gives_the_same_commands(
        self, robot: Robot, trot: Motion, name: str, yaw: float, shift: tuple[float, float]
    ) -> None:
        samples = np.array([10, 60, 130, 200])
        here, there = (Rig(robot, [trot], samples, controller_config(name)) for _ in range(2))
        there.clocks["origin"][:, :2] = rotate_planar(yaw, there.clocks["origin"][:, :2]) + shift
        there.clocks["origin"][:, 2] += yaw
        rng = np.random.default_rng(1)
        turn = quat_from_yaw(yaw)
        for _ in range(6):
            observation = disturbed(on_reference(trot, samples), rng)
            turned = observation.copy()
            turned["root_pos"] = quat_rotate(turn, observation["root_pos"]) + np.array([*shift, 0.0])
            turned["root_quat"] = quat_multiply(turn, observation["root_quat"])
            for field in ("lin_vel", "ang_vel", "foot_force"):
                turned[field] = quat_rotate(turn, observation[field])
            assert_same(here.step(observation), there.step(turned), atol=1e-9 * 500)
            np.testing.assert_allclose(
                there.controller.memory["force"], here.controller.memory["force"], atol=1e-9 * 500
            )

    def test_the_sign_of_a_quaternion_means_nothing(self, robot: Robot, trot: Motion) -> None:
        samples = np.array([10, 130])
        here, there = (Rig(robot, [trot], samples, ControllerConfig()) for _ in range(2))
        observation = disturbed(on_reference(trot, samples), np.random.default_rng(2))
        negated = observation.copy()
        negated["root_quat"] *= -1
        assert_same(here.step(observation), there.step(negated), atol=1e-9)


class TestLimits:
    @pytest.mark.parametrize("name", ["default", "paper"])
    def test_commands_keep_to_joint_and_torque_limits_whatever_is_observed(
        self, robot: Robot, trot: Motion, name: str
    ) -> None:
        config = controller_config(name)
        rng = np.random.default_rng(5)
        samples = rng.integers(trot.n_samples, size=50)
        rig = Rig(robot, [trot], samples, config)
        at_limit = False
        for _ in range(10):
            commands = rig.step(disturbed(on_reference(trot, samples), rng, 10.0))
            for field in FIELDS:
                assert np.isfinite(commands[field]).all()
            assert np.all(commands["joint_pos"] >= robot.joint_lower + config.joint_margin)
            assert np.all(commands["joint_pos"] <= robot.joint_upper - config.joint_margin)
            assert np.all(np.abs(commands["torque"]) <= robot.torque_limit)
            assert np.all(commands["stiffness"] >= 0)
            assert np.all(commands["damping"] >= 0)
            at_limit = at_limit or bool(np.any(np.abs(commands["torque"]) == robot.torque_limit))
        assert at_limit, "the disturbances must be large enough to matter"


class TestFailure:
    """A stance QP that cannot be solved, here for a weight that is no number."""

    @pytest.fixture
    def rig(self, robot: Robot, stand: Motion) -> Rig:
        config = ControllerConfig()
        config = dataclasses.replace(config, stance=dataclasses.replace(config.stance, disturbance_time=0.0))
        return Rig(robot, [stand], np.array([0, 0]), config)

    def test_the_last_torques_are_held_then_the_legs_are_damped(self, rig: Rig, robot: Robot, stand: Motion) -> None:
        observation = on_reference(stand, np.array([0, 0]))
        healthy = rig.step(observation)
        force = rig.controller.memory["force"].copy()
        rig.controller._config["r_weight"] = np.nan
        for _ in range(_HOLD_STEPS):
            held = rig.step(observation)
            np.testing.assert_allclose(held["torque"], healthy["torque"], atol=1e-9)
        np.testing.assert_array_equal(rig.controller.memory["force"], force)
        dropped = rig.step(observation)
        np.testing.assert_array_equal(rig.controller.memory["force"], 0.0)
        assert np.all(dropped["damping"] >= healthy["damping"])
        assert np.all(dropped["damping"] > 1.0), "N·m·s/rad, so that the robot sinks instead of dropping"
        assert np.abs(dropped["torque"]).max() < 0.5 * np.abs(healthy["torque"]).max()
        np.testing.assert_array_equal(rig.controller.memory["qp_failures"], _HOLD_STEPS + 1)

    def test_one_robots_failure_is_its_own(self, rig: Rig, stand: Motion) -> None:
        observation = on_reference(stand, np.array([0, 0]))
        healthy = rig.step(observation)
        broken = observation.copy()
        broken["lin_vel"][0, 0] = np.nan
        commands = rig.step(broken)
        np.testing.assert_array_equal(rig.controller.memory["qp_failures"], [1, 0])
        assert commands[1:].tobytes() == healthy[1:].tobytes()

    @pytest.mark.parametrize(
        "field", ["root_pos", "root_quat", "lin_vel", "ang_vel", "joint_pos", "joint_vel", "foot_force"]
    )
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_no_observation_makes_the_motors_a_command_that_is_no_number(
        self, robot: Robot, trot: Motion, field: str, value: float
    ) -> None:
        """A robot whose sensors fail is damped: no torque of its own, no target to go to."""
        samples = np.array([20, 160])
        rig = Rig(robot, [trot], samples, ControllerConfig())
        observation = on_reference(trot, samples)
        rig.step(observation)
        observation[field][0] = value
        commands = rig.step(observation)
        for name in FIELDS:
            assert np.isfinite(commands[name]).all()
        assert np.all(np.abs(commands["torque"]) <= robot.torque_limit)
        lost = commands["stiffness"][0] == 0
        np.testing.assert_array_equal(commands["torque"][0, lost], 0.0)
        assert np.all(commands["damping"][0, lost] > 1.0)
        assert not np.any(commands["stiffness"][1] == 0), "the other robot sees well"

    def test_a_broken_observation_is_forgotten_once_it_is_over(self, robot: Robot, trot: Motion) -> None:
        """Nothing that remembers (filters, offsets) may keep a value that is no number."""
        samples = np.array([20, 160])
        rig = Rig(robot, [trot], samples, ControllerConfig())
        observation = on_reference(trot, samples)
        rig.step(observation)
        broken = observation.copy()
        broken["lin_vel"] = np.nan
        rig.step(broken)
        commands = rig.step(observation)
        for field in FIELDS:
            assert np.isfinite(commands[field]).all(), field


class TestRefused:
    def test_a_reference_at_another_rate(self, robot: Robot, trot: Motion) -> None:
        config = dataclasses.replace(ControllerConfig(), rate_hz=400.0)
        with pytest.raises(ConfigError, match="'synthetic' has 500 samples a second; expected 400: retarget"):
            Controller(robot, [trot], 1, config)

    @pytest.mark.parametrize("count", [0, 2, 4])
    def test_neither_one_reference_nor_one_for_each(self, robot: Robot, trot: Motion, count: int) -> None:
        with pytest.raises(ConfigError, match=f"3 robots need 1 or 3 references, found {count}"):
            Controller(robot, [trot] * count, 3)

    def test_references_of_different_length(self, robot: Robot, trot: Motion) -> None:
        with pytest.raises(MotionError, match="same number of samples"):
            Controller(robot, [trot, gait(robot, n_samples=200)], 2)


@pytest.mark.nojit
def test_a_step_from_the_reference(robot: Robot, trot: Motion) -> None:
    """The whole controller also runs as plain Python, with the same result."""
    samples = np.array([20, 160])
    rig = Rig(robot, [trot], samples, ControllerConfig())
    commands = rig.step(disturbed(on_reference(trot, samples), np.random.default_rng(6), 0.3))
    assert np.isfinite(commands["torque"]).all()
    assert rig.controller.memory["qp_failures"].sum() == 0
    assert np.abs(commands["torque"]).max() > 1.0
