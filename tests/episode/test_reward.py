"""The reward, term by term against an implementation of its own, and what ends an episode."""

import numpy as np
import pytest

from control.motions import gait, standing, turned
from fastmimic.base.rotations import (
    matrix_from_quat,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.episode.reward import TALLY, TERMS, WEIGHTS, ScoringContext, score_step
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import make_clocks, place_clocks, reference_table, world_root
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import MEMORY, OBSERVATION

DT = 0.002
LOADED = 60.0  # N


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return turned(gait(robot, (0.5, 0.1), 0.8), 0.4, shift=(1.0, 2.0))


class Scoring:
    """n robots somewhere in the world, each at a sample of the demonstration, and their tallies."""

    def __init__(self, robot: Robot, motion: Motion, samples: np.ndarray, pose: np.ndarray | None = None) -> None:
        n = len(samples)
        self.robot, self.motion, self.samples = robot, motion, np.asarray(samples)
        self.table = reference_table(motion, robot)
        self.clocks = make_clocks(motion, n)
        place_clocks(self.clocks, self.samples, self.table, np.zeros((n, 3)) if pose is None else pose)
        self.memories = np.zeros(n, MEMORY)
        self.tallies = np.zeros(n, TALLY)

    def reference(self) -> np.ndarray:
        """Observations that match the demonstration exactly."""
        sample, yaw = self.clocks["sample"], self.clocks["origin"][:, 2]
        out = np.zeros(len(sample), OBSERVATION)
        out["root_pos"], out["root_quat"] = world_root(self.table, sample, self.clocks["origin"])
        for name in ("lin_vel", "ang_vel"):
            out[name] = quat_rotate(quat_from_yaw(yaw), self.table[name][sample])
        out["joint_pos"], out["joint_vel"] = self.motion.joint_pos[sample], self.motion.joint_vel[sample]
        out["foot_force"][..., 2] = np.where(self.motion.contact[sample], LOADED, 0.0)
        return out

    def score(self, observation: np.ndarray) -> np.ndarray:
        """Terms (n, 5) of this step."""
        context = ScoringContext(
            table=self.table,
            geometry=self.robot.geometry,
            foot_radius=self.robot.foot_radius,
            threshold=0.2 * LOADED,
            dt=DT,
            work=np.zeros((3, 3, 3)),
        )
        score_step(context, self.clocks, observation, observation, self.memories, self.tallies)
        return self.tallies["reward"].copy()

    def advance(self) -> None:
        self.clocks["sample"] += 1


def disturbed(observation: np.ndarray, rng: np.random.Generator, size: float) -> np.ndarray:
    out = observation.copy()
    n = len(out)
    out["root_quat"] = quat_multiply(quat_from_rotvec(size * 0.2 * rng.normal(size=(n, 3))), out["root_quat"])
    for name, scale in (
        ("root_pos", 0.1),
        ("lin_vel", 0.3),
        ("ang_vel", 0.5),
        ("joint_pos", 0.1),
        ("joint_vel", 1.0),
    ):
        out[name] += size * scale * rng.normal(size=out[name].shape)
    return out


def expected_terms(robot: Robot, wanted: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Paper, §IV-A, with the details of the implementation that it names: one robot, NumPy, straight from the text."""
    pose = np.exp(-5 * np.sum((wanted["joint_pos"] - found["joint_pos"]) ** 2))
    velocity = np.exp(-0.1 * np.sum((wanted["joint_vel"] - found["joint_vel"]) ** 2))

    def feet(state: np.ndarray) -> np.ndarray:
        """x and y relative to the root in the heading frame, height in the world."""
        offset = quat_rotate(state["root_quat"], foot_positions(robot, state["joint_pos"]))
        out = offset.copy()
        out[:, :2] = rotate_planar(-yaw_from_quat(state["root_quat"]), offset[:, :2])
        out[:, 2] += state["root_pos"][2]
        return out

    difference = feet(wanted) - feet(found)
    end_effector = np.exp(-40 * np.sum(difference**2 * [1, 1, 3]))
    turn = matrix_from_quat(wanted["root_quat"]) @ matrix_from_quat(found["root_quat"]).T
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    distance = np.sum((wanted["root_pos"] - found["root_pos"]) ** 2)
    root_pose = np.exp(-20 * distance - 10 * angle**2)
    linear = np.sum((wanted["lin_vel"] - found["lin_vel"]) ** 2)
    angular = np.sum((wanted["ang_vel"] - found["ang_vel"]) ** 2)
    root_velocity = np.exp(-2 * linear - angular)
    return np.array([pose, velocity, end_effector, root_pose, root_velocity])


class TestTerms:
    POSE = np.array([[0.0, 0, 0], [2.0, -1.0, 1.1], [-3.0, 4.0, -2.9], [0.5, 0.5, np.pi]])
    SAMPLES = np.array([0, 70, 140, 249])

    @pytest.mark.nojit
    def test_every_term_is_the_papers_formula(self, robot: Robot, motion: Motion) -> None:
        rng = np.random.default_rng(0)
        for size in (0.01, 0.3, 1.0):
            for _ in range(5):
                scoring = Scoring(robot, motion, self.SAMPLES, self.POSE)
                wanted = scoring.reference()
                found = disturbed(wanted, rng, size)
                terms = scoring.score(found)
                for i in range(len(self.SAMPLES)):
                    expected = expected_terms(robot, wanted[i], found[i])
                    np.testing.assert_allclose(terms[i], expected, rtol=1e-9, atol=1e-12)

    @pytest.mark.nojit
    def test_perfect_tracking_is_worth_one(self, robot: Robot, motion: Motion) -> None:
        scoring = Scoring(robot, motion, self.SAMPLES, self.POSE)
        np.testing.assert_allclose(scoring.score(scoring.reference()), 1.0, atol=1e-9)
        np.testing.assert_allclose(scoring.tallies["reward_sum"], 1.0, atol=1e-9)

    def test_weights_are_the_papers_and_sum_to_one(self) -> None:
        assert dict(zip(TERMS, WEIGHTS, strict=True)) == {
            "pose": 0.25,
            "velocity": 0.05,
            "end_effector": 0.1,
            "root_pose": 0.3,
            "root_velocity": 0.3,
        }
        assert sum(WEIGHTS) == pytest.approx(1.0)

    def test_a_step_is_worth_between_nothing_and_one(self, robot: Robot, motion: Motion) -> None:
        rng = np.random.default_rng(1)
        for _ in range(50):
            scoring = Scoring(robot, motion, self.SAMPLES, self.POSE)
            terms = scoring.score(disturbed(scoring.reference(), rng, float(rng.uniform(0, 2))))
            assert np.all((terms >= 0) & (terms <= 1))
            assert np.all((scoring.tallies["reward_sum"] >= 0) & (scoring.tallies["reward_sum"] <= 1))

    def test_sums_run_over_the_steps(self, robot: Robot, motion: Motion) -> None:
        rng = np.random.default_rng(2)
        scoring = Scoring(robot, motion, self.SAMPLES[:2])
        total = np.zeros((2, 5))
        for _ in range(10):
            total += scoring.score(disturbed(scoring.reference(), rng, 0.3))
            scoring.advance()
        np.testing.assert_array_equal(scoring.tallies["steps"], 10)
        np.testing.assert_allclose(scoring.tallies["terms"], total)
        np.testing.assert_allclose(scoring.tallies["reward_sum"], total @ WEIGHTS)


class TestFall:
    """Once fallen, the steps count 0: the tally stands still."""

    def after(self, robot: Robot, motion: Motion, **changes: object) -> bool:
        scoring = Scoring(robot, motion, np.array([40, 40]))
        observation = scoring.reference()
        for name, value in changes.items():
            observation[name][0] = observation[name][0] + value
        scoring.score(observation)
        fallen = scoring.tallies["fallen"].astype(bool)
        assert not fallen[1], "the other robot is not concerned"
        assert scoring.tallies["steps"][0] == (0 if fallen[0] else 1)
        assert np.isfinite(scoring.tallies["reward_sum"]).all()
        assert np.isfinite(scoring.tallies["foot_error_sq"]).all()
        return bool(fallen[0])

    @pytest.mark.parametrize(
        ("offset", "falls"),
        [
            ([0.99, 0, 0], False),
            ([1.01, 0, 0], True),
            ([0, -1.01, 0], True),
            ([0, 0, 1.01], True),
            ([0.8, 0.8, 0], True),
        ],
    )
    def test_more_than_a_metre_from_the_reference(
        self, robot: Robot, motion: Motion, offset: list[float], falls: bool
    ) -> None:
        assert self.after(robot, motion, root_pos=offset) == falls

    @pytest.mark.parametrize("axis", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.6, 0, 0.8]])
    @pytest.mark.parametrize(("degrees", "falls"), [(89, False), (91, True), (179, True)])
    def test_more_than_90_degrees_off(
        self, robot: Robot, motion: Motion, axis: list[float], degrees: float, falls: bool
    ) -> None:
        scoring = Scoring(robot, motion, np.array([40]))
        observation = scoring.reference()
        turn = quat_from_rotvec(np.radians(degrees) * np.array(axis))
        observation["root_quat"] = quat_multiply(turn, observation["root_quat"])
        scoring.score(observation)
        assert bool(scoring.tallies["fallen"][0]) == falls

    def test_anything_but_a_foot_touches_the_ground(self, robot: Robot, motion: Motion) -> None:
        assert not self.after(robot, motion, other_contact=0.0)
        assert self.after(robot, motion, other_contact=1.0)

    @pytest.mark.parametrize("field", ["root_pos", "root_quat", "lin_vel", "ang_vel", "joint_pos", "joint_vel"])
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_a_simulation_that_has_exploded(self, robot: Robot, motion: Motion, field: str, value: float) -> None:
        assert self.after(robot, motion, **{field: value})

    def test_nothing_is_counted_afterwards(self, robot: Robot, motion: Motion) -> None:
        scoring = Scoring(robot, motion, np.array([40]))
        for _ in range(3):
            scoring.score(scoring.reference())
            scoring.advance()
        broken = scoring.reference()
        broken["other_contact"] = 1
        scoring.memories["early_touchdowns"], scoring.clocks["jump"] = 2, 0.5
        scoring.score(broken)
        before = scoring.tallies.copy()
        scoring.memories["early_touchdowns"], scoring.memories["qp_failures"], scoring.clocks["jump"] = 9, 9, 9.0
        for _ in range(3):
            scoring.advance()
            scoring.score(scoring.reference())
        assert scoring.tallies.tobytes() == before.tobytes()
        assert scoring.tallies["steps"][0] == 3
        assert scoring.tallies["early_touchdowns"][0] == 2
        assert scoring.tallies["jump"][0] == 0.5


class TestCounting:
    """What is counted beside the reward."""

    def test_clearance_is_the_height_of_each_swing(self, robot: Robot) -> None:
        """On the demonstration itself: its own lift, over three swings."""
        motion = gait(robot, lift=0.06)
        scoring = Scoring(robot, motion, np.array([0]))
        for step in range(3 * motion.n_samples + 10):
            scoring.clocks["sample"] = step % motion.n_samples
            scoring.score(scoring.reference())
        tally = scoring.tallies[0]
        np.testing.assert_array_equal(tally["swings"], 3)
        np.testing.assert_allclose(tally["clearance_sum"] / tally["swings"], 0.06, atol=1e-4)

    def test_a_swing_in_which_the_episode_begins_has_no_clearance(self, robot: Robot) -> None:
        """Its top may have been before."""
        motion = gait(robot, lift=0.06)
        swing = np.flatnonzero(~motion.contact[:, 0])
        late = int(swing[-1]) - 3
        scoring = Scoring(robot, motion, np.array([late]))
        for step in range(motion.n_samples):
            scoring.clocks["sample"] = (late + step) % motion.n_samples
            scoring.score(scoring.reference())
        assert (scoring.tallies["swings"][0, 0], scoring.tallies["stances"][0, 0]) == (0, 1)

    def test_foot_errors_are_squared_in_the_body_frame(self, robot: Robot, motion: Motion) -> None:
        scoring = Scoring(robot, motion, np.array([40]))
        found = disturbed(scoring.reference(), np.random.default_rng(3), 0.3)
        scoring.score(found)
        expected = (foot_positions(robot, found["joint_pos"][0]) - motion.foot_pos_b[40]) ** 2
        np.testing.assert_allclose(scoring.tallies["foot_error_sq"][0], expected, atol=1e-12)

    def slip(self, robot: Robot, shift: float, pitch_rate: float, force: float) -> np.ndarray:
        """Of a standing robot whose trunk and feet move on as a whole, in 10 steps."""
        scoring = Scoring(robot, standing(robot), np.array([0]))
        for step in range(11):
            observation = scoring.reference()
            observation["root_pos"][0, 0] += step * shift
            observation["joint_vel"][0, 1::3] = pitch_rate
            observation["foot_force"][..., 2] = force
            scoring.score(observation)
        return scoring.tallies["slip"][0]

    def test_slip_is_the_way_that_loaded_feet_slide(self, robot: Robot) -> None:
        np.testing.assert_allclose(self.slip(robot, 1e-3, 0.0, LOADED), 10e-3, atol=1e-9)
        np.testing.assert_array_equal(self.slip(robot, 1e-3, 0.0, 0.0), 0.0)

    def test_rolling_is_not_sliding(self, robot: Robot) -> None:
        """The sphere's centre moves on by radius × turn while its contact point rests; pitch forwards is positive."""
        rate = 1e-4 / (robot.foot_radius * DT)
        np.testing.assert_allclose(self.slip(robot, 1e-4, rate, LOADED), 0.0, atol=1e-6)
        np.testing.assert_allclose(self.slip(robot, -1e-4, rate, LOADED), 10 * 2e-4, rtol=1e-3)

    def test_what_controller_and_clock_count_is_taken_over(self, robot: Robot, motion: Motion) -> None:
        scoring = Scoring(robot, motion, np.array([0, 1]))
        scoring.memories["early_touchdowns"], scoring.memories["qp_failures"] = [3, 4], [5, 6]
        scoring.clocks["jump"] = [0.1, 0.2]
        scoring.score(scoring.reference())
        np.testing.assert_array_equal(scoring.tallies["early_touchdowns"], [3, 4])
        np.testing.assert_array_equal(scoring.tallies["qp_failures"], [5, 6])
        np.testing.assert_array_equal(scoring.tallies["jump"], [0.1, 0.2])
