"""The live session without a browser: switching, modulation, pushes, friction, payload, falls, real time."""

import dataclasses
import math
from concurrent.futures import BrokenExecutor, Executor
from typing import Any

import mujoco
import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.episode.loop import run_episodes
from fastmimic.motion.motion import Motion
from fastmimic.play.page import MOST_BEHIND_S, Pacer
from fastmimic.play.session import DEFAULTS, LiveSession, load_motions, playable_methods
from fastmimic.primitive import FOOT_Z, MotionDmp
from fastmimic.reference.course import advance_place, course_of, fill_table, make_place, make_work
from fastmimic.reference.motion_set import IN_PLACE, MotionSet
from fastmimic.reference.standing import STAND
from fastmimic.reference.table import SAMPLE, reference_table
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, parse_terrain


@pytest.fixture(scope="module")
def library(a1: Robot) -> MotionSet:
    """All that is played by default; transitions are made as they are needed, once for all tests."""
    return MotionSet(a1, load_motions(DEFAULTS, a1))


def reach(session: LiveSession, name: str, within_s: float = 12.0) -> None:
    """Runs until the session does a motion."""
    session.switch(name)
    for _ in range(round(within_s * session.rate_hz)):
        if session.motion == name and session.state == name:
            return
        session.step()
    raise AssertionError(f"{name} was not reached: {session.state}")


def mean_velocity(session: LiveSession, seconds: float) -> tuple[float, float, float]:
    """Forwards and sideways, m/s, and turn rate, rad/s, over some time."""
    found = []
    for _ in range(round(seconds * session.rate_hz)):
        session.step()
        now = session.snapshot()
        found.append((now.velocity_b[0], now.velocity_b[1], now.turn_rate))
    forward, sideways, turning = np.mean(found, axis=0)
    return float(forward), float(sideways), float(turning)


