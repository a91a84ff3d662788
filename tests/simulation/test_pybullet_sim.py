"""PyBullet behind the same interface: the same kinematics and signs, sound mechanics, and the same bits again."""

import sys

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")

from control.motions import gait
from fastmimic.base.conventions import GRAVITY, GROUND_FRICTION
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import (
    matrix_from_quat,
    quat_conjugate,
    quat_multiply,
    quat_rotate_inverse,
    rotvec_from_quat,
)
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import nominal_start
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.conditions import Conditions, TerrainLevel, parse_disturbance
from fastmimic.simulation.mujoco_sim import MujocoSimulation
from fastmimic.simulation.pybullet_sim import PybulletSimulation
from fastmimic.simulation.simulators import make_simulation
from fastmimic.simulation.terrain import GroundPlane
from robot.mjcf import a1_tree, find, random_joints, random_quat, write

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
MASS = 12.458
"""kg, of Unitree's URDF."""


def hold(n: int, joints: np.ndarray, stiffness: float = 200.0, damping: float = 5.0) -> np.ndarray:
    """Commands that keep the joints where they are."""
    commands = np.zeros(n, COMMAND)
    commands["joint_pos"], commands["stiffness"], commands["damping"] = joints, stiffness, damping
    return commands


def standing(
    robot: Robot, seconds: float = 0.6, *disturbances: str, slope: float = 0.0
) -> tuple[PybulletSimulation, np.ndarray]:
    """A robot that holds its home pose on the ground, and its observation at the end; up a slope in degrees."""
    ground = Conditions(terrain=TerrainLevel("slope", (slope,))).ground
    assert ground is not None
    simulation = PybulletSimulation(robot, 1, disturbances=[parse_disturbance(d) for d in disturbances], ground=ground)
    home = robot.home_joint_pos
    height = robot.foot_radius - foot_positions(robot, home)[:, 2].min()
    plane = ground.plane(np.zeros(()), np.zeros(()))
    position, quat = plane.laid(np.array([0, 0, height]), LEVEL)
    simulation.reset(position, quat, home, np.zeros(3), np.zeros(3), np.zeros(12))
    for _ in range(round(500 * seconds)):
        simulation.step(hold(1, home))
    return simulation, simulation.observation[0]


class TestFrames:
    def test_the_state_comes_back_as_it_was_given(self, robot: Robot) -> None:
        """Bullet's base frame is the trunk's inertial frame, 13 mm ahead of ours and turned."""
        rng = np.random.default_rng(0)
        n = 6
        simulation = PybulletSimulation(robot, n)
        position, quat = rng.normal(size=(n, 3)) + np.array([0, 0, 5]), np.array([random_quat(rng) for _ in range(n)])
        joints = np.array([random_joints(robot, rng) for _ in range(n)])
        velocity, turning_b, speeds = (rng.normal(size=(n, k)) for k in (3, 3, 12))
        simulation.reset(position, quat, joints, velocity, turning_b, speeds)
        o = simulation.observation
        np.testing.assert_allclose(o["root_pos"], position, atol=1e-9)
        np.testing.assert_allclose(np.abs(np.sum(o["root_quat"] * quat, axis=1)), 1.0, atol=1e-9)
        np.testing.assert_allclose(o["lin_vel"], velocity, atol=1e-9)
        for i in range(n):
            np.testing.assert_allclose(o["ang_vel"][i], matrix_from_quat(quat[i]) @ turning_b[i], atol=1e-9)
        np.testing.assert_allclose(o["joint_pos"], joints, atol=1e-9)
        np.testing.assert_allclose(o["joint_vel"], speeds, atol=1e-9)

    def test_feet_are_where_our_kinematics_has_them(self, robot: Robot) -> None:
        """The zero of every joint, its axis and its sign are the same."""
        rng = np.random.default_rng(1)
        simulation = PybulletSimulation(robot, 1)
        for _ in range(20):
            joints = random_joints(robot, rng)
            np.testing.assert_allclose(simulation._bodies[0].feet(joints), foot_positions(robot, joints), atol=1e-6)

    def test_velocities_are_the_derivatives_of_the_pose(self, robot: Robot) -> None:
        """A robot that tumbles freely: pose before and after a control step."""
        rng = np.random.default_rng(2)
        simulation = PybulletSimulation(robot, 1)
        simulation.reset(
            np.array([0, 0, 5.0]), random_quat(rng), robot.home_joint_pos, rng.normal(size=3), 3 * rng.normal(size=3),
            np.zeros(12),
        )  # fmt: skip
        before = simulation.observation[0].copy()
        after = simulation.step(hold(1, robot.home_joint_pos))[0]
        moved = (after["root_pos"] - before["root_pos"]) / 0.002
        np.testing.assert_allclose(moved, (after["lin_vel"] + before["lin_vel"]) / 2, atol=0.05)
        turned = rotvec_from_quat(quat_multiply(after["root_quat"], quat_conjugate(before["root_quat"]))) / 0.002
        np.testing.assert_allclose(turned, (after["ang_vel"] + before["ang_vel"]) / 2, atol=0.1)


