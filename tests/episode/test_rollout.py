"""Closed-loop episodes: how they begin and end, what they are scored against, and that their figures agree."""

import dataclasses
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from control.motions import gait, standing, turned
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.rotations import quat_rotate, rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import ClosedLoop, run_episodes
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.plan import JOINT_NOISE, VELOCITY_NOISE, Start, nominal_start, perturbed_start
from fastmimic.episode.reward import TERMS, WEIGHTS
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import reference_table
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from robot.mjcf import a1_tree, find, heavier, write

STEPS = 600  # a bit over two periods


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return turned(gait(robot, (0.3, 0.05), 0.4), 0.9)


@pytest.fixture(scope="module")
def loop(robot: Robot, motion: Motion) -> ClosedLoop:
    return ClosedLoop(robot, motion, 3)


@pytest.fixture(scope="module")
def start(motion: Motion) -> Start:
    return perturbed_start(3, motion.n_samples, np.random.default_rng(0))


@pytest.fixture(scope="module")
def logged(loop: ClosedLoop, start: Start) -> Rollout:
    return loop.run(None, start, STEPS, log=True)


def test_a_denser_robot_with_stronger_motors_moves_as_the_original(tmp_path: Path) -> None:
    """Its physics are the same but for the unit of force; so must its controller's be."""
    rollouts = []
    for times in (1.0, 8.0):
        robot = load_robot(write(heavier(a1_tree(), times), tmp_path / f"{times:g}.xml"))
        rollouts.append(run_episodes(robot, gait(robot, (0.4, 0.0), 0.2), duration_s=1.0))
    one, other = rollouts
    assert not one.fell[0]
    assert one.reward[0] > 0.8
    np.testing.assert_allclose(other.reward, one.reward, rtol=0, atol=1e-3)


def test_what_the_joints_lose_is_made_up_for(tmp_path: Path) -> None:
    tree = a1_tree()
    for joint in tree.iter("joint"):
        joint.attrib.update(damping="0.3", frictionloss="1.0")
    known = load_robot(write(tree, tmp_path / "stiff.xml"))
    np.testing.assert_array_equal(known.joint_damping, 0.3)
    np.testing.assert_array_equal(known.joint_friction, 1.0)
    unknown = dataclasses.replace(known, joint_damping=np.zeros(12), joint_friction=np.zeros(12))
    motion = gait(known, (0.4, 0.0), 0.2)
    easy, with_it, without = (
        run_episodes(robot, motion, duration_s=1.0).reward[0] for robot in (load_robot("a1"), known, unknown)
    )
    assert easy - with_it < (easy - without) / 3


def test_feet_are_points(tmp_path: Path) -> None:
    """Vendors' files have feet that resist rolling, that sink in, and shells that reach below them."""
    tree, motion = a1_tree(), gait(load_robot("a1"), (0.4, 0.0), 0.2)
    (foot,) = (geom for geom in tree.iter("geom") if geom.get("type") == "sphere")  # of the class of all four
    foot.attrib.update(condim="6", friction="0.8 0.02 0.01", solimp="0.015 1 0.03", margin="0.001")
    for leg in LEGS:
        shell = {"type": "capsule", "size": "0.015", "fromto": "0 0 -0.1 0 0 -0.21"}
        ElementTree.SubElement(find(tree, "body", f"{leg}_calf"), "geom", shell)
    robot = load_robot(write(tree, tmp_path / "rolling.xml"))
    assert set(robot.model().geom_condim[[robot.model().geom(name).id for name in robot.foot_geoms]]) == {6}
    rolling = run_episodes(robot, motion, duration_s=1.0)
    np.testing.assert_array_equal(rolling.reward, run_episodes(load_robot("a1"), motion, duration_s=1.0).reward)


def thrown(n: int, who: int = 0) -> Start:
    """n starts, one with so much sideways speed that it is a metre off within 0.2 s whatever the controller does."""
    start = nominal_start(n)
    start.velocity_offset[who, 1] = 8.0
    return start


def lifted(motion: Motion, robot: Robot, factor: float) -> Motion:
    """The motion with its foot lift scaled: what an optimiser might send to the controller."""
    feet = motion.foot_pos_b.copy()
    ground = feet[..., 2].min(axis=0)
    feet[..., 2] = ground + factor * (feet[..., 2] - ground)
    joints, _ = inverse_kinematics(robot, feet)
    velocity = (np.roll(joints, -1, axis=0) - np.roll(joints, 1, axis=0)) * (motion.rate_hz / 2)
    return dataclasses.replace(motion, foot_pos_b=feet, joint_pos=joints, joint_vel=velocity, demonstration=motion)


