"""The report of a run and of a comparison: its numbers are the run's, it loads nothing, and a browser can draw it."""

import base64
import gzip
import io
import json
import shutil
import sys
import time
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from PIL import Image

from browsing import PATIENCE_S, open_page, plainly
from fastmimic.base.files import write_json
from fastmimic.base.text import csv_text
from fastmimic.cli import main
from fastmimic.clips.catalogue import open_clip
from fastmimic.control.config import CONFIGS
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import TRACKED
from fastmimic.experiments.measurement import COLUMNS
from fastmimic.report.episode_figures import episode_figure, motor_torque
from fastmimic.report.html import make_report
from fastmimic.report.html_page import markdown
from fastmimic.report.run_table import FIGURES
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.viewer.replay import recorded
from fastmimic.viewer.scene import line_up
from searches import quick_main

PICTURE = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
)
SECTIONS = {"figures", "optimisation", "tracking", "episodes", "run"}


class Parsed(HTMLParser):
    """Ids, addresses, pictures, and the figures marked with their name in metrics.json."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.urls: list[str] = []
        self.metrics: list[tuple[str, str, str]] = []
        self.pictures: list[Image.Image] = []
        self.kept: dict[str, str] = {}
        self._open: tuple[str, dict[str, str | None]] = ("", {})
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self._open = (tag, named)
        if named.get("id"):
            self.ids.append(str(named["id"]))
        if tag == "img":
            self.pictures.append(Image.open(io.BytesIO(base64.b64decode(str(named["src"]).partition(",")[2]))))
        self.urls += [str(named[k]) for k in ("src", "href", "srcset", "data", "poster") if k in named]

    def handle_data(self, data: str) -> None:
        tag, named = self._open
        if tag == "data" and named.get("data-metric"):
            self.metrics.append((str(named["data-metric"]), str(named["value"]), data))
        elif named.get("type") == "text/plain":
            self.kept[str(named["id"])] = gzip.decompress(base64.b64decode(data)).decode()
        self._open = ("", {})


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run of `imitate`."""
    folder = tmp_path_factory.mktemp("report") / "run"
    options = ["--iterations", "2", "--population", "4", "--duration", "1", "--no-video", "--out", str(folder)]
    assert quick_main(["imitate", "trot", *options]) == 0
    config = json.loads((folder / "config.json").read_text())
    config["arguments"]["no_video"] = False  # as if a video had been asked for
    write_json(folder / "config.json", config)
    (folder / "video.mp4").write_bytes(b"not a video, but embedded all the same")
    return folder


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(finished, tmp_path / "run", ignore=shutil.ignore_patterns("*.html")))