class TestMechanics:
    def test_free_fall(self, robot: Robot) -> None:
        """Without the drag of the air that Bullet has by default."""
        simulation = PybulletSimulation(robot, 1)
        simulation.reset(
            np.array([0, 0, 10.0]), LEVEL, robot.home_joint_pos, np.array([2.0, 0, 0]), np.zeros(3), np.zeros(12)
        )
        for _ in range(250):
            o = simulation.step(hold(1, robot.home_joint_pos))
        assert o["lin_vel"][0, 2] == pytest.approx(-GRAVITY * 0.5, rel=0.01)
        assert o["lin_vel"][0, 0] == pytest.approx(2.0, abs=0.02)
        np.testing.assert_array_equal(o["foot_force"], 0)

    def test_the_feet_of_a_standing_robot_carry_its_weight(self, robot: Robot) -> None:
        _, o = standing(robot)
        assert np.all(o["foot_force"][:, 2] > 10)
        np.testing.assert_allclose(o["foot_force"].sum(axis=0), [0, 0, MASS * GRAVITY], atol=0.02 * MASS * GRAVITY)
        assert o["other_contact"] == 0
        lowest = o["root_pos"][2] + foot_positions(robot, o["joint_pos"])[:, 2].min()
        assert lowest == pytest.approx(robot.foot_radius, abs=3e-3), "its feet are as thick as ours"

    def test_ground_forces_change_the_momentum(self, robot: Robot) -> None:
        """Sideways speed is lost to friction, and the sum of the forces says how fast."""
        simulation, _ = standing(robot)
        bullet, body = simulation._clients[0], simulation._bodies[0].id
        links = range(bullet.getNumJoints(body))
        masses = [bullet.getDynamicsInfo(body, j)[0] for j in (-1, *links)]

        def momentum() -> np.ndarray:
            body = simulation._bodies[0].id  # another one after a reset
            velocities = [bullet.getBaseVelocity(body)[0]]
            velocities += [
                bullet.getLinkState(body, j, computeLinkVelocity=1, computeForwardKinematics=1)[6] for j in links
            ]
            return sum(m * np.array(v) for m, v in zip(masses, velocities, strict=True))

        o = simulation.observation[0].copy()
        simulation.substeps = 1  # the forces of every physics step are seen
        yaw = np.array([np.cos(0.5), 0, 0, np.sin(0.5)])
        simulation.reset(
            o["root_pos"] + [0, 0, 1e-3], yaw, o["joint_pos"], np.array([0.3, 0.2, 0]), np.zeros(3), np.zeros(12)
        )
        before, impulse = momentum(), np.zeros(3)
        for _ in range(60):
            o = simulation.step(hold(1, robot.home_joint_pos))[0]
            impulse += 1e-3 * (o["foot_force"].sum(axis=0) - np.array([0, 0, MASS * GRAVITY]))
        change = momentum() - before
        assert np.linalg.norm(change[:2]) > 1.0, "most of the speed is gone"
        np.testing.assert_allclose(impulse, change, atol=0.06)

    def test_forces_belong_to_the_foot_that_they_act_on(self, robot: Robot) -> None:
        home = robot.home_joint_pos
        height = robot.foot_radius - foot_positions(robot, home)[:, 2].min()
        joints = np.tile(home, (4, 1))
        for leg in range(4):
            joints[leg, 3 * leg + 1 : 3 * leg + 3] += (0.3, -0.6)
        simulation = PybulletSimulation(robot, 4)
        simulation.reset(np.array([0, 0, height]), LEVEL, joints, np.zeros(3), np.zeros(3), np.zeros(12))
        for _ in range(10):
            o = simulation.step(hold(4, joints))
        np.testing.assert_array_equal(o["foot_force"][:, :, 2] > 1.0, ~np.eye(4, dtype=bool))

    def test_a_trunk_on_the_ground_is_noticed(self, robot: Robot) -> None:
        folded = np.tile([0.0, 1.2, -2.6], 4)
        simulation = PybulletSimulation(robot, 1)
        on_back = np.array([0.0, 1.0, 0.0, 0.0])
        simulation.reset(np.array([0, 0, 0.06]), on_back, folded, np.zeros(3), np.zeros(3), np.zeros(12))
        for _ in range(30):
            o = simulation.step(hold(1, folded))
        assert o["other_contact"][0] >= 1

    def test_the_torque_is_clipped_to_the_smaller_limit(self, robot: Robot) -> None:
        """The abduction motors of the URDF are weaker than the data sheet says, the others stronger."""
        np.testing.assert_array_equal(PybulletSimulation(robot, 1)._limit, np.tile([20.0, 33.5, 33.5], 4))

    def test_motors_act_as_in_mujoco(self, robot: Robot) -> None:
        """The same command for some steps in the air moves every joint the same way, if not as far: Bullet's robot has
        no rotor inertia."""
        rng = np.random.default_rng(3)
        commands = hold(1, robot.home_joint_pos + 0.3 * rng.choice([-1, 1], 12), 60.0, 2.0)
        moved = []
        for simulation in (PybulletSimulation(robot, 1), MujocoSimulation(robot, 1)):
            at = (np.array([0, 0, 2.0]), LEVEL, robot.home_joint_pos, np.zeros(3), np.zeros(3), np.zeros(12))
            simulation.reset(*at)
            for _ in range(15):
                o = simulation.step(commands)
            moved.append(o["joint_pos"][0] - robot.home_joint_pos)
        assert np.all(moved[0] * moved[1] > 0)
        ratio = np.abs(moved[0]) / np.abs(moved[1])
        assert np.all((ratio > 0.7) & (ratio < 2.0)), ratio