def same(a: Rollout, b: Rollout, rows_a: slice = slice(None), rows_b: slice = slice(None)) -> bool:
    """Whether all figures of some episodes agree bit for bit."""
    names = [f.name for f in dataclasses.fields(Rollout) if f.name not in ("duration_s", "log", "parts", "estimation")]
    return all(getattr(a, n)[rows_a].tobytes() == getattr(b, n)[rows_b].tobytes() for n in names)


class TestParts:
    """An episode divided into parts, such as the segments of a stitched motion."""

    def test_they_make_up_the_whole(self, loop: ClosedLoop, start: Start) -> None:
        whole = loop.run(None, start, STEPS)
        divided = loop.run(None, start, STEPS, divisions=[150, 400])
        assert same(divided, whole)
        assert [round(p.duration_s * 500) for p in divided.parts] == [150, 250, 200]
        weights = np.array([150, 250, 200]) / STEPS
        for name in ("reward", "terms"):
            parts = np.stack([getattr(p, name) for p in divided.parts])
            np.testing.assert_allclose(np.tensordot(weights, parts, axes=1), getattr(whole, name))
        np.testing.assert_array_equal(sum(p.steps for p in divided.parts), whole.steps)
        assert same(divided.parts[0], loop.run(None, start, 150))
        assert whole.parts == ()

    def test_a_fall_is_in_one_of_them_and_what_comes_after_counts_nothing(self, robot: Robot, motion: Motion) -> None:
        rollout = ClosedLoop(robot, motion, 1).run(None, thrown(1), STEPS, divisions=[50, 300, 450])
        assert rollout.fell.all()
        fell = [bool(p.fell[0]) for p in rollout.parts]
        assert sum(fell) == 1
        at = fell.index(True)
        assert [bool(p.steps[0] == 0) for p in rollout.parts[at + 1 :]] == [True] * (3 - at)
        assert all(p.reward[0] == 0 for p in rollout.parts[at + 1 :])


class TestEpisode:
    def test_the_robot_imitates(self, logged: Rollout) -> None:
        """An easy gait, so that it holds for any sensible gains."""
        assert not logged.fell.any()
        assert np.all(logged.reward > 0.8)
        np.testing.assert_array_equal(logged.steps, STEPS)
        np.testing.assert_array_equal(logged.qp_failures, 0)

    def test_n_episodes_at_once_are_n_single_ones(
        self, robot: Robot, motion: Motion, start: Start, logged: Rollout
    ) -> None:
        single = ClosedLoop(robot, motion, 1)
        for i in range(3):
            assert same(single.run(None, start.part(slice(i, i + 1)), STEPS), logged, rows_b=slice(i, i + 1))

    def test_an_episode_depends_on_nothing_that_came_before(
        self, loop: ClosedLoop, robot: Robot, start: Start, logged: Rollout
    ) -> None:
        loop.run(None, thrown(3), 200)
        loop.run([gait(robot)], start, 1)
        with pytest.raises(MotionError):
            loop.run([gait(robot, n_samples=200)], start, 1)
        assert same(loop.run(None, start, STEPS), logged)

    def test_threads_of_the_simulation_change_nothing(
        self, robot: Robot, motion: Motion, start: Start, logged: Rollout
    ) -> None:
        assert same(ClosedLoop(robot, motion, 3, threads=2).run(None, start, STEPS), logged)

    def test_the_heading_in_which_a_motion_was_recorded_does_not_matter(self, robot: Robot, motion: Motion) -> None:
        a, b = (run_episodes(robot, m, duration_s=0.4) for m in (motion, turned(motion, 2.0, shift=(5.0, 1.0))))
        np.testing.assert_allclose(a.reward, b.reward, rtol=1e-4)

    def test_its_length_is_a_whole_number_of_control_steps(self, robot: Robot, motion: Motion) -> None:
        for seconds, steps in ((0.1, 50), (0.101, 51), (1e-9, 1)):
            rollout = run_episodes(robot, motion, duration_s=seconds)
            assert rollout.steps[0] == steps
            assert rollout.duration_s == pytest.approx(steps / 500)

    def test_one_episode_from_the_start_unless_told_otherwise(self, robot: Robot, motion: Motion) -> None:
        a = run_episodes(robot, motion, duration_s=0.1)
        b = run_episodes(robot, motion, start=nominal_start(1), duration_s=0.1)
        assert same(a, b)


