"""The scene as viser holds it, without a browser."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from fastmimic.clips.catalogue import open_clip
from fastmimic.control.config import ControllerConfig
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import Animal
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions, parse_terrain
from fastmimic.viewer.scene import RobotScene, linear
from fastmimic.viewer.take import Take, contact_places, motion_take, rollout_take, smoothed_path
from fastmimic.viewer.viewer import Viewer, default_camera

if TYPE_CHECKING:
    Open = Callable[..., Viewer]

PORT = 8750


@pytest.fixture
def opened(a1: Robot) -> Iterator["Open"]:
    """Opens viewers, and closes them in the end."""
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    viewers: list[Viewer] = []

    def make(shown: list[list[Take]], animal: Animal | None = None) -> Viewer:
        viewers.append(Viewer(a1, shown, "a test", PORT, animal))
        return viewers[-1]

    yield make
    for viewer in viewers:
        viewer.close()


def trunk_of(scene: RobotScene) -> Any:
    """The trunk's node."""
    return scene._bodies[0][0]


def _show(viewer: Viewer, row: int) -> None:
    viewer.player.seek(row)
    viewer.draw(force=True)


def test_all_stands_where_the_log_says(opened: "Open", take: Take) -> None:
    viewer = opened([[take]])
    scene = viewer.robots[0]
    path = smoothed_path(take)
    for row in (0, 300, take.rows - 1):
        _show(viewer, row)
        trunk = trunk_of(scene)
        np.testing.assert_allclose(trunk.position, take.pose[row, :3], atol=1e-9)
        np.testing.assert_allclose(abs(trunk.wxyz @ take.pose[row, 3:7]), 1.0, atol=1e-9)
        np.testing.assert_allclose(scene.root.position[:2], -path[row], atol=1e-9)  # the view follows


def test_runs_are_beside_each_other_and_the_shorter_one_waits(opened: "Open", take: Take) -> None:
    short = dataclasses.replace(take, pose=take.pose[:100], title="short")
    viewer = opened([[short], [take]])
    left, right = viewer.robots
    assert right.root.position[1] - left.root.position[1] > 0.5
    _show(viewer, take.rows - 1)
    np.testing.assert_allclose(trunk_of(left).position, take.pose[99, :3], atol=1e-9)
    np.testing.assert_allclose(trunk_of(right).position, take.pose[-1, :3], atol=1e-9)


def test_episodes_can_be_chosen(opened: "Open", take: Take) -> None:
    other = dataclasses.replace(take, pose=take.pose[::-1].copy(), cycle_starts=np.array([0]))
    viewer = opened([[take, other]])
    viewer.player.speed = 0.5
    _show(viewer, 50)
    viewer.choose(1)
    assert (viewer.player.row, viewer.player.speed, len(viewer.player.cycle_starts)) == (0, 0.5, 1)
    np.testing.assert_allclose(trunk_of(viewer.robots[0]).position, take.pose[-1, :3], atol=1e-9)


def test_a_motion_without_physics_and_the_animal(opened: "Open", trot: Motion, a1: Robot) -> None:
    animal = Animal(open_clip("trot", robot=a1), a1, trot)
    take = motion_take(trot, a1, 2 * trot.period_s, "trot")
    viewer = opened([[take]], animal)
    for row in range(0, take.rows, 97):
        _show(viewer, row)
    scene = viewer.robots[0]
    assert "animal" in scene.layers
    for layer in ("animal", "forces", "ghost"):
        scene.set_layer(layer, False)
    scene.set_opacity(0.3)


def test_the_camera_keeps_all_in_the_picture(a1: Robot) -> None:
    wide, narrow = (default_camera(a1, [-0.5, 0.5], 0.0, aspect) for aspect in (1.5, 0.5))

    assert np.linalg.norm(np.subtract(*narrow)) > 1.5 * np.linalg.norm(np.subtract(*wide))
    assert narrow[1][2] < wide[1][2]
    turned, _ = default_camera(a1, [0.0], np.pi / 2)
    straight, _ = default_camera(a1, [0.0], 0.0)
    np.testing.assert_allclose(turned, [-straight[1], straight[0], straight[2]])


def test_colours_are_decoded_to_linear_light() -> None:
    np.testing.assert_array_equal(linear(np.array([0, 188, 255])), [0, 128, 255])  # 188 is half the light


def test_on_a_terrain_the_view_climbs_and_the_marks_lie_on_it(opened: "Open", trot: Motion, a1: Robot) -> None:
    conditions = Conditions(terrain=parse_terrain("rough=0.03"), seed=2)
    rollout = evaluate(trot, a1, duration_s=0.3, conditions=conditions, log=True).rollout
    take = rollout_take(rollout, trot, a1, ControllerConfig(), "trot")
    assert take.terrain is conditions.ground
    scene = opened([[take]]).robots[0]
    scene.show(take.rows - 1, follow=True)
    assert scene.root.position[2] == pytest.approx(-float(take.ground(smoothed_path(take)[-1])))
    marks = contact_places(take, 5)
    np.testing.assert_allclose(marks[:, 2], conditions.ground.height(*take.feet[5, :, :2].T) + 0.004)  # type: ignore[union-attr]
    assert np.ptp(marks[:, 2]) > 1e-3
