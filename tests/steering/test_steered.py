"""The steered reference by itself: it goes where it is told, its feet do not slide, and it stands when it may."""

import dataclasses

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, quat_rotate, rotate_planar
from fastmimic.reference.table import SAMPLE
from fastmimic.steering.gait_field import RATE_HZ, GaitField
from fastmimic.steering.steered import Steered

DT = 1.0 / RATE_HZ


def run(steered: Steered, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (t,) of `SAMPLE`, poses (t, 3), and feet (t, 4, 3) in the world, for a robot that is where it should be."""
    table, rows, poses = np.zeros(2, SAMPLE), [], []
    for _ in range(round(seconds * RATE_HZ)):
        steered.fill(table)
        rows.append(table[0].copy())
        poses.append(steered.place["pose"][0].copy())
        steered.advance(poses[-1][:2] + rotate_planar(poses[-1][2], table[1]["root_pos"][:2]))
    found, pose = np.array(rows, SAMPLE), np.array(poses)
    quat = quat_multiply(quat_from_yaw(pose[:, 2]), found["root_quat"])
    root = np.column_stack([pose[:, :2], found["root_pos"][:, 2]])
    return found, pose, root[:, None] + quat_rotate(quat[:, None], found["foot_pos"])


@pytest.mark.parametrize("velocity", [(0.5, 0.0, 0.0), (0.0, 0.2, 0.0), (0.3, -0.1, 0.8), (0.6, 0.2, -1.0)])
def test_it_goes_where_it_is_told_and_its_feet_do_not_slide(
    gaits: GaitField, velocity: tuple[float, float, float]
) -> None:
    steered = Steered(gaits)
    steered.steer(np.array(velocity))
    rows, poses, feet = run(steered, 4.0)
    period = gaits.chain()[1].rows.shape[1]
    np.testing.assert_allclose(steered.place["velocity"][0], velocity, atol=0.01)
    one, other = poses[-1 - 2 * period], poses[-1]
    turned = (other[2] - one[2]) / (2 * period * DT)
    assert turned == pytest.approx(velocity[2], abs=0.03)
    moved = np.mean([rotate_planar(-a[2], b[:2] - a[:2]) for a, b in zip(poses[-500:-1], poses[-499:], strict=True)], 0)
    np.testing.assert_allclose(moved / DT, velocity[:2], atol=0.06)

    stands = (rows["contact"][:-1] == 1) & (rows["contact"][1:] == 1)
    slid = rotate_planar(-poses[:-1, 2, None], np.diff(feet[..., :2], axis=0))
    legs = rows["joint_pos"].reshape(-1, 4, 3)
    pitch = legs[..., 1] + legs[..., 2] + 2.0 * rows["root_quat"][:, 2, None]
    slid[..., 0] -= gaits.robot.foot_radius * np.diff(pitch, axis=0)  # as a ball rolls
    assert np.abs(slid[stands]).max() < 2e-4  # of 2e-3 that the trunk moves
    speed = np.abs(np.diff(rows["joint_pos"], axis=0)).max() / DT
    assert speed < 1.2 * gaits.robot.joint_speed_limit.max()


def test_it_stands_when_nothing_is_wanted_and_starts_again(gaits: GaitField) -> None:
    steered = Steered(gaits)
    rows, poses, _ = run(steered, 0.5)
    assert (rows["contact"] == 1).all()
    assert np.abs(poses).max() < 1e-9
    assert steered.state == "standing"
    steered.steer(np.array([0.6, 0.0, 0.0]))
    run(steered, 2.0)
    assert steered.state != "standing"
    steered.steer(np.zeros(3))
    rows, poses, _ = run(steered, 3.0)
    assert steered.state == "standing"
    assert (rows["contact"][-200:] == 1).all()
    assert np.abs(rows["joint_vel"][-1]).max() < 0.01
    assert poses[-1, 0] == pytest.approx(poses[-200, 0], abs=2e-3)


def test_it_walks_where_it_is_slow_and_trots_where_it_is_fast(gaits: GaitField) -> None:
    steered = Steered(gaits)
    assert gaits.slower is not None
    steered.steer(np.array([0.4, 0.0, 0.3]))
    run(steered, 1.5)
    assert steered.state == "walk"
    steered.steer(np.array([0.9, 0.0, 0.3]))
    up, _, feet_up = run(steered, 2.0)
    assert steered.state == "trot"
    np.testing.assert_allclose(steered.place["velocity"][0], [0.9, 0.0, 0.3], atol=0.01)
    steered.steer(np.array([0.4, 0.0, 0.0]))
    down, _, feet_down = run(steered, 2.0)
    assert steered.state == "walk"
    for rows, feet in ((up, feet_up), (down, feet_down)):
        assert np.abs(np.diff(rows["joint_pos"], axis=0)).max() / DT < 1.2 * gaits.robot.joint_speed_limit.max()
        assert np.abs(np.diff(rows["root_pos"][:, 2])).max() < 1e-3  # m: nothing jumps
        same = (rows["contact"][1:] == rows["contact"][:-1]).all(axis=1)
        assert np.flatnonzero(~same)[1:].size > 4  # feet go on stepping
        stood, stands = rows["contact"][:-1] == 1, rows["contact"][1:] == 1
        assert np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1)[stood & stands].max() < 1e-3
        lands = ~stood & stands
        assert (feet[:-1, :, 2][lands] - gaits.robot.foot_radius).max() < 2e-3  # m: no foot is made to stand in the air
        assert np.diff(feet[..., 2], axis=0)[lands].min() / DT > -0.2  # m/s


def test_a_stick_that_trembles_at_the_walks_top_speed_does_not_change_the_gait(gaits: GaitField) -> None:
    steered = Steered(gaits)
    top = gaits.chain()[-1].forwards[-1]
    steered.steer(np.array([top + 0.1, 0.0, 0.0]))
    run(steered, 2.0)
    for k in range(20):
        steered.steer(np.array([top + 0.02 * (-1) ** k, 0.0, 0.0]))
        run(steered, 0.05)
        assert steered.state == "trot"
    steered.steer(np.array([0.8 * top, 0.0, 0.0]))
    run(steered, 2.0)
    assert steered.state == "walk"


def test_it_stands_in_one_gait_and_starts_in_another(gaits: GaitField) -> None:
    steered = Steered(gaits)
    steered.steer(np.array([0.9, 0.0, 0.0]))
    _, _, _ = run(steered, 0.3)
    assert steered.state == "trot"


def test_a_table_ahead_holds_what_comes(gaits: GaitField) -> None:
    steered = Steered(gaits)
    steered.steer(np.array([0.5, 0.1, 0.5]))
    run(steered, 1.234)
    ahead = np.zeros(40, SAMPLE)
    steered.fill(ahead)
    begins = steered.place["pose"][0].copy()
    rows, poses, _ = run(steered, 40 * DT)
    np.testing.assert_array_equal(ahead["contact"], rows["contact"])
    np.testing.assert_allclose(ahead["foot_pos"], rows["foot_pos"], atol=1e-12)
    np.testing.assert_allclose(
        ahead["root_pos"][:, :2], rotate_planar(-begins[2], poses[:, :2] - begins[:2]), atol=1e-12
    )


def test_what_is_beyond_the_gaits_becomes_the_nearest(gaits: GaitField) -> None:
    steered = Steered(gaits)
    trot = gaits.chain()[1]
    for gait, wanted in ((gaits, [9.0, 0.05, 0.0]), (trot, [0.5, -0.9, 0.9]), (trot, [-9.0, 0.0, 9.0])):
        taken = steered.steer(np.array(wanted))
        np.testing.assert_array_equal(taken, gait.nearest(np.array(wanted)))
    for wrong in (np.array([0.0, np.nan, 0.0]), np.zeros(2)):
        with pytest.raises(ConfigError, match="three numbers"):
            steered.steer(wrong)


def test_x_and_y_follow_the_robot_once_a_cycle(gaits: GaitField) -> None:
    steered = Steered(gaits)
    steered.steer(np.array([0.5, 0.0, 0.0]))
    run(steered, 1.0)
    for _ in range(max(gait.rows.shape[1] for gait in gaits.chain())):
        steered.advance(np.array([7.0, 8.0]))
    assert np.hypot(*(steered.place["pose"][0, :2] - [7.0, 8.0])) < 0.4
    assert steered.place["jump"][0] > 5.0


def test_gaits_in_which_never_the_same_feet_stand_follow_each_other_from_standing(gaits: GaitField) -> None:
    """Robots fell with one that changed over on feet in the air. Out of the trot two of the feet that stand could lift
    off, but what fits in one direction alone is left."""
    _, trot, walk = gaits.chain()
    rows = walk.rows.copy()
    rows["contact"] = np.where(np.arange(rows.shape[1])[:, None] % 300 < 150, [1, 1, 0, 0], [0, 0, 1, 1])  # a bound
    steered, states = Steered(dataclasses.replace(trot, slower=dataclasses.replace(walk, name="bound", rows=rows))), []
    for speed, seconds in ((0.4, 2.0), (0.9, 3.0), (0.3, 2.0), (0.0, 2.0), (0.3, 2.0)):
        steered.steer(np.array([speed, 0.0, 0.0]))
        for _ in range(round(seconds / 0.05)):
            run(steered, 0.05)
            states += [steered.state] if steered.state not in states[-1:] else []
    assert states == ["standing", "bound", "standing", "trot", "standing", "bound"]


def test_it_canters_where_it_is_faster_than_a_trot(gaits: GaitField) -> None:
    steered, states = Steered(gaits), []
    for wanted, seconds in ((1.9, 4.0), (0.9, 3.0), (0.0, 3.0)):
        steered.steer(np.array([wanted, 0.0, 0.0]))
        for _ in range(round(seconds / 0.1)):
            rows, poses, feet = run(steered, 0.1)
            stands = (rows["contact"][:-1] == 1) & (rows["contact"][1:] == 1)
            assert np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1)[stands].max() < 2e-3
            assert np.abs(np.diff(rows["joint_pos"], axis=0)).max() / DT < 1.2 * gaits.robot.joint_speed_limit.max()
            assert np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=-1).max() / DT < 2.6
            if steered.state not in states[-1:]:
                states.append(steered.state)
    way = ["trot", "trot to canter", "canter", "canter to trot", "trot"]
    assert [state for state in states if state not in ("standing", "walk")] == way
    assert states[-1] == "standing"


def test_it_takes_no_passage_while_it_turns_if_it_can_stand_instead(gaits: GaitField) -> None:
    """A pace and a trot have passages, and both can be slow. Here the canter is taken for such a trot."""
    forwards = np.array([0.0, *gaits.forwards[1:]])
    slow = dataclasses.replace(gaits, forwards=forwards, turning=np.full_like(forwards, 2.0))
    for turn, between in ((0.2, "trot to canter"), (1.6, "standing")):
        steered, states = Steered(slow), []
        for velocity in ((1.0, 0.0, 0.0), (forwards[-1], 0.0, turn)):
            steered.steer(np.array(velocity))
            for _ in range(60):
                run(steered, 0.05)
                states += [steered.state] if steered.state not in states[-1:] else []
        assert states[states.index("trot") :] == ["trot", between, "canter"]


def test_a_robot_that_is_to_stop_takes_no_passage_to_a_slower_gait(gaits: GaitField) -> None:
    forwards = np.array([0.0, *gaits.forwards[1:]])
    slow = dataclasses.replace(gaits, forwards=forwards, turning=np.full_like(forwards, 2.0))
    steered = Steered(slow)
    steered.steer(np.array([forwards[-1], 0.0, 0.0]))
    run(steered, 6.0)
    assert steered.state == "canter"
    steered.steer(np.zeros(3))
    run(steered, 2.0)
    assert steered.state == "standing"


def test_a_robot_that_is_put_somewhere_forgets_its_passage(gaits: GaitField) -> None:
    steered = Steered(gaits)
    steered.steer(np.array([1.9, 0.0, 0.0]))
    while steered.state != "trot to canter":
        run(steered, DT)
    steered.put(1.0, 2.0, 0.5)
    assert steered.state == "standing"
    run(steered, 1.5)
    assert steered.state == "trot"


@pytest.mark.parametrize("velocity", [(0.0, 0.4, -2.0), (0.12, 0.38, -1.55), (0.0, -0.4, 1.0)])
def test_legs_go_no_farther_while_the_velocity_changes_than_afterwards(
    gaits: GaitField, velocity: tuple[float, float, float]
) -> None:
    """The hip of an A1's hind leg came to the end of its range, and the robot fell."""
    steered, robot = Steered(gaits), gaits.robot
    steered.steer(np.array(velocity))
    joints = run(steered, 3.0)[0]["joint_pos"]
    room = np.minimum(joints - robot.joint_lower, robot.joint_upper - joints)[:, ::3].min(axis=1)
    assert room[: 2 * round(RATE_HZ)].min() > 0.9 * room[2 * round(RATE_HZ) :].min()


def test_feet_land_nearly_at_rest_while_the_velocity_changes(gaits: GaitField) -> None:
    steered = Steered(gaits)
    steered.steer(np.array([0.6, 0.0, 0.0]))
    run(steered, 2.0)
    steered.steer(np.array([1.2, 0.0, 0.8]))
    rows, _, feet = run(steered, 1.0)
    contact, speed = rows["contact"] == 1, np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1) / DT
    lands = ~contact[1:-1] & contact[2:]
    assert lands.sum() > 5
    for before in (speed[:-1], speed[1:]):
        assert before[lands].max() < 0.25  # m/s, of 0.6 to 1.2
        assert before[lands].mean() < 0.16
