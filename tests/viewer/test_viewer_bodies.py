"""The robot's meshes, and where they are put."""

import mujoco
import numpy as np
import pytest

from fastmimic.episode.rollout import Rollout
from fastmimic.render.video_scene import GHOST_GROUP, GHOST_RGBA, build_video_scene
from fastmimic.robot import Robot, load_robot
from fastmimic.simulation.mujoco_sim import build_model
from fastmimic.viewer.bodies import Puppet, surface
from fastmimic.viewer.take import Take


def test_bodies_are_where_the_log_says(take: Take, rollout: Rollout, a1: Robot) -> None:
    log = rollout.log
    assert log is not None
    puppet = Puppet(a1)
    model = build_model(a1)  # the simulation's own, not that of the pictures
    data = mujoco.MjData(model)
    names = [body.name for body in puppet.bodies]
    assert names == [body.name for body in puppet.ghost_bodies]
    assert len(names) == 13
    for row in (0, 200, take.rows - 1):
        robot, ghost = puppet.place(take.pose[row], take.reference[row])
        assert ghost is not None
        for source, placed in ((log.observation[0, row], robot), (log.demonstration[0, row], ghost)):
            data.qpos[:3], data.qpos[3:7] = source["root_pos"], source["root_quat"]
            joints = [model.joint(name).id for name in a1.joint_names]
            data.qpos[model.jnt_qposadr[joints]] = source["joint_pos"]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            ids = [model.body(name).id for name in names]
            np.testing.assert_allclose(placed.position, data.xpos[ids], atol=1e-12)
            np.testing.assert_allclose(np.abs(np.sum(placed.wxyz * data.xquat[ids], axis=1)), 1.0, atol=1e-12)
            np.testing.assert_allclose(placed.com, data.subtree_com[ids[0]], atol=1e-12)


@pytest.mark.parametrize("name", ["a1", "go2"])
def test_meshes_fill_the_geoms(name: str) -> None:
    robot = load_robot(name)
    puppet = Puppet(robot)
    model = build_video_scene(robot, ghost=True, size=(64, 64), floor=np.zeros((2, 2))).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for bodies, prefix in ((puppet.bodies, "robot/"), (puppet.ghost_bodies, "ghost/")):
        for body in bodies:
            body_id = model.body(prefix + body.name).id
            groups = (GHOST_GROUP,) if prefix == "ghost/" else (0, 1, 2)
            geoms = [g for g in np.flatnonzero(model.geom_bodyid == body_id) if model.geom_group[g] in groups]
            vertices = np.concatenate([mesh.vertices for mesh, _ in body.parts])
            for g in geoms:  # every geom's centre is within what is drawn
                centre = model.geom_pos[g]
                assert (vertices.min(axis=0) <= centre).all()
                assert (centre <= vertices.max(axis=0)).all()
            reach = max(np.linalg.norm(model.geom_pos[g]) + model.geom_rbound[g] for g in geoms)
            assert np.linalg.norm(vertices, axis=1).max() <= reach + 1e-9
            for mesh, _ in body.parts:
                assert mesh.faces.min() >= 0
                assert mesh.faces.max() < len(mesh.vertices)
    colours = {rgb for body in puppet.ghost_bodies for _, rgb in body.parts}
    assert colours == {tuple(round(255 * c) for c in GHOST_RGBA[:3])}
    assert len({rgb for body in puppet.bodies for _, rgb in body.parts}) > 2


KINDS = """
<mujoco>
  <asset><mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.2 0  0 0 0.1  0.3 0 0.1  0 0.2 0.1"/></asset>
  <worldbody>
    <geom type="sphere" size="0.1"/>
    <geom type="capsule" size="0.1 0.3"/>
    <geom type="cylinder" size="0.1 0.3"/>
    <geom type="ellipsoid" size="0.1 0.2 0.3"/>
    <geom type="box" size="0.1 0.2 0.3"/>
    <geom type="mesh" mesh="wedge"/>
    <geom type="plane" size="1 1 1"/>
  </worldbody>
</mujoco>"""


def test_every_kind_of_geom_has_its_size() -> None:
    model = mujoco.MjModel.from_xml_string(KINDS)
    shares = (np.pi / 6, None, np.pi / 4, np.pi / 6, 1.0, None)  # of the box around it
    for geom, share in enumerate(shares):
        mesh = surface(model, geom)
        assert mesh is not None
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        np.testing.assert_allclose(mesh.bounds, [centre - half, centre + half], atol=1e-6)
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        filled = np.sum(np.cross(a, b) * c) / 6 / np.prod(2 * half)  # closed, and facing outwards
        assert 0.3 < filled < 1.001
        if share is not None:
            assert filled == pytest.approx(share, rel=0.04)
    assert surface(model, 6) is None


def test_edges_are_sharp_and_round_surfaces_smooth() -> None:
    model = mujoco.MjModel.from_xml_string(KINDS)
    for geom, patches in ((0, 1), (1, 1), (2, 3), (3, 1), (4, 6)):
        mesh = surface(model, geom)
        assert mesh is not None
        assert mesh.body_count == patches
