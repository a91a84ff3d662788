"""`fastmimic play` as a browser sees it, and what a user can get wrong."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from browsing import PATIENCE_S, errors_of, open_page, picture, plainly, until
from fastmimic.cli import main
from fastmimic.play.live_panel import IDLE, read_steering, steering_script
from fastmimic.play.page import LiveHistory
from fastmimic.play.session import LiveSession
from fastmimic.reference.motion_set import IN_PLACE
from fastmimic.reference.standing import STAND
from fastmimic.robot import Robot
from fastmimic.steering.gait_field import GaitField
from fastmimic.viewer.viewer import HOST

GAMEPAD = """
const pad = {axes: [0, 0, 0, 0], buttons: Array.from({length: 16}, () => ({pressed: false}))};
window.pad = pad;
navigator.getGamepads = () => [pad];
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["trott"], "did you mean 'trot'"),
        (["trot", "--port", "0"], "--port takes 1 to 65535"),
        (["--method", "mcb", STAND], "did you mean 'mbc'"),
        (["--config", "papr", STAND], "did you mean 'paper'"),
        (["."], "a folder without motion.npz"),
        (["nowhere.npz"], "nowhere.npz"),
        (["--robot", "a2", STAND], "unknown robot 'a2'"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    monkeypatch.chdir(tmp_path)
    assert main(["play", *arguments]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("preparing")]
    assert len(lines) == 1
    assert said in lines[0]


def test_without_viser_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["play", "trot"]) == 2
    assert "pip install 'fastmimic[view]'" in capsys.readouterr().err


def test_the_field_of_keys_and_stick_is_read() -> None:
    assert read_steering(IDLE) == (0.0, 0.0, 0.0)
    assert read_steering("steer +1.00 -0.25 +0.50") == (1.0, -0.25, 0.5)
    assert read_steering("steer +9.99 -9.99 +0.00") == (1.0, -1.0, 0.0)
    for text in ("", "steer", "steer a b c", "steer 1 0 0", "steer +1.00 -0.25", "left"):
        assert read_steering(text) is None
    assert "<script" not in steering_script()  # which a browser would not run


@pytest.mark.slow
def test_the_command_serves_on_loopback_and_ends_at_ctrl_c() -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    command = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from fastmimic.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    with socket.socket() as busy:
        busy.bind((HOST, 0))
        busy.listen()
        taken = busy.getsockname()[1]
        process = subprocess.Popen(
            [sys.executable, "-c", command, "play", IN_PLACE, "--port", str(taken)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"DISPLAY": ""},
        )
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith(f"{STAND}, {IN_PLACE}: open http://{HOST}:")
            url = next(word for word in line.split() if word.startswith("http://"))
            with urllib.request.urlopen(url, timeout=PATIENCE_S) as page:
                assert b"<html" in page.read().lower()
            with pytest.raises(urllib.error.HTTPError, match="403") as refused:  # nobody steers without the token
                urllib.request.urlopen(f"http://{HOST}:{urlsplit(url).port}/", timeout=PATIENCE_S)
            assert b"printed where it was started" in refused.value.read()
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
            process.communicate()
    assert process.returncode == 0
    assert out == ""
    said = [line for line in err.splitlines() if not line.startswith("preparing")]
    assert said == [f"port {taken} is taken; listening on {urlsplit(url).port} instead", "closed"]


@contextmanager
def served(session: LiveSession, port: int) -> Iterator[Any]:
    from fastmimic.play.page import PlayPage

    with PlayPage(session, "a1, live", port) as page:
        stop = threading.Event()
        thread = threading.Thread(target=page.run, args=(stop,))
        thread.start()
        try:
            yield page
        finally:
            stop.set()
            thread.join()


