"""Planning ahead: the model, the QP and its solution, the schedule ahead, what happens between plans and without."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import nnls

from control.motions import feet_w, gait, standing
from control.rig import Rig, disturbed, on_reference
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import quat_from_rotvec, quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig, HorizonConfig, StanceConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import nominal_start
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

STEPS, STEP_S = 10, 0.03
SAMPLES = np.array([0, 30, 77, 140, 249])
WEIGHTLESS_LEGS = {"leg_momentum": False}  # what is asked for is what the body alone does


def lh(
    rate_hz: float = 50.0, stance: dict[str, bool] | dict[str, float] | None = None, **horizon: object
) -> ControllerConfig:
    """The default controller with forces planned ahead."""
    config = ControllerConfig()
    return dataclasses.replace(
        config,
        stance=dataclasses.replace(config.stance, forces="horizon", **(stance or {})),
        horizon=HorizonConfig(solve_rate_hz=rate_hz, **horizon),  # type: ignore[arg-type]
    )


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return gait(robot, (0.4, 0.1), 0.5)


def turned_vector(yaw: float, v: np.ndarray) -> np.ndarray:
    """A vector (3,) turned about z."""
    return np.array([*rotate_planar(yaw, v[:2]), v[2]])


class Problem:
    """The QP of the one robot of a rig in its last step, written down as a whole from what was foreseen."""

    def __init__(self, rig: Rig) -> None:
        config, self.ahead = rig.controller.config.horizon, rig.controller._work.foresight[0]
        self.steps, h = config.steps, config.step_s
        self.slot = np.array(self.ahead["slot"][: self.steps])
        self.k = int(self.slot.max()) + 1
        self.n = n = 3 * self.k
        weights = np.array([*config.position_weight, *config.velocity_weight])
        influence = np.zeros((self.steps + 1, 12, n))  # of the variables on the states
        for j in range(self.steps):
            b = np.zeros((6, n))
            for leg, slot in enumerate(self.slot[j]):
                for axis in range(3):
                    if slot >= 0:
                        b[:, self.variable(slot, axis)] = self.ahead["columns"][j, leg, axis]
            influence[j + 1, :6] = influence[j, :6] + h * influence[j, 6:] + 0.5 * h**2 * b
            influence[j + 1, 6:] = influence[j, 6:] + h * b
        self.influence = influence
        self.free = np.array(self.ahead["free"][: self.steps + 1])
        error = self.free - self.ahead["target"][: self.steps + 1]
        self.hessian = config.force_weight * np.eye(n)
        self.gradient = np.zeros(n)
        for j in range(1, self.steps + 1):
            self.hessian += influence[j].T @ (weights[:, None] * influence[j])
            self.gradient += influence[j].T @ (weights * error[j])
        stance = rig.controller.config.stance
        rows, limits = [], []
        for slot in range(self.k):
            x, y, z = (np.eye(n)[self.variable(slot, axis)] for axis in range(3))
            rows += [z, -z, *(sign * side - stance.friction * z for side in (x, y) for sign in (-1, 1))]
            limits += [stance.max_force, -stance.min_force, 0, 0, 0, 0]
            if stance.friction_sides == 8:
                diagonals = [(a * x + b * y) / np.sqrt(2) for a in (-1, 1) for b in (-1, 1)]
                rows += [side - stance.friction * z for side in diagonals]
                limits += [0] * 4
        self.rows, self.limits = np.array(rows), np.array(limits)
        self.qp = rig.controller._work.plan_qp[0]

    def variable(self, slot: int, axis: int) -> int:
        return slot if axis == 2 else self.k + 2 * slot + axis

    def solution(self) -> np.ndarray:
        """As a least-distance problem by non-negative least squares (Lawson and Hanson 1974, ch. 23)."""
        root = np.linalg.cholesky(self.hessian).T
        shift = np.linalg.solve(root.T, self.gradient)  # |R x + shift|² is the cost
        g = -np.linalg.solve(root.T, self.rows.T).T
        h = -self.limits + self.rows @ np.linalg.solve(root, -shift)
        a = np.vstack([g.T, h])
        b = np.zeros(self.n + 1)
        b[-1] = 1.0
        y, _ = nnls(a, b, maxiter=10_000)
        r = a @ y - b
        return np.linalg.solve(root, -r[:-1] / r[-1] - shift)


class TestProblem:
    """What is solved is the stated problem."""

    def rigs(self, robot: Robot, motion: Motion, config: ControllerConfig, n: int = 6) -> list[Rig]:
        rng = np.random.default_rng(0)
        out = []
        for sample in rng.integers(motion.n_samples, size=n):
            rig = Rig(robot, [motion], np.array([sample]), config)
            rig.step(disturbed(on_reference(motion, rig.samples), rng))
            out.append(rig)
        return out

    @pytest.mark.nojit
    def test_hessian_and_gradient_are_those_of_the_model_written_down_as_a_whole(
        self, robot: Robot, trot: Motion
    ) -> None:
        for rig in self.rigs(robot, trot, lh(steps=4), 2):
            problem = Problem(rig)
            n = problem.n
            hessian = problem.qp["hessian"][: n * n].reshape(n, n)
            np.testing.assert_allclose(hessian, problem.hessian, rtol=0, atol=1e-10 * np.abs(hessian).max())
            gradient = problem.qp["gradient"][:n]
            np.testing.assert_allclose(gradient, problem.gradient, rtol=0, atol=1e-10 * np.abs(gradient).max())

    @pytest.mark.parametrize("sides", [4, 8])
    def test_forces_are_those_that_another_solver_finds(self, robot: Robot, trot: Motion, sides: int) -> None:
        held, config = 0, lh()
        config = dataclasses.replace(config, stance=dataclasses.replace(config.stance, friction_sides=sides))
        for rig in self.rigs(robot, trot, config):
            problem = Problem(rig)
            expected = problem.solution()
            np.testing.assert_allclose(problem.qp["x"][: problem.n], expected, atol=1e-4)
            held += int((problem.rows @ expected > problem.limits - 1e-7).sum())
        assert held > 20, "the cases must exercise bounds and friction"

    def test_the_plan_is_what_the_model_makes_of_the_forces(self, robot: Robot, trot: Motion) -> None:
        for rig in self.rigs(robot, trot, lh(), 2):
            problem, plan = Problem(rig), rig.controller.plan[0]
            states = problem.free + problem.influence @ problem.qp["x"][: problem.n]
            np.testing.assert_allclose(plan["state"][: STEPS + 1], states, atol=1e-10)
            weight = robot.mass * GRAVITY
            for j, leg in np.argwhere(problem.slot >= 0):
                share = [problem.qp["x"][problem.variable(problem.slot[j, leg], axis)] for axis in range(3)]
                np.testing.assert_allclose(plan["force"][j, leg], np.array(share) * weight)
            assert np.all(plan["force"][:STEPS][problem.slot < 0] == 0)

    def test_one_step_with_velocity_weights_only_is_the_stance_qp(self, robot: Robot) -> None:
        """k_p = 0, k_d = 1/Δt, Q = Δt² W, the same R: the horizon claims nothing more than its length."""
        motion = gait(robot, (0.5, 0.1))
        weights, force_weight = (1.0, 2.0, 3.0, 0.4, 0.5, 0.6), 1e-3
        rate = 1 / STEP_S
        config = lh(500.0, steps=1, position_weight=(0.0,) * 6, velocity_weight=weights, force_weight=force_weight)
        instant = dataclasses.replace(
            ControllerConfig(),
            stance=StanceConfig(
                feedback="constant",
                position_gain=(0.0,) * 6,
                velocity_gain=(rate,) * 6,
                reference_acceleration=0.0,
                leg_momentum=False,
                acceleration_limit=(1e6,) * 6,
                acceleration_weight=tuple(STEP_S**2 * w for w in weights),  # type: ignore[arg-type]
                force_weight=force_weight / (robot.mass * GRAVITY) ** 2,
            ),
        )
        config = dataclasses.replace(config, stance=dataclasses.replace(config.stance, leg_momentum=False))
        rng = np.random.default_rng(2)
        observation = disturbed(on_reference(motion, SAMPLES), rng)
        pair = [Rig(robot, [motion], SAMPLES, c) for c in (config, instant)]
        for rig in pair:
            rig.step(observation)
        forces = [rig.controller.memory["force"] for rig in pair]
        assert np.abs(forces[1]).max() > 30
        np.testing.assert_allclose(*forces, rtol=0, atol=1e-6 * robot.mass * GRAVITY)

    def test_a_heavier_robot_plans_the_same_motion(self, robot: Robot, trot: Motion) -> None:
        """Mass and inertia twice as large: forces twice as large, accelerations the same."""
        heavy = dataclasses.replace(
            robot,
            mass=2 * robot.mass,
            trunk_mass=2 * robot.trunk_mass,
            link_mass=2 * robot.link_mass,
            link_inertia=2 * robot.link_inertia,
            inertia_b=2 * robot.inertia_b,
        )
        observation = disturbed(on_reference(trot, SAMPLES), np.random.default_rng(3), 0.3)
        observation["foot_force"][...] = 0.0
        plans = []
        for each in (robot, heavy):
            rig = Rig(each, [trot], SAMPLES, lh(stance=WEIGHTLESS_LEGS))
            rig.step(observation)
            plans.append(rig.controller.plan)
        # to the solver's tolerance: where forces are cheap, many plans cost nearly the same
        np.testing.assert_allclose(plans[1]["acceleration"], plans[0]["acceleration"], atol=0.03)
        np.testing.assert_allclose(plans[1]["force"], 2 * plans[0]["force"], atol=0.01 * robot.mass * GRAVITY)


class TestForesight:
    """What lies ahead, against the motion continued by hand."""

    CONFIG = lh()

    @pytest.mark.parametrize("sample", [0, 100, 180, 249])
    def test_targets_are_the_reference_ahead_also_beyond_the_cycles_end(
        self, robot: Robot, trot: Motion, sample: int
    ) -> None:
        """A robot that stands 3 cm beside the reference and moves slower."""
        rig = Rig(robot, [trot], np.array([sample]), self.CONFIG)
        observation = on_reference(trot, rig.samples)
        yaw = 0.5 * sample / 500
        beside = np.array([0.0, 0.03])
        observation["root_pos"][:, :2] += rotate_planar(yaw, beside)
        observation["lin_vel"] = 0.0
        rig.step(observation)
        ahead = rig.controller._work.foresight[0]
        time = STEP_S * np.arange(1, STEPS + 1)
        turn = 0.5 * time
        x, y = np.sin(turn) / 0.5, (1 - np.cos(turn)) / 0.5
        expected = np.column_stack([0.4 * x - 0.1 * y, 0.4 * y + 0.1 * x]) - beside
        target = ahead["target"][1 : STEPS + 1]
        np.testing.assert_allclose(target[:, :2], expected, atol=1e-9)
        np.testing.assert_allclose(target[:, 2], 0.0, atol=1e-9)
        np.testing.assert_allclose(target[:, 3:6], np.column_stack([0 * turn, 0 * turn, turn]), atol=1e-9)
        np.testing.assert_allclose(target[:, 6:8], rotate_planar(turn, np.tile([0.4, 0.1], (STEPS, 1))), atol=1e-9)
        np.testing.assert_allclose(target[:, 11], 0.5, atol=1e-9)
        np.testing.assert_allclose(ahead["free"][0, 6:9], 0.0, atol=1e-12)

    @pytest.mark.parametrize("sample", [20, 140, 230])
    def test_feet_stand_as_scheduled_and_stay_where_they_are(self, robot: Robot, trot: Motion, sample: int) -> None:
        """On the reference, every foot that stands ahead is a foothold of the motion, seen from the moving body."""
        rig = Rig(robot, [trot], np.array([sample]), self.CONFIG)
        rig.step(on_reference(trot, rig.samples))
        ahead = rig.controller._work.foresight[0]
        middle = sample + np.round((np.arange(STEPS) + 0.5) * STEP_S * 500).astype(int)
        np.testing.assert_array_equal(ahead["standing"][1:STEPS], trot.contact[middle[1:] % 250])
        np.testing.assert_array_equal(ahead["standing"][0], rig.controller.memory["stance"][0])
        holds = feet_w(trot)
        dx, dy, dyaw = trot.cycle
        for j in range(1, STEPS):
            wraps, index = divmod(middle[j], 250)
            time = (j + 0.5) * STEP_S
            nominal = 0.5 * (ahead["nominal"][j] + ahead["nominal"][j + 1])
            for leg in np.flatnonzero(ahead["standing"][j]):
                # the centre of mass turns with the body
                com = np.append(rotate_planar(0.5 * time, ahead["com"][:2]), ahead["com"][2])
                foot = ahead["arms"][j, leg] + com + nominal
                root, yaw = trot.root_pos_w[sample], 0.5 * sample / 500
                world = rotate_planar(yaw, foot[:2]) + root[:2]
                hold = holds[index, leg, :2]
                if wraps:
                    hold = rotate_planar(dyaw, hold) + np.array([dx, dy])
                np.testing.assert_allclose(world, hold, atol=2e-3)
                assert foot[2] + root[2] == pytest.approx(0.0, abs=1e-6), "on the ground"

    @pytest.mark.parametrize("yaw_rate", [0.5, 0.0])
    def test_a_motion_that_ends_goes_on_as_it_ended(self, robot: Robot, yaw_rate: float) -> None:
        """Where it goes and how fast it goes agree: the body leaves over its feet, which stay."""
        motion, now, n = gait(robot, (0.4, 0.1), yaw_rate), 116, 131  # two feet land 9 samples from now, before the end
        arrays = ("root_pos_w", "root_quat_wxyz", "joint_pos", "joint_vel", "foot_pos_b", "contact")
        cut = {name: getattr(motion, name)[:n] for name in (*arrays, "root_lin_vel_w", "root_ang_vel_w")}
        once = dataclasses.replace(motion, cycle=None, **cut)
        rig = Rig(robot, [once], np.array([now]), self.CONFIG)
        table = rig.controller.tables[0]
        table["lin_vel"][-1, 2], table["ang_vel"][-1, :2], table["leg_lin_acc"][-1] = 0.3, 0.2, 5.0
        rig.step(on_reference(once, rig.samples))
        ahead = rig.controller._work.foresight[0]
        time = STEP_S * np.arange(1, STEPS + 1)
        turn = yaw_rate * time
        along, across = time * np.sinc(turn / np.pi), 0.5 * turn * time * np.sinc(turn / (2 * np.pi)) ** 2
        expected = np.column_stack([0.4 * along - 0.1 * across, 0.4 * across + 0.1 * along])
        target = ahead["target"][1 : STEPS + 1]
        np.testing.assert_allclose(target[:, :2], expected, atol=1e-9)
        np.testing.assert_allclose(target[:, 2:6], np.column_stack([0 * turn, 0 * turn, 0 * turn, turn]), atol=1e-9)
        np.testing.assert_allclose(target[:, 6:8], rotate_planar(turn, np.tile([0.4, 0.1], (STEPS, 1))), atol=1e-9)
        np.testing.assert_allclose(target[:, 8:], np.tile([0, 0, 0, yaw_rate], (STEPS, 1)), atol=1e-9)
        np.testing.assert_allclose(ahead["drift"][1:STEPS], np.tile([0, 0, -GRAVITY, 0, 0, 0], (STEPS - 1, 1)))
        np.testing.assert_array_equal(ahead["standing"][1:STEPS], np.tile(once.contact[-1], (STEPS - 1, 1)))
        hold = rotate_planar(-yaw_rate * now / 500, feet_w(once)[-1, :, :2] - once.root_pos_w[now, :2])
        landed = 0
        for j in range(1, STEPS):
            nominal = 0.5 * (ahead["nominal"][j] + ahead["nominal"][j + 1])
            com = rotate_planar(yaw_rate * (j + 0.5) * STEP_S, ahead["com"][:2])
            for leg in np.flatnonzero(ahead["standing"][j]):
                np.testing.assert_allclose(ahead["arms"][j, leg, :2] + com + nominal[:2], hold[leg], atol=2e-3)
                landed += int(ahead["standing"][0, leg] == 0)
        assert landed, "a foot that is in the air now must stand at the end"

    @pytest.mark.nojit
    def test_a_robot_that_stays_in_the_air_plans_to_fall(self, robot: Robot) -> None:
        """No leg stands in any step: nothing to solve, and no failure either."""
        motion = standing(robot)
        flying = dataclasses.replace(motion, contact=np.zeros_like(motion.contact))
        rig = Rig(robot, [flying], np.array([10]), lh(steps=3, stance=WEIGHTLESS_LEGS))
        observation = on_reference(flying, rig.samples)
        rig.step(observation)
        plan = rig.controller.plan[0]
        assert plan["valid"] == 1
        np.testing.assert_array_equal(plan["force"], 0.0)
        np.testing.assert_allclose(plan["acceleration"][:3], np.tile([0, 0, -GRAVITY, 0, 0, 0], (3, 1)))
        assert rig.controller.memory["qp_failures"][0] == 0

    def test_steps_in_the_air_between_steps_on_the_ground(self, robot: Robot) -> None:
        """A leap: four feet leave together and land together, and leave with the speed that takes them there."""
        motion = gait(robot, n_samples=150, duty=0.5, touchdown=(0.0, 0.0, 0.0, 0.0))
        rig = Rig(robot, [motion], np.array([45]), lh(stance=WEIGHTLESS_LEGS))
        observation = on_reference(motion, rig.samples)
        rig.step(observation)
        plan = rig.controller.plan[0]
        flight = ~np.any(rig.controller._work.foresight[0]["standing"][:STEPS], axis=1)
        assert flight.any()
        assert not flight.all()
        np.testing.assert_allclose(plan["acceleration"][:STEPS][flight, 2], -GRAVITY)
        takeoff, air = plan["state"][int(np.argmax(flight)), 8], STEP_S * flight.sum()
        assert 0.6 < takeoff / (0.5 * GRAVITY * air) < 1.4


class TestBatch:
    """n robots are n single robots, bit for bit; the planner's work memory is shared and must carry nothing over."""

    @pytest.mark.parametrize("rate_hz", [50.0, 500.0])
    def test_n_robots_in_one_call_are_n_single_calls(self, robot: Robot, trot: Motion, rate_hz: float) -> None:
        config = lh(rate_hz)
        together = Rig(robot, [trot], SAMPLES, config)
        alone = [Rig(robot, [trot], SAMPLES[i : i + 1], config) for i in range(len(SAMPLES))]
        rng = np.random.default_rng(0)
        for _ in range(12):
            observation = disturbed(on_reference(trot, SAMPLES), rng)
            commands = together.step(observation)
            for i, rig in enumerate(alone):
                assert rig.step(observation[i : i + 1]).tobytes() == commands[i : i + 1].tobytes()

    def test_a_reset_forgets_the_plan(self, robot: Robot, trot: Motion) -> None:
        used, fresh = (Rig(robot, [trot], SAMPLES, lh()) for _ in range(2))
        rng = np.random.default_rng(1)
        for _ in range(5):
            used.step(disturbed(on_reference(trot, SAMPLES), rng))
        used.controller.reset(SAMPLES)
        last = disturbed(on_reference(trot, SAMPLES), rng)
        assert used.step(last).tobytes() == fresh.step(last).tobytes()


