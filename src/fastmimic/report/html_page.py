"""Pages: templates filled with data, in one self-contained file."""

import base64
import gzip
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from markdown_it import MarkdownIt
from markupsafe import Markup

from fastmimic import __version__
from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.files import write_text
from fastmimic.base.text import NONE
from fastmimic.imitation.methods import METHODS
from fastmimic.report.html_plots import Figure


@dataclass(frozen=True)
class HtmlReport:
    """A finished page: its HTML, and a sentence for each thing missing in the folder and thus in the page."""

    html: str
    missing: tuple[str, ...]

    def save(self, path: str | Path) -> None:
        """Writes the page, replacing an earlier one; raises `OutputError`."""
        write_text(path, self.html)


def render(
    template: str, figures: Iterable[Figure], *, title: str, missing: Sequence[str], replay: str = "", **data: Any
) -> HtmlReport:
    """Fills a page: a file of `templates/` with all its `figures`, a sentence for each thing that is `missing`, an HTML
    page to be opened inside (`replay`, empty for none), and `data` for the template. Raises `ConfigError` if there are
    figures and Plotly is not installed, `OutputError` if a file that the page shows cannot be read."""
    plots = {
        f"{figure.name}-{i}": {"data": plot.data, "layout": plot.layout}
        for figure in figures
        for i, plot in enumerate(figure.plots, start=1)
    }
    shared = {"title": title, "missing": tuple(missing), "plots": plots, "replay": replay}
    return HtmlReport(_environment().get_template(template).render(**shared, **data), tuple(missing))


def plotly_bundle() -> str:
    """Plotly's JavaScript from its Python package; raises `ConfigError` if it is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise ConfigError(
            "the report's plots need Plotly, which is not installed: pip install 'fastmimic[report]'"
        ) from None
    return str(get_plotlyjs())


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fastmimic.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.globals |= {"version": __version__, "asset": _asset, "plotly": plotly_bundle}
    environment.globals |= {"all_methods": METHODS, "NONE": NONE}
    environment.filters |= {"json": _json, "gzip": compressed, "embed": _embedded, "markdown": markdown}
    return environment


def _asset(name: str) -> Markup:
    return Markup(resources.files("fastmimic.report").joinpath("templates", name).read_text(encoding="utf-8"))


def _json(value: Any) -> Markup:
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))  # no text can end the script element


def compressed(text: str) -> str:
    """A text as stored in the page: gzip, in base64."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _embedded(path: Path, mime: str) -> str:
    """A file as a `data:` URL."""
    try:
        return f"data:{mime};base64,{base64.b64encode(path.read_bytes()).decode()}"
    except OSError as error:
        raise OutputError(f"{path}: cannot be read ({error.strerror or error})") from None


def markdown(text: str) -> Markup:
    """HTML of Markdown; its tables can be sorted, and from their third column on have numbers."""
    html = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    table = '<div class="dense scroll"><table class="sortable numbers">'
    return Markup(html.replace("<table>", table).replace("</table>", "</table></div>"))