class TestStart:
    def test_nominal_is_the_motions_start_unperturbed(self) -> None:
        start = nominal_start(2)
        assert start.n == 2
        for array in (start.sample, start.joint_offset, start.velocity_offset):
            assert not array.any()

    def test_perturbed_leaves_the_first_episode_alone(self) -> None:
        start = perturbed_start(5, 250, np.random.default_rng(1))
        for array in (start.sample, start.joint_offset, start.velocity_offset):
            assert not array[0].any()
            assert array[1:].any(axis=-1).all() if array.ndim > 1 else array[1:].any()

    def test_perturbations_fill_their_ranges(self) -> None:
        """± 0.05 rad, ± 0.1 m/s, any phase."""
        assert (JOINT_NOISE, VELOCITY_NOISE) == (0.05, 0.1)
        start = perturbed_start(400, 250, np.random.default_rng(2))
        for values, bound in ((start.joint_offset, JOINT_NOISE), (start.velocity_offset, VELOCITY_NOISE)):
            assert np.abs(values).max() <= bound
            assert values.max() > 0.98 * bound
            assert values.min() < -0.98 * bound
            assert abs(values.mean()) < 0.1 * bound
        assert start.sample.min() == 0
        assert start.sample.max() >= 245
        assert start.sample.max() < 250
        assert len(np.unique(start.sample)) > 150

    def test_the_generator_decides(self) -> None:
        a, b, c = (perturbed_start(6, 250, np.random.default_rng(seed)) for seed in (3, 3, 4))
        assert a.joint_offset.tobytes() == b.joint_offset.tobytes()
        np.testing.assert_array_equal(a.sample, b.sample)
        assert a.joint_offset.tobytes() != c.joint_offset.tobytes()

    def test_robots_start_in_the_demonstrations_state_plus_the_perturbation(
        self, robot: Robot, motion: Motion, start: Start
    ) -> None:
        """Seen before the first step, relative to the heading; raised just enough that no foot is in the ground."""
        loop = ClosedLoop(robot, motion, 3)
        loop.run(None, start, 1)  # leaves the simulation one step later
        loop.place(start)
        found = loop.simulation.observation
        at = start.sample
        np.testing.assert_allclose(found["joint_pos"], motion.joint_pos[at] + start.joint_offset, atol=1e-12)
        np.testing.assert_allclose(found["joint_vel"], motion.joint_vel[at], atol=1e-12)
        heading = yaw_from_quat(motion.root_quat_wxyz[at])
        expected = motion.root_lin_vel_w[at].copy()
        expected[:, :2] = rotate_planar(-heading, expected[:, :2])
        np.testing.assert_allclose(found["lin_vel"], expected + start.velocity_offset, atol=1e-9)
        np.testing.assert_allclose(yaw_from_quat(found["root_quat"]), 0.0, atol=1e-9)
        np.testing.assert_allclose(found["ang_vel"], motion.root_ang_vel_w[at], atol=1e-9)
        feet = foot_positions(robot, found["joint_pos"])
        lowest = (quat_rotate(found["root_quat"][:, None], feet) + found["root_pos"][:, None])[..., 2].min(axis=1)
        assert np.all(lowest >= robot.foot_radius - 1e-9)
        raised = found["root_pos"][:, 2] - motion.root_pos_w[at, 2]
        assert np.all(raised >= -1e-12)
        np.testing.assert_allclose(lowest[raised > 1e-9], robot.foot_radius, atol=1e-9)