class TestDisturbances:
    def test_a_payload_is_carried_by_the_feet(self, robot: Robot) -> None:
        _, o = standing(robot, 0.6, "payload=3")
        assert o["foot_force"][:, 2].sum() == pytest.approx((MASS + 3) * GRAVITY, rel=0.02)

    def test_a_centre_of_mass_ahead_loads_the_front_feet(self, robot: Robot) -> None:
        plain, ahead = standing(robot)[1], standing(robot, 0.6, "com-x=0.05")[1]
        front = [o["foot_force"][:2, 2].sum() / o["foot_force"][:, 2].sum() for o in (plain, ahead)]
        # 4.713 of 12.458 kg move by 0.05 m between feet that are 0.37 m apart
        assert front[1] - front[0] == pytest.approx(4.713 / MASS * 0.05 / 0.366, rel=0.15)

    @pytest.mark.parametrize("friction", [0.1, 0.4])
    def test_sliding_feet_meet_the_friction_that_was_given(self, robot: Robot, friction: float) -> None:
        """On a slope too steep to stand on; without disturbances it is that of MuJoCo's floor."""
        _, o = standing(robot, 0.3, f"friction={friction}", slope=28.0)
        steep = GroundPlane.of(np.zeros(()), np.array([np.tan(np.radians(28)), 0.0]))
        force = quat_rotate_inverse(steep.quat, o["foot_force"].sum(axis=0))
        assert np.linalg.norm(force[:2]) / force[2] == pytest.approx(friction, rel=0.02)
        simulation = standing(robot, 0.01)[0]
        about, body = simulation._clients[0].getDynamicsInfo, simulation._bodies[0]
        for toe in body.toes:
            assert about(body.ground, -1)[1] * about(body.id, toe)[1] == GROUND_FRICTION

    def test_slippery_ground(self, robot: Robot) -> None:
        """On a slope of 10° a standing robot stays if the friction is above its tangent, 0.18."""
        creep = [abs(standing(robot, 0.6, f"friction={mu}", slope=10.0)[1]["root_pos"][0]) for mu in (0.3, 0.1)]
        assert creep[0] < 0.03 < creep[1]

    def test_uneven_ground_is_mujocos(self, robot: Robot) -> None:
        """Rays from above hit the same heights at the corners of the cells."""
        ground = Conditions(terrain=TerrainLevel("rough", (0.05,)), seed=3).ground
        assert ground is not None
        simulation = PybulletSimulation(robot, 1, ground=ground)
        at_rest = (LEVEL, robot.home_joint_pos, np.zeros(3), np.zeros(3), np.zeros(12))
        simulation.reset(np.array([0, 0, 0.5]), *at_rest)
        corners = 0.15 * np.array([[30.0, 10.0], [60.0, -50.0], [-110.0, 100.0]])
        for (x, y), height in zip(corners, ground.height(*corners.T), strict=True):
            hit = simulation._clients[0].rayTest([x, y, 1], [x, y, -1])[0]
            assert hit[3][2] == pytest.approx(height, abs=2e-3)

    def test_stairs_are_refused(self) -> None:
        with pytest.raises(ConfigError, match="'stairs-up' is not realised in pybullet; those that are: slope, side-s"):
            Conditions("pybullet", terrain=TerrainLevel("stairs-up", (0.05,)))

    def test_a_push_is_an_impulse_along_the_heading(self, robot: Robot) -> None:
        simulation = PybulletSimulation(robot, 1, disturbances=[parse_disturbance("push=6@0.02")])
        yaw = np.array([np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)])
        simulation.reset(np.array([0, 0, 5.0]), yaw, robot.home_joint_pos, np.zeros(3), np.zeros(3), np.zeros(12))
        for _ in range(80):
            o = simulation.step(hold(1, robot.home_joint_pos))
        assert o["lin_vel"][0, 1] == pytest.approx(6 / MASS, rel=0.15)

    def test_delay_and_weakness_reach_the_motors(self, robot: Robot) -> None:
        """Falling with joint commands ahead: later, weaker and braked motors have moved less."""
        moved = []
        for text in ((), ("delay=0.01",), ("motor-strength=0.5",), ("joint-friction=5",), ("top-speed=0.3",)):
            simulation = PybulletSimulation(robot, 1, disturbances=[parse_disturbance(t) for t in text])
            home = robot.home_joint_pos
            simulation.reset(np.array([0, 0, 5.0]), LEVEL, home, np.zeros(3), np.zeros(3), np.zeros(12))
            simulation.step(hold(1, home, 60.0, 0.2))
            for _ in range(8):
                o = simulation.step(hold(1, home + 0.3, 60.0, 0.2))
            moved.append(o["joint_pos"][0, 2] - home[2])
        assert all(0 < m < 0.8 * moved[0] for m in moved[1:]), moved


