"""The report of a run or a comparison: one HTML file that holds all it shows and loads nothing."""

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError, FastMimicError, OutputError
from fastmimic.base.files import replace_file
from fastmimic.deploy.files import RESULT as DEPLOYMENT
from fastmimic.experiments.comparison_run import POLICY
from fastmimic.imitation.methods import ALL_METHODS
from fastmimic.report import html_episodes, html_limits, html_search
from fastmimic.report.comparison_folder import ENVIRONMENT
from fastmimic.report.html_numbers import before_and_after, parameter_table, segments, tiles
from fastmimic.report.html_parts import Page, embedded, pairs, plotly_bundle
from fastmimic.report.html_run import Episodes, RunData, read_run
from fastmimic.report.run_folder import CONFIG, METRICS

REPORT: Final = "report.html"
_REPLAY_HINT: Final = (
    "Drag to turn, scroll or pinch to zoom, space to pause. The green ghost is the demonstration; coloured lines"
    " are the paths of the feet, dashed ones the demonstration's. Under a foot a ring means that the schedule wants"
    " it down, a disc that it is loaded, a square that the planner has it in stance. The scene tree, right of the"
    " time, also has the forces, the centre of mass, and the legs' names."
)


@dataclass(frozen=True)
class Report:
    """What was made.

    Attributes:
        html: the whole page.
        missing: a sentence for each thing that the folder lacks: what the page goes without.
    """

    html: str
    missing: tuple[str, ...]

    def save(self, path: str | Path) -> None:
        """Writes the page in place of an earlier one; raises `OutputError`."""
        replace_file(path, lambda file: file.write(self.html.encode()))


def kind_of(folder: str | Path) -> str:
    """What a folder holds: "run" for one of `imitate` or `stitch`, "comparison" for one of `compare`, "results" for one
    of `stress` or `transfer`, "deployment" for one of `deploy`.

    Raises:
        ConfigError: none of these.
    """
    path = Path(folder)
    if (path / METRICS).is_file():
        return "run"
    if (path / DEPLOYMENT).is_file():
        return "deployment"
    if (path / ENVIRONMENT).is_file():
        return "results" if "experiment" in _environment(path) else "comparison"
    if not path.is_dir():
        raise ConfigError(f"{path}: {'not a folder' if path.exists() else 'no such folder'}; give the folder of a run")
    if (path / POLICY).is_file():
        raise ConfigError(
            f"{path}: a policy of 'train' has no report; 'fastmimic evaluate MOTION --policy {path / POLICY}' scores it"
        )
    if (path / CONFIG).is_file():
        raise ConfigError(f"{path}: the run is not finished ({METRICS} is missing); 'imitate --resume' may finish it")
    raise ConfigError(
        f"{path}: not the folder of a run: neither {METRICS} of imitate and stitch nor {ENVIRONMENT} of compare, stress"
        f" and transfer nor {DEPLOYMENT} of deploy"
    )


