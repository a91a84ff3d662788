"""Terrains: how they are written and refused, that they are where they say, and what a robot on them is measured by."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from control.motions import gait
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import quat_rotate
from fastmimic.episode.loop import ClosedLoop
from fastmimic.episode.plan import nominal_start, perturbed_start
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import COMMAND, OBSERVATION
from fastmimic.simulation.conditions import Conditions, TerrainLevel, parse_terrain
from fastmimic.simulation.mujoco_sim import MujocoSimulation
from fastmimic.simulation.terrain import TERRAINS, GroundPlane, HeightField, Terrain

EVERY = ("stairs-up=0.06", "stairs-down=0.05", "slope=15", "side-slope=-10", "rough=0.05", "waves=0.05", "stones=0.1")


def made(text: str, seed: int = 0) -> Terrain:
    ground = Conditions(terrain=parse_terrain(text), seed=seed).ground
    assert ground is not None
    return ground


class TestWriting:
    def test_name_and_level(self) -> None:
        assert parse_terrain(" stairs-up=0.05") == TerrainLevel("stairs-up", (0.05,))
        assert str(parse_terrain("slope=-10")) == "slope -10 deg"
        assert parse_terrain("my hills.PNG@0.1 = 0.3") == TerrainLevel("my hills.PNG@0.1", (0.3,))
        assert parse_terrain("hills.npy").values == (1.0,)

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("stair-up=0.1", r"unknown terrain 'stair-up'; there are stairs-up, .*did you mean 'stairs-up'"),
            ("stairs-up", r"written name=level, such as stairs-up=0.05.* found 'stairs-up'"),
            ("slope=steep", r"written name=level"),
            ("slope=31", r"'slope' takes -30 deg to 30 deg, found 31: of the ground along the way"),
            ("rough=nan", r"'rough' takes 0 m to 0.3 m"),
            ("rough=0.1@0.2", r"written name=level"),
            ("hills.npy=inf", r"terrain 'hills.npy' takes -1000 to 1000"),
            ("hills.npy@0", r"terrain 'hills.npy@0': the distance of points after @ must be 0\.001 to 100"),
            ("hills.npy@1e300", r"the distance of points after @ must be 0\.001 to 100"),
            ("hills.npy@x=2", r"terrain 'hills.npy@x': the distance of points after @ must be 0\.001 to 100"),
        ],
    )
    def test_what_is_refused(self, text: str, said: str) -> None:
        with pytest.raises(ConfigError, match=said):
            Conditions(terrain=text)  # type: ignore[arg-type]  # texts are read

    def test_the_documentation_lists_them_all(self) -> None:
        page = (Path(__file__).parents[2] / "docs" / "robustness.md").read_text(encoding="utf-8")
        listed = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `") and line.count("|") == 5]
        assert [name for name in listed if name in TERRAINS] == list(TERRAINS)

    @pytest.mark.parametrize("kind", TERRAINS.values(), ids=list(TERRAINS))
    def test_every_range_holds_what_is_tried(self, kind: object) -> None:
        levels = TERRAINS[kind.name].levels  # type: ignore[attr-defined]
        assert 0.0 in levels
        assert [TerrainLevel(kind.name, (level,)).values[0] for level in levels] == sorted(levels)  # type: ignore[attr-defined]


class TestGround:
    @pytest.mark.parametrize("text", EVERY)
    def test_it_is_where_it_is_said_to_be(self, text: str, robot: Robot) -> None:
        """Rays from above hit it there, and it goes as far as a robot comes in 10 s at 1.5 m/s."""
        ground, geom = made(text, seed=3), np.zeros(1, np.int32)
        model = MujocoSimulation(robot, 1, ground=ground).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        x, y = np.random.default_rng(0).uniform([[-2.0], [-2.5]], [[16.0], [2.5]], (2, 60))
        for *at, height in zip(x, y, ground.height(x, y), strict=True):
            start, down = np.array([*at, 9.0]), np.array([0.0, 0.0, -1.0])
            found = 9.0 - mujoco.mj_ray(model, data, start, down, None, 1, int(model.jnt_bodyid[0]), geom)
            assert found == pytest.approx(height, abs=1e-4)

    def test_steps_have_their_rise_and_tread(self) -> None:
        x = np.linspace(-15.0, 15.0, 3001) + 1e-4
        height = made("stairs-up=0.05").height(x, np.zeros_like(x))
        risers = x[1:][np.diff(height) > 0]
        np.testing.assert_allclose(np.diff(height)[np.diff(height) != 0], 0.05)
        np.testing.assert_allclose(np.diff(risers), 0.3, atol=0.011)
        np.testing.assert_allclose(made("stairs-down=0.05").height(x, x), -height)

    def test_a_robot_that_is_lost_has_ground(self) -> None:
        """Beyond the edge, and where the state is no longer finite."""
        x = np.array([1e9, np.nan])
        for text in EVERY:
            height = made(text).height(x, x)
            assert height.shape == (2,)
        edge = made("rough=0.05").field.heights[-1, -1]  # type: ignore[union-attr]
        assert made("rough=0.05").height(x, x)[0] == pytest.approx(edge)

    def test_rough_ground_is_its_seeds(self) -> None:
        heights = made("rough=0.05", seed=1).field.heights  # type: ignore[union-attr]
        assert 0.049 < np.abs(heights).max() <= 0.05
        assert made("rough=0.05", seed=1).field.heights.tobytes() == heights.tobytes()  # type: ignore[union-attr]
        assert made("rough=0.05", seed=2).field.heights.tobytes() != heights.tobytes()  # type: ignore[union-attr]

    def test_planes(self) -> None:
        """Of stairs that through the middles of the treads; of a field the nearest under the robot."""
        np.testing.assert_allclose(made("stairs-up=0.1").plane(np.array(3.0), np.array(1.0)).height, 1.0)
        x = 0.1 * np.arange(41) - 2.0
        ramp = Terrain(field=HeightField(0.2 * x[None] - 0.1 * x[:, None] + 0.3, 0.1))
        plane = ramp.plane(np.array([0.5, -1.0]), np.array([0.2, 0.3]))
        np.testing.assert_allclose(plane.height, [0.38, 0.07])
        normal = np.array([-0.2, 0.1, 1.0]) / math.hypot(0.2, 0.1, 1.0)
        np.testing.assert_allclose(plane.normal, [normal, normal], atol=1e-12)

    def test_own_files(self, tmp_path: Path) -> None:
        """A picture's white is high, its upper edge the greatest y; 8 and 16 bits are the same hills."""
        hills = np.linspace(0.0, 1.0, 12).reshape(3, 4)
        Image.fromarray((255 * hills).round().astype(np.uint8)).save(tmp_path / "low.png")
        Image.fromarray((65535 * hills).round().astype(np.uint16)).save(tmp_path / "deep.png")
        np.save(tmp_path / "hills.npy", 0.2 * hills[::-1])
        for name in ("low.png@0.1=0.2", "deep.png@0.1=0.2", "hills.npy@0.1"):
            ground = made(f"{tmp_path / name}")
            top = ground.height(np.array([-0.15, 0.15]), np.array([0.1, -0.1]))
            np.testing.assert_allclose(top, [0.0, 0.2], atol=1e-9)
        np.save(tmp_path / "flat.npy", np.zeros(4))
        np.save(tmp_path / "high.npy", np.full((3, 4), -1e307))
        (tmp_path / "text.npy").write_text("heights")
        np.save(tmp_path / "none.npy", np.full((3, 4), np.nan))
        for name, said in (
            ("flat.npy", r"rows and columns of heights; found \(4,\)"),
            ("high.npy", r"in m and at most 1000; found 1e\+307"),
            ("none.npy", r"in m and at most 1000; found nan"),
            ("no.npy", "no such file"),
            ("text.npy", "cannot be read as a height field"),
        ):
            with pytest.raises(ConfigError, match=said):
                made(f"{tmp_path / name}")


