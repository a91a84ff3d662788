"""Videos: what is in them, and what happens when they cannot be made."""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from video_files import RATE_HZ, read_video, stream_facts

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.render import video
from fastmimic.render.offscreen import Offscreen, in_any_thread
from fastmimic.render.tracks import Track, resample
from fastmimic.render.video import render_video
from fastmimic.robot import Robot

SIZE = (320, 180)
Walk = Callable[..., Track]


@pytest.mark.usefixtures("opengl")
def test_video_has_the_length_size_and_format_asked_for(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "video.mp4"
    done = []
    info = render_video(
        a1, [walk(0.4)], path, rate_hz=RATE_HZ, fps=25, size=SIZE, progress=lambda i, n: done.append((i, n))
    )
    assert info is not None
    assert (info.frames, info.seconds) == (10, 0.4)
    assert done == [(i, 10) for i in range(1, 11)]
    assert read_video(path).shape == (10, 180, 320, 3)
    assert "h264" in stream_facts(path)
    assert "yuv420p" in stream_facts(path)  # what browsers and slides can play
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.usefixtures("opengl")
@pytest.mark.skipif(not in_any_thread(), reason="contexts of this OpenGL belong to one thread")
def test_frames_are_the_same_however_many_draw_them(
    a1: Robot, walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    track = replace(walk(0.3), ghost=walk(0.3, offset_m=0.1).pose)
    made = []
    for cores in (0, 8):  # one paints, or as many as ever do
        monkeypatch.setattr(video, "available_cores", lambda cores=cores: cores)
        path = tmp_path / f"{cores}.mp4"
        render_video(a1, [track, track], path, rate_hz=RATE_HZ, fps=25, size=SIZE)
        made.append(read_video(path))
    assert len(made[0]) == 8
    following = np.diff(made[0].astype(int), axis=0) != 0
    assert following.mean(axis=(1, 2, 3)).min() > 0.05  # they differ from each other
    # an OpenGL context may draw a single edge otherwise than another one, and the encoder spreads that over a block
    assert (made[0] != made[1]).mean(axis=(1, 2, 3)).max() < 0.005


@pytest.mark.usefixtures("opengl")
def test_a_failure_while_drawing_is_told_and_leaves_no_file(
    a1: Robot, walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(view: object, frame: int) -> None:
        if frame == 3:
            raise RuntimeError("no such scene")

    monkeypatch.setattr(video.CameraView, "frame", fail)
    monkeypatch.setattr(Offscreen, "draw", lambda self, scenes, columns: np.zeros((180, 320, 3), np.uint8))
    with pytest.raises(RuntimeError, match="no such scene"):
        render_video(a1, [walk(0.3)], tmp_path / "v.mp4", rate_hz=RATE_HZ, fps=25, size=SIZE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("opengl")
def test_the_robot_is_in_the_picture_and_moves(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    render_video(a1, [walk(0.4)], tmp_path / "v.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE)
    frames = read_video(tmp_path / "v.mp4").astype(int)
    middle = frames[0, 45:150, 80:240]
    assert np.mean(middle.max(axis=-1) < 90) > 0.04  # the dark trunk and legs; the ground is light
    assert np.mean(frames[0, :20, 60:].min(axis=-1) > 150) > 0.9  # nothing dark above: no black sky
    assert np.mean(np.abs(frames[3] - frames[0])) > 2


@pytest.mark.usefixtures("opengl")
def test_two_tracks_stand_side_by_side_each_with_its_words(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    still = walk(0.2)
    bent = replace(still, pose=still.pose + np.repeat([0.0, 0.5], (7, 12)), title="after", caption="reward 0.84")
    render_video(a1, [still, bent], tmp_path / "v.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE)
    first = read_video(tmp_path / "v.mp4")[0].astype(int)
    left, right = first[:, :156], first[:, 164:]
    assert all(np.mean(half[45:150].max(axis=-1) < 90) > 0.02 for half in (left, right))
    assert np.mean(np.abs(left[45:150] - right[45:150, :156])) > 3
    words = (slice(4, 30), slice(4, 60))
    assert left[words].std() < 15 < right[words].std()  # bare ground against a plate with letters


@pytest.mark.usefixtures("opengl")
def test_the_demonstration_shows_as_a_green_ghost(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    plain, apart = walk(0.1), walk(0.1, offset_m=0.3)
    shots = []
    for name, track in (("plain", plain), ("ghost", replace(plain, ghost=apart.pose))):
        render_video(a1, [track], tmp_path / f"{name}.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE)
        shots.append(read_video(tmp_path / f"{name}.mp4")[0, 30:150].astype(int))

    def green(shot: np.ndarray) -> float:
        return float(np.mean(shot[..., 1] - shot[..., 0] > 25))

    assert green(shots[0]) < 0.002
    assert green(shots[1]) > 0.02


@pytest.mark.usefixtures("opengl")
def test_only_the_tracks_that_have_a_ghost_show_one(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    plain = walk(0.1)
    haunted = replace(plain, ghost=walk(0.1, offset_m=0.3).pose)
    render_video(a1, [plain, haunted], tmp_path / "v.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE)
    first = read_video(tmp_path / "v.mp4")[0, 30:150].astype(int)
    green = first[..., 1] - first[..., 0] > 25
    assert green[:, :156].mean() < 0.002
    assert green[:, 164:].mean() > 0.02


@pytest.mark.usefixtures("opengl")
def test_slow_motion_takes_more_frames_of_the_same_motion(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    info = render_video(a1, [walk(0.4)], tmp_path / "v.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE, slow_motion=4)
    assert info is not None
    assert info.frames == 16


@pytest.mark.usefixtures("opengl")
def test_one_pose_makes_one_frame_and_panels_may_differ_in_length(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    single = walk(1 / RATE_HZ)
    info = render_video(a1, [single], tmp_path / "one.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE)
    assert info is not None
    assert info.frames == 1
    info = render_video(a1, [single, walk(0.3)], tmp_path / "two.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE)
    assert info is not None
    assert info.frames == 3


@pytest.mark.usefixtures("opengl")
def test_three_tracks_make_a_grid_whose_last_cell_is_blank(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    render_video(a1, [walk(0.1)] * 3, tmp_path / "v.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE, clock=False)
    first = read_video(tmp_path / "v.mp4")[0].astype(int)
    cells = [first[y : y + 82, x : x + 152] for y in (4, 94) for x in (4, 164)]
    dark = [np.mean(cell.max(axis=-1) < 90) for cell in cells]
    assert all(share > 0.02 for share in dark[:3])
    assert np.ptp(cells[3], axis=(0, 1)).max() < 16  # the encoder's, where a robot would be 150
    np.testing.assert_allclose(cells[0], cells[2], atol=60)  # the same robot, the same camera


@pytest.mark.usefixtures("opengl")
def test_a_gif_plays_for_ever_in_few_colours(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    info = render_video(a1, [walk(0.3)], tmp_path / "v.gif", rate_hz=RATE_HZ, fps=20, size=(161, 91))
    assert info is not None
    with Image.open(tmp_path / "v.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"], gif.info["duration"]) == (info.frames, (161, 91), 0, 50)
        assert (info.frames, info.seconds) == (6, 0.3)
    assert np.mean(read_video(tmp_path / "v.gif")[0].max(axis=-1) < 90) > 0.02
    assert [path.name for path in tmp_path.iterdir()] == ["v.gif"]
    with pytest.raises(
        ConfigError, match="a GIF of 20 frames of 2000 x 2000 would be enormous; make it smaller, short"
    ):
        render_video(a1, [walk(1.0)], tmp_path / "v.gif", rate_hz=RATE_HZ, size=(2000, 2000))


@pytest.mark.usefixtures("opengl")
def test_a_webm_is_vp9(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    render_video(a1, [walk(0.2)], tmp_path / "v.webm", rate_hz=RATE_HZ, fps=10, size=SIZE)
    assert "vp9" in stream_facts(tmp_path / "v.webm")
    assert read_video(tmp_path / "v.webm").shape == (2, 180, 320, 3)


@pytest.mark.usefixtures("opengl")
def test_high_quality_has_smooth_edges_and_a_mirror_image(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    shots = {}
    for quality in ("preview", "high"):
        path = tmp_path / f"{quality}.mp4"
        render_video(a1, [walk(0.1)], path, rate_hz=RATE_HZ, fps=10, size=SIZE, quality=quality, clock=False)
        shots[quality] = read_video(path)[0].astype(int)
    steps = {q: np.abs(np.diff(shot[45:150, 80:240].sum(axis=-1), axis=1)) for q, shot in shots.items()}
    assert np.mean(steps["high"] > 200) < np.mean(steps["preview"] > 200)
    ground = {q: shot[80:140, 60:260].sum(axis=-1) for q, shot in shots.items()}
    shadow = {q: np.mean((g > 200) & (g < 420)) for q, g in ground.items()}
    assert all(0.02 < share < 0.5 for share in shadow.values())  # between the robot's black and the ground


@pytest.mark.usefixtures("opengl")
def test_loaded_feet_are_marked_and_leave_trails(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    stands = replace(walk(0.4), contact=np.tile([True, False, False, False], (20, 1)))
    coloured = {}
    for name, track, marks in (("marks", stands, True), ("air", walk(0.4), True), ("bare", stands, False)):
        render_video(a1, [track], tmp_path / f"{name}.mp4", rate_hz=RATE_HZ, fps=10, size=SIZE, marks=marks)
        last = read_video(tmp_path / f"{name}.mp4")[-1, 30:160].astype(int)
        orange = np.mean((last[..., 0] - last[..., 2] > 90) & (last[..., 0] > 150))  # the right front leg's colour
        blue = np.mean((last[..., 2] - last[..., 0] > 60) & (last[..., 2] > 120))  # the left front leg's
        coloured[name] = (orange, blue)
    assert coloured["marks"][0] > 1.3 * coloured["bare"][0]  # there is an orange stripe on the trunk as well
    assert coloured["air"][1] > 5 * coloured["bare"][1] + 1e-3


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("quality", ["preview", "high"])
def test_a_loop_ends_on_the_ground_on_which_it_begins(a1: Robot, walk: Walk, tmp_path: Path, quality: str) -> None:
    still = walk(1.6)
    still.pose[:, 7:] = still.pose[0, 7:]
    differences = []
    for loop_m in (0.7, None):  # at 1 m/s: the frame after the loop's last is its first
        render_video(
            a1,
            [still],
            tmp_path / "v.mp4",
            rate_hz=RATE_HZ,
            fps=10,
            size=SIZE,
            quality=quality,
            marks=False,
            clock=False,
            window_s=(0.4, 1.2),
            loop_m=loop_m,
        )
        frames = read_video(tmp_path / "v.mp4").astype(int)
        assert len(frames) == 8
        differences.append(np.mean(np.abs(frames[7, 100:] - frames[0, 100:])))
    assert differences[0] < 3 < differences[1]


def test_resampling_interpolates_between_samples(walk: Walk) -> None:
    track = walk(0.1)
    poses = resample(track.pose, RATE_HZ, np.array([0.0, 0.5, 1.0]) / RATE_HZ)
    np.testing.assert_allclose(poses[:, 0], np.array([0.0, 0.5, 1.0]) / RATE_HZ, atol=1e-12)
    np.testing.assert_allclose(poses[1, 7:], track.pose[:2, 7:].mean(axis=0), atol=1e-12)


def test_resampling_takes_the_short_way_between_quaternions_of_opposite_sign(walk: Walk) -> None:
    pose = walk(0.1).pose
    pose[:, 3:7] *= np.array([1, -1, 1, -1, 1])[:, None]
    poses = resample(pose, RATE_HZ, np.array([0.5]) / RATE_HZ)
    np.testing.assert_allclose(np.abs(poses[0, 3:7]), [1, 0, 0, 0], atol=1e-12)


def test_a_fall_holds_the_last_pose_before_it(walk: Walk) -> None:
    track = walk(0.2)
    fallen = track.pose.copy()
    fallen[4:, 10] = np.nan
    poses = resample(fallen, RATE_HZ, np.array([0.06, 0.08, 0.19, 5.0]))
    np.testing.assert_allclose(poses, np.tile(poses[0], (4, 1)), atol=1e-12)
    np.testing.assert_allclose(poses[0, 7:], track.pose[3, 7:], atol=1e-12)


@pytest.mark.usefixtures("opengl")
def test_an_interrupted_video_leaves_the_earlier_one_untouched(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(b"earlier")

    def interrupt(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_video(a1, [walk(0.4)], path, rate_hz=RATE_HZ, fps=10, size=SIZE, progress=interrupt)
    assert path.read_bytes() == b"earlier"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.usefixtures("opengl")
def test_a_place_that_cannot_be_written_is_one_clear_error(a1: Robot, walk: Walk, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(OutputError, match=r"file/v\.mp4: cannot be written"):
        render_video(a1, [walk(0.1)], tmp_path / "file" / "v.mp4", rate_hz=RATE_HZ, size=SIZE)
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        render_video(a1, [walk(0.1)], tmp_path / "folder.mp4", rate_hz=RATE_HZ, size=SIZE)
    with pytest.raises(OutputError, match=r"must end in \.mp4 or \.gif or \.webm"):
        render_video(a1, [walk(0.1)], tmp_path / "v.avi", rate_hz=RATE_HZ, size=SIZE)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.mp4"]


@pytest.mark.usefixtures("opengl")
def test_an_encoder_that_fails_is_one_clear_error_and_leaves_nothing(
    a1: Robot, walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fastmimic.render.encoding._encode", lambda *_: ("-c:v", "no_such_codec"))
    with pytest.raises(OutputError, match=r"v\.mp4: the video encoder .*Encoder not found"):
        render_video(a1, [walk(0.1)], tmp_path / "v.mp4", rate_hz=RATE_HZ, size=SIZE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate_hz": 0.0}, "rate_hz must be positive, found 0"),
        ({"fps": float("nan")}, "fps must be positive, found nan"),
        ({"slow_motion": -1.0}, "slow_motion must be positive, found -1"),
        ({"size": (321, 180)}, "even width and height, found 321 x 180"),
        ({"quality": "hihg"}, "unknown quality 'hihg'; there are preview, high.*did you mean 'high'"),
        ({"columns": 2}, "1 panels cannot stand in 2 columns"),
        ({"window_s": (1.0, 2.0)}, "nothing is between 1 and 2 s of tracks of 0.07 s"),
    ],
)
def test_settings_out_of_range_say_what_was_found(
    a1: Robot, walk: Walk, tmp_path: Path, change: dict, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        render_video(a1, [walk(0.1)], tmp_path / "v.mp4", **{"rate_hz": RATE_HZ, "size": SIZE, **change})
    for count in (0, 5):
        with pytest.raises(ConfigError, match=f"a video shows 1 to 4 tracks, found {count}"):
            render_video(a1, [walk(0.1)] * count, tmp_path / "v.mp4", rate_hz=RATE_HZ)
    assert not list(tmp_path.iterdir())


def test_tracks_that_do_not_fit_are_refused(walk: Walk) -> None:
    track = walk(0.1)
    with pytest.raises(ConfigError, match=r"needs poses \(t, 19\) with t ≥ 1, found \(5, 18\)"):
        replace(track, pose=track.pose[:, :-1])
    with pytest.raises(ConfigError, match="a ghost has 10 samples; its track has 5"):
        replace(track, ghost=walk(0.2).pose)
    with pytest.raises(ConfigError, match="first pose is not finite"):
        replace(track, pose=np.full((5, 19), np.nan))
    with pytest.raises(ConfigError, match=r"needs contacts \(5, 4\), found \(4, 4\)"):
        replace(track, contact=np.ones((4, 4), bool))


def test_without_opengl_there_is_a_warning_and_no_video(
    a1: Robot, walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert render_video(a1, [walk(0.1)], tmp_path / "v.mp4", rate_hz=RATE_HZ, size=SIZE) is None
    assert not list(tmp_path.iterdir())
    assert len(caplog.records) == 1
    assert "v.mp4 was not written: no OpenGL here" in caplog.text


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_no_display_and_mujoco_imported_first_still_draws(tmp_path: Path) -> None:
    """MuJoCo reads MUJOCO_GL when it is imported, long before a video is wanted."""
    script = f"""
import mujoco, numpy as np
from fastmimic.robot import load_robot
from fastmimic.render.tracks import Track
from fastmimic.render.video import render_video
robot = load_robot("a1")
track = Track(np.array([[0, 0, 0.3, 1.0, 0, 0, 0, *robot.home_joint_pos]]))
assert render_video(robot, [track], {str(tmp_path / "v.mp4")!r}, rate_hz=50, size=(64, 48)).frames == 1
"""
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
    environment = {k: v for k, v in os.environ.items() if k not in hidden}
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""  # nothing for the user to worry about
    assert read_video(tmp_path / "v.mp4").shape == (1, 48, 64, 3)
