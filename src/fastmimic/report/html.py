"""The report of a folder: one self-contained HTML file."""

import dataclasses
import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.base.files import read_json, write_text
from fastmimic.deploy.log import RESULT as DEPLOYMENT
from fastmimic.experiments.comparison_run import POLICY
from fastmimic.runs.work_folder import CONFIG, ENVIRONMENT, METRICS, TABLE

if TYPE_CHECKING:
    from fastmimic.report.html_run import RerunEpisodes

REPORT: Final = "report.html"


@dataclass(frozen=True)
class HtmlReport:
    """A finished page: its HTML, and a sentence for each thing missing in the folder and thus in the page."""

    html: str
    missing: tuple[str, ...]

    def save(self, path: str | Path) -> None:
        """Writes the page, replacing an earlier one; raises `OutputError`."""
        write_text(path, self.html)


def kind_of(folder: str | Path) -> str:
    """The kind of a folder: "run" (`imitate`, `stitch`), "comparison" (`compare`), "results" (`stress`, `transfer`) or
    "deployment" (`deploy`); raises `ConfigError` for others."""
    path = Path(folder)
    if (path / METRICS).is_file():
        return "run"
    if (path / DEPLOYMENT).is_file():
        return "deployment"
    if (path / ENVIRONMENT).is_file():
        return "results" if "experiment" in read_json(path / ENVIRONMENT) else "comparison"
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


def make_report(folder: str | Path, replay: "Callable[[RerunEpisodes], str] | None" = None) -> HtmlReport:
    """Makes the page of a folder. For a run, its two episodes are simulated again.

    Args:
        folder: of a kind that `kind_of` knows.
        replay: makes a self-contained HTML page that plays a run's episodes in 3D, or raises `FastMimicError`; None for
            no replay.

    Raises:
        ConfigError: not such a folder, its figures cannot be read, or Jinja2 or Plotly is not installed.
    """
    path, kind = Path(folder), kind_of(folder)
    if importlib.util.find_spec("jinja2") is None:
        raise ConfigError("the report needs Jinja2, which is not installed: pip install 'fastmimic[report]'")
    if kind == "run":
        return _run_report(path, replay)
    if kind == "comparison":
        from fastmimic.report.html_comparison import comparison_page

        return HtmlReport(*comparison_page(path))
    if kind == "results":
        return HtmlReport(*_results_page(path, read_json(path / ENVIRONMENT)))
    from fastmimic.report.html_deployment import deployment_page

    return HtmlReport(*deployment_page(path))


def _run_report(path: Path, replay: "Callable[[RerunEpisodes], str] | None") -> HtmlReport:
    from fastmimic.report.html_page import plotly_bundle
    from fastmimic.report.html_run import read_run
    from fastmimic.report.html_run_page import run_page

    plotly_bundle()  # before the episodes: without it there is no page
    run = read_run(path)
    recorded = ""
    if replay is not None and run.episodes is not None:
        try:
            recorded = replay(run.episodes)
        except FastMimicError as error:
            run = dataclasses.replace(run, missing=(*run.missing, f"{error}: without the replay in 3D"))
    return HtmlReport(run_page(run, recorded), run.missing)


def _results_page(path: Path, environment: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """The page of an experiment with a table and figures, `stress` or `transfer`."""
    from fastmimic.report.html_page import render

    missing = []
    try:
        table = (path / TABLE).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        table = ""
        missing.append(f"{path / TABLE} is missing: without the table; --resume writes it when something is done")
    pictures = sorted(path.glob("*.png"))
    if not pictures:
        missing.append(f"{path} has no figures: without them")
    page = render(
        "results.html",
        [],
        title=str(environment["experiment"]).capitalize(),
        missing=missing,
        pictures=pictures,
        table=table,
        settings=environment.get("settings", {}),
        versions=environment.get("versions", {}),
    )
    return page, tuple(missing)