@pytest.mark.slow
def test_a_browser_plays(browser: Any, a1: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    # all of it, since the page may be slower than the two seconds that its history keeps
    rows: list[float] = []  # force that pushes, N
    add = LiveHistory.add

    def noted(history: LiveHistory) -> None:
        add(history)
        rows.append(float(np.linalg.norm(history.now.push)))

    monkeypatch.setattr(LiveHistory, "add", noted)
    session = LiveSession(a1, {})
    assert session.motions.next_hop(STAND, IN_PLACE) is not None  # made before, so that no second is lost later
    assert session.motions.next_hop(IN_PLACE, STAND) is not None
    with served(session, 8750) as live:
        plainly(live.server)
        page = open_page(browser, 700, 520)
        page.add_init_script(GAMEPAD)
        wrong = errors_of(page)
        page.goto(live.url)
        button = page.get_by_role("button", name=IN_PLACE, exact=True)
        button.wait_for()
        until(lambda: picture(page).std() > 12.0, page)  # not blank: ground, sky and a dark robot
        trunk = live.scene._bodies[0][0]

        button.click()
        until(lambda: session.state == IN_PLACE, page)
        assert session.falls == 0
        assert trunk.position[2] == pytest.approx(session.snapshot().pose[2], abs=0.05)

        before = len(rows)
        page.get_by_role("button", name="Push", exact=True).click()

        def given() -> float:
            return sum(rows[before:]) / live.history.rate_hz  # N·s

        until(lambda: given() > 3.5, page)
        page.wait_for_timeout(500)
        assert given() == pytest.approx(4.0, rel=0.15)  # `test_play_session` says what a push does

        page.keyboard.press("Space")
        page.get_by_role("button", name="Go on", exact=True).wait_for()
        steps = session.steps
        page.wait_for_timeout(300)
        assert session.steps == steps
        page.evaluate("window.pad.buttons[9].pressed = true")
        page.get_by_role("button", name="Pause", exact=True).wait_for()
        until(lambda: session.steps > steps, page)

        page.get_by_role("button", name="Motors off", exact=True).click()
        until(lambda: session.falls == 1, page)
        until(lambda: session.state == IN_PLACE, page)
        assert "real time" in live.panel._state.content
        assert "µs" in live.panel._figures.content
        assert wrong == []
        page.context.close()


@pytest.mark.slow
def test_a_browser_steers(browser: Any, gaits: GaitField) -> None:
    session = LiveSession(gaits.robot, {}, gaits=gaits)

    def wanted() -> list[float]:
        return [round(float(value), 2) for value in session.reference._asked]

    with served(session, 8755) as live:
        plainly(live.server)
        page = open_page(browser, 700, 520)
        page.add_init_script(GAMEPAD)
        wrong = errors_of(page)
        page.goto(live.url)
        page.get_by_role("button", name="Stop", exact=True).wait_for()
        until(lambda: picture(page).std() > 12.0, page)
        page.mouse.click(300, 250)
        for key, there in (("ArrowUp", [2.0, 0.0, 0.0]), ("KeyA", [0.0, 0.0, 2.0]), ("KeyE", [0.0, -0.4, 0.0])):
            page.keyboard.down(key)
            until(lambda there=there: wanted() == there, page)  # type: ignore[misc]
            page.keyboard.up(key)
            until(lambda: wanted() == [0.0, 0.0, 0.0], page)
        page.evaluate("window.pad.axes = [0.8, -1.0, 0.0, 0.0]")
        until(lambda: wanted() == [1.5, 0.0, -0.9], page)
        one = r"-?\d\.\d\d"
        assert re.search(f"↑ {one}, ← {one} m/s, ↺ {one} rad/s", live.panel._state.content)
        assert "-0.00" not in live.panel._state.content
        began = session.observation["root_pos"][:2].copy()
        until(lambda: float(np.hypot(*(session.observation["root_pos"][:2] - began))) > 0.3, page)
        page.evaluate("window.pad.axes = [0.0, 0.0, 0.0, 0.0]")
        until(lambda: session.state == "standing", page)
        assert session.falls == 0
        assert "m/s" in live.panel._figures.content
        assert wrong == []
        page.context.close()


def test_a_failure_of_the_simulation_ends_the_page(a1: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    from fastmimic.play.page import PlayPage

    session = LiveSession(a1, {})
    with PlayPage(session, "a1, live", 8760) as page:
        monkeypatch.setattr(page, "watched", lambda: True)

        def broken() -> None:
            raise FloatingPointError("broken")

        monkeypatch.setattr(session, "step", broken)
        began = time.monotonic()
        with pytest.raises(FloatingPointError, match="broken"):
            page.run(threading.Event())
        assert time.monotonic() - began < PATIENCE_S


def test_the_view_follows_without_the_sway(a1: Robot) -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    from fastmimic.play.page import LiveHistory

    session = LiveSession(a1, {})
    history = LiveHistory(session)
    session.switch(IN_PLACE)
    for _ in range(1500):
        session.step()
        if session.steps % history.every == 0:
            history.add()
    take = history.take()
    assert take.rate_hz == 100.0
    assert 190 <= take.rows <= 220
    assert np.linalg.norm(history.followed - take.pose[-1, :2]) < 0.05
    assert history.push(0.5) is None
    session.push(2.0)
    session.step()
    history.add()
    pushed = history.push(0.5)
    assert pushed is not None
    assert np.linalg.norm(pushed) == pytest.approx(20.0)
    time_s, *terms, reward = history.plot()
    assert time_s[-1] == 0.0
    assert len(terms) == 5
    assert np.all((reward >= 0) & (reward <= 1 + 1e-9))