@pytest.fixture
def no_replay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without it, which has tests of its own."""
    monkeypatch.setattr("fastmimic.viewer.replay.recorded", lambda episodes: "")


@pytest.fixture(scope="module")
def page(finished: Path) -> Parsed:
    """Its report, with a replay that is drawn plainly."""
    pytest.importorskip("viser", reason="viser is not installed: pip install 'fastmimic[view]'")

    def lined_up(server: Any, *arguments: Any, **options: Any) -> Any:
        plainly(server)
        return line_up(server, *arguments, **options)

    with mock.patch("fastmimic.viewer.replay.line_up", lined_up):
        report = make_report(finished, recorded)
    assert report.missing == ()
    report.save(finished / "report.html")
    return Parsed(report.html)


def test_has_every_part_once(page: Parsed) -> None:
    assert len(page.ids) == len(set(page.ids))
    assert set(page.ids) >= SECTIONS | {"video", "replay", "verified"}
    assert page.ids.index("verified") > page.ids.index("run")
    assert "notes" not in page.ids  # nothing is missing, and the rerun has the recorded rewards
    assert len(page.pictures) == 4  # the search, the feet, the motion, the episodes
    assert all(len(picture.convert("RGB").getcolors(1 << 24) or ()) > 100 for picture in page.pictures)


def test_loads_nothing(page: Parsed) -> None:
    assert [url[:40] for url in page.urls if not url.startswith(("data:", "#"))] == []
    client = Parsed(page.kept["replay-page"].replace("<script data-p=", "<script data-client="))
    assert [url[:40] for url in client.urls if not url.startswith("data:")] == []


def test_its_numbers_are_those_of_the_metrics(page: Parsed, finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    checked = set()
    for key, exact, shown in page.metrics:
        value = metrics
        for name in key.split("."):
            value = value[int(name)] if isinstance(value, list) else value[name]
        assert exact == repr(value), key
        if "fell" in key:
            assert shown == ("yes" if value else "no"), key
        else:
            digits, parts = len(shown.partition(".")[2]), set(key.split("."))
            lengths = 1e3 if "swing_clearance_m" in parts else 1.0
            scale = next((scale for _, name, _, scale in FIGURES if name in parts), lengths)
            assert shown == f"{scale * value:.{digits}f}", key
        checked.add(key)
    terms = [f"reward.components_{c}.{t}" for c in ("before", "after") for t in metrics["reward"]["components_after"]]
    assert checked >= {"reward.before", "reward.after", "fell.after", "parameters.7.value", *terms}
    assert checked >= {f"{name}.{when}" for name in TRACKED for when in ("before", "after")}
    assert checked >= {"kinematic.reward_mean", "kinematic.fell", "kinematic.mpjpe_mm", "reward_animal.after"}


def test_its_pictures_are_the_files_of_the_run(page: Parsed, finished: Path) -> None:
    for shown, file in zip(page.pictures, ("convergence.png", "tracking.png"), strict=False):
        assert np.array_equal(np.asarray(shown), np.asarray(Image.open(finished / file)))


def test_the_figure_of_episodes_shows_them_until_a_fall(robot: Robot) -> None:
    motion, config = retarget(open_clip("trot"), robot)[0], CONFIGS["default"]
    stands = run_episodes(robot, motion, duration_s=1.0, config=config, log=True)
    falls = run_episodes(replace(robot, torque_limit=0.2 * robot.torque_limit), motion, duration_s=1.0, log=True)
    assert falls.fell.all()
    figure = episode_figure(robot, config, {"before": falls, "after": stands}, (0.0, 0.5), "trot", [0.25])
    panels = {axes.get_title("left").partition(":")[0]: axes for axes in figure.axes}
    assert panels["reward"].get_title("left") == f"reward: mean {falls.reward[0]:.3f} → {stands.reward[0]:.3f}"
    before, after, border = panels["reward"].get_lines()
    assert list(border.get_xdata()) == [0.25, 0.25]
    assert np.isfinite(after.get_ydata()).all()
    assert np.isnan(np.asarray(before.get_ydata())[falls.steps[0] :]).all()
    assert np.nanmax(np.asarray(panels["torque, share of the limit"].get_lines()[1].get_ydata())) <= 1.0
    assert panels["gait"].get_xlim() == (0.0, 0.5)


def test_torque_is_the_motor_law_cut_off() -> None:
    from types import SimpleNamespace

    from fastmimic.robot.state import COMMAND, OBSERVATION

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
    assert "fitted: the episode run again has reward" in html
    assert 'id="verified"' not in html


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "gone", "stays"),
    [
        ("tracking.png", {"tracking"}, {"optimisation", "episodes", "video"}),
        ("motion.npz", {"episodes"}, {"optimisation", "tracking", "video"}),
        ("config.json", {"episodes"}, {"optimisation", "tracking", "video"}),
        ("video.mp4", {"video"}, {"optimisation", "episodes"}),
    ],
)
@pytest.mark.usefixtures("no_replay")
def test_goes_without_what_is_missing(
    run: Path, capsys: pytest.CaptureFixture[str], file: str, gone: set[str], stays: set[str]
) -> None:
    (run / file).unlink()
    _goes_without(run, capsys, file, gone, stays)


def test_goes_without_settings_of_another_form(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "config.json").write_text('{"arguments": 5}')
    _goes_without(run, capsys, "config.json", {"episodes"}, {"optimisation", "tracking", "video"})


def _goes_without(run: Path, capsys: pytest.CaptureFixture[str], file: str, gone: set[str], stays: set[str]) -> None:
    capsys.readouterr()
    assert main(["report", str(run)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert len(lines) == 1
    assert file in lines[0]
    assert "without" in lines[0]
    ids = set(Parsed((run / "report.html").read_text()).ids)
    assert not ids & gone
    assert ids >= stays | {"notes"}


@pytest.mark.parametrize(
    "damage", ["no such folder", "empty", "unfinished", "policy", "metrics", "two with --out", "ending"]
)
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
    elif damage == "policy":
        (run / "metrics.json").unlink()
        (run / "policy.npz").write_bytes(b"a policy")
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
    assert ("'fastmimic evaluate MOTION --policy" in error) == (damage == "policy")
    assert not list(tmp_path.rglob("*.html"))


@pytest.mark.slow
def test_of_a_motion_done_once_no_drift_is_told(page: Parsed, tmp_path: Path) -> None:
    drift = [key for key, *_ in page.metrics if key == "drift_m_per_s.after"]
    assert len(drift) == 2  # large, and in the table
    folder = tmp_path / "once"
    once = ["--frames", "0:40", "--discrete", "--no-optimize", "--no-video", "--out", str(folder)]
    assert main(["imitate", "trot", *once]) == 0
    keys = {key for key, *_ in Parsed(make_report(folder).html).metrics}
    assert "stance_slip_m.before" in keys
    assert not [key for key in keys if "drift" in key]


@pytest.mark.slow
@pytest.mark.usefixtures("no_replay")
def test_of_a_take_it_runs_first_as_it_is(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report", "trot", "--robot", "go2", "--frames", "0:40", "--discrete"]) == 0
    (folder,) = (tmp_path / "runs").iterdir()
    assert json.loads((folder / "config.json").read_text())["arguments"]["robot"] == "go2"
    assert 'data-metric="drift' not in (folder / "report.html").read_text()
    capsys.readouterr()
    assert main(["report", str(run), "--robot", "go2"]) == 2
    assert "belong to motions that are not run yet; drop them" in capsys.readouterr().err


def test_without_viser_one_line_says_what_to_install(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    capsys.readouterr()
    assert main(["report", str(run)]) == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert len(warnings) == 1
    assert "pip install 'fastmimic[view]'" in warnings[0]
    assert "without the replay in 3D" in warnings[0]
    without = Parsed((run / "report.html").read_text())
    assert "replay" not in without.ids
    assert {"episodes", "video", "notes"} <= {*without.ids}


def a_row(motion: str, method: str, seed: int, reward: float, variant: str = "") -> dict[str, Any]:
    """A row of results.csv, as short as it can be."""
    texts = {name: "x" for name in COLUMNS if name.endswith("_version") or name in ("parameters", "digest", "config")}
    said = {"motion": motion, "method": method, "variant": variant, "seed": float(seed), "robot": "a1", "fell": 0.0}
    numbers = {"reward_mean": reward, "reward_mean_perturbed": reward - 0.1, "style_distance_realised": 0.1}
    numbers |= {"cpu_s": 10.0 + seed, "foot_z_rmse_m": 0.002, "fell_before": 1.0}
    return {**dict.fromkeys(COLUMNS), **texts, **said, **numbers}


ROWS = [
    a_row("trot", "mbc", 0, 0.5),
    a_row("trot", "mbc-dmp", 0, 0.8123456789012345),
    a_row("trot", "mbc-dmp", 1, 0.7),
    a_row("pace", "mbc-dmp", 0, 0.9),
    a_row("trot", "mbc-dmp", 0, 0.4, "no-adaptation"),
]


@pytest.fixture
def compared(tmp_path: Path) -> Path:
    """A comparison's folder without its pictures."""
    folder = tmp_path / "compared"
    folder.mkdir()
    said = {"settings": {"robot": "<trot>"}, "methods": ["mbc", "mbc-dmp"], "motions": ["<trot>", "pace"], "seeds": 2}
    write_json(folder / "environment.json", {**said, "ablations": ["no-adaptation"]})
    (folder / "results.csv").write_text(csv_text(COLUMNS, ROWS))
    for name in ("table.md", "ablations.md"):
        (folder / name).write_text("| motion | reward |\n| --- | --- |\n| `trot` | **0.500** |\n| `pace` | 0.9 ± 0 |\n")
    return folder


