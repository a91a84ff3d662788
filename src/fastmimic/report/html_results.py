"""The page of an experiment that is a table and its figures, as `stress` and `transfer` write them."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from fastmimic.report.html_comparison import markdown
from fastmimic.report.html_parts import Page, embedded, pairs
from fastmimic.report.result_folder import TABLE


def results_page(path: Path, environment: Mapping[str, Any]) -> tuple[Page, tuple[str, ...]]:
    """The page of such a folder, and a sentence for each thing that it lacks.

    Args:
        path: the folder.
        environment: its `environment.json`.
    """
    name = str(environment["experiment"]).capitalize()
    page = Page(f"{name}: FastMimic report")
    page.add(f"<h1>{escape(name)}</h1>")
    missing: list[str] = []
    try:
        table = markdown((path / TABLE).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        table = ""
        missing.append(f"{path / TABLE} is missing: without the table; --resume writes it when something is done")
    pictures = sorted(path.glob("*.png"))
    if not pictures:
        missing.append(f"{path} has no figures: without them")
    if missing:
        page.add(f'<div class="notes" id="notes"><ul>{"".join(f"<li>{escape(m)}</li>" for m in missing)}</ul></div>')
    page.section("figures", "In figures")
    for picture in pictures:
        title = escape(picture.stem.replace("-", " ").replace("_", " "))
        try:
            page.add(f'<figure><img alt="{title}" src="{embedded(picture, "image/png")}"></figure>')
        except OSError as error:
            missing.append(f"{picture} cannot be read ({error.strerror or error}): without that figure")
    page.section("results", "In numbers")
    page.add('<p class="hint screen">The heading of a column sorts its table.</p>' if table else "", table)
    page.section("run", "What was run")
    settings, versions = environment.get("settings", {}), environment.get("versions", {})
    page.add(
        f'<div class="two"><div><h3>Settings</h3>{pairs(settings)}</div>'
        f"<div><h3>Versions</h3>{pairs(versions)}</div></div>"
    )
    return page, tuple(missing)
