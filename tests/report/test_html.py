"""The report of a run and of a comparison: its numbers are the run's, it loads nothing, and a browser can draw it."""

import json
import re
import shutil
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastmimic.cli import main
from fastmimic.errors import ConfigError
from fastmimic.report.run_folder import write_json

pytest.importorskip("plotly", reason="Plotly is not installed: pip install 'fastmimic[report]'")

from fastmimic.report.html import make_report
from fastmimic.report.html_comparison import markdown
from fastmimic.report.html_plots import motor_torque

SECTIONS = {"figures", "optimisation", "tracking", "terms", "limits", "run"}
FIGURES = {"convergence", "parameters", "foot-z", "foot-x", "gait", "reward", "torque", "speed", "friction"}
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Parsed(HTMLParser):
    """Ids, addresses, the figures marked with their name in metrics.json, and the plots' data."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.urls: list[str] = []
        self.metrics: list[tuple[str, str, str]] = []
        self.plots: dict[str, Any] = {}
        self.missing = ""
        self._open: tuple[str, dict[str, str | None]] = ("", {})
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self._open = (tag, named)
        if named.get("id"):
            self.ids.append(str(named["id"]))
        self.urls += [str(named[k]) for k in ("src", "href", "srcset", "data", "poster") if k in named]

    def handle_data(self, data: str) -> None:
        tag, named = self._open
        if tag == "data" and named.get("data-metric"):
            self.metrics.append((str(named["data-metric"]), str(named["value"]), data))
        elif named.get("id") == "plots":
            self.plots = json.loads(data)
        self._open = ("", {})


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run of `imitate`."""
    folder = tmp_path_factory.mktemp("report") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastmimic.optimize.cma_es.VALIDATION_S", 0.4)
        patch.setattr("fastmimic.optimize.cma_es.VALIDATION_EPISODES", 2)
        patch.setattr("fastmimic.optimize.cma_es.VALIDATED", 2)
        options = ["--iterations", "2", "--population", "4", "--duration", "1", "--no-video", "--out", str(folder)]
        assert main(["imitate", "trot", *options]) == 0
    config = json.loads((folder / "config.json").read_text())
    config["arguments"]["no_video"] = False  # as if a video had been asked for
    write_json(folder / "config.json", config)
    (folder / "video.mp4").write_bytes(b"not a video, but embedded all the same")
    return folder


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(finished, tmp_path / "run", ignore=shutil.ignore_patterns("*.html")))


@pytest.fixture(scope="module")
def page(finished: Path) -> Parsed:
    """Its report."""
    report = make_report(finished)
    assert report.missing == ()
    report.save(finished / "report.html")
    return Parsed(report.html)


def test_has_every_part_once(page: Parsed) -> None:
    assert len(page.ids) == len(set(page.ids))
    assert set(page.ids) >= SECTIONS | FIGURES | {"video", "verified"}
    assert "notes" not in page.ids  # nothing is missing, and the rerun has the recorded rewards
    assert set(page.plots) == {name for name in page.ids if re.fullmatch(r".*-\d+", name)}


def test_loads_nothing(page: Parsed) -> None:
    assert [url[:40] for url in page.urls if not url.startswith(("data:", "#"))] == []