class TestDeterminism:
    def test_the_same_start_leads_to_the_same_bits(self, robot: Robot) -> None:
        """Again in the same simulation, in another one, and next to other robots."""
        rng = np.random.default_rng(4)
        home = robot.home_joint_pos
        commands = [hold(1, home + 0.2 * rng.normal(size=12)) for _ in range(60)]
        height = robot.foot_radius - foot_positions(robot, home)[:, 2].min()

        def course(simulation: PybulletSimulation, n: int) -> bytes:
            simulation.reset(np.array([0, 0, height]), LEVEL, home, np.zeros(3), np.zeros(3), np.zeros(12))
            states = [simulation.step(np.repeat(c, n))[-1].tobytes() for c in commands]
            assert simulation.observation["foot_force"].any()
            return b"".join(states)

        first = PybulletSimulation(robot, 1)
        once = course(first, 1)
        assert course(first, 1) == once
        assert course(PybulletSimulation(robot, 1), 1) == once
        assert course(PybulletSimulation(robot, 3), 3) == once


class TestEpisodes:
    def test_a_motion_is_imitated_here_too(self, robot: Robot) -> None:
        motion = gait(robot, (0.3, 0.0), 0.0, n_samples=200)
        here, there = (
            run_episodes(
                robot, motion, start=nominal_start(1), duration_s=1.0, conditions=Conditions(simulator=simulator)
            )
            for simulator in ("pybullet", "mujoco")
        )
        assert not here.fell[0]
        assert here.reward[0] > 0.75
        assert here.reward[0] == pytest.approx(there.reward[0], abs=0.1)
        assert here.reward[0] != there.reward[0]


class TestRefusals:
    def test_another_robot(self) -> None:
        with pytest.raises(ConfigError, match=r"description of a1, none of 'go1'; run it in mujoco"):
            PybulletSimulation(load_robot("go1"), 1)

    def test_a_robot_of_the_same_name_with_other_legs(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        tree = a1_tree()
        find(tree, "body", "FL_calf").set("pos", "0 0 -0.25")
        other = load_robot(write(tree, tmp_path_factory.mktemp("robots") / "a1.xml"))
        with pytest.raises(ConfigError, match=r"other legs than the given model: its feet are \d+ mm apart"):
            PybulletSimulation(other, 1)

    def test_a_disturbance_that_it_does_not_realise(self, robot: Robot) -> None:
        conditions = Conditions(simulator="pybullet", disturbances=(parse_disturbance("softness=0.05"),))
        with pytest.raises(ConfigError, match=r"'softness' is not realised in pybullet; those that are: friction"):
            make_simulation(robot, 1, conditions, control_rate_hz=500.0)

    def test_pybullet_missing(self, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "pybullet", None)
        with pytest.raises(ConfigError, match=r"pip install 'fastmimic\[pybullet\]'"):
            PybulletSimulation(robot, 1)

    def test_rates_that_do_not_fit(self, robot: Robot) -> None:
        with pytest.raises(ConfigError, match=r"1000 Hz\) must be a multiple of .* \(300 Hz\)"):
            PybulletSimulation(robot, 1, control_rate_hz=300.0)
