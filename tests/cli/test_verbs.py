"""The other verbs, each on something real."""

import http.server
import json
import re
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path

import pytest

from cli.running import TINY, Run
from clips.sample_files import csv_text, keypoint_text, take_text
from fastmimic.base.registry import Registry
from fastmimic.clips.catalogue import RECORDED, open_clip
from fastmimic.clips.clip import ClipOrigin
from fastmimic.clips.data import Dataset
from fastmimic.clips.synthesis import GAITS, JUMPS
from fastmimic.commands.show import provenance
from fastmimic.control.config import controller_config
from fastmimic.imitation.methods import METHODS, made_with
from fastmimic.motion.motion import Motion
from fastmimic.primitive import MotionDmp
from fastmimic.render.offscreen import NoRendererError, Offscreen
from fastmimic.render.tracks import Track
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.runs.loading import load_motion

EVALUATION_KEYS = {
    *("reward_mean", "reward_std", "components", "fell", "drift_m_per_s"),
    *("swing_clearance_m", "foot_z_rmse_m", "foot_x_rmse_m"),
}


def test_evaluate_json_is_one_object_and_nothing_else(run: Run) -> None:
    done = run("evaluate", "trot", "--duration", "0.6", "--json")
    assert done.status == 0
    found = json.loads(done.out)
    assert set(found) >= EVALUATION_KEYS
    assert 0 < found["reward_mean"] <= 1
    assert found["reward_std"] == 0  # of one episode
    assert len(found["swing_clearance_m"]) == 4


def test_segment_lists_prints_and_draws_what_repeats(run: Run, tmp_path: Path) -> None:
    (tmp_path / "take.txt").write_text(take_text(open_clip("trot"), cycles=4))
    done = run("segment", tmp_path / "take.txt", "--figure", tmp_path / "take.png")
    assert done.status == 0
    assert re.search(r"0:\d+ +trot +trot", done.out)
    assert re.search(r"fastmimic imitate .*take.txt --frames \d+:\d+", done.err)
    assert (tmp_path / "take.png").read_bytes()[:4] == b"\x89PNG"
    (found,) = json.loads(run("segment", tmp_path / "take.txt", "--json").out)["segments"]
    assert set(found) >= {"start", "end", "period_frames", "gait", "confidence", "speed_m_per_s", "yaw_rate_rad_per_s"}
    first, end = found["cycle"]
    again = run("inspect", tmp_path / "take.txt", "--frames", f"{first}:{end}")
    assert again.status == 0


def test_segment_tells_how_to_imitate_what_does_not_repeat(run: Run, data_folder: Path) -> None:
    take = data_folder / "dog_keypoints" / "dog_walk00_joint_pos.txt"
    done = run("segment", take)
    assert re.search(r"35:94 +discrete", done.out)
    assert f"fastmimic imitate {take} --frames 35:94 --discrete" in done.err


def test_segment_refuses_what_is_no_take(run: Run, tmp_path: Path) -> None:
    for arguments, words in (
        (("trott",), "did you mean 'trot'"),
        (("dog:nothing",), "dog:"),
        (("trot", "--figure", tmp_path / "x.gif"), ".png"),
    ):
        done = run("segment", *arguments)
        assert (done.status, len(done.err.strip().splitlines())) == (2, 1)
        assert words in done.err


def test_evaluate_of_several_episodes_depends_on_the_seed_alone(run: Run) -> None:
    def evaluate(seed: int) -> dict:
        done = run("evaluate", "trot", "--duration", "0.6", "--episodes", "3", "--seed", seed, "--json")
        return json.loads(done.out)

    assert evaluate(0) == evaluate(0)
    assert evaluate(0)["reward_mean"] != evaluate(1)["reward_mean"]
    assert evaluate(0)["reward_std"] > 0


def test_evaluate_in_words(run: Run) -> None:
    lines = run("evaluate", "trot", "--duration", "0.6", "--episodes", "2").out.splitlines()
    assert lines[0] == "trot on a1 with mbc, 2 episodes of 0.6 s"
    assert lines[1].startswith("reward against the animal ")
    assert lines[2].startswith("reward ")
    assert "±" in lines[2]


