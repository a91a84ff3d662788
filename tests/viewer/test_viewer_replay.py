"""A deployment as the viewer shows it: what was done, beside what was due."""

import dataclasses

import numpy as np
import pytest

from deploy.rig import Rig
from fastmimic.base.errors import LogError
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.sequence import make_sequence
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.reference.standing import standing
from fastmimic.robot import Robot
from fastmimic.viewer.panel import plot_base, plot_data, status_line
from fastmimic.viewer.replay import deployment_take


@pytest.fixture(scope="module")
def log(a1: Robot) -> DeploymentLog:
    return Rig(a1, make_sequence(a1, standing(a1), ControllerConfig())).run(duration_s=0.4).log


def test_the_whole_run_is_shown_by_the_true_states(log: DeploymentLog, a1: Robot) -> None:
    take = deployment_take(a1, log)
    assert log.truth is not None
    assert take.rows == len(log.rows)
    np.testing.assert_array_equal(take.pose[:, :3], log.truth["root_pos"])
    np.testing.assert_array_equal(take.pose[:, 7:], log.truth["joint_pos"])
    assert take.pose[0, 2] < 0.15, "m: it lies"
    moving = log.rows["in_motion"]
    assert take.reference is not None
    np.testing.assert_allclose(take.reference[moving, 7:], take.pose[moving, 7:], atol=0.05)
    np.testing.assert_array_equal(take.reference[0], take.reference[np.argmax(moving)])
    assert take.terms is not None
    assert take.reward is not None
    assert np.isnan(take.reward[~moving]).all()
    assert take.reward[moving].mean() == pytest.approx(log.facts.result["reward_truth_mean"])
    assert "stopped by duration, ground truth" in take.caption


def test_the_charts_have_no_reward_before_and_after_the_motion(log: DeploymentLog, a1: Robot) -> None:
    take = deployment_take(a1, log)
    row = int(np.argmax(log.rows["in_motion"]))
    assert "reward now <b>1.00" in status_line(take, row)
    assert "reward now" not in status_line(take, 0)
    columns = plot_data(plot_base(take), 0.0)
    assert np.isfinite(columns[0]).all()


def test_without_true_states_it_begins_when_the_robot_knows_its_place(log: DeploymentLog, a1: Robot) -> None:
    known = dataclasses.replace(log, truth=None)
    take = deployment_take(a1, known)
    assert take.rows == 1 + (log.rows["phase"] >= DeploymentPhase.SETTLE).sum()  # the estimator begins a row before
    assert take.pose[0, 2] == pytest.approx(0.28, abs=0.03)
    early = dataclasses.replace(known, rows=log.rows[:500])
    with pytest.raises(LogError, match="had not stood up yet"):
        deployment_take(a1, early)


def test_a_run_that_never_came_to_the_motion_has_no_reference(log: DeploymentLog, a1: Robot) -> None:
    assert log.truth is not None
    early = dataclasses.replace(log, rows=log.rows[:1800], truth=log.truth[:1800])
    take = deployment_take(a1, early)
    assert take.reference is None
    assert take.reward is None
    assert take.rows == 1800
