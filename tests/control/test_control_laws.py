"""The laws of the paper: what the standing feet do to the body, where the swinging feet go."""

import dataclasses

import mujoco
import numpy as np
import pytest

from control.motions import gait, standing
from control.rig import Rig, disturbed, on_reference
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import (
    matrix_from_quat,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    rotate_planar,
)
from fastmimic.control.config import CONFIGS, ControllerConfig, SwingConfig
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from robot.mjcf import Simulated


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return gait(robot, (0.4, 0.1), 0.5)


@pytest.fixture(scope="module")
def stand(robot: Robot) -> Motion:
    return standing(robot)


KP, KD = (25.0, 25.0, 40.0, 100.0, 110.0, 120.0), (5.5, 5.5, 7.0, 8.0, 9.0, 10.0)


def stance_law(**changes: object) -> ControllerConfig:
    """The paper's stance law with gains of its own and forces that cost nothing."""
    stance = dataclasses.replace(
        CONFIGS["paper"].stance,
        position_gain=KP,
        velocity_gain=KD,
        acceleration_limit=(100.0,) * 6,
        acceleration_weight=(1.0,) * 6,
        force_weight=1e-10,
        friction=0.9,
        min_force=0.0,
        adaptation="off",
    )
    return ControllerConfig(stance=dataclasses.replace(stance, **changes))


