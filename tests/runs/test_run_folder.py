"""The folder of a run: its name, its JSON, and that a run that fails leaves it as it was."""

import json
import subprocess
import sys
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastmimic.base.errors import CheckpointError, ConfigError, OutputError
from fastmimic.base.files import write_json
from fastmimic.clips.catalogue import open_clip
from fastmimic.imitation.imitate import imitate
from fastmimic.imitation.methods import METHODS
from fastmimic.optimize.parameters import Parameter
from fastmimic.render.tracks import AnimalTrack, Track
from fastmimic.report.figures import write_video
from fastmimic.runs.loading import load_motion
from fastmimic.runs.work_folder import RunFolder, default_folder, open_run

CONFIG = {"arguments": {"motion": "trot", "seed": 0}}


def new_run(path: Path) -> AbstractContextManager[RunFolder]:
    return open_run(path, CONFIG, CONFIG["arguments"], resume=False, overwrite=False)


def test_json_has_null_for_what_it_cannot_say(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": float("nan"), "b": [1.5, float("inf")], "c": {"d": (True, None)}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": None, "b": [1.5, None], "c": {"d": [True, None]}}


HELD = """
import sys
from pathlib import Path
from fastmimic.runs.work_folder import open_run
with open_run(Path(sys.argv[1]), {"arguments": {}}, {}, resume=False, overwrite=False):
    print("in", flush=True)
    sys.stdin.read()
"""


def test_two_at_once_do_not_work_in_one_folder(tmp_path: Path) -> None:
    path, pipe = tmp_path / "run", subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", HELD, str(path)], stdin=pipe, stdout=pipe, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "in\n"
        before = sorted(path.iterdir())
        for options in ({"resume": False, "overwrite": True}, {"resume": False, "overwrite": False}):
            with pytest.raises(OutputError, match="another process works in it"), open_run(path, {}, {}, **options):
                pass
        assert sorted(path.iterdir()) == before
        other.kill()
    assert sorted(path.iterdir()) == before, "a lock is no file that a killed process leaves behind"
    with open_run(path, CONFIG, {}, resume=False, overwrite=True) as folder:
        assert folder.path == path


def test_the_first_name_that_is_not_taken(tmp_path: Path) -> None:
    assert default_folder(tmp_path, "run", resume=False) == tmp_path / "run"
    for name in ("run", "run-2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
    assert default_folder(tmp_path, "run", resume=False) == tmp_path / "run-3"
    (tmp_path / "run-3").mkdir()
    assert default_folder(tmp_path, "run", resume=False) == tmp_path / "run-3"


def test_resuming_takes_the_last_name_with_a_checkpoint(tmp_path: Path) -> None:
    assert default_folder(tmp_path, "run", resume=True) == tmp_path / "run"
    for name, file in (("run", "checkpoint.npz"), ("run-2", "checkpoint.npz"), ("run-3", "metrics.json")):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).touch()
    assert default_folder(tmp_path, "run", resume=True) == tmp_path / "run-2"


def test_a_run_that_fails_leaves_no_trace(tmp_path: Path) -> None:
    def work(folder: RunFolder) -> None:
        assert json.loads((folder.path / "config.json").read_text()) == CONFIG
        raise OutputError("full")

    with pytest.raises(OutputError, match="full"), new_run(tmp_path / "a" / "b") as folder:
        work(folder)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_fails_late_keeps_its_checkpoint(tmp_path: Path) -> None:
    def work(folder: RunFolder) -> None:
        folder.checkpoint.touch()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), new_run(tmp_path / "a") as folder:
        work(folder)
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"config.json", "checkpoint.npz"}


def test_an_unfinished_run_is_not_begun_anew_without_a_word(tmp_path: Path) -> None:
    with new_run(tmp_path) as folder:
        folder.checkpoint.write_bytes(b"hours")
    with pytest.raises(OutputError, match="unfinished; go on with it by --resume"), new_run(tmp_path):
        pass
    assert folder.checkpoint.read_bytes() == b"hours"
    with open_run(tmp_path, CONFIG, CONFIG["arguments"], resume=False, overwrite=True):
        pass


def test_a_failing_rerun_keeps_the_results_and_their_config(tmp_path: Path) -> None:
    write_json(tmp_path / "config.json", {**CONFIG, "first": True})
    write_json(tmp_path / "metrics.json", {})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(KeyboardInterrupt), new_run(tmp_path):
        raise KeyboardInterrupt
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("resume", "overwrite", "error"),
    [(False, False, OutputError), (True, True, ConfigError), (True, False, CheckpointError)],
)
def test_refusals(tmp_path: Path, resume: bool, overwrite: bool, error: type[Exception]) -> None:
    write_json(tmp_path / "config.json", {"arguments": {"motion": "pace", "seed": 0}})
    with (
        pytest.raises(error),
        open_run(tmp_path, CONFIG, CONFIG["arguments"], resume=resume, overwrite=overwrite),
    ):
        pytest.fail("the folder was opened")


@pytest.mark.parametrize(("amplitude", "title"), [(1.0, "fitted"), (1.1, "optimised")])
def test_the_video_says_when_a_search_has_gained_nothing(
    amplitude: float, title: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: Any = {"history": object(), "parameters": (Parameter("FR_foot_z.amplitude", "1", 0.8, 1.2, 1.0),)}
    result = replace(imitate("trot", method="mbc", duration_s=0.1), values=np.array([amplitude]), **searched)
    shown: list[Track] = []
    monkeypatch.setattr("fastmimic.report.figures.render_video", lambda robot, tracks, *_, **__: shown.extend(tracks))
    write_video(result, RunFolder.at(tmp_path))
    assert shown[-1].title == f"with: executable, {title}"


@pytest.mark.parametrize(
    ("method", "optimised", "searched", "title"),
    [
        ("mbc", False, False, "not optimised"),
        ("lh", True, False, "as its motions were optimised"),
        ("mbc-dmp", True, True, "optimised"),
    ],
)
def test_the_video_says_what_it_shows(
    method: str, optimised: bool, searched: bool, title: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The animal, where there is a clip, the robot without the method, and with it. A stitched motion may be of
    optimised ones, even if the method of the whole optimises nothing."""
    motion = load_motion("trot")
    result = imitate(motion, method="mbc", duration_s=0.1)
    stands_for = replace(motion, demonstration=motion) if optimised else motion
    history = object() if searched else None
    result = replace(result, motion=stands_for, method=method, history=history)  # type: ignore[arg-type]
    shown: list[Track] = []
    monkeypatch.setattr("fastmimic.report.figures.render_video", lambda robot, tracks, *_, **__: shown.extend(tracks))
    write_video(result, RunFolder.at(tmp_path), clip=open_clip("trot"))
    animal, without, with_it = shown
    assert isinstance(animal, AnimalTrack)
    assert (animal.title, animal.caption) == ("the animal", "trot")
    assert without.title == "without: the animal's motion as it is"
    assert without.caption.startswith(f"trot · {METHODS[method].unoptimised.label} · reward 0.")
    assert with_it.title == f"with: executable, {title}"
    assert with_it.caption == f"trot · {METHODS[method].label} · reward {result.after.reward_animal[0]:.2f}"
    assert len({len(track.pose) for track in shown}) == 1
    shown.clear()
    write_video(result, RunFolder.at(tmp_path))
    assert [track.title for track in shown] == [without.title, with_it.title]
    kinematic = replace(result, motion=replace(stands_for, animal=None, demonstration=None))
    shown.clear()
    write_video(kinematic, RunFolder.at(tmp_path))
    assert [track.title for track in shown] == ["optimised" if searched else "not optimised"]