def test_evaluate_by_sensors_says_how_far_the_estimate_is_off(run: Run) -> None:
    options = ("evaluate", "trot", "--duration", "1.5", "--observe", "sensors")
    found = json.loads(run(*options, "--json").out)
    assert 0 < found["estimate_velocity_rmse_m_per_s"] < 0.1
    assert 0 < found["estimate_drift_percent"] < 10
    lines = run(*options).out.splitlines()
    assert any(line.startswith("estimator drift") and line.endswith("% of the distance") for line in lines)
    truthful = json.loads(run("evaluate", "trot", "--duration", "1.5", "--json").out)
    assert not [key for key in truthful if key.startswith("estimate")]
    assert truthful["reward_mean"] != found["reward_mean"]


def test_evaluate_knows_what_can_be_observed(run: Run) -> None:
    done = run("evaluate", "trot", "--observe", "sensor")
    assert done.status == 2
    assert "unknown observation 'sensor'; there are truth, sensors" in done.err


def test_retarget_writes_a_motion_that_the_other_verbs_take(run: Run, in_folder: Path) -> None:
    done = run("retarget", "pace", "--out", "deep/pace.npz")
    assert done.out.splitlines()[0].startswith("scale 0.825; one cycle")
    assert "slip in stance" in done.out
    motion = Motion.load(in_folder / "deep" / "pace.npz")
    assert motion.cycle is not None
    assert run("inspect", "deep/pace.npz").status == 0
    saved, named = (
        json.loads(run("evaluate", source, "--duration", "0.6", "--json").out) for source in ("deep/pace.npz", "pace")
    )
    # another machine's kinematic motion may be in the cache: it differs in the last digit
    assert saved["reward_animal"] == pytest.approx(named["reward_animal"], rel=1e-9)
    assert saved | {"reward_animal": None} == named | {"reward_animal": None}


def test_options_reach_the_clip(run: Run, in_folder: Path) -> None:
    (in_folder / "clip.txt").write_text(keypoint_text(40))
    options = ("--frames", "4:36", "--fps", "50", "--up", "y", "--scale", "0.7", "--no-executable")  # it only glides
    done = run("retarget", "clip.txt", *options, "--out", "o.npz")
    assert done.status == 0, done.err
    motion = Motion.load(in_folder / "o.npz")
    assert "clip: clip.txt, frames 4:36, dog keypoints, scale 0.700, " in provenance(motion)
    meta = motion.provenance.as_dict()
    assert meta["source"]["frames"] == [4, 36]
    assert meta["retarget"]["scale"] == 0.7
    assert meta["retarget"]["before"]["period_s"] == pytest.approx(32 / 50)


def test_a_recordings_line_has_its_frames_once(run: Run, in_folder: Path) -> None:
    assert run("retarget", "pace", "--out", "o.npz").status == 0
    motion = Motion.load(in_folder / "o.npz")
    recorded = ClipOrigin(source="dog/walk.txt frames 162:201", frames=(162, 201), format="keypoints")
    named = replace(motion, provenance=replace(motion.provenance, source=recorded))
    assert ": dog/walk.txt frames 162:201, dog keypoints, scale 0.825, " in provenance(named)


@pytest.mark.slow
def test_inspect_says_what_a_clip_is(run: Run, in_folder: Path) -> None:
    (in_folder / "clip.dat").write_text(keypoint_text(12))
    done = run("inspect", "clip.dat")
    lines = done.out.splitlines()
    assert any(line.startswith("NOT EXECUTABLE no motion of a1 near 'clip' keeps the limits: ") for line in lines)
    assert lines[0] == "format     dog keypoints, 81 columns of text"
    assert lines[1] == "frames     12 at 60 Hz, 0.200 s"
    assert any(line.startswith("assumed    y is up") for line in lines)
    assert any(line.startswith("travel     +0.495 m/s forward") for line in lines)  # 0.6 m/s by 0.825


def test_inspect_of_a_robot_csv(run: Run, in_folder: Path) -> None:
    (in_folder / "clip.csv").write_text(csv_text(40))
    done = run("inspect", "clip.csv")
    assert done.out.startswith("format     retargeted robot motion, 19 columns")


