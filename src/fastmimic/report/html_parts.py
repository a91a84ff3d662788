"""What pages are built of: text, tables, plots in panels, and the page that holds everything it needs in itself."""

import base64
import gzip
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic import __version__
from fastmimic.base.errors import ConfigError

NONE: Final = "–"
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'{scripts}; style-src 'unsafe-inline'; img-src data:; media-src data:"
)
"""Content-Security-Policy: the browser itself refuses whatever would come from a network."""
_OF_REPLAY: Final = " 'unsafe-eval'; connect-src data:"  # viser's client has WebAssembly in it
REPLAY: Final = "replay-page"
"""The id of the kept text that the replay's button opens."""
_ZOOM: Final = ' <span class="screen">Drag over a plot to zoom, double-click for everything.</span>'
_PATTERNS: Final = {
    "": "",
    "/": "M3 12L9 2M9 12L15 2M15 12L21 2M21 12L27 2",
    "\\": "M3 2L9 12M9 2L15 12M15 2L21 12M21 2L27 12",
    "x": "M3 12L9 2M3 2L9 12M12 12L18 2M12 2L18 12M21 12L27 2M21 2L27 12",
    ".": "M4 5h2M10 5h2M16 5h2M22 5h2M7 9h2M13 9h2M19 9h2M25 9h2",
    "-": "M1 5.5h28M1 9h28",
}
_SYMBOLS: Final = {
    "circle": "M15 2a5 5 0 1 0 .01 0z",
    "cross": "M13 2h4v3h3v4h-3v3h-4v-3h-3v-4h3z",
    "diamond": "M15 1l6 6-6 6-6-6z",
    "square": "M10 2h10v10h-10z",
    "star": "M15 1l1.6 4.2 4.4.2-3.4 2.8 1.2 4.3-3.8-2.4-3.8 2.4 1.2-4.3-3.4-2.8 4.4-.2z",
    "triangle-down": "M9 3h12l-6 10z",
    "triangle-up": "M9 12h12l-6-10z",
}
_DASHES: Final = {"solid": "", "dash": "7 4", "dot": "2 3", "dashdot": "8 3 2 3", "2px,5px": "2 5"}


@dataclass(frozen=True)
class Key:
    """An entry of a legend: how a series is drawn.

    Attributes:
        label: its name.
        color: `var(--name)` of the style sheet.
        dash: one of Plotly's dash patterns; "fill" for an area, followed by Plotly's name of its pattern if it has one;
            "o" and "d" for an open circle and a diamond, "symbol " and Plotly's name for another one.
    """

    label: str
    color: str
    dash: str = "solid"

    def html(self) -> str:
        """The entry with a sample of its line."""
        if self.dash.startswith("fill"):
            mark = f'<rect x="1" y="2" width="28" height="10" fill="{self.color}"/>'
            mark += f'<path d="{_PATTERNS[self.dash[4:]]}" stroke="var(--paper)" stroke-width="1.4" fill="none"/>'
        elif self.dash.startswith("symbol "):
            mark = f'<path d="{_SYMBOLS[self.dash[7:]]}" fill="{self.color}"/>'
        elif self.dash == "o":
            mark = f'<circle cx="15" cy="7" r="4.5" fill="none" stroke="{self.color}" stroke-width="1.8"/>'
        elif self.dash == "d":
            mark = f'<path d="M15 1l6 6-6 6-6-6z" fill="{self.color}"/>'
        else:
            mark = (
                f'<line x1="1" y1="7" x2="29" y2="7" stroke="{self.color}" stroke-width="2.4"'
                f' stroke-dasharray="{_DASHES[self.dash]}"/>'
            )
        mark = mark.replace('fill="var', 'style="fill:var').replace('stroke="var', 'style="stroke:var')
        return f'<span><svg width="30" height="14" aria-hidden="true">{mark}</svg>{escape(self.label)}</span>'


@dataclass(frozen=True)
class Panel:
    """One plot.

    Attributes:
        title: a few words, HTML.
        data: Plotly traces.
        layout: Plotly layout without what the theme gives.
    """

    title: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]


@dataclass(frozen=True)
class Figure:
    """Panels under one heading.

    Attributes:
        name: its id in the page.
        title: what there is to see.
        hint: how to read it.
        panels: the plots.
        columns: of the panels on a wide page.
        legend: how the series are drawn.
    """

    name: str
    title: str
    hint: str
    panels: Sequence[Panel]
    columns: int = 1
    legend: Sequence[Key] = ()


