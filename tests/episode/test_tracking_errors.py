"""The field's measures of motion tracking, against their definitions computed from a logged episode with MuJoCo."""

import mujoco
import numpy as np
import pytest

import fastmimic as fm
from fastmimic.base.conventions import LEGS
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.plan import perturbed_start
from fastmimic.episode.reward import Scorer
from fastmimic.episode.rollout import Rollout
from fastmimic.episode.tracking_errors import POINTS, tracking_errors
from fastmimic.motion.export import sample
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import make_clocks, place_clocks, reference_table, world_root
from fastmimic.robot import Robot
from fastmimic.robot.state import MEMORY, OBSERVATION
from fastmimic.simulation.conditions import Conditions, parse_disturbance

RATE_HZ = 500.0


@pytest.fixture(scope="module")
def turn(robot: Robot) -> Motion:
    return fm.retarget(fm.open_clip("turn"), robot)[0]


@pytest.fixture(scope="module")
def slippery(robot: Robot, turn: Motion) -> Rollout:
    """Two perturbed episodes of more than a period on a floor on which the reference drifts away."""
    start = perturbed_start(2, 1, np.random.default_rng(3))
    conditions = Conditions(disturbances=(parse_disturbance("friction=0.3"),))
    return run_episodes(robot, turn, start=start, duration_s=2.2, log=True, conditions=conditions)


def points(robot: Robot, position: np.ndarray, quat: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(t, 13, 3) the trunk, and the frames of thigh and calf and the foot of each leg, in the world."""
    model = robot.model()
    data = mujoco.MjData(model)
    out = np.zeros((len(position), POINTS, 3))
    addresses = [int(model.joint(name).qposadr[0]) for name in robot.joint_names]
    for i in range(len(position)):
        data.qpos[:3], data.qpos[3:7] = position[i], quat[i]
        data.qpos[addresses] = joints[i]
        mujoco.mj_kinematics(model, data)
        found = [data.xpos[1]]
        for leg, foot in zip(LEGS, robot.foot_geoms, strict=True):
            found += [data.body(f"{leg}_thigh").xpos, data.body(f"{leg}_calf").xpos, data.geom(foot).xpos]
        out[i] = found
    return out


def test_the_measures_are_their_definitions(robot: Robot, turn: Motion, slippery: Rollout) -> None:
    log, reference = slippery.course, slippery.course.demonstration
    free = sample(turn, RATE_HZ, 6.0)  # cycle after cycle, never moved to the robot
    for i in range(2):
        seen, due, steps = log.observation[i], reference[i], int(slippery.steps[i])
        assert steps == len(seen), "the robot does not fall"
        robots = points(robot, seen["root_pos"], seen["root_quat"], seen["joint_pos"])
        wanted = points(robot, due["root_pos"], due["root_quat"], due["joint_pos"])
        got = slippery.tracking[i]
        error = np.linalg.norm(robots - wanted, axis=-1)
        assert got["mpjpe_mm"] == pytest.approx(1e3 * error.mean(), rel=1e-6)
        relative = (robots - robots[:, :1]) - (wanted - wanted[:, :1])
        assert got["mpbpe_root_mm"] == pytest.approx(1e3 * np.linalg.norm(relative, axis=-1)[:, 1:].mean(), rel=1e-6)
        speeds = np.linalg.norm(seen["joint_vel"] - due["joint_vel"], axis=-1)
        assert got["joint_velocity_error_rad_s"] == pytest.approx(speeds.mean())
        heading = yaw_from_quat(due["root_quat"]) - yaw_from_quat(seen["root_quat"])
        assert got["root_heading_error_rad"] == pytest.approx(np.abs((heading + np.pi) % (2 * np.pi) - np.pi).mean())

        # the reference that nobody moves: where the first step's was, from there on
        first = int(np.argmin(np.abs(turn.joint_pos - due["joint_pos"][0]).sum(axis=1)))
        rows = slice(first, first + steps)
        angle = yaw_from_quat(due["root_quat"][0]) - yaw_from_quat(free.root_quat_wxyz[first])
        path = free.root_pos_w[rows].copy()
        path[:, :2] = due["root_pos"][0, :2] + rotate_planar(angle, path[:, :2] - path[0, :2])
        off = np.linalg.norm(path - seen["root_pos"], axis=-1)
        assert got["root_position_error_m"] == pytest.approx(off.mean(), rel=1e-3)
        assert off.mean() > 1.5 * error[:, 0].mean(), "re-synchronisation hides most of it here"

        still = points(
            robot, path, quat_multiply(quat_from_yaw(angle)[None], free.root_quat_wxyz[rows]), due["joint_pos"]
        )
        frames = (robots - still)[::17]  # 34 ms, about 30 Hz
        second = np.diff(frames, n=2, axis=0) / (17 / RATE_HZ) ** 2
        assert got["acceleration_distance"] == pytest.approx(np.linalg.norm(second, axis=-1).mean(), rel=1e-3)


def test_metrics_are_means_over_the_episodes(slippery: Rollout) -> None:
    found = Metrics.of(slippery)
    assert found.success == 1.0
    assert found.mpjpe_mm == pytest.approx(slippery.tracking["mpjpe_mm"].mean())
    assert found.as_dict()["root_position_error_m"] == found.root_position_error_m
    one = Metrics.of(slippery.episodes(slice(1, 2)))
    assert one.mpjpe_mm == slippery.tracking["mpjpe_mm"][1]


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("away", "tilt", "success", "fell"),
    [
        (0.49, 0.0, True, False),
        (0.51, 0.0, False, False),
        (0.0, 0.99, True, False),
        (0.0, 1.01, False, False),
        (1.1, 0.0, False, True),
    ],
)
def test_success_is_to_stay_near(
    robot: Robot, turn: Motion, away: float, tilt: float, success: bool, fell: bool
) -> None:
    table = reference_table(turn, robot)
    scorer, memory, seen = (
        Scorer(robot, table, 1, ControllerConfig(), RATE_HZ),
        np.zeros(1, MEMORY),
        np.zeros(1, OBSERVATION),
    )
    clocks = make_clocks(turn, 1)
    place_clocks(clocks, np.array([10]), table, np.zeros((1, 3)))
    seen["root_pos"], seen["root_quat"] = world_root(table, clocks["sample"], clocks["origin"])
    seen["joint_pos"] = table["joint_pos"][10]
    scorer.score(clocks, seen, memory)
    assert tracking_errors(scorer.tallies)["mpjpe_mm"][0] == pytest.approx(0.0, abs=1e-9)
    seen["root_pos"][0, 1] += away
    seen["root_quat"] = quat_multiply(seen["root_quat"], np.array([[np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0]]))
    scorer.score(clocks, seen, memory)
    found = tracking_errors(scorer.tallies)[0]
    assert (bool(found["success"]), bool(scorer.tallies["fallen"][0])) == (success, fell)
    if not fell and not tilt:
        assert found["mpjpe_mm"] == pytest.approx(1e3 * away / 2), "of the two steps, all points are off in one"
        assert found["mpbpe_root_mm"] == pytest.approx(0.0, abs=1e-9)


def test_an_episode_that_fell_at_once_has_no_measures(robot: Robot, turn: Motion) -> None:
    scorer = Scorer(robot, reference_table(turn, robot), 1, ControllerConfig(), RATE_HZ)
    scorer.tallies["fallen"] = 1
    found = tracking_errors(scorer.tallies)[0]
    assert not found["success"]
    assert all(np.isnan(found[name]) for name in found.dtype.names or () if name != "success")
