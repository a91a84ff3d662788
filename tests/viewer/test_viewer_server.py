"""The server: its port, its end, what a user can get wrong, and what a browser sees."""

import dataclasses
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import types
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from browsing import PATIENCE_S, errors_of, open_page, picture, plainly, until
from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError
from fastmimic.cli import main
from fastmimic.commands.options import ClipOptions
from fastmimic.commands.pictures import View
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.loading import find_motion
from fastmimic.viewer.take import Take
from fastmimic.viewer.viewer import HOST, free_port


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that somebody listens on."""
    with socket.socket() as busy:
        busy.bind((HOST, 0))
        busy.listen()
        yield busy.getsockname()[1]


def test_a_taken_port_is_passed_over(taken: int) -> None:
    found = free_port(taken)
    assert taken < found < taken + 50
    with pytest.raises(ConfigError, match="all taken"):
        free_port(taken, tries=1)
    for wrong in (0, -1, 65536):
        with pytest.raises(ConfigError, match="1 to 65535"):
            free_port(wrong)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["trott"], "did you mean 'trot'"),
        (["trot", "--port", "0"], "--port takes 1 to 65535"),
        (["trot", "--duration", "-1"], "--duration must be above 0"),
        (["trot", "--kinematic", "--method", "lh"], "--method cannot be applied with --kinematic"),
        (["trot", "--method", "mcb"], "did you mean 'mbc'"),
        (["trot", "--episodes", "0"], "episodes must be at least 1"),
        (["trot", "--clip", "trott"], "did you mean 'trot'"),
        (["."], "a folder without motion.npz"),
        (["damaged"], "config.json: does not hold a JSON object"),
        (["nowhere.npz"], "nowhere.npz"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str],
    said: str,
    trot: Motion,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "damaged").mkdir()
    trot.save(tmp_path / "damaged" / "motion.npz")
    (tmp_path / "damaged" / "config.json").write_text("[]")
    assert main(["view", *arguments]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]


def test_without_viser_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "trot"]) == 2
    assert "pip install 'fastmimic[view]'" in capsys.readouterr().err


def test_an_old_viser_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    old = types.SimpleNamespace(GuiApi=object, __version__="1.0.30")
    monkeypatch.setitem(sys.modules, "viser", old)
    assert main(["view", "trot"]) == 2
    assert "viser 1.0.30 is too old" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_serves_on_loopback_and_ends_at_ctrl_c(taken: int) -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    command = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from fastmimic.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", command, "view", "trot", "--kinematic", "--duration", "0.5", "--port", str(taken)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"DISPLAY": ""},
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        url = next(word for word in line.split() if word.startswith("http://"))
        assert url.startswith(f"http://{HOST}:")
        assert urlsplit(url).port != taken
        with urllib.request.urlopen(url, timeout=PATIENCE_S) as page:
            assert b"<html" in page.read().lower()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0
    assert out == ""
    assert err.splitlines() == [f"port {taken} is taken; listening on {urlsplit(url).port} instead", "closed"]


def test_a_run_is_shown_before_and_after_as_it_was_made(
    trot: Motion, a1: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("run", "trot"):
        (tmp_path / folder).mkdir()
    lifted = dataclasses.replace(trot, foot_pos_b=trot.foot_pos_b + 0.01, demonstration=trot)
    lifted.save(tmp_path / "run" / "motion.npz")
    arguments = {"robot": None, "method": "lh", "config": "paper", "duration": 0.2}
    (tmp_path / "run" / "config.json").write_text(json.dumps({"arguments": arguments}))
    run = find_motion("run")
    view = View(motion="run", config="default", reading=ClipOptions())._of_run(run)
    assert (view.method, view.config, view.duration) == ("lh", "default", 0.2)  # what is given goes first
    robot, shown, heading, animal = view._prepare(run)
    assert (robot.name, heading, animal) == ("a1", "trot on a1", None)
    assert [takes[0].title for takes in shown] == ["before: not optimised", "after: optimised"]
    assert [takes[0].rows for takes in shown] == [100, 100]
    assert not np.array_equal(shown[0][0].pose, shown[1][0].pose)
    file = tmp_path / "run" / "motion.npz"
    with_animal = View(motion=str(file), clip="trot", kinematic=True, duration=0.2, reading=ClipOptions())
    assert with_animal._prepare(find_motion(file))[3] is not None


@pytest.mark.slow
def test_a_browser_sees_the_robot_and_scrubs(browser: Any, take: Take, a1: Robot) -> None:
    from fastmimic.viewer.viewer import Viewer, default_camera

    def usual(aspect: float) -> Array:
        return default_camera(a1, [0.0], float(take.heading[0]), aspect)[0]

    with Viewer(a1, [[take]], "trot on a1", 8700) as viewer:
        viewer.player.toggle()  # software rendering is slow: one picture is enough
        viewer.panel.show_playing()
        stop = threading.Event()
        thread = threading.Thread(target=viewer.run, args=(stop,))
        thread.start()
        try:
            plainly(viewer.server)
            page = open_page(browser, 900, 420)
            wrong = errors_of(page)
            page.goto(viewer.url)
            page.get_by_role("button", name="Play", exact=True).wait_for()
            until(lambda: picture(page).std() > 12.0, page)  # not blank: ground, sky and a dark robot
            before = picture(page)
            trunk = viewer.robots[0]._bodies[0][0]
            np.testing.assert_allclose(trunk.position, take.pose[0, :3], atol=1e-6)

            slider = page.get_by_role("slider").first
            slider.focus()
            slider.press("End")
            last = take.rows - 1
            until(lambda: viewer.player.row == last, page)
            until(lambda: np.allclose(trunk.position, take.pose[last, :3], atol=1e-6), page)
            np.testing.assert_allclose(np.abs(trunk.wxyz @ take.pose[last, 3:7]), 1.0, atol=1e-6)
            until(lambda: np.abs(picture(page) - before).mean() > 0.2, page)

            page.get_by_role("button", name="first", exact=True).click()
            until(lambda: viewer.player.row == 0, page)
            page.get_by_role("button", name="+ 1", exact=True).click()
            until(lambda: viewer.player.row == take.cycle_starts[1], page)

            (client,) = viewer.server.get_clients().values()
            told: list[Any] = []  # by the browser: the server's own value is there before the browser has heard of it
            client.camera.on_update(lambda camera: told.append(np.array(camera.position)))
            client.camera.position = (3.0, 3.0, 3.0)
            until(lambda: bool(told) and np.allclose(told[-1], 3.0, atol=1e-3), page)
            page.get_by_role("button", name="Reset the view", exact=True).click()
            until(lambda: np.allclose(client.camera.position, usual(client.camera.aspect), atol=1e-2), page)

            page.get_by_role("button", name="Play", exact=True).click()
            until(lambda: viewer.player.row != take.cycle_starts[1], page)
            page.get_by_role("button", name="Pause", exact=True).wait_for()
            assert wrong == []
            page.context.close()
        finally:
            stop.set()
            thread.join()
