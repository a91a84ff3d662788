"""The stage: one ground, the robot as it is, and a ghost that does not get in the way."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from fastmimic.render.encoding import HIGH, PREVIEW
from fastmimic.render.video_scene import GHOST_GROUP, GHOST_RGBA, build_video_scene
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.simulation.conditions import Conditions, parse_terrain

FLOOR = np.array([[0.0, 0.0], [5.0, 1.0]])


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_robot_and_ghost_take_a_pose_each(name: str) -> None:
    robot = load_robot(name)
    stage = build_video_scene(robot, ghost=True, size=(64, 48), floor=FLOOR)
    assert stage.ghost_qpos is not None
    assert sorted([*stage.robot_qpos, *stage.ghost_qpos]) == list(range(38))
    data = mujoco.MjData(stage.model)
    data.qpos[stage.robot_qpos] = [0, 0, 0.3, 1, 0, 0, 0, *robot.home_joint_pos]
    data.qpos[stage.ghost_qpos] = [0, 1, 0.3, 1, 0, 0, 0, *robot.home_joint_pos]
    mujoco.mj_kinematics(stage.model, data)
    for geom in robot.foot_geoms:
        apart = data.geom("ghost/" + geom).xpos - data.geom("robot/" + geom).xpos
        np.testing.assert_allclose(apart, [0, 1, 0], atol=1e-12)


def test_the_ghost_is_translucent_and_leaves_the_robot_as_it_is(a1: Robot) -> None:
    alone = build_video_scene(a1, ghost=False, size=(64, 48), floor=FLOOR)
    both = build_video_scene(a1, ghost=True, size=(64, 48), floor=FLOOR)
    n = alone.model.ngeom
    np.testing.assert_array_equal(both.model.geom_rgba[:n], alone.model.geom_rgba)
    np.testing.assert_array_equal(both.model.geom_size[:n], alone.model.geom_size)
    trunk = both.model.geom("ghost/trunk")
    np.testing.assert_allclose(trunk.rgba, GHOST_RGBA, atol=1e-6)
    assert 0 < trunk.rgba[3] < 1
    assert trunk.group[0] == GHOST_GROUP
    assert not both.casts_shadow[n:].any()


def test_a_floor_and_lights_of_the_users_own_model_are_left_out(a1: Robot, tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    own = '<worldbody><light pos="0 0 9"/><geom name="floor" type="plane" size="1 1 1"/><camera/>'
    path.write_text(a1.xml.replace("<worldbody>", own))
    stage = build_video_scene(load_robot(path), ghost=False, size=(64, 48), floor=FLOOR)
    planes = np.flatnonzero(stage.model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    assert [stage.model.geom(i).name for i in planes] == []  # the ground is tiles
    assert (stage.model.nlight, stage.model.ncam) == (1, 0)


def test_the_ground_reaches_beyond_the_whole_path(a1: Robot) -> None:
    path = np.array([[-40.0, 0.0], [60.0, 10.0]])
    ground = build_video_scene(a1, ghost=False, size=(64, 48), floor=path, quality=HIGH).model.geom("ground")
    assert np.all(ground.pos[:2] - ground.size[:2] < path[0] - 10)
    assert np.all(ground.pos[:2] + ground.size[:2] > path[1] + 10)


def test_decoration_casts_no_shadow_but_hidden_collision_geometry_does_not_replace_what_is_seen(
    a1: Robot, tmp_path: Path
) -> None:
    stage = build_video_scene(a1, ghost=False, size=(64, 48), floor=FLOOR)
    shadows = {stage.model.geom(i).name for i in np.flatnonzero(stage.casts_shadow)}
    assert "robot/trunk" in shadows
    assert "robot/flank" not in shadows  # collides with nothing

    path = tmp_path / "hidden.xml"
    path.write_text(a1.xml.replace('<geom name="', '<geom group="3" name="'))  # all that collides
    path.write_text(path.read_text().replace('group="3" name="flank"', 'name="flank"'))
    stage = build_video_scene(load_robot(path), ghost=False, size=(64, 48), floor=FLOOR)
    shown = stage.casts_shadow
    assert shown[stage.model.geom("robot/flank").id]
    assert not shown[stage.model.geom("robot/trunk").id]


def test_of_a_robot_that_has_only_collision_shapes_these_are_shown(a1: Robot, tmp_path: Path) -> None:
    spec = a1.spec()
    for geom in spec.geoms:
        geom.group = 3
    spec.compile()
    (tmp_path / "hidden.xml").write_text(spec.to_xml())
    stage = build_video_scene(load_robot(tmp_path / "hidden.xml"), ghost=True, size=(64, 48), floor=FLOOR)
    shown = np.flatnonzero(stage.casts_shadow)
    assert len(shown) > 12
    assert set(stage.model.geom_group[shown]) == {0}
    assert np.count_nonzero(stage.model.geom_group == GHOST_GROUP) == len(shown)


def test_tiles_are_as_large_as_asked_for_and_cover_the_ground_once(a1: Robot) -> None:
    model = (stage := build_video_scene(a1, ghost=False, size=(64, 48), floor=FLOOR, tile=0.4)).model
    areas, columns = [], []
    for tiles in stage.tiles:
        geom, mesh = model.geom(tiles), model.mesh(model.geom_dataid[tiles])
        first, faces = mesh.vertadr[0], mesh.faceadr[0]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, geom.quat)
        vertices = model.mesh_vert[first : first + mesh.vertnum[0]].astype(float)
        corners = vertices @ rotation.reshape(3, 3).T + geom.pos
        triangles = corners[model.mesh_face[faces : faces + mesh.facenum[0]]]
        tiled = np.abs(triangles[..., :2]).max(axis=(1, 2)) < 8.5  # the rest is ground without a pattern
        np.testing.assert_allclose(triangles[tiled][..., 2], 0.0, atol=1e-6)
        assert np.all(triangles[~tiled][..., 2] < -0.001)
        assert np.all(np.abs(triangles[~tiled][..., :2]).max(axis=1).min(axis=-1) > 7.9)
        middle = (triangles[tiled].min(axis=1) + triangles[tiled].max(axis=1))[:, :2] / 2
        np.testing.assert_allclose(middle / 0.4 - 0.5, np.round(middle / 0.4 - 0.5), atol=1e-4)
        columns.append(set(map(tuple, np.round(middle / 0.4 - 0.5).astype(int).tolist())))
        area = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])[:, 2] / 2
        assert area.min() > 0  # all face up
        areas.append(area[tiled].sum())
    assert not columns[0] & columns[1]
    assert {(x + y) % 2 for x, y in columns[0]} == {0}
    assert sum(areas) == pytest.approx(16.0**2)


def test_high_quality_has_its_pattern_as_a_texture(a1: Robot) -> None:
    textured = build_video_scene(a1, ghost=False, size=(64, 48), floor=FLOOR, quality=HIGH)
    assert textured.tiles == ()
    assert textured.model.ntex == 1


def test_only_high_quality_pays_for_a_shadow_map(a1: Robot) -> None:
    preview, high = (
        build_video_scene(a1, ghost=False, size=(64, 48), floor=FLOOR, quality=q).model for q in (PREVIEW, HIGH)
    )
    assert (preview.vis.quality.shadowsize, preview.vis.quality.offsamples) == (0, 0)
    assert not preview.light_castshadow.any()
    assert high.vis.quality.shadowsize > 0
    assert high.vis.quality.offsamples > 1
    assert high.light_castshadow.all()


@pytest.mark.parametrize("text", ["stairs-up=0.1", "side-slope=10", "waves=0.05"])
def test_a_terrain_is_drawn_where_it_is(text: str, a1: Robot) -> None:
    ground = Conditions(terrain=parse_terrain(text)).ground
    assert ground is not None
    model = build_video_scene(a1, ghost=False, size=(64, 48), floor=FLOOR, terrain=ground).model
    data, hit = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_forward(model, data)
    for x, y in np.random.default_rng(0).uniform(-4.0, 4.0, (20, 2)):
        start, down = np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0])
        found = 5.0 - mujoco.mj_ray(model, data, start, down, None, 1, int(model.jnt_bodyid[0]), hit)
        assert found == pytest.approx(float(ground.height(x, y)), abs=1e-3)
