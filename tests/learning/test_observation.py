"""What a policy sees and what becomes of its actions, against plain NumPy and SciPy."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from control.motions import gait
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import matrix_from_quat, quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.learning.config import (
    FRAME_SIZE,
    FRAMES,
    OBSERVATION_SIZE,
    PolicyConfig,
    action_bounds,
    low_pass,
    pack_settings,
)
from fastmimic.learning.observation import act, command, make_senses, observe
from fastmimic.reference.table import make_clocks, place_clocks, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, OBSERVATION
from learning.hand_made import FRAMES_AT

pytestmark = pytest.mark.nojit
CONFIG = PolicyConfig()


def states(robot: Robot, n: int, rng: np.random.Generator) -> np.ndarray:
    """Random upright robots."""
    obs = np.zeros(n, OBSERVATION)
    tilt = np.concatenate([np.ones((n, 1)), rng.uniform(-0.2, 0.2, (n, 3))], axis=1)
    tilt /= np.linalg.norm(tilt, axis=1, keepdims=True)
    obs["root_quat"] = quat_multiply(quat_from_yaw(rng.uniform(-3, 3, n)), tilt)
    obs["root_pos"] = rng.normal(size=(n, 3))
    obs["ang_vel"] = rng.normal(size=(n, 3))
    obs["joint_pos"] = robot.home_joint_pos + rng.uniform(-0.3, 0.3, (n, 12))
    return obs


def test_what_is_seen_is_what_the_documentation_says(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    motion = gait(robot, (0.4, 0.1), 0.8, n_samples=200)
    table, settings, n = reference_table(motion, robot), pack_settings(CONFIG, robot), 3
    clocks, senses = make_clocks(motion, n), make_senses(n)
    place_clocks(clocks, np.array([0, 90, 199]), table, rng.uniform(-1, 1, (n, 3)))
    seen = np.zeros((n, OBSERVATION_SIZE), np.float32)
    imu, joints = [], []
    actions = [(obs0 := states(robot, n, rng))["joint_pos"] - robot.home_joint_pos]
    actions = [actions[0] / CONFIG.action_scale] * 3
    for step in range(4):
        obs = obs0 if step == 0 else states(robot, n, rng)
        observe(settings, table[None], clocks, obs, senses, np.zeros((3, 3)), seen)
        rotation = matrix_from_quat(obs["root_quat"])
        gyro = np.einsum("nij,ni->nj", rotation, obs["ang_vel"])
        roll, pitch = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2]), np.arcsin(-rotation[:, 2, 0])
        imu = [np.column_stack([roll, pitch, gyro[:, :2]]), *imu][:3]
        joints = [obs["joint_pos"], *joints][:3]
        imu, joints = imu + imu[-1:] * (3 - len(imu)), joints + joints[-1:] * (3 - len(joints))
        expected = np.concatenate([np.concatenate(part, axis=1) for part in (imu, joints, actions)], axis=1)
        assert seen[:, :FRAMES_AT] == pytest.approx(expected, abs=1e-6)
        wanted = rng.uniform(-1, 1, (n, 12))  # within the joints' limits
        act(settings, wanted, senses)
        actions = [wanted, *actions][:3]

    yaw = yaw_from_quat(obs["root_quat"])
    for i in range(n):
        for k, ahead in enumerate(FRAMES):
            frame = seen[i, FRAMES_AT + k * FRAME_SIZE : FRAMES_AT + (k + 1) * FRAME_SIZE]
            laps, sample = divmod(int(clocks["sample"][i]) + ahead * CONFIG.decimation, motion.n_samples)
            position, quat = table["root_pos"][sample].copy(), table["root_quat"][sample]
            for _ in range(laps):
                position[:2] = rotate_planar(motion.cycle[2], position[:2]) + motion.cycle[:2]
                quat = quat_multiply(quat_from_yaw(np.array(motion.cycle[2])), quat)
            turn = clocks["origin"][i, 2] - yaw[i]
            offset = position - table["root_pos"][clocks["sample"][i]]
            assert frame[:2] == pytest.approx(rotate_planar(np.array(turn), offset[:2]), abs=1e-6)
            assert frame[2] == pytest.approx(offset[2], abs=1e-6)
            expected_quat = quat_multiply(quat_from_yaw(np.array(turn)), quat)
            assert frame[3:7] == pytest.approx(expected_quat * np.sign(expected_quat[0]), abs=1e-6)
            assert frame[3] >= 0
            assert frame[7:] == pytest.approx(motion.joint_pos[sample], abs=1e-6)


def test_where_the_robot_is_does_not_matter(robot: Robot) -> None:
    motion = gait(robot, (0.4, 0.0), 0.5)
    table, settings = reference_table(motion, robot), pack_settings(CONFIG, robot)
    obs = np.repeat(states(robot, 1, np.random.default_rng(1)), 2)
    obs["root_pos"][1] += (5.0, -3.0, 0.0)
    clocks = make_clocks(motion, 2)
    place_clocks(clocks, np.array([40, 40]), table, obs["root_pos"] * [1, 1, 0])
    seen = np.zeros((2, OBSERVATION_SIZE), np.float32)
    observe(settings, table[None], clocks, obs, make_senses(2), np.zeros((3, 3)), seen)
    assert seen[0] == pytest.approx(seen[1], abs=1e-6)


def test_a_motion_that_ends_stays_where_it_ends(robot: Robot) -> None:
    motion = gait(robot, (0.4, 0.0), n_samples=300)
    table, settings = reference_table(motion, robot), pack_settings(CONFIG, robot)
    clocks = make_clocks(motion, 1)
    clocks["repeats"], clocks["sample"] = 0, 280
    seen = np.zeros((1, OBSERVATION_SIZE), np.float32)
    observe(settings, table[None], clocks, states(robot, 1, np.random.default_rng(2)), make_senses(1), np.eye(3), seen)
    frames = seen[0, FRAMES_AT:].reshape(len(FRAMES), FRAME_SIZE)
    assert frames[0, 7:] == pytest.approx(motion.joint_pos[297], abs=1e-6)
    assert np.all(frames[1:] == frames[3])
    assert frames[3, 7:] == pytest.approx(motion.joint_pos[299], abs=1e-6)


def test_actions_are_clipped_filtered_and_interpolated(robot: Robot) -> None:
    motion = gait(robot)
    table, settings, senses = reference_table(motion, robot), pack_settings(CONFIG, robot), make_senses(1)
    obs = np.zeros(1, OBSERVATION)
    obs["root_quat"], obs["joint_pos"] = (1, 0, 0, 0), robot.home_joint_pos
    seen, commands = np.zeros((1, OBSERVATION_SIZE), np.float32), np.zeros(1, COMMAND)
    rng = np.random.default_rng(3)
    actions = rng.uniform(-3, 3, (6, 12))
    actions[2] = 100.0
    lower, upper = action_bounds(CONFIG, robot)
    wanted = robot.home_joint_pos + CONFIG.action_scale * np.clip(actions, lower, upper)
    b, a = butter(2, CONFIG.filter_cutoff_hz, fs=CONFIG.rate_hz)
    assert low_pass(CONFIG.filter_cutoff_hz, CONFIG.rate_hz)[0] == pytest.approx(b)
    expected = robot.home_joint_pos + lfilter(b, a, wanted - robot.home_joint_pos, axis=0)
    before = robot.home_joint_pos
    for action, after in zip(actions, expected, strict=True):
        observe(settings, table[None], make_clocks(motion, 1), obs, senses, np.eye(3), seen)
        act(settings, action[None], senses)
        for step in range(1, CONFIG.decimation + 1):
            command(settings, senses, commands)
            line = before + step / CONFIG.decimation * (after - before)
            limited = np.clip(line, robot.joint_lower, robot.joint_upper)
            assert commands["joint_pos"][0] == pytest.approx(limited, abs=1e-9)
        before = after
    assert commands["stiffness"][0] == pytest.approx(np.tile(CONFIG.stiffness, 4))
    assert not commands["joint_vel"].any()
    assert not commands["torque"].any()


def test_an_action_that_is_not_a_number_changes_nothing(robot: Robot) -> None:
    motion = gait(robot)
    table, settings, senses = reference_table(motion, robot), pack_settings(CONFIG, robot), make_senses(1)
    obs, seen = states(robot, 1, np.random.default_rng(4)), np.zeros((1, OBSERVATION_SIZE), np.float32)
    observe(settings, table[None], make_clocks(motion, 1), obs, senses, np.eye(3), seen)
    act(settings, np.full((1, 12), np.nan), senses)
    assert senses["after"][0] == pytest.approx(obs["joint_pos"][0])
    assert np.isfinite(senses["actions"]).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"decimation": 0}, "decimation must be at least 1"),
        ({"action_scale": 0.0}, "action_scale must be positive"),
        ({"filter_cutoff_hz": 20.0}, "below half the rate"),
        ({"stiffness": (1.0, 2.0)}, "have 3 numbers"),
    ],
)
def test_settings_out_of_range_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        PolicyConfig(**values)  # type: ignore[arg-type]
