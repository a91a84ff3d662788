"""The page of a comparison: its tables and its figures."""

import json
import re
from html import escape
from pathlib import Path
from typing import Any, Final

from fastmimic.errors import ConfigError
from fastmimic.report.comparison_folder import (
    ABLATION_FIGURE,
    ABLATION_TABLE,
    COMPARISON,
    ENVIRONMENT,
    TABLE,
    TRACKING_FIGURE,
)
from fastmimic.report.html_parts import Page, embedded, pairs, table

_PARTS: Final = (  # name, heading, table, (figure, what it shows) ...
    (
        "methods",
        "Methods",
        TABLE,
        (
            (COMPARISON, "Reward of each method on each motion."),
            (TRACKING_FIGURE, "A foot before and after optimisation, and the errors of all feet."),
        ),
    ),
    ("ablations", "Ablations", ABLATION_TABLE, ((ABLATION_FIGURE, "What each part of the method is worth."),)),
)


def comparison_page(path: Path) -> tuple[Page, tuple[str, ...]]:
    """The page of a comparison's folder, and a sentence for each thing that the folder lacks.

    Raises:
        ConfigError: `environment.json` cannot be read.
    """
    try:
        environment = json.loads((path / ENVIRONMENT).read_text(encoding="utf-8"))
        settings = environment["settings"]
        methods, motions = list(environment["methods"]), list(environment["motions"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path / ENVIRONMENT}: cannot be read ({error})") from None
    page = Page("Comparison: FastMimic report")
    page.add(
        "<h1>Comparison</h1>",
        f'<p class="lead">{len(methods)} methods on {len(motions)} motions; {escape(str(settings.get("robot")))},'
        f" {escape(str(settings.get('config')))} controller, {environment.get('seeds')} seed(s) where something is"
        " optimised.</p>",
    )
    missing: list[str] = []
    body = Page("")
    for name, heading, text, figures in _PARTS:
        if name == "ablations" and not environment.get("ablations"):
            continue
        body.section(name, heading)
        for file, what in figures:
            try:
                body.add(f'<figure><img alt="{escape(what)}" src="{embedded(path / file, "image/png")}">')
                body.add(f'<figcaption><p class="hint">{escape(what)}</p></figcaption></figure>')
            except OSError:
                missing.append(f"{path / file} is missing: without that figure")
        try:
            body.add(markdown((path / text).read_text(encoding="utf-8")))
        except (OSError, UnicodeDecodeError):
            missing.append(
                f"{path / text} is missing: without that table; 'compare --resume' writes it when it is done"
            )
    if missing:
        page.add(f'<div class="notes" id="notes"><ul>{"".join(f"<li>{escape(m)}</li>" for m in missing)}</ul></div>')
    page.add(*body.body)
    page.section("run", "What was run")
    said: dict[str, Any] = {"motions": ", ".join(motions), "methods": ", ".join(methods), **settings}
    page.add(
        f'<div class="two"><div><h3>Settings</h3>{pairs(said)}</div><div><h3>Machine</h3>'
        f"{pairs(environment.get('machine', {}))}<h3 class='next'>Versions</h3>"
        f"{pairs(environment.get('versions', {}))}</div></div>"
    )
    return page, tuple(missing)


def markdown(text: str) -> str:
    """HTML of the Markdown that a comparison's tables are written in: tables, lists, paragraphs, `code`, **bold** and
    *italics*."""
    html = []
    for block in re.split(r"\n\s*\n", text.strip()):
        lines = block.splitlines()
        if lines[0].startswith("|"):
            rows = [[_inline(cell.strip()) for cell in line.strip("| ").split(" | ")] for line in lines]
            html.append('<div class="dense">')
            html.append(table([cell for cell in lines[0].strip("| ").split(" | ")], rows[2:], left=2))
            html.append("</div>")
        elif lines[0].startswith("- "):
            html.append(f"<ul>{''.join(f'<li>{_inline(line[2:])}</li>' for line in lines)}</ul>")
        else:
            html.append(f"<p>{_inline(' '.join(lines))}</p>")
    return "\n".join(html)


def _inline(text: str) -> str:
    text = escape(text)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    text = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", text)
    return re.sub(r"\*([^*]+)\*", r"<em>\1</em>", text)
