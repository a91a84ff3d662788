"""What a notebook and a terminal show of motions and results."""

import re
import sys
from types import SimpleNamespace

import pytest

import fastmimic as fm
from fastmimic.imitation.imitate import Imitation
from fastmimic.motion.motion import Motion
from fastmimic.report import notebook


@pytest.fixture(scope="module")
def result() -> Imitation:
    return fm.imitate("trot", iterations=1, population=4, duration_s=0.6)


def test_what_is_printed_of_them_takes_three_lines(result: Imitation) -> None:
    evaluation = fm.evaluate(result.motion, episodes=2, duration_s=0.6)
    clip = fm.open_clip("trot")
    for shown in (result, result.motion, result.robot, result.after, evaluation, clip):
        lines = repr(shown).splitlines()
        assert len(lines) <= 3, repr(shown)
        assert max(map(len, lines)) < 160, repr(shown)
    assert "Motion trot for a1: optimised, executable, 0.50 s at 500 Hz, +1.25 m/s forward" in repr(result.motion)
    assert "12.45 kg" in repr(result.robot)
    assert f"reward {result.after.reward[0]:.3f}" in repr(result)
    assert "2 episodes" in repr(evaluation)
    assert "0 of 2 fell" in repr(evaluation)


def test_a_result_is_shown_with_video_table_and_plot(result: Imitation) -> None:
    page = notebook.as_html(result)
    assert f"<td>{result.after.reward[0]:.3f}</td>" in page
    assert "data:image/png;base64," in page
    assert "data:video/mp4;base64," in page


def test_without_opengl_there_is_no_video(result: Imitation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    page = notebook.as_html(result)
    assert "<video" not in page
    assert "data:image/png;base64," in page


def test_a_motion_is_shown_by_its_figure(result: Imitation) -> None:
    assert "data:image/png;base64," in notebook.as_html(result.motion)


def test_ipython_shows_them_by_itself(monkeypatch: pytest.MonkeyPatch, result: Imitation) -> None:
    formatters = pytest.importorskip("IPython.core.formatters", reason="IPython is not installed")
    shell = SimpleNamespace(display_formatter=formatters.DisplayFormatter())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    asked: list[Motion] = []
    monkeypatch.setattr(notebook, "as_html", lambda shown: asked.append(shown) or "<b>it</b>")
    fm._show_in_notebooks()
    formats, _ = shell.display_formatter.format(result.motion)
    assert formats["text/html"] == "<b>it</b>"
    assert re.match("<Motion trot", formats["text/plain"])
    assert asked == [result.motion]