def test_inspect_of_an_optimised_motion_names_its_parameters(run: Run, in_folder: Path) -> None:
    robot = load_robot("a1")
    dmp = MotionDmp.fit(retarget(open_clip("trot"), robot)[0], robot)
    goal, amplitude = dmp.goal, dmp.amplitude
    goal[dmp.index("FR_foot_z")] += 0.0123
    amplitude[dmp.index("RL_foot_z")] = 1.25
    dmp.motion(goal, amplitude).save("changed.npz")
    dmp.motion().save("same.npz")
    lines = run("inspect", "changed.npz").out.splitlines()
    assert lines[-3:] == [
        "optimised  contains its demonstration; these DMP parameters differ from it",
        "  FR_foot_z    baseline +0.0123, amplitude 1.000",
        "  RL_foot_z    baseline +0.0000, amplitude 1.250",
    ]
    assert run("inspect", "same.npz").out.splitlines()[-1].endswith("no DMP parameter differs from it")


def test_inspect_draws(run: Run, in_folder: Path) -> None:
    assert run("inspect", "walk", "--figure", "walk.png").status == 0
    assert (in_folder / "walk.png").read_bytes().startswith(b"\x89PNG")


def test_motions_lists_every_name(run: Run) -> None:
    done = run("motions")
    rows = {line.split()[0]: line for line in done.out.splitlines()[1:]}
    assert set(rows) == {*GAITS, *JUMPS, *RECORDED}
    assert " yes " in rows["trot"]
    assert " no " in rows["dog:pace"]
    assert "'fastmimic data fetch'" in done.err


def test_robots(run: Run) -> None:
    lines = run("robots").out.splitlines()
    assert tuple(line.split()[0] for line in lines[1:]) == ROBOT_NAMES


