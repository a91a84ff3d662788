"""A robot that is steered over a deployment's whole way: it stands up, goes where it is told, stands, and sits down."""

from pathlib import Path

import numpy as np
import pytest

from deploy.rig import Rig, once
from fastmimic.base.errors import LogError
from fastmimic.base.files import write_json
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.deployment import Deployment, evaluation_of
from fastmimic.deploy.log import RESULT
from fastmimic.deploy.safety import StopReason
from fastmimic.deploy.sequence import MotionSequence, SteeredFollower
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.deploy.summary import summary_rows
from fastmimic.report.html_pages import deployment_page
from fastmimic.robot import Robot
from fastmimic.robot.state import MEMORY, OBSERVATION
from fastmimic.steering.commands import CommandScript
from fastmimic.steering.gait_field import GaitField


@pytest.fixture
def steered(a1: Robot, standstill: MotionSequence, gaits: GaitField, tmp_path) -> Rig:
    path = tmp_path / "commands.csv"
    path.write_text("time_s,forwards,left,turn\n0.2,0.6,0,0\n2.2,0.5,0,0.8\n4.2,0,0,0\n5.9,0,0,0\n")
    rig = Rig(a1, standstill)
    rig.follower = SteeredFollower(standstill, gaits, CommandScript(path).velocity)
    return rig


def velocities(done: Deployment, first_s: float, last_s: float) -> tuple[float, float]:
    """Mean speed, m/s, and turn rate, rad/s, between two times of steering."""
    assert done.log.truth is not None
    inside = done.log.truth[done.log.rows["in_motion"]][round(first_s * 500) : round(last_s * 500)]
    return float(np.hypot(*inside["lin_vel"][:, :2].T).mean()), float(inside["ang_vel"][:, 2].mean())


@pytest.mark.slow
def test_it_goes_where_the_script_says_and_sits_down(steered: Rig, a1: Robot, tmp_path: Path) -> None:
    done = steered.run(duration_s=5.9)
    assert done.outcome.stopped_by is StopReason.DURATION
    assert done.outcome.phase is DeploymentPhase.DONE
    assert not done.result["fell"]
    assert velocities(done, 1.2, 2.2) == pytest.approx((0.6, 0.0), abs=0.08)
    assert velocities(done, 3.4, 4.2) == pytest.approx((0.5, 0.8), abs=0.12)
    assert velocities(done, 5.7, 5.9)[0] < 0.03, "it stands, its trunk over the middle of its feet"
    wanted = done.log.rows["wanted"][done.log.rows["in_motion"]]
    np.testing.assert_allclose(wanted[[50, 800, 1800, 2500]], [[0, 0, 0], [0.6, 0, 0], [0.5, 0, 0.8], [0, 0, 0]])
    assert done.log.truth is not None
    steps = np.diff(done.log.truth["root_pos"][done.log.rows["in_motion"], :2][::50], axis=0)
    assert done.result["way_m"] == pytest.approx(np.hypot(*steps.T).sum(), abs=0.05)
    write_json(tmp_path / RESULT, done.log.facts.as_dict() | {"result": done.result})
    assert "Ended as planned (duration)." in deployment_page(tmp_path).html
    assert (done.result["cycles"], done.result["reward_mean"]) == (None, None)
    assert done.result["velocity_error_m_s"] < 0.05
    assert done.result["yaw_rate_error_rad_s"] < 0.1
    assert 100 < done.result["response_ms"] < 900
    said = dict(summary_rows(done.result))
    assert said["steered"].endswith(f"{done.result['way_m']:.1f} m")
    assert said["velocity error, median"].endswith(" rad/s")
    assert said["response, median"].endswith(" ms")
    with pytest.raises(LogError, match="the robot was steered"):
        evaluation_of(a1, done.log, ControllerConfig())


@pytest.mark.slow
def test_asked_to_sit_down_it_stands_first(steered: Rig) -> None:
    def press(machine: object) -> None:
        steered.switch.leave = True

    done = steered.run(endless=True, watch=once(lambda machine: machine.follower.steps > 750, press))
    assert done.outcome.stopped_by is StopReason.ASKED
    assert done.outcome.phase is DeploymentPhase.DONE
    inside = done.log.rows["in_motion"]
    assert velocities(done, 1.2, 1.5)[0] > 0.4, "it went"
    assert 2.0 < inside.sum() / 500 < 3.5
    assert velocities(done, inside.sum() / 500 - 0.2, inside.sum() / 500)[0] < 0.05, "it stood before it sat down"


def test_its_gains_are_those_of_the_gait_that_it_is_in(standstill: MotionSequence, gaits: GaitField) -> None:
    follower = SteeredFollower(standstill, gaits, lambda time_s: np.array([1.9, 0.0, 0.0]))
    observation, memory, states = np.zeros(1, OBSERVATION), np.zeros(1, MEMORY), set()
    follower.enter_motion(np.zeros(3))
    for _ in range(2500):
        follower.advance_motion(observation, memory)
        observation["root_pos"][0, :2] = follower.clock["origin"][0, :2]
        states.add(follower.text)
        assert follower.tables["gain"].max() < follower.gains.shape[1]
        assert follower.text == "standing" or np.shares_memory(follower.gains, follower._steered.gains)
    assert states == {"standing", "trot", "trot to canter", "canter"}
