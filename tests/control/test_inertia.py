"""The trunk's inertia over standing feet is that of MuJoCo's model with the feet held, and the stance goes by it."""

import dataclasses

import mujoco
import numpy as np
import pytest

from control.motions import standing
from control.rig import Rig, on_reference
from fastmimic.control.config import ControllerConfig, default_config
from fastmimic.control.inertia import WORK, add_standing_leg
from fastmimic.episode.loop import run_episodes
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import pack_model
from fastmimic.simulation.conditions import Conditions
from robot.mjcf import Simulated, random_joints

FEET = ((), (0,), (1, 2), (0, 1, 2), (0, 1, 2, 3))


class Witness(Simulated):
    """MuJoCo's mass matrix of a robot's own model, reduced to turns of the trunk about the centre of mass."""

    def inertia(self, joint_pos: np.ndarray, held: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """(3, 3) inertia with some feet held and the other legs rigid, and (3,) the centre of mass; body axes."""
        model, data = self.model, self.data
        self.pose(joint_pos, np.zeros(3), np.array([1.0, 0, 0, 0]))
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        com = np.array(data.subtree_com[self.trunk])
        motion = np.zeros((model.nv, 3))
        linear, angular = slice(self.base_dof, self.base_dof + 3), slice(self.base_dof + 3, self.base_dof + 6)
        motion[angular] = np.eye(3)
        motion[linear] = -np.cross(np.eye(3), com).T
        for leg in held:
            jacobian, foot = np.zeros((3, model.nv)), self.feet[leg]
            mujoco.mj_jac(model, data, jacobian, None, data.geom_xpos[foot], int(model.geom_bodyid[foot]))
            own = self.dofs[3 * leg : 3 * leg + 3]
            motion[own] = -np.linalg.solve(jacobian[:, own], jacobian @ motion)
        return motion.T @ mass @ motion, com


@pytest.mark.nojit
@pytest.mark.parametrize("name", ["a1", "go1", "go2"])
def test_inertia_is_that_of_the_mass_matrix_with_the_feet_held(name: str) -> None:
    robot = load_robot(name)
    witness, model, rng = Witness(robot), pack_model(robot)[0], np.random.default_rng(0)
    for held in FEET:
        joints = random_joints(robot, rng)
        inertia, com = witness.inertia(joints, ())
        feet, rigid = foot_positions(robot, joints), inertia.copy()
        for leg in held:
            q = joints[3 * leg : 3 * leg + 3].copy()
            add_standing_leg(model, leg, q, feet[leg], com, np.zeros(1, WORK)[0], inertia)
        expected, _ = witness.inertia(joints, held)
        np.testing.assert_allclose(inertia, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        assert not held or np.abs(inertia - rigid).max() > 0.005


def test_a_stretched_leg_counts_as_rigid(robot: Robot) -> None:
    model, inertia = pack_model(robot)[0], robot.inertia_b.copy()
    joints = np.array([0.1, 0.5, 0.0])
    g = robot.geometry[0]
    joints[2] = np.arctan2(g[8], g[9]) - np.arctan2(g[6], g[7])  # hip, knee and foot in a line
    foot = foot_positions(robot, np.tile(joints, 4))[0]
    add_standing_leg(model, 0, joints, foot, np.zeros(3), np.zeros(1, WORK)[0], inertia)
    np.testing.assert_array_equal(inertia, robot.inertia_b)


def stance(**changes: object) -> ControllerConfig:
    """Gains on turns alone, forces that cost nothing, and nothing that limits them."""
    config = dataclasses.replace(
        default_config().stance,
        feedback="constant",
        position_gain=(0.0,) * 6,
        velocity_gain=(0.0, 0.0, 0.0, 10.0, 11.0, 12.0),
        force_weight=1e-10,
        friction=2.0,
        min_force=0.0,
    )
    return ControllerConfig(stance=dataclasses.replace(config, **changes))


def test_feedback_has_the_moment_that_turns_the_trunk_over_its_feet(robot: Robot) -> None:
    """Moment of the forces about the centre of mass = I_held k_d ω; of the rigid body by default."""
    motion = standing(robot)
    joints = robot.home_joint_pos
    _, com = Witness(robot).inertia(joints, ())
    held, rate = robot.inertia_b.copy(), np.array([0.3, -0.2, 0.25])
    feet = foot_positions(robot, joints)
    for leg in range(4):
        q = joints[3 * leg : 3 * leg + 3].copy()
        add_standing_leg(pack_model(robot)[0], leg, q, feet[leg], com, np.zeros(1, WORK)[0], held)
    for on, inertia in ((True, held), (False, robot.inertia_b)):
        rig = Rig(robot, [motion], np.array([0]), stance(standing_inertia=on, leg_momentum=False))
        observation = on_reference(motion, np.array([0]))
        observation["ang_vel"] = rate
        rig.step(observation)
        arms = foot_positions(robot, observation["joint_pos"][0]) - com - np.array([0, 0, robot.foot_radius])
        moment = np.cross(arms, rig.controller.memory["force"][0]).sum(axis=0)
        np.testing.assert_allclose(moment, -inertia @ (np.array([10.0, 11.0, 12.0]) * rate), atol=2e-3)


def test_the_references_own_turning_keeps_its_moment(robot: Robot) -> None:
    """What inverse dynamics say of the reference holds already: only what deviates from it is rescaled."""
    motion = standing(robot)
    forces = []
    for on in (False, True):
        rig = Rig(robot, [motion], np.array([0]), stance(standing_inertia=on))
        rig.controller.tables["ang_acc"] = (3.0, -2.0, 1.0)
        rig.step(on_reference(motion, np.array([0])))
        forces.append(rig.controller.memory["force"][0].copy())
    assert np.ptp(forces[0][:, 2]) > 1.0
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-6)


def test_four_feet_do_not_shake_the_trunk_of_light_legs_with_late_sensors(robot: Robot) -> None:
    """PyBullet's legs have no rotors: for them the rigid body's inertia is 3.8 times too much in roll, and with 6 ms
    from gyro to motor the roll feedback then oscillates at some 45 Hz."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")
    shaking = []
    for on in (False, True):
        config = default_config()
        config = dataclasses.replace(config, stance=dataclasses.replace(config.stance, standing_inertia=on))
        rollout = run_episodes(
            robot,
            standing(robot),
            duration_s=1.0,
            config=config,
            conditions=Conditions("pybullet", "sensors", 0, ("delay=0.002", "side-push=1@0.2")),
            log=True,
        )
        assert rollout.log is not None
        assert not rollout.fell.any()
        shaking.append(float(rollout.log.observation["ang_vel"][0, 300:, 0].std()))
    assert shaking[0] > 0.3, "the default is meant to be seen oscillating here"
    assert shaking[1] < 0.03