class TestPlane:
    def test_seen_is_the_inverse_of_laid(self) -> None:
        rng = np.random.default_rng(0)
        plane = GroundPlane.of(rng.normal(size=5), rng.normal(0.0, 0.3, (5, 2)))
        level, state = np.zeros(5, OBSERVATION), np.zeros(5, OBSERVATION)
        level["root_pos"], quat = rng.normal(size=(5, 3)), rng.normal(size=(5, 4))
        level["root_quat"] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
        state["root_pos"], state["root_quat"] = plane.laid(level["root_pos"], level["root_quat"])
        seen = plane.seen(state)
        np.testing.assert_allclose(seen["root_pos"], level["root_pos"], atol=1e-12)
        np.testing.assert_allclose(seen["root_quat"], level["root_quat"], atol=1e-12)

    def test_a_robot_stands_on_a_slope(self, robot: Robot) -> None:
        """Its feet carry its weight, straight down, and uphill the rear ones carry more."""
        ground, home = made("slope=10"), robot.home_joint_pos
        simulation = MujocoSimulation(robot, 1, ground=ground)
        height = robot.foot_radius - foot_positions(robot, home)[:, 2].min()
        start = ground.plane(np.zeros(1), np.zeros(1)).laid(np.array([[0.0, 0.0, height]]), np.array([[1.0, 0, 0, 0]]))
        simulation.reset(*start, home, np.zeros(3), np.zeros(3), np.zeros(12))
        command = np.zeros(1, COMMAND)
        command["joint_pos"], command["stiffness"], command["damping"] = home, 200.0, 5.0
        for _ in range(300):
            force = simulation.step(command)["foot_force"][0]
        np.testing.assert_allclose(force.sum(axis=0), [0.0, 0.0, robot.mass * GRAVITY], atol=2.0)
        assert force[2:, 2].sum() > 1.1 * force[:2, 2].sum()