class TestBetweenPlans:
    def test_the_stance_follows_the_plan_and_plans_anew_when_it_is_time(self, robot: Robot, trot: Motion) -> None:
        rig = Rig(robot, [trot], np.array([60]), lh(50.0))
        planned = []
        for _ in range(25):
            rig.step(on_reference(trot, rig.samples))
            planned.append(bool(rig.controller.memory["solve_time"][0] > 0))
        assert planned == [i % 10 == 0 for i in range(25)]

    @pytest.mark.parametrize("turned", [0.0, 2.0])
    def test_on_its_plan_a_robot_is_asked_for_the_planned_acceleration(self, robot: Robot, turned: float) -> None:
        """Whatever its heading in the world; 16 ms later the plan has moved on, and so has its heading frame."""
        motion = gait(robot, (0.4, 0.1))
        rig = Rig(robot, [motion], np.array([60]), lh(50.0, WEIGHTLESS_LEGS | {"disturbance_time": 0.0}))
        controller = rig.controller
        observation = disturbed(on_reference(motion, rig.samples), np.random.default_rng(4), 0.5)
        observation["root_quat"] = quat_multiply(quat_from_yaw(turned), observation["root_quat"])
        for name in ("root_pos", "lin_vel", "ang_vel"):
            observation[name][:, :2] = rotate_planar(turned, observation[name][:, :2])
        rig.clocks["origin"][:, :2] = rotate_planar(turned, rig.clocks["origin"][:, :2])
        rig.clocks["origin"][:, 2] += turned
        rig.step(observation)
        plan = controller.plan[0]
        acceleration = np.array(plan["acceleration"][0])
        assert np.linalg.norm(acceleration[3:]) > 10, "far enough from the reference that feedback would be heard"
        np.testing.assert_allclose(controller._work.scratch[0]["desired"], acceleration, atol=1e-8)
        t, heading = 0.016, float(plan["heading"])
        start = np.array(plan["state"][0])
        pose = start[:6] + t * start[6:] + 0.5 * t**2 * acceleration
        velocity = start[6:] + t * acceleration
        later = observation.copy()
        later["root_pos"][0] += turned_vector(heading, pose[:3])
        turn = quat_multiply(quat_from_yaw(heading), quat_multiply(quat_from_rotvec(pose[3:]), quat_from_yaw(-heading)))
        later["root_quat"][0] = quat_multiply(turn, observation["root_quat"][0])
        later["lin_vel"][0] = turned_vector(heading, velocity[:3])
        later["ang_vel"][0] = turned_vector(heading, velocity[3:])
        for i in range(1, 9):
            rig.clocks["sample"] = 60 + i
            rig.step(later)
        back = heading - float(yaw_from_quat(later["root_quat"][0]))
        wanted = controller._work.scratch[0]["desired"]
        np.testing.assert_allclose(wanted[:3], turned_vector(back, acceleration[:3]), atol=0.08)
        # differences of rotation vectors for rotations: 2 % here
        np.testing.assert_allclose(wanted[3:], turned_vector(back, acceleration[3:]), atol=1.0)

    def test_a_plan_that_is_the_reference_changes_nothing(self, robot: Robot) -> None:
        """The stance's own feedback of the trunk goes on, without that of the feet, which the plan knows."""
        motion = gait(robot, (0.4, 0.1))
        known = {"disturbance_time": 0.0, "acceleration_limit": (1e6,) * 6}
        instant = ControllerConfig(stance=StanceConfig(**known))
        pair = [Rig(robot, [motion], np.array([60]), c) for c in (lh(50.0, known), instant)]
        for rig in pair:
            rig.step(on_reference(motion, rig.samples))
        plan = pair[0].controller.plan[0]
        plan["state"], plan["acceleration"] = plan["reference"], 0.0
        observation = disturbed(on_reference(motion, np.array([61])), np.random.default_rng(8))
        for rig in pair:
            rig.clocks["sample"] = 61
            rig.step(observation)
        planned, instant = (rig.controller._work.scratch[0]["desired"] for rig in pair)
        gains = pair[0].controller.gains[0, pair[0].controller.tables[0]["gain"][61]]
        by_feet = -gains["trunk"][:, 12:] @ pair[0].controller._work.scratch[0]["state"][12:]
        assert np.abs(planned).max() > 10
        np.testing.assert_allclose(planned, instant - by_feet, atol=1e-9)

    def test_at_the_controllers_rate_the_planned_forces_are_applied(self, robot: Robot, trot: Motion) -> None:
        rig = Rig(robot, [trot], SAMPLES, lh(500.0))
        rng = np.random.default_rng(5)
        for _ in range(3):
            rig.step(disturbed(on_reference(trot, SAMPLES), rng))
            assert np.all(rig.controller.plan["age"] == 0)
            np.testing.assert_array_equal(rig.controller.memory["force"], rig.controller.plan["force"][:, 0])