class TestFall:
    def test_steps_after_a_fall_count_nothing(self, robot: Robot, motion: Motion) -> None:
        loop = ClosedLoop(robot, motion, 1)
        short, long = (loop.run(None, thrown(1), n) for n in (300, 600))
        assert short.fell[0]
        assert long.fell[0]
        assert 0 < short.steps[0] < 300
        assert long.steps[0] == short.steps[0]
        np.testing.assert_allclose(long.reward, short.reward / 2)
        np.testing.assert_allclose(long.terms, short.terms / 2)
        for name in ("foot_rmse", "drift", "early_contacts", "qp_failures", "slip"):
            np.testing.assert_array_equal(getattr(long, name), getattr(short, name), err_msg=name)

    def test_figures_of_a_fallen_robot_do_not_depend_on_how_long_the_others_live(
        self, robot: Robot, motion: Motion
    ) -> None:
        fallen = ClosedLoop(robot, motion, 1).run(None, thrown(1), STEPS)
        both = ClosedLoop(robot, motion, 2).run(None, thrown(2), STEPS)
        np.testing.assert_array_equal(both.fell, [True, False])
        assert same(fallen, both, rows_b=slice(0, 1))

    def test_the_log_is_empty_after_a_fall(self, robot: Robot, motion: Motion) -> None:
        rollout = ClosedLoop(robot, motion, 1).run(None, thrown(1), 300, log=True)
        assert rollout.log is not None
        alive = rollout.log.terms[0].any(axis=1)
        assert alive.sum() == rollout.steps[0]
        assert not alive[rollout.steps[0] :].any()
        assert rollout.log.reward[0].mean() == pytest.approx(rollout.reward[0])


class TestDemonstration:
    """The reward compares with the demonstration, whatever the controller is told to follow."""

    @pytest.fixture(scope="class")
    @classmethod
    def modulated(cls, motion: Motion, robot: Robot) -> Motion:
        return lifted(motion, robot, 0.3)

    def test_a_modulated_reference_is_scored_against_the_demonstration(
        self, robot: Robot, motion: Motion, modulated: Motion
    ) -> None:
        rollout = run_episodes(robot, modulated, duration_s=0.5, log=True)
        log = rollout.log
        assert log is not None
        samples = np.arange(1, 251) % motion.n_samples
        np.testing.assert_array_equal(log.demonstration["joint_pos"][0], motion.joint_pos[samples])
        error = motion.joint_pos[samples] - log.observation["joint_pos"][0]
        np.testing.assert_allclose(log.terms[0, :, 0], np.exp(-5 * np.sum(error**2, axis=1)), atol=1e-12)

    def test_a_shuffle_follows_itself_well_and_is_not_rewarded_for_it(
        self, robot: Robot, motion: Motion, modulated: Motion
    ) -> None:
        against_itself = run_episodes(robot, dataclasses.replace(modulated, demonstration=None), duration_s=1.0)
        against_demonstration = run_episodes(robot, modulated, duration_s=1.0)
        pose = TERMS.index("pose")
        assert against_demonstration.terms[0, pose] < against_itself.terms[0, pose] - 0.05
        assert np.all(against_demonstration.clearance < 0.6 * swing_clearance(motion, robot.foot_radius))

    def test_the_controller_follows_the_modulated_reference(
        self, robot: Robot, motion: Motion, modulated: Motion
    ) -> None:
        rollout = run_episodes(robot, modulated, duration_s=1.0)
        np.testing.assert_allclose(rollout.clearance[0], swing_clearance(modulated, robot.foot_radius), atol=0.008)

    def test_references_may_be_motions_or_their_tables(self, robot: Robot, motion: Motion, modulated: Motion) -> None:
        loop = ClosedLoop(robot, motion, 2)
        tables = np.stack([reference_table(m, robot) for m in (motion, modulated)])
        a = loop.run([motion, modulated], nominal_start(2), 200)
        b = loop.run(tables, nominal_start(2), 200)
        assert same(a, b)
        assert a.reward[0] != a.reward[1]
        each = [loop.run([m], nominal_start(2), 200) for m in (motion, modulated)]
        assert same(a, each[0], slice(0, 1), slice(0, 1))
        assert same(a, each[1], slice(1, 2), slice(1, 2))