def test_a_comparison_has_its_tables_and_figures(compared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(make_report(compared).missing) == 1  # it has no figures
    (compared / "comparison.png").write_bytes(PICTURE)
    report = make_report(compared)
    assert report.missing == ()
    assert "<td><code>trot</code></td>\n<td><strong>0.500</strong></td>" in report.html
    assert report.html.count('class="sortable numbers"') == 2
    assert "0.8123456789012345</td>" in report.html
    assert "<trot>" not in report.html
    assert "Reward of each method on each motion." in report.html
    found = Parsed(report.html)
    assert [url[:40] for url in found.urls if not url.startswith(("data:", "#"))] == []
    (compared / "results.csv").unlink()
    (compared / "ablations.md").unlink()
    assert "results.csv is missing" in make_report(compared).missing[0]
    (compared / "table.md").write_bytes(b"\xff")
    assert main(["report", str(compared)]) == 2
    error = capsys.readouterr().err
    assert "table.md: cannot be read" in error
    assert error.count("\n") == 1
    assert not (compared / "report.html").exists()


def test_other_experiments_have_their_table_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(tmp_path / "environment.json", {"experiment": "stress", "settings": {"robot": "a1"}, "versions": {}})
    assert len(make_report(tmp_path).missing) == 3
    (tmp_path / "table.md").write_text("| method | push, N·s |\n| --- | --- |\n| MBC | **12.5** |\n")
    (tmp_path / "success.png").write_bytes(PICTURE)
    (tmp_path / "results.csv").write_text("method,push\nmbc,12.5\n")
    report = make_report(tmp_path)
    assert report.missing == ()
    assert "<strong>12.5</strong>" in report.html
    assert 'class="sortable numbers"' in report.html
    assert [picture.size for picture in Parsed(report.html).pictures] == [(1, 1)]
    (tmp_path / "environment.json").write_text("{")
    assert main(["report", str(tmp_path)]) == 2
    assert "environment.json: cannot be read" in capsys.readouterr().err


def test_markdown_is_escaped() -> None:
    html = "<p>a &lt;b&gt; <em>c</em></p>\n<ul>\n<li><code>d</code>: e.</li>\n</ul>\n"
    assert markdown("a <b> *c*\n\n- `d`: e.") == html


class Tab:
    """A page in a browser without a network, and what it complained about.

    Attributes:
        page: Playwright's.
        complaints: errors and warnings of its console.
        requests: what it asked for besides the file itself.
    """

    def __init__(self, browser: Any, path: Path, width: int = 1280) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page = open_page(browser, width, 800, offline=True)
        self.page.on("console", self._heard)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", self._asked)
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready]", state="attached")

    def __enter__(self) -> "Tab":
        return self

    def __exit__(self, *error: object) -> None:
        self.page.context.close()

    def _heard(self, message: Any) -> None:
        known = ("media", "video", "gl driver message", "three.clock")  # no real video here, and no graphics card
        if message.type in ("error", "warning") and not any(word in message.text.lower() for word in known):
            self.complaints.append(message.text)

    def _asked(self, request: Any) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            self.requests.append(request.url)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_a_browser_draws_it(page: Parsed, finished: Path, browser: Any, width: int) -> None:
    with Tab(browser, finished / "report.html", width) as tab:
        drawn = tab.page.evaluate("[...document.images].map(i => [i.naturalWidth, i.getBoundingClientRect().width])")
        overflow = tab.page.evaluate("document.documentElement.scrollWidth")
    assert tab.complaints == []
    assert tab.requests == []
    assert len(drawn) == len(page.pictures)
    assert all(natural > 1000 and shown >= 860 for natural, shown in drawn), drawn  # on a phone they are moved sideways
    assert overflow <= width