CONTENT = keypoint_text(40).encode()
DATASET = Dataset(
    name="dog_keypoints",
    about="a stiff dog",
    origin="retarget_motion/data",
    files={"dog_pace_joint_pos.txt": sha256(CONTENT).hexdigest()},
    licence="CC BY-NC 4.0",
    credit="nobody",
)


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A server on this machine that has the dataset of one small file."""
    monkeypatch.setattr("fastmimic.clips.data.DATASETS", Registry("dataset", [DATASET]))
    folder = tmp_path / "served" / DATASET.origin
    folder.mkdir(parents=True)
    (folder / "dog_pace_joint_pos.txt").write_bytes(CONTENT)

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *arguments: object) -> None: ...

    handler = partial(Quiet, directory=str(tmp_path / "served"))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as httpd:
        thread = threading.Thread(target=httpd.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{httpd.server_address[1]}"
        httpd.shutdown()
        thread.join()


def test_data_is_fetched_and_listed(server: str, run: Run, in_folder: Path) -> None:
    assert "dog_keypoints  0 of 1" in run("data", "list", "--folder", "here").out
    done = run("data", "fetch", "--folder", "here", "--base-url", server)
    assert done.status == 0, done.err
    assert "1 files, verified, in here" in done.out
    assert "CC BY-NC 4.0" in done.out
    assert (in_folder / "here/dog_keypoints/dog_pace_joint_pos.txt").read_bytes() == CONTENT
    assert "dog_keypoints  1 of 1" in run("data", "list", "--folder", "here").out


def test_data_with_other_content_is_refused(server: str, run: Run, in_folder: Path) -> None:
    (in_folder / "served" / DATASET.origin / "dog_pace_joint_pos.txt").write_bytes(b"something else")
    done = run("data", "fetch", "--folder", "here", "--base-url", server)
    assert done.status == 2
    assert "SHA-256 differs" in done.err.splitlines()[-1]
    assert not (in_folder / "here/dog_keypoints/dog_pace_joint_pos.txt").exists()


@pytest.fixture
def opengl() -> None:
    """Skips a test where nothing can be drawn."""
    import mujoco

    try:
        Offscreen(mujoco.MjModel.from_xml_string("<mujoco/>")).close()
    except NoRendererError as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("how", [[], ["--kinematic"]])
def test_render(how: list[str], run: Run, in_folder: Path) -> None:
    done = run("render", "trot", *how, "--duration", "0.2", "--size", "160x120", "--out", "trot.mp4")
    assert re.fullmatch(r"6 frames, 0\.2 s, \d\.\d MB, in trot\.mp4\n", done.out)
    assert b"ftyp" in (in_folder / "trot.mp4").read_bytes()[:12]


@pytest.mark.usefixtures("opengl")
def test_render_of_several_motions_by_several_methods_as_a_gif(run: Run, in_folder: Path) -> None:
    some = ("--duration", "0.1", "--size", "160x120", "--frame-rate", "20", "--out", "v.gif")
    done = run("render", "trot", "pace", "trot", "--method", "mbc", "raibert", "lh", *some)
    assert done.out.startswith("2 frames, 0.1 s, ")
    assert (in_folder / "v.gif").read_bytes().startswith(b"GIF89a")


def test_the_verbs_take_what_a_motion_was_optimised_with(
    run: Run, in_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trot = load_motion("trot", load_robot("a1"))
    made_with(trot, "lh-dmp", METHODS["lh-dmp"].configure(controller_config("paper"))).save(in_folder / "m.npz")
    assert "made with  method lh-dmp, controller paper" in run("inspect", "m.npz").out
    assert run("evaluate", "m.npz", "--duration", "0.2").out.startswith("trot on a1 with lh-dmp (paper), 1 episode")
    given = run("evaluate", "m.npz", "--duration", "0.2", "--method", "raibert", "--config", "default").out
    assert given.startswith("trot on a1 with raibert, 1 episode")
    shown: list[Track] = []

    def catch(robot: Robot, tracks: list[Track], *_: object, **__: object) -> None:
        shown.extend(tracks)

    monkeypatch.setattr("fastmimic.render.video.render_video", catch)
    some = ("--duration", "0.2", "--out", "v.mp4")
    run("render", "m.npz", "trot", *some)
    run("render", "m.npz", "--method", "mbc", *some)
    run("render", "m.npz", "--kinematic", *some)
    assert [track.title for track in shown] == 4 * ["trot on a1"]
    assert [track.caption.split(" · ")[0] for track in shown] == [
        "LH-DMP (paper)",
        "MBC",
        "MBC (paper)",
        "as retargeted, no physics",
    ]


def test_render_tells_the_sizes_that_it_takes(run: Run) -> None:
    from fastmimic.render.encoding import GIF_SIZE, HIGH, PREVIEW

    said = " ".join(run("render", "--help").out.replace("│", " ").split())
    sizes = [f"{w}x{h}" for w, h in (PREVIEW.size, HIGH.size, GIF_SIZE)]
    assert f"Default: {sizes[0]}; {sizes[1]} for high quality; {sizes[2]} for a GIF" in said


def test_render_without_opengl_is_an_error(run: Run, monkeypatch: pytest.MonkeyPatch, in_folder: Path) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    done = run("render", "trot", "--kinematic", "--duration", "0.2", "--out", "trot.mp4")
    assert done.status == 2
    assert "there is no OpenGL to draw with; 'fastmimic view' shows the same in a browser" in done.err.splitlines()[-1]
    assert not (in_folder / "trot.mp4").exists()


@pytest.mark.usefixtures("opengl")
def test_imitate_adds_the_video_and_its_time(run: Run, in_folder: Path) -> None:
    done = run("imitate", "trot", *TINY[:-1], "--out", "run")
    assert done.status == 0
    assert b"ftyp" in (in_folder / "run" / "video.mp4").read_bytes()[:12]
    found = json.loads((in_folder / "run" / "metrics.json").read_text())
    assert found["video_s"] > 0


def test_imitate_without_opengl_does_all_but_the_video(
    run: Run, monkeypatch: pytest.MonkeyPatch, in_folder: Path
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    done = run("imitate", "trot", *TINY[:-1], "--out", "run")
    assert done.status == 0
    assert "video.mp4 was not written" in done.err
    assert not (in_folder / "run" / "video.mp4").exists()
    assert (in_folder / "run" / "metrics.json").exists()