def test_its_numbers_are_those_of_the_metrics(page: Parsed, finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    checked = set()
    for key, exact, shown in page.metrics:
        value = metrics
        for name in key.split("."):
            value = value[int(name)] if isinstance(value, list) else value[name]
        assert exact == repr(value), key
        if isinstance(value, bool):
            assert shown == ("yes" if value else "no"), key
        else:
            digits = len(shown.partition(".")[2])
            scale = 1e3 if key.split(".")[0].endswith("_m") else 1.0
            assert shown == f"{scale * value:.{digits}f}", key
        checked.add(key)
    terms = [f"reward.components_{c}.{t}" for c in ("before", "after") for t in metrics["reward"]["components_after"]]
    assert checked >= {"reward.before", "reward.after", "fell.after", "parameters.7.value", *terms}


def test_every_plot_has_units_and_points(page: Parsed) -> None:
    for name, plot in page.plots.items():
        assert plot["layout"]["xaxis"]["title"]["text"], name
        assert any(v is not None for trace in plot["data"] for v in trace["x"]), name
    scores = page.plots["convergence-1"]["data"]
    assert [len(trace["x"]) for trace in scores[:4]] == [2, 2, 2, 2]


def test_torque_is_the_motor_law_cut_off() -> None:
    from types import SimpleNamespace

    from fastmimic.control.state import COMMAND, OBSERVATION

    command, seen = np.zeros((1, 3), COMMAND), np.zeros((1, 3), OBSERVATION)
    command["torque"], command["stiffness"], command["damping"] = 1.0, 10.0, 2.0
    command["joint_pos"][0, 1], seen["joint_pos"][0, 0] = 0.5, 0.2
    seen["joint_vel"][0, 0] = -0.25
    command["stiffness"][0, 2], command["joint_pos"][0, 2] = 1e6, 1.0
    log: Any = SimpleNamespace(command=command, observation=seen)
    torque = motor_torque(log, np.full(12, 30.0))
    assert np.isnan(torque[0]).all()
    np.testing.assert_allclose(torque[1:], [[1 + 10 * 0.3 + 2 * 0.25] * 12, [30.0] * 12])


def test_says_so_if_the_episodes_do_not_come_out_the_same(run: Path) -> None:
    metrics = json.loads((run / "metrics.json").read_text())
    metrics["reward"]["after"] += 1e-3
    write_json(run / "metrics.json", metrics)
    html = make_report(run).html
    assert "after: the episode run again has reward" in html
    assert 'id="verified"' not in html


@pytest.mark.parametrize(
    ("file", "gone", "stays"),
    [
        ("checkpoint.npz", {"convergence"}, {"parameters", "foot-z", "video"}),
        ("motion.npz", {"foot-z", "gait", "friction"}, {"convergence", "parameters", "video"}),
        ("config.json", {"foot-z", "gait", "friction"}, {"convergence", "parameters", "video"}),
        ("video.mp4", {"video"}, {"convergence", "foot-z"}),
    ],
)
def test_goes_without_what_is_missing(
    run: Path, capsys: pytest.CaptureFixture[str], file: str, gone: set[str], stays: set[str]
) -> None:
    (run / file).unlink()
    capsys.readouterr()
    assert main(["report", str(run)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert len(lines) == 1
    assert file in lines[0]
    assert "without" in lines[0]
    ids = set(Parsed((run / "report.html").read_text()).ids)
    assert not ids & gone
    assert ids >= stays | {"notes"}


@pytest.mark.parametrize("damage", ["no such folder", "empty", "unfinished", "metrics", "two with --out", "ending"])
def test_one_line_for_what_cannot_be(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: str
) -> None:
    (tmp_path / "empty").mkdir()
    arguments = [str(run)]
    if damage == "no such folder":
        arguments += [str(tmp_path / "nowhere")]
    elif damage == "empty":
        arguments += [str(tmp_path / "empty")]
    elif damage == "unfinished":
        (run / "metrics.json").unlink()
    elif damage == "metrics":
        (run / "metrics.json").write_text('{"motion": "trot"}')
    elif damage == "two with --out":
        arguments += [str(run), "--out", str(tmp_path / "a.html")]
    else:
        arguments += ["--out", str(tmp_path / "a.txt")]
    capsys.readouterr()
    assert main(["report", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("fastmimic: error: ")
    assert error.count("\n") == 1
    assert not list(tmp_path.rglob("*.html"))


def test_without_plotly_says_what_to_install(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(ConfigError, match=r"pip install 'fastmimic\[report\]'"):
        make_report(run)


def test_a_comparison_has_its_tables_and_figures(tmp_path: Path) -> None:
    write_json(
        tmp_path / "environment.json",
        {"settings": {"robot": "a1"}, "methods": ["mbc"], "motions": ["<trot>"], "seeds": 1, "ablations": []},
    )
    (tmp_path / "table.md").write_text(
        "a1.\n\n| motion | method | reward |\n| --- | --- | --- |\n| `trot` | MBC | **0.9** |\n"
    )
    (tmp_path / "comparison.png").write_bytes(b"picture")
    report = make_report(tmp_path)
    assert len(report.missing) == 1
    assert "tracking.png is missing" in report.missing[0]
    assert "<td><code>trot</code></td><td>MBC</td>" in report.html
    assert "<strong>0.9</strong>" in report.html
    assert "<trot>" not in report.html
    assert Parsed(report.html).urls[1:] == ["data:image/png;base64,cGljdHVyZQ=="]


def test_markdown_is_escaped() -> None:
    assert markdown("a <b> *c*\n\n- `d`: e.") == "<p>a &lt;b&gt; <em>c</em></p>\n<ul><li><code>d</code>: e.</li></ul>"


@pytest.mark.parametrize("width", [1280, 390])
def test_a_browser_draws_it(page: Parsed, finished: Path, tmp_path: Path, width: int) -> None:
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install playwright")
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install chromium")
    complaints: list[str] = []
    requests: list[str] = []
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": width, "height": 800})
        tab.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.on("request", lambda r: requests.append(r.url) if not r.url.startswith(("file:", "data:")) else None)
        tab.goto((finished / "report.html").as_uri())
        tab.wait_for_function("document.documentElement.dataset.drawn !== undefined", timeout=60_000)
        drawn = tab.evaluate(
            "[...document.querySelectorAll('.plot')].map(p => [p.id,"
            " p.querySelectorAll('.trace path').length, p.querySelector('svg').getBoundingClientRect().width])"
        )
        overflow = tab.evaluate("document.documentElement.scrollWidth")
        browser.close()
    complaints = [c for c in complaints if "media" not in c.lower() and "video" not in c.lower()]  # it is not a video
    assert complaints == []
    assert requests == []
    assert {name for name, _, _ in drawn} == set(page.plots)
    assert all(paths > 0 and 0 < wide <= width for _, paths, wide in drawn), drawn
    assert overflow <= width
