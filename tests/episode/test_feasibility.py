"""What a motion asks of the robot is measured right, and a fall gets the reason that it has."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from control.motions import gait, standing
from fastmimic.base.conventions import GRAVITY
from fastmimic.episode.feasibility import MAX_SLIP_M, Demands, Fall, demands, describe_fall, reasons
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import nominal_start
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_jacobians

EASY = Demands(
    joint_speed=0.7,
    torque=0.5,
    torque_at_speed=0.6,
    friction=0.3,
    flight=0.0,
    lacking=0.02,
    lacking_angular=0.5,
    joint_limited=0.0,
    slide_m=1e-4,
    body_clearance_m=0.02,
)
FELL = Fall(1.0, ("trunk",), "touched the ground", 0.0, 0.004)


@pytest.fixture(scope="module")
def stand(robot: Robot) -> Motion:
    return standing(robot)


@pytest.fixture(scope="module")
def pushed(robot: Robot, stand: Motion) -> Rollout:
    """A standing robot thrown to the side, and one that is not."""
    start = nominal_start(2)
    start.velocity_offset[0] = (0.0, 4.0, 0.0)
    return run_episodes(robot, stand, start=start, duration_s=1.0, log=True)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"body_clearance_m": -0.01}, "reach"),
        ({"slide_m": 0.05}, "reach"),
        ({"joint_limited": 0.5}, "reach"),
        ({"joint_speed": 1.3}, "joint speed"),
        ({"torque": 1.2}, "torque"),
        ({"friction": 1.0}, "friction"),
        ({"flight": 0.2}, "flight"),
        ({"lacking": 0.8}, "support"),
    ],
)
def test_each_limit_that_the_demonstration_exceeds_is_named(change: dict[str, float], kind: str) -> None:
    needs = replace(EASY, **change)
    assert [reason.kind for reason in reasons(needs)] == [kind]
    assert [reason.kind for reason in reasons(needs, FELL)] == [kind]


def test_a_motion_within_all_limits_has_no_reason_unless_the_robot_fell() -> None:
    assert reasons(EASY) == ()
    assert [reason.kind for reason in reasons(EASY, FELL)] == ["feedback"]
    assert [reason.kind for reason in reasons(EASY, replace(FELL, saturated=0.3))] == ["torque"]
    assert [reason.kind for reason in reasons(EASY, replace(FELL, slip_m=0.1))] == ["friction"]


def test_reach_comes_before_what_follows_from_it() -> None:
    needs = replace(EASY, joint_limited=0.5, torque=3.0, friction=2.0)
    assert [reason.kind for reason in reasons(needs, FELL)] == ["reach", "torque", "friction"]


def test_standing_asks_for_the_robots_weight_and_no_more(robot: Robot, stand: Motion) -> None:
    needs = demands(robot, stand)
    assert needs.flight == 0.0
    assert needs.joint_speed < 1e-3
    assert needs.friction < 0.02
    assert needs.lacking < 0.02
    assert needs.slide_m < 1e-6
    # a quarter of the weight on each foot, through the legs' Jacobians; the legs' own weight is a fifth of that
    force = np.array([0.0, 0.0, robot.mass * GRAVITY / 4])
    torque = np.einsum("lij,i->lj", foot_jacobians(robot, stand.joint_pos[0]), force).ravel()
    assert needs.torque == pytest.approx(np.abs(torque / robot.torque_limit).max(), rel=0.3)


def test_without_a_foot_down_the_ground_gives_nothing(robot: Robot, stand: Motion) -> None:
    needs = demands(robot, replace(stand, contact=np.zeros_like(stand.contact)))
    assert needs.flight == 1.0
    assert needs.lacking == pytest.approx(1.0, abs=0.02)
    assert {"flight", "support"} <= {reason.kind for reason in reasons(needs)}


def test_the_body_is_seen_below_the_ground(robot: Robot, stand: Motion) -> None:
    down = np.array([0.0, 0.0, 0.05])
    above, below = demands(robot, stand), demands(robot, replace(stand, root_pos_w=stand.root_pos_w - down))
    assert above.body_clearance_m > 0.0
    assert above.body_clearance_m - below.body_clearance_m == pytest.approx(0.05, abs=1e-6)
    assert reasons(below)[0].kind == "reach"


def test_twice_as_fast_asks_for_twice_the_joint_speed(robot: Robot) -> None:
    motion = gait(robot, (0.3, 0.0), 0.0)
    fast = replace(
        motion,
        rate_hz=2 * motion.rate_hz,
        joint_vel=2 * motion.joint_vel,
        root_lin_vel_w=2 * motion.root_lin_vel_w,
        root_ang_vel_w=2 * motion.root_ang_vel_w,
    )
    slow, quick = demands(robot, motion), demands(robot, fast)
    assert quick.joint_speed == pytest.approx(2 * slow.joint_speed)
    assert quick.lacking_angular > slow.lacking_angular
    json.dumps(asdict(slow))


def test_a_fall_says_when_and_how(robot: Robot, pushed: Rollout) -> None:
    assert pushed.fell.tolist() == [True, False]
    fall = describe_fall(robot, pushed, 0)
    assert fall is not None
    assert fall.time_s == pytest.approx(pushed.steps[0] / 500)
    assert fall.how in ("touched the ground", "tipped over")
    assert bool(fall.touched) == (fall.how == "touched the ground")
    assert not set(fall.touched) & set(robot.foot_geoms)
    assert 0.0 <= fall.saturated <= 1.0
    assert fall.slip_m > MAX_SLIP_M
    assert "friction" in [reason.kind for reason in reasons(EASY, fall)]
    json.dumps(asdict(fall))


def test_who_did_not_fall_has_no_fall_and_without_a_log_there_is_none(robot: Robot, pushed: Rollout) -> None:
    assert describe_fall(robot, pushed, 1) is None
    with pytest.raises(ValueError, match="log"):
        describe_fall(robot, replace(pushed, log=None), 0)