@pytest.mark.nojit
def test_left_alone_the_stream_is_the_motions_own_table(a1: Robot, trot: Motion) -> None:
    course, table = course_of(trot, a1), reference_table(trot, a1)
    work, place, row = make_work(a1, trot.dt), make_place(), np.zeros(1, SAMPLE)
    place["pose"][0, 2] = yaw_from_quat(table["root_quat"][0])
    place["pose"][0, :2] = table["root_pos"][0, :2]
    for sample in range(trot.n_samples // 2 + 20):  # beyond half a cycle every foot has lifted off and landed
        fill_table(course, course, place.copy()[0], work[0], row)
        want, pose = table[sample], place["pose"][0]
        np.testing.assert_allclose(pose[:2], want["root_pos"][:2], atol=1e-9)
        quat = quat_multiply(quat_from_yaw(pose[2]), row["root_quat"][0])
        np.testing.assert_allclose(abs(quat @ want["root_quat"]), 1.0, atol=1e-9)
        turned = np.array(want["lin_vel"])
        turned[:2] = rotate_planar(-pose[2], turned[:2])
        np.testing.assert_allclose(row["lin_vel"][0], turned, atol=1e-9)
        np.testing.assert_allclose(row["foot_pos"][0], want["foot_pos"], atol=1e-6)
        np.testing.assert_allclose(row["joint_pos"][0], want["joint_pos"], atol=1e-5)
        np.testing.assert_array_equal(row["contact"][0], want["contact"])
        advance_place(course, course, place[0], 1.0, True, 0.0, 0.0)


def test_left_alone_the_session_is_the_rollout(a1: Robot, trot: Motion, library: MotionSet) -> None:
    session = LiveSession(a1, library, start="trot")
    rewards = []
    for _ in range(1000):
        session.step()
        rewards.append(session.snapshot().reward)
    offline = run_episodes(a1, trot, duration_s=2.0)
    assert np.mean(rewards) == pytest.approx(float(offline.reward[0]), abs=2e-3)


@pytest.mark.slow
def test_switching_among_all_defaults_does_not_fall(a1: Robot, library: MotionSet) -> None:
    session = LiveSession(a1, library)
    assert session.motion == STAND
    for name in (*DEFAULTS[1:], STAND):
        reach(session, name)
        session.run(0.6)
        assert session.falls == 0, f"fell on the way to or in {name}"
        assert session.snapshot().reward > 0.9


def test_the_reference_of_a_switch_is_one_that_joints_can_follow(a1: Robot, library: MotionSet) -> None:
    session = LiveSession(a1, library, start="trot")
    session.switch("pace")
    before, fastest, states = None, 0.0, set()
    for _ in range(2500):
        session.step()
        now = session.snapshot().reference[7:]
        if before is not None:
            fastest = max(fastest, float(np.abs((now - before) * session.rate_hz / a1.joint_speed_limit).max()))
        before = now
        states.add(session.state)
    assert {"trot → pace", "pace"} <= states
    assert fastest < 1.05  # a seam would show as a jump of the joints


def test_a_push_by_hand_adds_to_those_of_a_disturbance(a1: Robot, library: MotionSet) -> None:
    conditions = Conditions(disturbances=("push=0.01",))  # type: ignore[arg-type]
    session = LiveSession(a1, library, start=IN_PLACE, conditions=conditions)
    session.run(0.5)
    session.push(3.0, math.pi / 2)
    session.run(0.1)
    assert session.snapshot().velocity_b[1] > 0.03


def test_a_push_changes_the_velocity(a1: Robot, library: MotionSet) -> None:
    session = LiveSession(a1, library, start=IN_PLACE)
    session.run(0.5)
    period = session.motions.entries[IN_PLACE].motion.n_samples

    def velocities() -> np.ndarray:
        found = []
        for _ in range(75):
            session.step()
            found.append(session.snapshot().velocity_b.copy())
        return np.array(found)

    for direction, axis, sign in ((math.pi / 2, 1, 1), (-math.pi / 2, 1, -1), (0.0, 0, 1), (math.pi, 0, -1)):
        calm = velocities()
        session.run((period - len(calm)) * session.dt)
        session.push(3.0, direction)
        assert np.linalg.norm(session.world.force) == pytest.approx(30.0)
        change = sign * (velocities() - calm)[:, axis]
        assert change.max() > 0.03, "3 N·s are 0.24 m/s of a robot of 12.5 kg, less what its feet hold against"
        assert not session.world.force.any()
        session.run(2.0)
    assert session.falls == 0
    for wrong in (-1.0, math.nan, 1e6):
        with pytest.raises(ConfigError, match="N·s"):
            session.push(wrong)


def test_payload_and_friction_reach_the_simulation(a1: Robot, library: MotionSet) -> None:
    session = LiveSession(a1, library)
    session.run(0.5)
    assert session.snapshot().measured.all()  # each foot carries a quarter of the weight
    session.world.set_payload(3.0)
    session.world.set_friction(0.3)
    session.run(1.5)
    carried = np.mean([session.step() or session.snapshot().force[:, 2].sum() for _ in range(250)])
    assert carried == pytest.approx((a1.mass + 3.0) * GRAVITY, rel=0.01)
    model, data = session.simulation.batch.get_model(0), session.simulation.batch.get_data(0)
    mujoco.mj_forward(model, data)
    assert data.ncon == 4
    np.testing.assert_allclose(data.contact.friction[:, 0], 0.3)
    session.world.set_payload(0.0)
    session.run(1.5)
    carried = np.mean([session.step() or session.snapshot().force[:, 2].sum() for _ in range(250)])
    assert carried == pytest.approx(a1.mass * GRAVITY, rel=0.01)
    for wrong in (-1.0, 1e3):
        with pytest.raises(ConfigError):
            session.world.set_payload(wrong)
        with pytest.raises(ConfigError):
            session.world.set_friction(wrong)


def test_it_gets_up_and_goes_on(a1: Robot, library: MotionSet) -> None:
    session = LiveSession(a1, library, start="trot")
    session.run(1.0)
    session.fall()
    assert session.fallen
    assert session.falls == 1
    reach(session, "trot")
    session.run(1.0)
    assert session.falls == 1
    assert session.snapshot().reward > 0.9


def test_from_its_back_it_gets_up_in_place_facing_the_same_way(a1: Robot, library: MotionSet) -> None:
    session = LiveSession(a1, library, start="turn")
    session.run(1.0)
    session.push(60.0, math.pi / 2)  # no robot stands that
    session.run(0.4)
    assert session.fallen
    session.run(0.1)
    before = session.snapshot().pose
    reach(session, STAND)
    after = session.snapshot().pose
    assert np.linalg.norm(after[:2] - before[:2]) < 0.6
    assert np.all(np.isfinite(after))
    assert session.snapshot().reward > 0.9
    assert after[2] == pytest.approx(library.entries[STAND].motion.root_pos_w[0, 2], abs=0.03)


def test_the_controller_changes_while_it_runs(a1: Robot, library: MotionSet) -> None:
    session = LiveSession(a1, library, start="trot")
    for method in (*playable_methods(), "mbc"):
        session.set_method(method)
        session.run(1.0)
        assert session.method == method
        assert session.falls == 0
    median, p99 = session.control_us
    assert 0 < median <= p99
    with pytest.raises(ConfigError, match="did you mean 'mbc'"):
        session.set_method("mcb")


@pytest.mark.slow
def test_an_optimised_motion_is_followed_and_scored_against_its_demonstration(a1: Robot, trot: Motion) -> None:
    dmp = MotionDmp.fit(trot, a1)
    amplitude = dmp.amplitude
    amplitude[list(FOOT_Z)] = 1.3
    optimised = dmp.motion(amplitude=amplitude)
    session = LiveSession(a1, {"optimised": optimised}, start="optimised")
    entry = session.motions.entries["optimised"]
    lifted = entry.course["foot"][..., 2].max() - entry.demonstration["foot"][..., 2].max()
    assert lifted > 0.005
    own = course_of(trot, a1)
    for name in ("foot", "lin_vel"):
        np.testing.assert_array_equal(entry.demonstration[name], own[name])
    session.run(1.0)
    reach(session, IN_PLACE)

    reach(session, "optimised")
    session.run(1.0)
    assert session.falls == 0


def test_what_cannot_be_played_is_refused(a1: Robot, trot: Motion, library: MotionSet) -> None:
    session = LiveSession(a1, library)
    with pytest.raises(ConfigError, match="did you mean 'trot'"):
        session.switch("trott")
    with pytest.raises(MotionError, match="does not repeat"):
        MotionSet(a1, {"once": dataclasses.replace(trot, cycle=None)})
    with pytest.raises(MotionError, match="samples a second"):
        MotionSet(a1, {"trot": trot}, rate_hz=400.0)
    with pytest.raises(MotionError, match="is for robot 'go1'"):
        MotionSet(a1, {"trot": dataclasses.replace(trot, provenance=dataclasses.replace(trot.provenance, robot="go1"))})


class _Dead(Executor):
    """Processes that have ended."""

    def submit(self, *_args: Any, **_named: Any) -> Any:
        raise BrokenExecutor("ended")


def test_without_the_other_process_this_one_makes_what_is_needed(a1: Robot) -> None:
    library = MotionSet(a1, {}, executor=_Dead())
    library.prepare(STAND)
    found = library.next_hop(STAND, IN_PLACE)
    assert found is not None
    assert found[0] == IN_PLACE
    assert found[1].first < found[1].last


def test_two_of_one_name_are_told_apart(a1: Robot) -> None:
    assert tuple(load_motions(["trot", "trot", STAND], a1)) == ("trot", "trot (2)", STAND)


def test_real_time_neither_drifts_nor_catches_up_for_ever(a1: Robot, library: MotionSet) -> None:
    pacer = Pacer(LiveSession(a1, library))
    for _ in range(100):
        pacer.advance(0.0103)
    assert pacer.session.time_s == pytest.approx(1.03, abs=pacer.session.dt)
    assert pacer.realtime_factor == pytest.approx(1.0, abs=0.01)
    before = pacer.session.steps
    for _ in range(10):  # a machine that takes 0.2 s for what should take a hundredth
        pacer.advance(0.2)
    assert pacer.session.steps - before <= 10 * MOST_BEHIND_S / pacer.session.dt + 1
    assert pacer.realtime_factor == pytest.approx(MOST_BEHIND_S / 0.2, rel=0.05)
    pacer.pace = 0.1
    before = pacer.session.steps
    for _ in range(100):
        pacer.advance(0.01)
    assert (pacer.session.steps - before) * pacer.session.dt == pytest.approx(0.1 + MOST_BEHIND_S, abs=0.06)


@pytest.mark.slow
def test_a_dog_is_played(a1: Robot) -> None:
    try:
        motion = load_motion("dog:trot", a1)
    except Exception as error:  # noqa: BLE001 - whatever keeps the recording from being there
        pytest.skip(f"the dog's recordings are not here ({error}); 'fastmimic data fetch', or set FASTMIMIC_DATA")
    session = LiveSession(a1, {"dog:trot": motion})
    reach(session, "dog:trot")
    session.run(3.0)
    assert session.falls == 0


def test_on_a_terrain_it_stands_gets_up_and_is_scored_from_the_ground(library: MotionSet, a1: Robot) -> None:
    conditions = Conditions(terrain=parse_terrain("side-slope=8"))
    ground = conditions.ground
    assert ground is not None
    session = LiveSession(a1, library, conditions=conditions)
    session.run(0.1)
    assert session.snapshot().reward > 0.8
    session.fall()
    session.run(5.0)
    assert session.state == STAND
    now = session.snapshot()
    assert now.reward > 0.5
    above = now.pose[2] - float(ground.height(now.pose[0], now.pose[1]))
    assert above == pytest.approx(a1.home_height, abs=0.05)
    assert now.reference[2] - float(ground.height(now.reference[0], now.reference[1])) == pytest.approx(above, abs=0.05)


def test_a_live_session_has_sensors_and_disturbances(library: MotionSet, a1: Robot) -> None:
    conditions = Conditions(observe="sensors", disturbances=("payload=2",))  # type: ignore[arg-type]
    session = LiveSession(a1, library, start="trot", conditions=conditions)
    session.run(5.0)
    assert session.falls == 0
    assert session.snapshot().reward > 0.6
    assert session._observer is not None
    told = session._observer.estimator.observation["root_pos"][0]
    assert 1e-4 < float(np.linalg.norm(told - session.observation["root_pos"])) < 0.5
    with pytest.raises(ConfigError, match="simulated by mujoco"):
        LiveSession(a1, library, conditions=Conditions(simulator="pybullet"))