class TestFigures:
    """The running sums agree with what the log shows."""

    def test_reward_and_terms(self, logged: Rollout) -> None:
        assert logged.log is not None
        np.testing.assert_allclose(logged.log.reward.mean(axis=1), logged.reward)
        np.testing.assert_allclose(logged.log.terms.mean(axis=1), logged.terms)
        np.testing.assert_allclose(logged.terms @ WEIGHTS, logged.reward)
        assert logged.components(1) == dict(zip(TERMS, logged.terms[1], strict=True))

    def test_a_log_changes_nothing(self, loop: ClosedLoop, start: Start, logged: Rollout) -> None:
        without = loop.run(None, start, STEPS)
        assert without.log is None
        assert same(without, logged)

    def test_foot_errors(self, logged: Rollout, robot: Robot) -> None:
        assert logged.log is not None
        feet = foot_positions(robot, logged.log.observation["joint_pos"])
        error = feet - logged.log.demonstration["foot_pos"]
        np.testing.assert_allclose(logged.foot_rmse, np.sqrt(np.mean(error**2, axis=1)))

    def test_clearance_is_the_mean_peak_of_the_swings(self, logged: Rollout, robot: Robot) -> None:
        log = logged.log
        assert log is not None
        feet = quat_rotate(
            log.observation["root_quat"][:, :, None], foot_positions(robot, log.observation["joint_pos"])
        )
        height = feet[..., 2] + log.observation["root_pos"][:, :, None, 2] - robot.foot_radius
        for leg in range(4):
            swing = ~log.wanted[0, :, leg]
            edges = np.flatnonzero(np.diff(np.concatenate([[0], swing.astype(int), [0]]))).reshape(-1, 2)
            # a swing that begins before the episode, or ends after it, is not counted
            peaks = [height[0, a:b, leg].max() for a, b in edges if a > 0 and b < STEPS]
            assert logged.clearance[0, leg] == pytest.approx(np.mean(peaks))

    def test_drift_is_what_the_synchronisation_hides(self, logged: Rollout, motion: Motion) -> None:
        """At each wrap: from where the period's displacement leads to where the robot is."""
        log = logged.log
        assert log is not None
        assert motion.cycle is not None
        hidden = 0.0
        position, quat = log.demonstration["root_pos"][0], log.demonstration["root_quat"][0]
        origin, heading = np.zeros(2), 0.0  # episode 0 starts at the origin, heading 0
        for step in range(STEPS):
            if (step + 1) % motion.n_samples == 0:
                led_to = origin + rotate_planar(heading, motion.cycle[:2])
                origin, heading = log.observation["root_pos"][0, step, :2], yaw_from_quat(quat[step])
                np.testing.assert_allclose(position[step, :2], origin, atol=1e-9)
                hidden += float(np.linalg.norm(origin - led_to))
        assert heading == pytest.approx(2 * motion.cycle[2], abs=1e-9), "yaw is never synchronised"
        assert hidden > 0
        assert logged.drift[0] == pytest.approx(hidden / (STEPS / 500))

    def test_the_log_holds_the_schedule_the_states_and_the_forces(self, logged: Rollout, motion: Motion) -> None:
        log = logged.log
        assert log is not None
        samples = np.arange(1, STEPS + 1) % motion.n_samples
        np.testing.assert_array_equal(log.wanted[0], motion.contact[samples])
        assert np.mean(log.stance == log.wanted) > 0.85
        np.testing.assert_array_equal(log.force[~log.stance], 0.0)
        assert np.all(log.force[log.stance][:, 2] > 0)
        assert log.rate_hz == 500

    def test_commands_lead_to_the_observation_beside_them(self, logged: Rollout) -> None:
        assert logged.log is not None
        assert np.any(logged.log.command["torque"][:, 0] != 0)


