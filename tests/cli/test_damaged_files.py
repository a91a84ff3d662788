"""What fuzzing found (`benchmarks/fuzz.py`): one line and status 2, quickly, and nothing left in the working folder."""

import json
import struct
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.running import Run
from clips.sample_files import save_motion
from fastmimic.control.config import FILE_FORMAT
from fastmimic.deploy.log import PERIODS, ROW
from fastmimic.deploy.log_file import LogFile


def with_arrays(path: Path, **changed: Any) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **arrays | changed)


def deployment(folder: Path, meta: dict[str, Any], kind: np.dtype[Any] = ROW) -> str:
    content = save_motion(folder / "motion.npz").read_bytes()
    log = LogFile(folder / "log.mcap", {PERIODS: kind}, 5, {"motion.npz": content}, meta)
    log.add_rows(np.arange(5), {PERIODS: np.zeros(5, kind)})
    log.end({})
    return "log.mcap"


def motion(folder: Path, **changed: Any) -> str:
    with_arrays(save_motion(folder / "motion.npz"), **changed)
    return "motion.npz"


def text(name: str, content: str) -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        (folder / name).write_text(content)
        return name

    return make


def picture(folder: Path) -> str:
    """A PNG that says it is 100,000 pixels wide and high."""
    head = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 0, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(b"\0\0")), (b"IEND", b""))
    chunks = (struct.pack(">I", len(d)) + kind + d + struct.pack(">I", zlib.crc32(kind + d)) for kind, d in parts)
    (folder / "hills.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    return "hills.png"


def heights(folder: Path) -> str:
    np.save(folder / "hills.npy", np.zeros((3000, 3000), bool))
    return "hills.npy"


def a1(folder: Path, *added: str, times: int = 1) -> str:
    """An A1 with further elements in its trunk."""
    tree = ElementTree.fromstring(resources.files("fastmimic.robot").joinpath("a1.xml").read_text(encoding="utf-8"))
    trunk = tree.find("worldbody/body")
    assert trunk is not None
    for _ in range(times):
        trunk.extend(ElementTree.fromstring(part) for part in added)
    ElementTree.ElementTree(tree).write(folder / "robot.xml")
    return "robot.xml"


CONFIG = json.dumps({**FILE_FORMAT, "base": []})
HUGE = json.dumps({**FILE_FORMAT, "stance": {"friction": 10**400}})
FAR = np.full((5, 4, 3), 1e16)
GEOM = '<geom size=".01"/>'
FACTS = dict.fromkeys(("robot", "motion", "driver", "method", "foot_force"), "x") | {"config": {}, "latency_s": 0.0}
FILES: dict[str, tuple[Callable[[Path], str], str, str]] = {
    "limits": (text("l.toml", "qp_failures = nan"), "deploy stand --driver sim --limits", "NaN is no finite number"),
    "limits nested": (text("l.toml", "a = " + "[" * 3000), "deploy stand --driver sim --limits", "cannot be read as"),
    "limits too large": (text("l.toml", "tilt = " + "9" * 400), "deploy stand --driver sim --limits", "finite"),
    "base": (text("c.json", CONFIG), "evaluate trot --config", "unknown base '[]'; there are default, paper"),
    "number": (text("c.json", HUGE), "evaluate trot --config", "is no finite number"),
    "version": (lambda folder: motion(folder, format_version=np.str_("x")), "inspect", "format version x"),
    "motion's feet": (lambda folder: motion(folder, foot_pos_b=FAR), "evaluate", "is not finite at sample 0, or"),
    "motion's rate": (lambda folder: motion(folder, rate_hz=1e155), "inspect", "rate_hz must be in 1 to 10000, found"),
    "log without": (
        lambda folder: deployment(folder, {"rate_hz": 500.0}),
        "evaluate",
        "missing required field `robot`",
    ),
    "log rate": (
        lambda folder: deployment(folder, FACTS | {"rate_hz": [500]}),
        "identify",
        "got `array` - at `$.rate_hz`",
    ),
    "log slow": (
        lambda folder: deployment(folder, FACTS | {"rate_hz": 1e-320}),
        "evaluate",
        "Expected `float` >= 1.0 - at `$.rate_hz`",
    ),
    "log result": (
        lambda folder: deployment(folder, FACTS | {"rate_hz": 500.0, "result": None}),
        "evaluate",
        "got `null` - at `$.result`",
    ),
    "log version": (
        lambda folder: deployment(folder, {}, np.dtype([("time_s", "f8")])),
        "identify",
        "rows of another version of FastMimic",
    ),
    "picture": (picture, "evaluate trot --terrain", "cannot be read as a height field"),
    "heights": (heights, "evaluate trot --terrain", "it has 9000000 points, more than the 4000000"),
    "geoms": (lambda folder: a1(folder, GEOM, times=200_000), "robots", "more than 5000 elements"),
    "replicas": (
        lambda folder: a1(folder, f'<replicate count="100"><replicate count="100">{GEOM}</replicate></replicate>'),
        "robots",
        "more than 5000 elements, copies counted",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILES)
def test_one_line(kind: str, run: Run, in_folder: Path) -> None:
    make, command, said = FILES[kind]
    name = make(in_folder)
    before = sorted(in_folder.iterdir())
    error = run(*command.split(), name).error
    assert said in error
    assert name in error or name == "l.toml" or kind == "number"
    assert sorted(in_folder.iterdir()) == before


def test_a_few_copies_are_no_harm(run: Run, in_folder: Path) -> None:
    light = '<geom size=".01" mass="0" contype="0" conaffinity="0"/>'
    assert run("robots", a1(in_folder, f'<replicate count="20" offset="0 0 .01">{light}</replicate>')).status == 0


def test_a_clip_of_a_moment_is_refused(run: Run, in_folder: Path) -> None:
    from clips.sample_files import keypoint_text

    (in_folder / "clip.txt").write_text(keypoint_text(12))
    assert "retargeting needs at least 8 frames" in run("inspect", "clip.txt", "--fps", "9000").error


def test_a_name_longer_than_names_are_is_no_source(run: Run) -> None:
    assert run("inspect", "x" * 5000).status == 2
    assert run("library", "build", "x/" + "y" * 5000, "--out", "library").status == 2


def test_warnings_of_mujoco_are_logged_and_not_written(
    in_folder: Path, a1: Any, caplog: pytest.LogCaptureFixture
) -> None:
    import mujoco

    from fastmimic.simulation.mujoco_sim import build_model

    model = build_model(a1)
    data = mujoco.MjData(model)
    data.qvel[0] = 1e15
    with caplog.at_level("WARNING", "fastmimic"):
        mujoco.mj_step(model, data)
    assert "The simulation is unstable" in caplog.text
    assert not list(in_folder.iterdir())