@dataclass
class Page:
    """A page under construction.

    Attributes:
        title: of the document.
        body: finished HTML.
        plots: by the id of the element that shows them.
        kept: long texts by the id of the element that holds them, compressed.
    """

    title: str
    body: list[str] = field(default_factory=list)
    plots: dict[str, Any] = field(default_factory=dict)
    kept: dict[str, str] = field(default_factory=dict)

    def add(self, *html: str) -> None:
        """Appends HTML."""
        self.body += html

    def section(self, name: str, title: str) -> None:
        """Begins a section."""
        self.add(f'<h2 id="{name}">{escape(title)}</h2>')

    def figure(self, figure: Figure) -> None:
        """Appends a figure, and keeps its plots for the script."""
        boxes = []
        for i, panel in enumerate(figure.panels):
            name = f"{figure.name}-{i + 1}"
            self.plots[name] = {"data": panel.data, "layout": panel.layout}
            height = panel.layout.get("height", 240)
            title = f"<p>{panel.title}</p>" if panel.title else ""
            boxes.append(
                f'<div class="panel">{title}<div class="plot" id="{name}" style="height:{height}px"></div></div>'
            )
        legend = "".join(key.html() for key in figure.legend)
        self.add(
            f'<figure id="{figure.name}"><figcaption><h3>{escape(figure.title)}</h3><p class="hint">'
            f"{escape(figure.hint)}</p></figcaption>",
            f'<div class="legend">{legend}</div>' if legend else "",
            f'<div class="panels c{figure.columns}">{"".join(boxes)}</div></figure>',
        )

    def replay(self, page: str, label: str, hint: str) -> None:
        """Appends a button that opens a page within the page; until then it costs nothing.

        Args:
            page: HTML that needs nothing but itself.
            label: of the button.
            hint: how to use what opens.
        """
        self.kept[REPLAY] = page
        self.add(
            f'<div class="replay screen"><button type="button" data-opens="{REPLAY}">{escape(label)}</button></div>',
            f'<p class="hint screen">{hint}</p>',
        )

    def html(self) -> str:
        """The whole document.

        Raises:
            ConfigError: there are plots, and Plotly is not installed.
        """
        data = json.dumps(self.plots, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        data = data.replace("<", "\\u003c")  # no text can end the script element
        kept = {"plotly": plotly_bundle(), **self.kept} if self.plots else self.kept
        scripts = (
            f'<script type="application/json" id="plots">{data}</script>\n'
            + "".join(f'<script type="text/plain" id="{k}">{compressed(text)}</script>\n' for k, text in kept.items())
            + f"<script>{_asset('html_page.js')}</script>\n"
        )
        policy = _POLICY.format(scripts=_OF_REPLAY if REPLAY in self.kept else "")
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f'<meta name="generator" content="fastmimic {__version__}">\n<title>{escape(self.title)}</title>\n'
            f'<link rel="icon" href="data:,">\n<style>{_asset("html_page.css")}</style>\n</head>\n<body>\n<main>\n'
            + "\n".join(part for part in self.body if part)
            + f"\n<footer>Made by fastmimic {__version__}. This file holds everything it shows and loads nothing."
            f"{_ZOOM if self.plots else ''}</footer>\n"
            f"<noscript><p>The plots need JavaScript; tables and video do not.</p></noscript>\n</main>\n{scripts}"
            "</body>\n</html>\n"
        )


def plotly_bundle() -> str:
    """Plotly's JavaScript out of its Python package.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise ConfigError(
            "the report's plots need Plotly, which is not installed: pip install 'fastmimic[report]'"
        ) from None
    return str(get_plotlyjs())


def compressed(text: str) -> str:
    """A text as the page keeps it: gzip, in base64."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def embedded(path: Path, mime: str) -> str:
    """A file as a `data:` URL; raises `OSError`."""
    return f"data:{mime};base64,{base64.b64encode(path.read_bytes()).decode()}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1, sortable: bool = False) -> str:
    """A table of finished cells, HTML; the first `left` columns are text, the others numbers. The headings of a
    `sortable` one are buttons that sort it by their columns."""

    def cells(tag: str, row: Sequence[str]) -> str:
        kinds = ["" if i < left else ' class="n"' for i in range(len(row))]
        return "".join(
            cell if cell.startswith("<t") else f"<{tag}{kind}>{cell}</{tag}>"
            for cell, kind in zip(row, kinds, strict=True)
        )

    headings = [f'<button type="button">{escape(h)}</button>' if sortable else escape(h) for h in header]
    head = f"<thead><tr>{cells('th', headings)}</tr></thead>" if header else ""
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    kind = ' class="sortable"' if sortable else ""
    return f'<div class="scroll"><table{kind}>{head}<tbody>{body}</tbody></table></div>'


def pairs(values: Mapping[str, Any]) -> str:
    """A table of names and values."""
    return table((), [(f"<th>{escape(k)}</th>", f'<td class="wide">{escape(str(v))}</td>') for k, v in values.items()])


def numbers(values: Any, digits: int = 5) -> list[float | None]:
    """A list for JSON: `digits` significant ones, None for what is not a number."""
    return [
        float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in np.asarray(values, dtype=np.float64).tolist()
    ]


def _asset(name: str) -> str:
    return resources.files("fastmimic.report").joinpath(name).read_text(encoding="utf-8")