class TestFailure:
    """A planner that fails is counted, and the stance goes on as it would without."""

    def broken(self, robot: Robot, motion: Motion, rate_hz: float) -> tuple[Rig, Rig]:
        """A controller whose reference is unreadable 0.2 s from now, and one that looks at the present only."""
        rigs = tuple(Rig(robot, [motion], np.array([60]), c) for c in (lh(rate_hz), ControllerConfig()))
        for rig in rigs:
            rig.controller.tables["root_pos"][0, 155:170] = np.nan
        return rigs

    @pytest.mark.parametrize("rate_hz", [50.0, 500.0])
    def test_the_instant_forces_stay_in_force_until_there_is_a_plan(
        self, robot: Robot, trot: Motion, rate_hz: float
    ) -> None:
        broken, instant = self.broken(robot, trot, rate_hz)
        rng = np.random.default_rng(6)
        for i in range(1, 4):
            observation = disturbed(on_reference(trot, broken.samples), rng)
            assert broken.step(observation).tobytes() == instant.step(observation).tobytes()
            assert broken.controller.memory["horizon_failures"][0] == i
            assert broken.controller.memory["qp_failures"][0] == i
        broken.controller.tables["root_pos"][0] = Rig(
            robot, [trot], broken.samples, ControllerConfig()
        ).controller.tables["root_pos"][0]
        broken.step(observation)
        assert broken.controller.plan["valid"][0] == 1
        assert broken.controller.memory["horizon_failures"][0] == 3

    def test_an_unknown_state_gives_commands_that_are_safe(self, robot: Robot, trot: Motion) -> None:
        rig = Rig(robot, [trot], SAMPLES, lh())
        observation = on_reference(trot, SAMPLES)
        observation["lin_vel"][2] = np.nan
        commands = rig.step(observation)
        for name in ("joint_pos", "joint_vel", "torque"):
            assert np.isfinite(commands[name]).all()
        np.testing.assert_array_equal(rig.controller.plan["valid"], [1, 1, 0, 1, 1])


