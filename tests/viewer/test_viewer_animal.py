"""The animal's keypoints beside the robot."""

import dataclasses

import numpy as np

from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import KEYPOINTS
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import Animal
from fastmimic.retargeting.retarget import choose_scale
from fastmimic.robot import Robot
from fastmimic.viewer.take import Take, animal_beside, bone_segments


def test_the_animal_keeps_its_shape_and_the_robots_place(take: Take, trot: Motion, a1: Robot) -> None:
    clip = open_clip("trot", robot=a1)
    animal = Animal(clip, a1, trot)
    scale = choose_scale(clip, a1)
    for frame in (0, clip.n_frames // 2):
        points = animal.points[frame]
        shape = np.linalg.norm(points[:, None] - points[None], axis=-1)
        original = np.linalg.norm(clip.points_w[frame][:, None] - clip.points_w[frame][None], axis=-1)
        np.testing.assert_allclose(shape, scale * original, atol=1e-9)
    row, aside = 150, -0.7
    placed = animal_beside(animal, take, row, aside)
    reference = take.reference[row]
    yaw = float(yaw_from_quat(take.reference[0, 3:7]))
    middle = rotate_planar(-yaw, placed[:2, :2].mean(axis=0) - reference[:2])
    np.testing.assert_allclose(middle, [0.0, aside], atol=0.01)
    turned = take.reference.copy()
    turned[1:, 3:7] = quat_multiply(quat_from_yaw(1.0), turned[1:, 3:7])
    after = animal_beside(animal, dataclasses.replace(take, reference=turned), row, aside)
    np.testing.assert_allclose(after[:2].mean(axis=0), placed[:2].mean(axis=0), atol=0.01)  # it stays where it is
    spines = [points[1, :2] - points[0, :2] for points in (placed, after)]  # and turns with the robot
    np.testing.assert_allclose(rotate_planar(1.0, spines[0]), spines[1], atol=1e-9)
    assert bone_segments(placed).shape == (len(KEYPOINTS.bones), 2, 3)


def test_animal_and_robot_lift_the_same_feet(trot: Motion, a1: Robot) -> None:
    animal = Animal(open_clip("trot", robot=a1), a1, trot)
    heights = np.array([animal.at(animal.points, sample)[6:10, 2] for sample in range(trot.n_samples)])
    for leg in range(4):
        stands = trot.contact[:, leg]
        assert heights[~stands, leg].max() > 3 * heights[stands, leg].mean()