def _environment(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads((path / ENVIRONMENT).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path / ENVIRONMENT}: cannot be read ({error})") from None


def make_report(folder: str | Path, replay: Callable[[Episodes], str] | None = None) -> Report:
    """Makes the page of a folder. A run's two episodes are run again for it.

    Args:
        folder: as `kind_of` knows them.
        replay: makes an HTML page that plays the episodes of a run in 3D, needing nothing but itself, or raises
            `FastMimicError`; None to go without.

    Raises:
        ConfigError: not such a folder, its figures cannot be read, or Plotly is not installed.
    """
    kind = kind_of(folder)
    if kind == "comparison":
        from fastmimic.report.html_comparison import comparison_page

        page, missing = comparison_page(Path(folder))
        return Report(page.html(), missing)
    if kind == "results":
        from fastmimic.report.html_results import results_page

        page, missing = results_page(Path(folder), _environment(Path(folder)))
        return Report(page.html(), missing)
    if kind == "deployment":
        from fastmimic.report.html_deployment import deployment_page

        page, missing = deployment_page(Path(folder))
        return Report(page.html(), missing)
    plotly_bundle()  # before the episodes: without it there is no page
    run = read_run(Path(folder))
    recorded = ""
    if replay is not None and run.episodes is not None:
        try:
            recorded = replay(run.episodes)
        except FastMimicError as error:
            run = dataclasses.replace(run, missing=(*run.missing, f"{error}: without the replay in 3D"))
    return Report(run_page(run, recorded).html(), run.missing)


def run_page(run: RunData, replay: str = "") -> Page:
    """The page of a run.

    Args:
        run: its folder.
        replay: an HTML page that plays its episodes; empty for none.
    """
    m = run.metrics
    page = Page(f"{m['motion']} on {m['robot']}: FastMimic report")
    page.add(f"<h1>{escape(m['motion'])} on {escape(m['robot'])}</h1>", f'<p class="lead">{_summary(run)}</p>')
    page.add(_notes(run), tiles(run), _contents(run, bool(replay)))
    if run.video is not None:
        page.section("video", "Video")
        try:
            source = embedded(run.video, "video/mp4")
        except OSError as error:
            raise OutputError(f"{run.video}: cannot be read ({error.strerror or error})") from None
        page.add(
            f'<video controls loop muted playsinline src="{source}"></video>'
            '<p class="hint">The green ghost is the demonstration.</p>'
        )
    if replay:
        page.section("replay", "In 3D")
        page.replay(replay, "Open the replay", _REPLAY_HINT)
    page.section("figures", "In numbers")
    page.add(before_and_after(run))
    page.add(segments(m))
    if m["parameters"]:
        page.section("optimisation", "Optimisation")
        if run.course is not None:
            page.figure(
                html_search.convergence(
                    run.course,
                    m["reward"]["before"],
                    m["reward"]["after"],
                    unchanged=html_search.as_fitted(m["parameters"]),
                    randomized="randomization" in m,
                )
            )
        page.figure(html_search.parameters(m["parameters"]))
        page.add("<details><summary>Table of the parameters</summary>", parameter_table(m), "</details>")
    e = run.episodes
    if e is not None:
        page.section("tracking", "Feet and gait")
        for figure in html_episodes.feet(e):
            page.figure(figure)
        page.figure(html_episodes.paths(e))
        page.figure(html_episodes.gait(e))
        page.section("terms", "Reward")
        page.figure(html_episodes.reward(e))
        page.section("limits", "Limits of the robot")
        for figure in html_limits.limits(e):
            page.figure(figure)
        page.figure(html_limits.friction(e))
        solved = html_limits.solve_times(e)
        if solved is not None:
            page.section("times", "Solve times")
            page.figure(solved)
    page.section("run", "What was run")
    page.add(_provenance(run))
    return page


def _summary(run: RunData) -> str:
    m = run.metrics
    method = ALL_METHODS.get(m.get("method", ""))
    name = f"{method.label}, {method.summary}" if method is not None else str(m.get("method", "unknown method"))
    parts = [escape(name), f"{escape(str(m.get('config', '')))} controller", f"episodes of {m['duration_s']:g} s"]
    if m.get("iterations"):
        plural = "" if m["iterations"] == 1 else "s"
        parts.append(f"{m['iterations']} iteration{plural}, seed {m.get('seed')}")
    return "; ".join(parts) + (". The search was interrupted." if m.get("interrupted") else ".")


def _notes(run: RunData) -> str:
    lines = [escape(line) for line in run.missing]
    e = run.episodes
    if e is not None and e.differences:
        lines += [escape(line) for line in e.differences]
        lines.append(
            "The plots of the episodes are those of the episodes run again; the figures are the recorded ones."
        )
    found = ""
    if e is not None and not e.differences:
        both = "Both nominal episodes were" if e.after is not None else "The nominal episode was"
        found = (
            f'<div class="notes good" id="verified"><p>{both} run again for this page; the'
            f" reward{'s are' if e.after is not None else ' is'} to the last bit that of <code>{METRICS}</code>.</p>"
            "</div>"
        )
    if lines:
        found += f'<div class="notes" id="notes"><ul>{"".join(f"<li>{line}</li>" for line in lines)}</ul></div>'
    return found


def _contents(run: RunData, replay: bool) -> str:
    entries = {
        "video": ("Video", run.video is not None),
        "replay": ("In 3D", replay),
        "figures": ("In numbers", True),
        "optimisation": ("Optimisation", run.optimised),
        "tracking": ("Feet and gait", run.episodes is not None),
        "terms": ("Reward", run.episodes is not None),
        "limits": ("Limits", run.episodes is not None),
        "run": ("What was run", True),
    }
    return f"<nav>{''.join(f'<a href=#{k}>{text}</a>' for k, (text, there) in entries.items() if there)}</nav>"


def _provenance(run: RunData) -> str:
    m, config = run.metrics, run.config
    arguments = {
        k.replace("_", "-"): v
        for k, v in config.get("arguments", {}).items()
        if v is not False and v not in (None, "", [])
    }
    for name in ("motions", "cycles"):
        if name in arguments:
            arguments[name] = " ".join(str(v) for v in arguments[name])
    arguments = {k: "yes" if v is True else v for k, v in arguments.items()}
    source = config.get("source")
    about: dict[str, Any] = {"motion": m["motion"], "robot": m["robot"]}
    if isinstance(source, dict):
        about |= {k: v for k, v in source.items() if isinstance(v, str | int | float)}
    if config.get("licence"):
        about["licence"] = config["licence"]
    html = '<div class="two"><div><h3>Arguments</h3>'
    html += pairs(arguments) if arguments else f'<p class="hint">{CONFIG} does not tell.</p>'
    html += f"</div><div><h3>Motion</h3>{pairs(about)}"
    html += f"<h3 class='next'>Versions</h3>{pairs(m.get('versions', {}))}</div></div>"
    if config.get("controller"):
        record = escape(json.dumps(config["controller"], indent=2, ensure_ascii=False))
        html += f"<details><summary>All parameters of the controller</summary><pre>{record}</pre></details>"
    return html