class TestStanceLaw:
    """Paper, eq. 1: what the forces on the standing feet do to the body, by Newton and Euler on MuJoCo's masses."""

    def body_acceleration(self, robot: Robot, observation: np.ndarray, force_h: np.ndarray) -> np.ndarray:
        """(6,) in the heading frame, forces in the heading frame."""
        simulated = Simulated(robot)
        simulated.pose(observation["joint_pos"], observation["root_pos"], observation["root_quat"])
        rotation = simulated.rotation
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
        to_heading = matrix_from_quat(quat_from_yaw(-yaw))
        contact = simulated.data.geom_xpos[simulated.feet] - [0, 0, robot.foot_radius]
        arms = (contact - simulated.data.subtree_com[simulated.trunk]) @ to_heading.T
        body = to_heading @ rotation
        inertia = body @ robot.inertia_b @ body.T
        linear = force_h.sum(axis=0) / robot.mass - [0, 0, GRAVITY]
        return np.concatenate([linear, np.linalg.solve(inertia, np.cross(arms, force_h).sum(axis=0))])

    @pytest.mark.parametrize("yaw", [0.0, 2.0])
    def test_the_body_accelerates_by_gains_on_errors_in_the_heading_frame(
        self, robot: Robot, stand: Motion, yaw: float
    ) -> None:
        rig = Rig(robot, [stand], np.array([0]), stance_law())
        rig.clocks["origin"][:, 2] = yaw
        observation = on_reference(stand, np.array([0]))
        offset, twist = np.array([0.01, -0.02, 0.005]), np.array([0.02, -0.03, 0.04])
        velocity, turning = np.array([0.05, 0.02, -0.03]), np.array([0.1, -0.05, 0.08])
        turn = quat_from_yaw(yaw + twist[2])  # the robot's heading: errors are given in its frame
        observation["root_pos"][0] += quat_rotate(turn, offset)
        attitude = quat_from_rotvec(np.array([twist[0], twist[1], 0.0]))
        observation["root_quat"][0] = quat_multiply(turn, attitude)
        observation["lin_vel"][0], observation["ang_vel"][0] = quat_rotate(turn, velocity), quat_rotate(turn, turning)
        rig.step(observation)
        heading = np.arctan2(*matrix_from_quat(observation["root_quat"][0])[[1, 0], 0])
        into = quat_from_yaw(-heading)
        position_error = -quat_rotate(into, observation["root_pos"][0] - stand.root_pos_w[0])
        reference = quat_multiply(into, quat_from_yaw(yaw))
        robot_quat = quat_multiply(into, observation["root_quat"][0])
        error = matrix_from_quat(reference) @ matrix_from_quat(robot_quat).T
        wanted = np.concatenate(
            [
                np.array(KP[:3]) * position_error - np.array(KD[:3]) * quat_rotate(into, observation["lin_vel"][0]),
                np.array(KP[3:]) * rotation_vector(error)
                - np.array(KD[3:]) * quat_rotate(into, observation["ang_vel"][0]),
            ]
        )
        force = rig.controller.memory["force"][0]
        np.testing.assert_allclose(self.body_acceleration(robot, observation[0], force), wanted, atol=2e-4)

    def test_the_references_acceleration_is_added_by_its_share(self, robot: Robot, stand: Motion) -> None:
        """It comes in the reference's heading frame, here 0.3 rad off the robot's."""
        rig = Rig(robot, [stand], np.array([0]), stance_law(reference_acceleration=0.5))
        rig.controller.tables["lin_acc"] = acceleration = np.array([0.4, -0.2, 0.1])
        observation = on_reference(stand, np.array([0]))
        observation["root_quat"] = quat_from_yaw(0.3)
        rig.step(observation)
        wanted = 0.5 * acceleration
        wanted[:2] = rotate_planar(-0.3, wanted[:2])
        force = rig.controller.memory["force"][0]
        found = self.body_acceleration(robot, observation[0], force)
        np.testing.assert_allclose(found[:3], wanted, atol=2e-4)

    def test_what_the_legs_take_is_added_beyond_the_limit_of_the_feedback(self, robot: Robot, stand: Motion) -> None:
        config = stance_law(leg_momentum=True, acceleration_limit=(0.1,) * 6)
        rig = Rig(robot, [stand], np.array([0]), config)
        linear, angular = np.array([0.4, -0.2, 0.3]), np.array([0.5, 0.6, -0.7])
        rig.controller.tables["leg_lin_acc"], rig.controller.tables["leg_ang_acc"] = linear, angular
        observation = on_reference(stand, np.array([0]))
        observation["root_quat"] = quat_from_yaw(0.3)
        rig.controller.tables["root_quat"] = quat_from_yaw(0.3)  # no error, so nothing but the feed-forward
        rig.controller.tables["foot_pos"] = foot_positions(robot, observation["joint_pos"])
        rig.step(observation)
        found = self.body_acceleration(robot, observation[0], rig.controller.memory["force"][0])
        wanted = [*rotate_planar(-0.3, linear[:2]), linear[2], *rotate_planar(-0.3, angular[:2]), angular[2]]
        np.testing.assert_allclose(found, wanted, atol=5e-4)

    def test_the_wanted_acceleration_is_clipped_in_each_axis(self, robot: Robot, stand: Motion) -> None:
        limit = (0.5, 0.6, 0.7, 2.0, 2.1, 2.2)
        rig = Rig(robot, [stand], np.array([0]), stance_law(acceleration_limit=limit))
        observation = on_reference(stand, np.array([0]))
        observation["lin_vel"], observation["ang_vel"] = (3.0, -3.0, 3.0), (-3.0, 3.0, -3.0)
        rig.step(observation)
        expected = np.array([-0.5, 0.6, -0.7, 2.0, -2.1, 2.2])
        force = rig.controller.memory["force"][0]
        np.testing.assert_allclose(self.body_acceleration(robot, observation[0], force), expected, atol=2e-4)

    def test_standing_still_on_four_feet_carries_exactly_the_weight(self, robot: Robot, stand: Motion) -> None:
        rig = Rig(robot, [stand], np.array([0]), stance_law())
        rig.step(on_reference(stand, np.array([0])))
        force = rig.controller.memory["force"][0]
        np.testing.assert_allclose(force.sum(axis=0), [0, 0, robot.mass * GRAVITY], atol=1e-4)

    def test_torques_press_the_feet_with_the_opposite_of_the_grounds_forces(self, robot: Robot, trot: Motion) -> None:
        """τ = −Jᵀ f with the Jacobian of the point under the foot sphere's centre, where the ground is felt."""
        samples = np.array([10, 60, 130, 200])
        rig = Rig(robot, [trot], samples, stance_law())
        observation = disturbed(on_reference(trot, samples), np.random.default_rng(3), 0.3)
        commands = rig.step(observation)
        memory = rig.controller.memory
        rotation = matrix_from_quat(observation["root_quat"])
        yaw = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
        force_w = quat_rotate(quat_from_yaw(yaw)[:, None], memory["force"])
        torque = np.array([self.ground_torque(robot, o, f) for o, f in zip(observation, force_w, strict=True)])
        torque = np.clip(torque, -robot.torque_limit, robot.torque_limit)
        standing_legs = np.repeat(memory["stance"], 3, axis=1) == 1
        assert standing_legs.any(axis=1).all()
        np.testing.assert_allclose(commands["torque"][standing_legs], torque[standing_legs], atol=1e-9)

    @staticmethod
    def contact_jacobians(robot: Robot, observation: np.void) -> np.ndarray:
        """Those of the points of the feet that touch the ground, (4, 3, 18), by MuJoCo: velocities in the world of base
        and joints, the base's turning in its own frame."""
        model = robot.spec().compile()
        data = mujoco.MjData(model)
        joints = [model.joint(name).id for name in robot.joint_names]
        data.qpos[:3], data.qpos[3:7] = observation["root_pos"], observation["root_quat"]
        data.qpos[model.jnt_qposadr[joints]] = observation["joint_pos"]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        found = np.zeros((4, 3, model.nv))
        for leg, name in enumerate(robot.foot_geoms):
            point = data.geom(name).xpos - [0, 0, robot.foot_radius]
            mujoco.mj_jac(model, data, found[leg], None, point, int(model.geom(name).bodyid[0]))
        return found[:, :, [*range(6), *model.jnt_dofadr[joints]]]

    def ground_torque(self, robot: Robot, observation: np.void, force_w: np.ndarray) -> np.ndarray:
        """−Jᵀ f, (12,)."""
        return -np.einsum("lkj,lk->j", self.contact_jacobians(robot, observation), force_w)[6:]

    @pytest.mark.parametrize("kind", ["off", "paper", "full"])
    def test_adaptation_moves_the_foot_against_the_bodys_motion(self, robot: Robot, trot: Motion, kind: str) -> None:
        """Paper, eq. 2: under the commanded joint velocities the contacts stand still beneath a body that moves with v̄,
        in the full form also with ω̄; by MuJoCo's Jacobians of the points that touch the ground. The gains are low."""
        samples = np.array([5, 60, 130, 180])
        config = stance_law(adaptation=kind, joint_stiffness=33.0, joint_damping=1.2)
        rig = Rig(robot, [trot], samples, config)
        observation = on_reference(trot, samples)
        commands = rig.step(observation)
        standing_legs = rig.controller.memory["stance"] == 1
        turning = quat_rotate_inverse(trot.root_quat_wxyz, trot.root_ang_vel_w)[samples]
        for i, sample in enumerate(samples):
            base = np.concatenate([trot.root_lin_vel_w[sample], turning[i] if kind == "full" else np.zeros(3)])
            velocity = np.concatenate([base, commands["joint_vel"][i]])
            contacts = self.contact_jacobians(robot, observation[i]) @ velocity
            if kind == "off":
                assert not commands["joint_vel"][i][np.repeat(standing_legs[i], 3)].any()
            else:
                np.testing.assert_allclose(contacts[standing_legs[i]], 0.0, atol=0.01)
        joints = np.repeat(standing_legs, 3, axis=1)
        np.testing.assert_array_equal(commands["stiffness"][joints], 0.0 if kind == "off" else 33.0)
        np.testing.assert_array_equal(commands["damping"][joints], 0.0 if kind == "off" else 1.2)
        way = (commands["joint_pos"] - observation["joint_pos"]) / trot.dt
        np.testing.assert_allclose(commands["joint_vel"][joints], way[joints], atol=1e-6)


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """By the matrix logarithm's definition: angle from the trace, axis from the skew part."""
    angle = np.arccos((np.trace(matrix) - 1) / 2)
    skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return angle * skew / (2 * np.sin(angle))


