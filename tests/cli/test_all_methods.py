"""Every method with the verbs that show what it made."""

import contextlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from fastmimic import cli
from fastmimic.control.config import controller_config
from fastmimic.imitation.methods import METHODS, made_with
from fastmimic.robot import load_robot
from fastmimic.runs.loading import load_motion

WITHOUT_POLICY = [name for name, method in METHODS.items() if not method.learned]


def motion_of(method: str, folder: Path) -> Path:
    """A motion that records the method, as if it had been optimised with it."""
    motion = load_motion("trot", load_robot("a1"))
    path = folder / f"{method}.npz"
    made_with(motion, method, METHODS[method].configure(controller_config("default"))).save(path)
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of mbc. Not to be changed."""
    out = tmp_path_factory.mktemp("methods") / "run"
    arguments = ["imitate", "trot", "--method", "mbc", "--no-video", "--duration", "0.3", "--out", str(out)]
    assert cli.main(arguments) == 0
    return out


@pytest.fixture(params=WITHOUT_POLICY)
def run(request: pytest.FixtureRequest, finished: Path, tmp_path: Path) -> Path:
    """The folder of that run, as if it were of another method."""
    method: str = request.param
    folder = Path(shutil.copytree(finished, tmp_path / "run"))
    shutil.copy(motion_of(method, tmp_path), folder / "motion.npz")
    config = json.loads((folder / "config.json").read_text())
    config["arguments"]["method"] = method
    config["controller"] = METHODS[method].configure("default").as_dict()
    (folder / "config.json").write_text(json.dumps(config))
    metrics = json.loads((folder / "metrics.json").read_text())
    (folder / "metrics.json").write_text(json.dumps(metrics | {"method": method}))
    return folder


@pytest.mark.slow
def test_its_run_can_be_reported(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fastmimic.viewer.replay.recorded", lambda episodes: "")  # has tests of its own
    assert cli.main(["report", str(run)]) == 0
    assert "without" not in capsys.readouterr().err, "nothing is missing"
    method = json.loads((run / "metrics.json").read_text())["method"]
    assert f">{method}<" in (run / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("file", [".", "motion.npz"])
def test_its_run_and_its_motion_can_be_viewed(file: str, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    shown = []

    @contextlib.contextmanager
    def viewer(robot: object, takes: object, *rest: object) -> Iterator[None]:
        shown.append(takes)
        yield

    monkeypatch.setattr("fastmimic.viewer.viewer.Viewer", viewer)
    monkeypatch.setattr("fastmimic.commands.pictures.serve", lambda *_: 0)
    assert cli.main(["view", str(run / file), "--duration", "0.1"]) == 0
    assert len(shown) == 1


@pytest.mark.parametrize("method", WITHOUT_POLICY)
def test_it_can_be_rendered(method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn(robot: object, tracks: object, out: Path, **options: object) -> SimpleNamespace:
        out.write_bytes(b"")
        return SimpleNamespace(frames=1, seconds=0.1)

    monkeypatch.setattr("fastmimic.render.video.render_video", drawn)
    path = motion_of(method, tmp_path)
    assert cli.main(["render", str(path), "--duration", "0.1", "--out", str(tmp_path / "x.mp4")]) == 0


def test_a_motion_of_a_policy_says_what_it_needs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = motion_of("rl", tmp_path)
    assert cli.main(["render", str(path), "--duration", "0.1", "--out", str(tmp_path / "x.mp4")]) == 2
    assert "method 'rl' needs a trained policy" in capsys.readouterr().err


@pytest.mark.parametrize("method", WITHOUT_POLICY)
def test_without_an_optimisation_nothing_is_searched(method: str, tmp_path: Path) -> None:
    out = tmp_path / "run"
    arguments = ["imitate", "trot", "--method", method, "--no-optimize", "--no-video", "--duration", "0.3"]
    assert cli.main([*arguments, "--out", str(out)]) == 0
    assert '"evaluations": 0' in (out / "metrics.json").read_text(encoding="utf-8")
    assert f'"method": "{METHODS[method].unoptimised.name}"' in (out / "metrics.json").read_text(encoding="utf-8")
