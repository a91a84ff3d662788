"""The page of an experiment: the pictures and tables that `compare`, `stress` and `transfer` write."""

import csv
from pathlib import Path
from typing import Any

from fastmimic.base.errors import ConfigError
from fastmimic.base.files import read_json
from fastmimic.experiments import comparison_run as compared
from fastmimic.report.html_page import HtmlReport, Picture, render
from fastmimic.runs.work_folder import ENVIRONMENT, RESULTS_CSV, TABLE


def results_page(path: Path) -> HtmlReport:
    """The page of an experiment's folder; raises `ConfigError` if its files cannot be read."""
    about = read_json(path / ENVIRONMENT)
    pictures = [Picture.of(file) for file in sorted(path.glob("*.png"))]
    tables = [_text(path / name) for name in (TABLE, compared.ABLATION_TABLE) if (path / name).is_file()]
    rows = [*csv.reader(_text(path / RESULTS_CSV).splitlines())] if (path / RESULTS_CSV).is_file() else []
    missing = [] if pictures else [f"{path} has no figures: without them"]
    for name, there in ((TABLE, tables), (RESULTS_CSV, rows)):
        if not there:
            missing.append(f"{path / name} is missing: without it; --resume writes it when something is done")
    title = str(about.get("experiment", "comparison")).capitalize()
    shown: dict[str, Any] = {"about": about, "pictures": pictures, "tables": tables, "rows": rows}
    return render("results.html", title=title, missing=missing, **shown)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