def test_a_rollout_logs_how_long_planning_took(robot: Robot, trot: Motion) -> None:
    """And that is all that time changes: two runs agree to the bit."""
    runs = [run_episodes(robot, trot, start=nominal_start(2), duration_s=0.1, config=lh(), log=True) for _ in range(2)]
    for run in runs:
        assert run.log is not None
        assert run.log.solve_time.shape == (2, 50)
        np.testing.assert_array_equal(run.log.solve_time > 0, np.tile(np.arange(50) % 10 == 0, (2, 1)))
        assert run.log.solve_time.max() < 1.0
    assert runs[0].log is not None
    assert runs[1].log is not None
    assert runs[0].log.observation.tobytes() == runs[1].log.observation.tobytes()
    instant = run_episodes(robot, trot, duration_s=0.02, log=True)
    assert instant.log is not None
    np.testing.assert_array_equal(instant.log.solve_time, 0.0)


@pytest.mark.parametrize("rate_hz", [50.0, 500.0])
def test_a_robot_trots_on_its_plans(robot: Robot, trot: Motion, rate_hz: float) -> None:
    run = run_episodes(robot, trot, duration_s=3.0, config=lh(rate_hz))
    assert not run.fell[0]
    assert run.reward[0] > 0.97  # without its weights on position 0.89
    assert run.qp_failures[0] == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, r"horizon.steps must be in \[1, 20\], found 0"),
        ({"steps": 21}, r"horizon.steps must be in \[1, 20\], found 21"),
        ({"steps": 2.5}, "horizon.steps must be a whole number"),
        ({"step_s": 0.001}, "horizon.step_s must be at least one control step, 0.002 s, not 0.001"),
        ({"step_s": float("nan")}, "horizon.step_s must be finite"),
        ({"solve_rate_hz": 60.0}, "horizon.solve_rate_hz must be rate_hz = 500 or a whole fraction of it, not 60"),
        ({"solve_rate_hz": 1000.0}, "horizon.solve_rate_hz must be rate_hz = 500 or a whole fraction"),
        ({"solve_rate_hz": 0.0}, "horizon.solve_rate_hz must be positive"),
        ({"position_weight": (0.0,) * 6, "velocity_weight": (0.0,) * 6}, "horizon.position_weight and velocity_weight"),
        ({"velocity_weight": (1, 1, 1, 1, 1, float("inf"))}, "horizon.velocity_weight must be finite"),
        ({"position_weight": (1.0, 1.0)}, "horizon.position_weight must have 6 numbers"),
        ({"force_weight": 0.0}, "horizon.force_weight must be positive"),
    ],
)
def test_nonsense_is_refused_by_name(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        lh(changes.pop("solve_rate_hz", 50.0), **changes)  # type: ignore[arg-type]


def test_a_horizon_that_is_not_used_does_not_restrict_the_rate() -> None:
    assert ControllerConfig(rate_hz=333.0).horizon.solve_rate_hz == 50.0
    with pytest.raises(ConfigError, match="solve_rate_hz"):
        ControllerConfig(rate_hz=333.0, stance=StanceConfig(forces="horizon"))