class TestEpisodes:
    @pytest.mark.parametrize("text", EVERY)
    def test_they_begin_on_the_ground_and_lead_the_named_way(self, text: str, robot: Robot) -> None:
        motion = gait(robot, (0.0, 0.4))  # to the left: it is turned to the right to go along x
        loop = ClosedLoop(robot, motion, 4, conditions=Conditions(terrain=parse_terrain(text)))
        loop.place(perturbed_start(4, motion.n_samples, np.random.default_rng(0)))
        state, ground = loop.simulation.observation.copy(), loop.terrain
        assert ground is not None
        above = ground.plane(state["root_pos"][:, 0], state["root_pos"][:, 1]).seen(state)
        np.testing.assert_allclose(above["root_pos"][:, 2], robot.home_height, atol=0.07)
        assert len(np.unique(state["root_pos"][:, 0])) == (1 if "slope" in text else 4), "on different ground"
        if "rough" not in text and "waves" not in text:
            w, _, _, z = above["root_quat"].T
            np.testing.assert_allclose(np.degrees(2 * np.arctan2(z, w)), -90.0, atol=5.0)
        assert state["foot_force"].max() < 100.0, "in the ground"
        loop.apply(loop.control())
        loop.score()
        assert not loop.scorer.tallies["fallen"].any()
        assert loop.scorer.tallies["reward_sum"].min() > 0.5

    def test_on_a_ramp_a_motion_scores_as_on_the_floor(self, robot: Robot) -> None:
        """The same states, laid on a slope, have the same reward, up to the way, which is measured in the world."""
        motion = gait(robot, (0.0, 0.0))
        flat = ClosedLoop(robot, motion, 1)
        ramp = ClosedLoop(robot, motion, 1, conditions=Conditions(terrain=TerrainLevel("slope", (12.0,))))
        for loop in (flat, ramp):
            loop.place(nominal_start(1))
        ground, state = ramp.terrain, flat.simulation.observation.copy()
        assert ground is not None
        for _ in range(30):
            flat.apply(flat.control())
            flat.score()
            state[...] = flat.simulation.observation
            plane = ground.plane(state["root_pos"][:, 0], state["root_pos"][:, 1])
            state["root_pos"], state["root_quat"] = plane.laid(state["root_pos"], state["root_quat"])
            for name in ("lin_vel", "ang_vel"):
                state[name] = quat_rotate(plane.quat, state[name])
            ramp._truth = state
            ramp.score()
        np.testing.assert_allclose(ramp.scorer.tallies["terms"], flat.scorer.tallies["terms"], rtol=1e-3)
        np.testing.assert_allclose(ramp.scorer.tallies["point_error"], flat.scorer.tallies["point_error"], rtol=0.02)