PLAIN_SWING = SwingConfig(
    foothold="reference",
    velocity_feedback=(0.03, 0.04),
    joint_stiffness=70.0,
    joint_damping=2.0,
    leg_dynamics=False,
    level=0.0,
    liftoff_blend_time=0.0,
)


class TestSwingLaw:
    """Paper, eq. 3: x̄_f − K (v̄ − v) in x and y of the body frame, joint PD about its inverse kinematics."""

    SAMPLES = np.array([20, 60, 160, 220])

    def rig(self, robot: Robot, trot: Motion, **changes: object) -> Rig:
        config = ControllerConfig(swing=dataclasses.replace(PLAIN_SWING, **changes))
        return Rig(robot, [trot], self.SAMPLES, config)

    def targets(self, robot: Robot, rig: Rig, observation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        commands = rig.step(observation)
        swinging = rig.controller.memory["stance"] == 0
        assert swinging.any()
        return foot_positions(robot, commands["joint_pos"]), swinging

    def test_on_the_reference_the_foot_is_the_references(self, robot: Robot, trot: Motion) -> None:
        rig = self.rig(robot, trot)
        target, swinging = self.targets(robot, rig, on_reference(trot, self.SAMPLES))
        np.testing.assert_allclose(target[swinging], trot.foot_pos_b[self.SAMPLES][swinging], atol=1e-9)
        joints = np.repeat(swinging, 3, axis=1)
        commands = rig.controller.command
        np.testing.assert_allclose(commands["joint_vel"][joints], trot.joint_vel[self.SAMPLES][joints])
        np.testing.assert_array_equal(commands["stiffness"][joints], 70.0)
        np.testing.assert_array_equal(commands["damping"][joints], 2.0)
        np.testing.assert_array_equal(commands["torque"][joints], 0.0)

    def test_the_foot_steps_against_the_velocity_error(self, robot: Robot, trot: Motion) -> None:
        rig = self.rig(robot, trot)
        observation = on_reference(trot, self.SAMPLES)
        faster_b = np.array([0.3, -0.2, 0.0])
        observation["lin_vel"] += quat_rotate(observation["root_quat"], faster_b)
        target, swinging = self.targets(robot, rig, observation)
        expected = trot.foot_pos_b[self.SAMPLES] + np.array([0.03, 0.04, 0.0]) * faster_b
        np.testing.assert_allclose(target[swinging], expected[swinging], atol=1e-9)

    def test_a_foot_that_the_regulator_shifts_is_as_fast_as_that(self, robot: Robot, trot: Motion) -> None:
        """Beside the reference's, the joints have the speed at which their targets move while the reference waits."""
        rig = self.rig(robot, trot, foothold="regulator")
        observation = on_reference(trot, self.SAMPLES)
        observation["lin_vel"] += quat_rotate(observation["root_quat"], np.array([0.3, -0.2, 0.0]))
        for _ in range(20):
            before = rig.step(observation)
        commands = rig.step(observation)
        joints = np.repeat(rig.controller.memory["stance"] == 0, 3, axis=1)
        moving = (commands["joint_pos"] - before["joint_pos"])[joints] / trot.dt
        assert np.abs(moving).max() > 1.0
        own = commands["joint_vel"][joints] - trot.joint_vel[self.SAMPLES][joints]
        np.testing.assert_allclose(own, moving, atol=0.02 * np.abs(moving).max())

    def test_a_levelled_swing_keeps_the_feet_in_the_world_while_the_trunk_tilts(
        self, robot: Robot, trot: Motion
    ) -> None:
        observation = on_reference(trot, self.SAMPLES)
        tilt = quat_from_rotvec(np.array([0.06, -0.05, 0.0]))
        observation["root_quat"] = quat_multiply(observation["root_quat"], tilt)
        observation["root_pos"][:, 2] += 0.01
        for level in (0.0, 1.0):
            rig = self.rig(robot, trot, level=level)
            target_b, swinging = self.targets(robot, rig, observation)
            target_w = quat_rotate(observation["root_quat"][:, None], target_b) + observation["root_pos"][:, None]
            wanted_w = quat_rotate(trot.root_quat_wxyz[:, None], trot.foot_pos_b) + trot.root_pos_w[:, None]
            error = np.abs(target_w - wanted_w[self.SAMPLES])[swinging]
            if level == 1.0:
                assert error[:, 2].max() < 1e-9, "heights are the reference's exactly"
                assert error.max() < 1e-3, "the yaw that tilting brings along is left out"
            else:
                assert error[:, 2].max() > 0.01

    def test_at_lift_off_the_foot_leaves_from_where_it_is(self, robot: Robot, trot: Motion) -> None:
        """The offset from the reference fades within the blend time instead of jumping."""
        samples = np.flatnonzero(trot.contact[:, 0] & ~np.roll(trot.contact[:, 0], -1))[:1]
        config = ControllerConfig(
            swing=dataclasses.replace(PLAIN_SWING, velocity_feedback=(0.0, 0.0), liftoff_blend_time=0.05)
        )
        rig = Rig(robot, [trot], samples, config)
        observation = on_reference(trot, samples)
        observation["joint_pos"][0, :3] += 0.1
        rig.step(observation)
        offsets = []
        for _ in range(30):
            rig.clocks["sample"] += 1
            at = rig.clocks["sample"] % trot.n_samples
            commands = rig.step(observation)
            offsets.append(foot_positions(robot, commands["joint_pos"])[0, 0] - trot.foot_pos_b[at[0], 0])
        start = foot_positions(robot, observation["joint_pos"])[0, 0] - trot.foot_pos_b[(samples[0] + 1), 0]
        length = np.linalg.norm(offsets, axis=1)
        np.testing.assert_allclose(offsets[0], start, atol=1e-9)
        assert np.all(np.diff(length[:25]) < 1e-12)
        np.testing.assert_allclose(length[26:], 0.0, atol=1e-9)


class TestPaperConfiguration:
    def test_it_is_eq_1_to_3_as_printed(self) -> None:
        config = CONFIGS["paper"]
        assert config.stance.feedback == "constant"
        assert config.stance.reference_acceleration == config.stance.disturbance_time == 0
        assert not config.stance.leg_momentum
        assert config.stance.adaptation == "paper"
        assert not config.stance.leg_dynamics
        assert not config.swing.leg_dynamics
        assert config.swing.foothold == "reference"
        assert config.swing.level == 0
        assert config.swing.liftoff_blend_time == 0

    def test_it_commands_something_else_than_the_default(self, robot: Robot, trot: Motion) -> None:
        samples = np.array([20, 160])
        observation = disturbed(on_reference(trot, samples), np.random.default_rng(4), 0.3)
        commands = [Rig(robot, [trot], samples, c).step(observation) for c in (ControllerConfig(), CONFIGS["paper"])]
        for name in ("joint_pos", "torque"):
            assert np.abs(commands[0][name] - commands[1][name]).max() > 1e-3

    def test_leg_dynamics_are_an_addition_to_the_same_torques(self, robot: Robot, trot: Motion) -> None:
        """On the reference, the difference is the inverse dynamics of the legs on their moving trunk."""
        from fastmimic.robot.dynamics import leg_torques

        samples = np.array([20, 60, 160])
        observation = on_reference(trot, samples)
        without = stance_law()
        without = dataclasses.replace(without, swing=PLAIN_SWING)
        with_dynamics = dataclasses.replace(
            without,
            stance=dataclasses.replace(without.stance, leg_dynamics=True),
            swing=dataclasses.replace(PLAIN_SWING, leg_dynamics=True),
        )
        rigs = [Rig(robot, [trot], samples, c) for c in (with_dynamics, without)]
        a, b = (rig.step(observation) for rig in rigs)
        table = rigs[0].controller.tables[0][samples]
        turning_b = quat_rotate_inverse(observation["root_quat"], observation["ang_vel"])
        up_b = quat_rotate_inverse(observation["root_quat"], np.tile([0, 0, GRAVITY], (3, 1)))
        expected = leg_torques(
            robot, observation["joint_pos"], observation["joint_vel"], table["joint_acc"], turning_b, up_b
        )
        free = np.abs(a["torque"]) < robot.torque_limit  # where nothing was clipped
        assert free.mean() > 0.9
        np.testing.assert_allclose((a["torque"] - b["torque"])[free], expected[free], atol=1e-6)
