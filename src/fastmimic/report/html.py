"""The report of a folder: one self-contained HTML file."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from fastmimic.base.errors import ConfigError
from fastmimic.deploy.log import LOG, RESULT
from fastmimic.learning.policy import POLICY_FILE
from fastmimic.runs.work_folder import CONFIG, ENVIRONMENT, METRICS, of_finished

if TYPE_CHECKING:
    from fastmimic.report.html_page import HtmlReport
    from fastmimic.report.html_pages import RerunEpisodes

REPORT: Final = "report.html"


def kind_of(folder: str | Path) -> str:
    """The kind of a folder: "run" (`imitate`, `stitch`), "results" (`compare`, `stress`, `transfer`) or "deployment"
    (`deploy`); raises `ConfigError` for others."""
    path = Path(folder)
    if (path / METRICS).is_file():
        return "run"
    if (path / RESULT).is_file() or (path / LOG).is_file():
        return "deployment"
    if (path / ENVIRONMENT).is_file():
        return "results"
    if not path.is_dir():
        raise ConfigError(f"{path}: {'not a folder' if path.exists() else 'no such folder'}; give the folder of a run")
    if (path / POLICY_FILE).is_file():
        scores = f"'fastmimic evaluate MOTION --policy {path / POLICY_FILE}' scores it"
        raise ConfigError(f"{path}: a policy of 'train' has no report; {scores}")
    if (path / CONFIG).is_file():
        raise ConfigError(f"{path}: the run is not finished ({METRICS} is missing); 'imitate --resume' may finish it")
    files = f"neither {METRICS} of imitate and stitch nor {ENVIRONMENT} of compare, stress and transfer"
    raise ConfigError(f"{path}: not the folder of a run: {files} nor {RESULT} of deploy")


def make_report(folder: str | Path, replay: "Callable[[RerunEpisodes], str] | None" = None) -> "HtmlReport":
    """Makes the page of a folder, of a kind that `kind_of` knows. A run's two episodes are simulated again, and
    `replay` makes a self-contained HTML page that plays them in 3D, or raises `FastMimicError`. Raises `ConfigError`
    for another folder, or figures that cannot be read."""
    path, kind = Path(folder), kind_of(folder)
    from fastmimic.report.html_pages import deployment_page, results_page, run_page

    if kind == "run":
        return run_page(path, replay)
    if kind == "deployment":
        return deployment_page(path)
    with of_finished(path):
        return results_page(path)