class TestSwingClearance:
    """Of a reference: mean over the swings of each foot's greatest height above the ground."""

    def test_is_the_lift_of_the_gait(self, robot: Robot) -> None:
        for lift in (0.03, 0.07):
            motion = gait(robot, (0.3, 0.0), lift=lift)
            np.testing.assert_allclose(swing_clearance(motion, robot.foot_radius), lift, atol=1e-4)

    def test_does_not_exist_without_swings(self, robot: Robot) -> None:
        assert np.isnan(swing_clearance(standing(robot), robot.foot_radius)).all()
        flying = dataclasses.replace(gait(robot), contact=np.zeros((250, 4), dtype=bool))
        assert np.isnan(swing_clearance(flying, robot.foot_radius)).all()

    def test_a_swing_across_the_wrap_is_one(self, robot: Robot) -> None:
        """The period may begin in the middle of a swing."""
        for phase in (0.1, 0.35, 0.8):
            motion = gait(robot, touchdown=(phase, phase + 0.5, phase + 0.5, phase), lift=0.05)
            np.testing.assert_allclose(swing_clearance(motion, robot.foot_radius), 0.05, atol=1e-4)

    def test_a_swing_that_an_end_cuts_off_is_none(self, robot: Robot) -> None:
        """As in the episodes of a motion that does not repeat."""
        motion = gait(robot, touchdown=(0.1, 0.6, 0.6, 0.1), lift=0.05)
        once = dataclasses.replace(motion, cycle=None)
        assert not once.contact[0, 0]
        assert once.contact[0, 1]
        found = swing_clearance(once, robot.foot_radius)
        np.testing.assert_array_equal(np.isfinite(found), once.contact[0])
        cut = slice(0, int(np.argmax(~motion.contact[:, 0])) + 5)
        names = ("root_pos_w", "root_quat_wxyz", "joint_pos", "joint_vel", "foot_pos_b", "contact")
        velocities = ("root_lin_vel_w", "root_ang_vel_w")
        early = dataclasses.replace(once, **{n: getattr(once, n)[cut] for n in (*names, *velocities)})
        assert np.isnan(swing_clearance(early, robot.foot_radius)[0])

    def test_is_the_mean_over_several_swings(self, robot: Robot) -> None:
        low, high = gait(robot, lift=0.04), gait(robot, lift=0.06)
        names = ("root_pos_w", "root_quat_wxyz", "joint_pos", "joint_vel", "foot_pos_b", "contact")
        both = {n: np.concatenate([getattr(low, n), getattr(high, n)]) for n in names}
        velocity = {n: np.zeros((2 * low.n_samples, 3)) for n in ("root_lin_vel_w", "root_ang_vel_w")}
        motion = dataclasses.replace(low, **both, **velocity)
        np.testing.assert_allclose(swing_clearance(motion, robot.foot_radius), 0.05, atol=1e-4)

    def test_counts_the_trunks_own_height(self, robot: Robot) -> None:
        motion = gait(robot, lift=0.05)
        raised = dataclasses.replace(motion, root_pos_w=motion.root_pos_w + np.array([0, 0, 0.01]))
        np.testing.assert_allclose(swing_clearance(raised, robot.foot_radius), 0.06, atol=1e-4)


class TestRefused:
    def test_a_motion_for_another_robot(self, motion: Motion) -> None:
        with pytest.raises(MotionError, match="'synthetic' is for robot 'a1', not for 'go1'"):
            ClosedLoop(load_robot("go1"), motion, 1)

    def test_a_motion_at_another_rate(self, robot: Robot, motion: Motion) -> None:
        slow = dataclasses.replace(motion, rate_hz=250.0)
        with pytest.raises(ConfigError, match="250 samples a second"):
            ClosedLoop(robot, slow, 1)

    def test_a_rate_that_the_physics_cannot_follow(self, robot: Robot, motion: Motion) -> None:
        odd = dataclasses.replace(motion, rate_hz=300.0)
        with pytest.raises(ConfigError, match="must be a multiple of the control rate"):
            ClosedLoop(robot, odd, 1, dataclasses.replace(ControllerConfig(), rate_hz=300.0))

    def test_starts_for_another_number_of_robots(self, loop: ClosedLoop) -> None:
        with pytest.raises(ConfigError, match="holds 3 robots; 2 starts"):
            loop.run(None, nominal_start(2), 10)

    def test_references_for_another_number_of_robots(self, loop: ClosedLoop, motion: Motion) -> None:
        with pytest.raises(ConfigError, match="3 robots need 1 or 3 references, found 2"):
            loop.run([motion, motion], nominal_start(3), 10)

    def test_references_with_another_period(self, loop: ClosedLoop, robot: Robot) -> None:
        other = gait(robot, n_samples=200)
        for references in ([other], reference_table(other, robot)[None]):
            with pytest.raises(MotionError, match="200 samples and the demonstration 'synthetic' 250"):
                loop.run(references, nominal_start(3), 10)

    def test_references_at_another_rate(self, loop: ClosedLoop, motion: Motion) -> None:
        with pytest.raises(ConfigError, match="'synthetic' has 1000 samples a second; expected 500"):
            loop.run([dataclasses.replace(motion, rate_hz=1000.0)], nominal_start(3), 10)


@pytest.mark.nojit
def test_a_few_steps_without_the_compiler(robot: Robot) -> None:
    rollout = run_episodes(robot, standing(robot), duration_s=0.04)
    assert rollout.reward[0] > 0.95
