"""Disturbances: how they are written, what is refused, and that each does to MuJoCo's robot what it says."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.conditions import (
    Conditions,
    Disturbance,
    driving_limit,
    make_world,
    parse_disturbance,
)
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, DisturbanceKind, loaded
from fastmimic.simulation.mujoco_sim import MujocoSimulation
from fastmimic.simulation.simulators import SIMULATORS, Simulator, make_simulation

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def hold(n: int, joints: np.ndarray, stiffness: float = 200.0, damping: float = 5.0) -> np.ndarray:
    """Commands that keep the joints where they are."""
    commands = np.zeros(n, COMMAND)
    commands["joint_pos"], commands["stiffness"], commands["damping"] = joints, stiffness, damping
    return commands


def place(simulation: MujocoSimulation, robot: Robot, height: float | None = None, quat: np.ndarray = LEVEL) -> None:
    """At rest in the home pose, on the ground unless a height is given."""
    home = robot.home_joint_pos
    height = robot.foot_radius - foot_positions(robot, home)[:, 2].min() if height is None else height
    simulation.reset(np.array([0, 0, height]), quat, home, np.zeros(3), np.zeros(3), np.zeros(12))


def disturbed(robot: Robot, *given: Disturbance) -> MujocoSimulation:
    return MujocoSimulation(robot, max(len(d.values) for d in given), given)


def at_rest(robot: Robot, *given: Disturbance, seconds: float = 0.6) -> np.ndarray:
    simulation = disturbed(robot, *given)
    place(simulation, robot)
    for _ in range(round(500 * seconds)):
        simulation.step(hold(simulation.batch.nsim, robot.home_joint_pos))
    return simulation.observe()


class TestWriting:
    def test_name_and_value(self) -> None:
        assert parse_disturbance("payload=2") == Disturbance("payload", (2.0,))
        assert parse_disturbance(" com-x = -0.05 ").values == (-0.05,)
        assert parse_disturbance("push=10").at_s == 2.0
        assert parse_disturbance("side-push=-7.5@3").at_s == 3.0
        assert str(parse_disturbance("side-push=-7.5@3")) == "side-push -7.5 N·s at 3 s"

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("paylod=2", r"unknown disturbance 'paylod'; there are friction, .*did you mean 'payload'"),
            ("payload", r"written name=value, such as payload=2 .* found 'payload'"),
            ("payload=heavy", r"'payload=heavy' is not a number of kg"),
            ("payload=21", r"'payload' takes 0 kg to 20 kg, found 21"),
            ("friction=nan", r"'friction' takes 0.05 to 2, found nan"),
            ("com-x=-1", r"'com-x' takes -0.15 m to 0.15 m"),
            ("payload=2@1", r"'payload' is there all the time; only pushes take @time"),
            ("push=2@-1", r"the time must not be negative, found -1 s"),
        ],
    )
    def test_what_is_refused(self, text: str, said: str) -> None:
        with pytest.raises(ConfigError, match=said):
            parse_disturbance(text)

    def test_what_does_not_fit_together(self) -> None:
        twice = [Disturbance("payload", (1.0,)), Disturbance("payload", (2.0,))]
        with pytest.raises(ConfigError, match="'payload' is given twice"):
            make_world(twice, 1, "mujoco")
        with pytest.raises(ConfigError, match="has 2 values for 3 robots; expected 1 or 3"):
            make_world([Disturbance("payload", (1.0, 2.0))], 3, "mujoco")

    @pytest.mark.parametrize("kind", DISTURBANCES.values(), ids=list(DISTURBANCES))
    def test_every_range_holds_what_is_tried(self, kind: object) -> None:
        kind = DISTURBANCES[kind.name]  # type: ignore[attr-defined]
        assert kind.nominal in kind.levels
        assert list(kind.levels) == sorted(set(kind.levels))
        assert kind.lower <= kind.levels[0]
        assert kind.levels[-1] <= kind.upper

    def test_the_documentation_lists_them_all(self) -> None:
        page = (Path(__file__).parents[2] / "docs" / "robustness.md").read_text(encoding="utf-8")
        listed = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `") and line.count("|") == 7]
        assert [name for name in listed if name in DISTURBANCES] == list(DISTURBANCES)


class TestNothingElseChanges:
    def test_nominal_values_are_the_undisturbed_robot(self, robot: Robot) -> None:
        """Every disturbance at its nominal value, through all the code that realises them: the same course, up to
        what adding a payload of nothing rounds."""
        kinds = [k for k in DISTURBANCES.values() if k.name not in ("restitution", "softness")]
        given = [Disturbance(kind.name, (kind.nominal,)) for kind in kinds]
        simulations = [MujocoSimulation(robot, 1), MujocoSimulation(robot, 1, given)]
        rng = np.random.default_rng(0)
        for simulation in simulations:
            place(simulation, robot)
        for _ in range(60):
            commands = hold(1, robot.home_joint_pos + 0.1 * rng.normal(size=12), 60.0, 2.0)
            a, b = (simulation.step(commands) for simulation in simulations)
        np.testing.assert_allclose(b["root_pos"], a["root_pos"], atol=1e-7)
        np.testing.assert_allclose(b["joint_vel"], a["joint_vel"], atol=1e-4)

    def test_a_robot_among_others_is_as_alone(self, robot: Robot) -> None:
        """A whole range in one batch gives each robot what it would meet alone."""
        values = (0.0, 2.0, 5.0)
        together = at_rest(robot, Disturbance("payload", values), seconds=0.2)
        for i, value in enumerate(values):
            alone = at_rest(robot, Disturbance("payload", (value,)), seconds=0.2)
            assert together[i].tobytes() == alone[0].tobytes()


class TestGround:
    def test_friction_limits_the_force(self, robot: Robot) -> None:
        values = (0.2, 0.5, 0.7)
        simulation = disturbed(robot, Disturbance("friction", values))
        place(simulation, robot)
        for _ in range(60):
            simulation.batch.bind("xfrc_applied")[:, 1, 0] = 1.5 * robot.mass * GRAVITY
            o = simulation.step(hold(3, robot.home_joint_pos))
        force = o["foot_force"].sum(axis=1)
        np.testing.assert_allclose(-force[:, 0] / force[:, 2], values, rtol=0.1)

    @pytest.mark.parametrize("share", [0.3, 0.6])
    def test_restitution_is_the_share_of_speed_that_comes_back(self, robot: Robot, share: float) -> None:
        simulation = disturbed(robot, Disturbance("restitution", (share,)))
        place(simulation, robot)
        stiffness, damping = simulation.batch.expanded("geom_solref")[0, 0]
        ball = mujoco.MjModel.from_xml_string(f"""
            <mujoco><option timestep="0.001"/>
            <default><geom solref="{stiffness} {damping}"/></default>
            <worldbody><geom type="plane" size="0 0 1"/>
            <body pos="0 0 0.025"><freejoint/><geom type="sphere" size="0.02" mass="1"/></body></worldbody></mujoco>""")
        data = mujoco.MjData(ball)
        data.qvel[2] = -1.0
        for _ in range(200):
            mujoco.mj_step(ball, data)
            if data.qpos[2] > 0.02 and data.qvel[2] > 0:
                break
        assert data.qvel[2] == pytest.approx(share, abs=0.12)

    def test_feet_sink_deeper_into_soft_ground(self, robot: Robot) -> None:
        o = at_rest(robot, Disturbance("softness", (0.02, 0.06)))
        lowest = [h["root_pos"][2] + foot_positions(robot, h["joint_pos"])[:, 2].min() - robot.foot_radius for h in o]
        assert lowest[1] < lowest[0] - 0.005


class TestTrunk:
    def test_a_payload_is_carried(self, robot: Robot) -> None:
        o = at_rest(robot, Disturbance("payload", (0.0, 4.0)))
        weights = o["foot_force"][:, :, 2].sum(axis=1)
        np.testing.assert_allclose(weights, np.array([robot.mass, robot.mass + 4.0]) * GRAVITY, rtol=0.01)

    def test_mass_centre_and_inertia_of_trunk_and_payload(self) -> None:
        mass, com, inertia = loaded(2.0, np.array([0.1, 0.0, 0.0]), np.diag([0.1, 0.2, 0.3]), 2.0)
        assert mass == 4.0
        np.testing.assert_allclose(com, [0.05, 0.0, 0.05])
        # both are 0.0707 m from the common centre
        expected = np.diag([0.1, 0.2, 0.3]) + 2 * 0.1**2 / 6 * np.eye(3)
        expected += 4 * np.array([[0.0025, 0, 0.0025], [0, 0.005, 0], [0.0025, 0, 0.0025]])
        np.testing.assert_allclose(inertia, expected)

    def test_a_shifted_centre_of_mass_loads_its_side(self, robot: Robot) -> None:
        o = at_rest(robot, Disturbance("com-x", (0.05, 0.0)), Disturbance("com-y", (0.0, 0.03)))
        z = o["foot_force"][:, :, 2]
        front, left = z[:, :2].sum(axis=1) / z.sum(axis=1), z[:, [1, 3]].sum(axis=1) / z.sum(axis=1)
        assert front[0] - front[1] == pytest.approx(robot.trunk_mass / robot.mass * 0.05 / 0.366, rel=0.15)
        assert left[1] - left[0] == pytest.approx(robot.trunk_mass / robot.mass * 0.03 / 0.264, rel=0.15)

    @pytest.mark.parametrize(("name", "axis"), [("push", 0), ("side-push", 1)])
    def test_a_push_is_an_impulse_in_the_heading_frame(self, robot: Robot, name: str, axis: int) -> None:
        simulation = disturbed(robot, Disturbance(name, (5.0, -3.0), 0.02))
        yaw = 1.0
        place(simulation, robot, 5.0, np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]))
        speeds = []
        for _ in range(90):
            o = simulation.step(hold(2, robot.home_joint_pos))
            speeds.append(o["lin_vel"].copy())
        direction = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])[axis]
        gained = speeds[-1][:, :2] @ direction
        # of the whole robot; the base itself also swings about the centre of mass a little
        np.testing.assert_allclose(gained, np.array([5.0, -3.0]) / robot.mass, rtol=0.1)
        np.testing.assert_allclose(speeds[8][:, :2] @ direction, 0.0, atol=1e-12)
        np.testing.assert_allclose(speeds[60][:, :2] @ direction, gained, rtol=0.05)


class TestMotors:
    def courses(self, robot: Robot, *given: Disturbance, steps: int = 6) -> np.ndarray:
        """Knees of robots in the air that are told to move by 0.3 rad in the second step, (n, steps) rad."""
        simulation = disturbed(robot, *given)
        n = simulation.batch.nsim
        place(simulation, robot, 5.0)
        moved = []
        for step in range(steps):
            target = robot.home_joint_pos + (0.3 if step >= 1 else 0.0)
            o = simulation.step(hold(n, target, 60.0, 0.2))
            moved.append(o["joint_pos"][:, 2] - robot.home_joint_pos[2])
        return np.array(moved).T

    def test_strength_scales_torque_and_limit(self, robot: Robot) -> None:
        """So the acceleration at the start is in proportion."""
        moved = self.courses(robot, Disturbance("motor-strength", (1.0, 0.5)), steps=3)
        assert moved[1, -1] / moved[0, -1] == pytest.approx(0.5, abs=0.03)

    def test_a_delay_shifts_the_course(self, robot: Robot) -> None:
        late = 0.004  # two control steps
        moved = self.courses(robot, Disturbance("delay", (0.0, late)), steps=10)
        np.testing.assert_allclose(moved[1, 3:], moved[0, 1:-2], atol=2e-4)
        assert np.abs(moved[1, 1:3]).max() < 1e-4 < moved[0, 2]

    def test_a_delay_need_not_be_whole_control_steps(self, robot: Robot) -> None:
        moved = self.courses(robot, Disturbance("delay", (0.002, 0.003, 0.004)), steps=8)
        assert np.all(np.diff(moved[:, -1]) < -1e-3)

    def test_fast_motors_have_less_torque(self, robot: Robot) -> None:
        limit = driving_limit(np.full(6, 30.0), np.full(6, 20.0), np.array([0.0, 10, 15, -15, 20, 25]))
        np.testing.assert_allclose(limit, [30, 30, 15, 15, 0, 0])
        np.testing.assert_array_equal(driving_limit(np.full(6, 30.0), np.full(6, np.inf), np.full(6, 9.0)), 30.0)
        simulation = disturbed(robot, Disturbance("top-speed", (math.inf, 0.4)))
        place(simulation, robot, 5.0)
        commands = np.zeros(2, COMMAND)
        commands["torque"][:, 2] = 20.0
        fastest = np.zeros(2)
        for _ in range(12):
            fastest = np.maximum(fastest, simulation.step(commands)["joint_vel"][:, 2])
        assert fastest[0] > 12 > 8.5 > fastest[1]

    def test_dry_and_viscous_friction_brake(self, robot: Robot) -> None:
        for name, value in (("joint-friction", 4.0), ("joint-damping", 1.0)):
            moved = self.courses(robot, Disturbance(name, (0.0, value)), steps=8)
            assert 0 < moved[1, -1] < 0.9 * moved[0, -1], name
        simulation = disturbed(robot, Disturbance("joint-friction", (5.0,)))
        place(simulation, robot, 5.0)
        commands = np.zeros(1, COMMAND)
        commands["torque"] = 4.0
        for _ in range(20):
            o = simulation.step(commands)
        assert np.abs(o["joint_pos"] - robot.home_joint_pos).max() < 0.02, "it sticks below the friction"


class TestRegistered:
    """A user's own disturbance: a function of the simulation at each control step, or a change of its model."""

    @pytest.fixture
    def wind(self) -> Iterator[DisturbanceKind]:
        def blow(simulation: Any, force: np.ndarray, time_s: float) -> None:
            simulation.trunk_force[:, 1] += force * (time_s >= 0.1)

        yield DISTURBANCES.register(
            DisturbanceKind("wind", unit="N", lower=-50.0, upper=50.0, about="from the side", each_step=blow)
        )
        DISTURBANCES.pop("wind")

    @pytest.mark.usefixtures("wind")
    @pytest.mark.parametrize("simulator", ["mujoco", "pybullet"])
    def test_acts_in_every_simulator(self, robot: Robot, simulator: str) -> None:
        if simulator == "pybullet":
            pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")
        conditions = Conditions(simulator, disturbances=("wind=30",))  # type: ignore[arg-type]
        simulation = make_simulation(robot, 1, conditions, control_rate_hz=500.0)
        place(simulation, robot, 1.0)  # type: ignore[arg-type]
        sideways = []
        for _ in range(75):
            seen = simulation.step(hold(1, robot.home_joint_pos))
            sideways.append(float(seen["lin_vel"][0, 1]))
        assert abs(sideways[48]) < 1e-3
        # 0.05 s of 30 N on all of the robot, the legs held
        assert sideways[-1] == pytest.approx(30.0 * 0.05 / robot.mass, rel=0.2)

    @pytest.mark.usefixtures("wind")
    def test_is_read_and_refused_like_the_others(self) -> None:
        assert parse_disturbance("wind=8").values == (8.0,)
        assert DISTURBANCES["wind"].levels == (-50.0, -25.0, 0.0, 25.0, 50.0)
        with pytest.raises(ConfigError, match="'wind' takes -50 N to 50 N, found 60"):
            parse_disturbance("wind=60")

    def test_changes_the_model(self, robot: Robot) -> None:
        def weaker(simulation: Any, values: np.ndarray) -> None:
            simulation.batch.expand("opt.gravity")[:, 2] *= values
            simulation.constants_changed = True

        DISTURBANCES.register(DisturbanceKind("gravity", lower=0.1, upper=1.0, nominal=1.0, apply={"mujoco": weaker}))
        try:
            forces = at_rest(robot, Disturbance("gravity", (1.0, 0.5)))["foot_force"][:, :, 2].sum(axis=1)
            assert forces[1] == pytest.approx(0.5 * forces[0], rel=0.02)
            with pytest.raises(ConfigError, match="'gravity' is not realised in pybullet"):
                make_world([Disturbance("gravity", (0.5,))], 1, "pybullet")
        finally:
            DISTURBANCES.pop("gravity")


def test_a_registered_simulator_runs_episodes(robot: Robot) -> None:
    made = []

    def make(robot: Robot, n: int, conditions: Conditions, rate_hz: float, threads: int) -> MujocoSimulation:
        made.append(n)
        return MujocoSimulation(robot, n, control_rate_hz=rate_hz)

    SIMULATORS.register(Simulator("mine", "as MuJoCo", make))
    try:
        assert make_simulation(robot, 2, Conditions("mine"), control_rate_hz=500.0).observation.shape == (2,)
        assert made == [2]
        with pytest.raises(ConfigError, match="not realised in mine"):
            make_world([Disturbance("payload", (1.0,))], 1, "mine")
    finally:
        SIMULATORS.pop("mine")