@pytest.mark.slow
def test_the_replay_opens_on_demand_and_plays_without_a_network(page: Parsed, finished: Path, browser: Any) -> None:
    def colours(tab: Tab) -> int:
        picture = Image.open(io.BytesIO(tab.page.locator(".replay").screenshot())).convert("RGB").resize((160, 100))
        return len(picture.getcolors(16000) or [None] * 16000)

    with Tab(browser, finished / "report.html", width=500) as tab:
        assert tab.page.locator("iframe").count() == 0
        assert colours(tab) < 500
        tab.page.click("button[data-opens]")
        frame = tab.page.frame_locator(".replay iframe")
        frame.locator("canvas").last.wait_for()
        moment = frame.locator("input").first
        end = time.monotonic() + PATIENCE_S
        moments = {moment.input_value()}  # all that were seen: it starts again at its end, where the picture fades
        most = 0
        while time.monotonic() < end and (most < 1000 or len(moments) < 2):
            tab.page.wait_for_timeout(200)
            moments.add(moment.input_value())
            most = max(most, colours(tab))
        assert most >= 1000  # robots and ground, not an empty picture
        assert len(moments) > 1  # it plays
    assert tab.complaints == []
    assert tab.requests == []


@pytest.mark.slow
def test_a_heading_sorts_its_table(compared: Path, browser: Any) -> None:
    place = COLUMNS.index("reward_mean")
    report = make_report(compared)
    report.save(compared / "report.html")
    with Tab(browser, compared / "report.html") as tab:
        tab.page.click("summary")
        heading = tab.page.locator("#each th").nth(place)
        orders = []
        for _ in range(2):
            heading.locator("button").click()
            rows = tab.page.locator("#each tbody tr")
            cells = rows.evaluate_all("(rows, at) => rows.map(r => r.cells[at].textContent)", place)
            orders.append([float(value) for value in cells])
        said = heading.get_attribute("aria-sort")
        tab.page.locator("table.sortable button", has_text="reward").first.click()
        first = tab.page.locator("table.sortable tbody tr").first.inner_text()
    rewards = sorted(row["reward_mean"] for row in ROWS)
    assert orders == [rewards, rewards[::-1]]
    assert said == "descending"
    assert "0.500" in first
    assert tab.complaints == []
    assert tab.requests == []
