"""The animal as the README's animation shows it."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from readme_animation import AnimalTrack

from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import DOG, KEYPOINTS
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import motion_track
from fastmimic.render.video import render_video
from fastmimic.retargeting.retarget import choose_scale
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion


@pytest.fixture(scope="module")
def trot(a1: Robot) -> Motion:
    return load_motion("trot", a1)


def test_the_animal_goes_where_the_demonstration_goes(a1: Robot, trot: Motion) -> None:
    clip = open_clip("trot", robot=a1)
    track = AnimalTrack.of(clip, a1, trot, 2 * trot.period_s, "animal", "by formula")
    path = motion_track(trot, 2 * trot.period_s)
    assert track.bones == KEYPOINTS.bones
    assert (track.title, track.caption) == ("animal", "by formula")
    middle = track.points[:, :2].mean(axis=1)  # of pelvis and neck
    np.testing.assert_allclose(middle[:, :2], path.pose[:, :2], atol=0.005)
    spine = np.linalg.norm(np.diff(track.points[:, :2], axis=1), axis=-1)
    original = np.linalg.norm(clip.point("neck") - clip.point("pelvis"), axis=-1).mean()
    np.testing.assert_allclose(spine, choose_scale(clip, a1) * original, rtol=0.01)
    assert track.points[..., 2].min() > -0.02
    n = trot.n_samples
    moved = track.points[n:] - track.points[:n]
    np.testing.assert_allclose(moved, np.broadcast_to(moved[0, 0], moved.shape), atol=1e-6)  # whole cycles


def test_a_recorded_dog_has_all_its_bones(a1: Robot) -> None:
    if not Path(os.environ.get("FASTMIMIC_DATA", ""), "dog_keypoints", "dog_walk03_joint_pos.txt").is_file():
        pytest.skip("needs FASTMIMIC_DATA with dog_keypoints")
    clip = open_clip("dog:trot", robot=a1)
    assert clip.skeleton is DOG
    assert clip.drawn_w.shape == (clip.n_frames, 27, 3)
    np.testing.assert_array_equal(clip.drawn_w[:, 3], clip.point("neck"))
    lengths = np.linalg.norm(np.diff(clip.drawn_w[:, np.array(DOG.bones)], axis=2)[:, :, 0], axis=-1)
    assert np.all(lengths.std(axis=0) < 0.02 * lengths.mean(axis=0) + 1e-3), "a bone keeps its length"
    assert lengths.mean(axis=0).max() < 0.4
    scale = choose_scale(clip, a1)
    track = AnimalTrack.of(clip, a1, load_motion(clip, a1), 0.2)
    np.testing.assert_allclose(track.radii, scale * np.array(DOG.radii))
    assert track.points.shape == (100, 27, 3)


def test_an_animal_is_drawn_in_the_robots_place(a1: Robot, trot: Motion, tmp_path: Path) -> None:
    track = AnimalTrack.of(open_clip("trot", robot=a1), a1, trot, 0.2, "animal")
    shown, size = [track, motion_track(trot, 0.2)], (320, 180)
    if render_video(a1, shown, tmp_path / "v.gif", rate_hz=500, fps=10, size=size) is None:
        pytest.skip("there is no OpenGL to draw with")
    picture = np.asarray(Image.open(tmp_path / "v.gif").convert("RGB")).astype(int)
    left, right = np.split(picture[30:150], [160], axis=1)

    def brown(half: np.ndarray) -> float:
        return float(np.mean((half[..., 0] - half[..., 2] > 40) & (half[..., 0] < 200)))

    assert brown(left) > 0.05 > brown(right)
