"""Pages: templates filled with data, in one self-contained file; and their plots, as plain Plotly: figures, series,
lines and axes. Colours are names in the style sheet."""

import base64
import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any, Final

import jinja2
import numpy as np
from markdown_it import MarkdownIt
from markupsafe import Markup

from fastmimic import __version__
from fastmimic.base.arrays import Array, Flags, stretches
from fastmimic.base.errors import ConfigError, FastMimicError, OutputError
from fastmimic.base.files import packaged, write_text
from fastmimic.base.machine import optional
from fastmimic.base.text import NONE, plain
from fastmimic.imitation.methods import METHODS

_HINTS: Final = packaged("fastmimic.report", "hints.json", dict[str, str])
Interval = tuple[float, float]


@dataclass(frozen=True)
class Key:
    """A series: its name and style, in a plot and in the legend, as Plotly names them."""

    label: str
    color: str  # `var(--name)` of the style sheet
    dash: str = "solid"
    symbol: str = ""  # for points
    pattern: str | None = None  # for an area or bars; "" for a plain one


@dataclass(frozen=True)
class Plot:
    """One plot: its title, Plotly traces, Plotly layout without the theme, and a note in small print."""

    title: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]
    note: str = ""


@dataclass(frozen=True)
class Figure:
    name: str  # its id in the page
    title: str
    plots: Sequence[Plot]
    columns: int = 1  # of the plots on a wide page
    legend: Sequence[Key] = ()
    about: str = ""  # its entry in `hints.json`; empty for that of its name
    told: Mapping[str, Any] = field(default_factory=dict)  # the values in that

    @property
    def hint(self) -> str:
        """How to read it."""
        return _HINTS[self.about or self.name].format(**self.told)


Sections = Mapping[str, Sequence[Figure]]  # the figures of a page by section
BEFORE: Final = Key("before: not optimised", "var(--before)", "2px,5px")
AFTER: Final = Key("after: optimised", "var(--after)", "solid")
ONLY: Final = Key("not optimised", "var(--after)", "solid")
DEMONSTRATION: Final = Key("demonstration", "var(--demo)", "dash")
STANCE: Final = Key("stance wanted", "var(--stance)", pattern="")
LIMIT: Final = Key("limit", "var(--limit)", "dashdot")
POINTS: Final = 1000  # maximum of a curve: a page must open on a phone


def greatest(values: Array) -> float:
    """The greatest finite value; NaN without one."""
    found = values[np.isfinite(values)]
    return float(found.max()) if found.size else float("nan")


def arrow(values: Sequence[float], digits: int) -> str:
    return " → ".join(f"{v:.{digits}f}" if np.isfinite(v) else "–" for v in values)


def curve(time: Array, values: Array, key: Key, *, peak: bool = False) -> dict[str, Any]:
    """A line of at most `POINTS` points: regular samples or, with `peak`, the greatest in each interval."""
    stride = -(-len(time) // POINTS)
    kept = np.fmax.reduceat(values, np.arange(0, len(values), stride)) if peak else values[::stride]
    return line(numbers(time[::stride]), kept, key, width=1.7)


def line(x: Any, y: Any, key: Key, *, width: float = 2.0, **more: Any) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": key.label,
        "x": x,
        "y": numbers(y) if isinstance(y, np.ndarray) else y,
        "line": {"color": key.color, "dash": key.dash, "width": width},
        "hovertemplate": "%{y:.4g}",
        **more,
    }


def points(x: Sequence[Any], y: Sequence[Any], key: Key, hover: str, *, size: float = 10) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": key.label,
        "x": list(x),
        "y": list(y),
        "marker": {"symbol": key.symbol, "size": size, "color": key.color, "line": {"width": 1.8, "color": key.color}},
        "hovertemplate": hover,
    }


def bar_marker(key: Key, **pattern: Any) -> dict[str, Any]:
    shape = {"shape": key.pattern, "fillmode": "overlay", "fgcolor": "var(--paper)", **pattern}
    return {"color": key.color, "line": {"width": 0}, "pattern": shape}


def layout_of(
    x: str, y: str, height: int, xrange: Interval | None = None, yrange: Interval | None = None, **more: Any
) -> dict[str, Any]:
    def axis(title: str, shown: Interval | None) -> dict[str, Any]:
        return {"title": {"text": title}} | ({} if shown is None else {"range": numbers(shown)})

    return {"height": height, "xaxis": axis(x, xrange), "yaxis": axis(y, yrange), **more}


def time_plot(
    title: str,
    y: str,
    time: Array,
    found: Sequence[tuple[Array, Key]],
    span: Interval,
    yrange: Interval | None = None,
    *,
    height: int = 230,
    shapes: Sequence[dict[str, Any]] = (),
    note: str = "",
    peak: bool = False,
) -> Plot:
    """Series of values at the times (t,), s, the first one on top; see `curve` for `peak`."""
    data = [curve(time, values, key, peak=peak) for values, key in reversed(found)]
    return Plot(title, data, layout_of("time (s)", y, height, span, yrange, shapes=list(shapes)), note)


def shades(time: Array, stance: Flags) -> list[dict[str, Any]]:
    ends = np.append(time, time[-1])
    style = {"fillcolor": STANCE.color, "line": {"width": 0}, "layer": "below"}
    return [_upright("rect", float(ends[a]), float(ends[b]), style) for a, b in stretches(stance)]


def rule(key: Key, *, x: float | None = None, y: float | None = None, width: float = 1.6) -> dict[str, Any]:
    """A vertical line at `x`, or a horizontal one at `y`."""
    line = {"color": key.color, "dash": key.dash, "width": width}
    if x is not None:
        return _upright("line", x, x, {"line": line})
    return {"type": "line", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line}


def _upright(kind: str, start: float, end: float, style: dict[str, Any]) -> dict[str, Any]:
    """A shape as high as the plot."""
    return {"type": kind, "xref": "x", "yref": "paper", "x0": start, "x1": end, "y0": 0, "y1": 1, **style}


def rows_axis(names: Sequence[str]) -> dict[str, Any]:
    """An axis of words, the first on top."""
    order = {"type": "category", "categoryorder": "array", "categoryarray": list(names)}
    return {**order, "range": [len(names) - 0.4, -0.6], "tickmode": "linear", "dtick": 1}


def numbers(values: Any, digits: int = 5) -> list[float]:
    """A list for JSON of `digits` significant digits."""
    return [float(f"{v:.{digits}g}") for v in np.asarray(values, dtype=np.float64).tolist()]


def said_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a command that say something, for a page."""
    arguments = {k.replace("_", "-"): v for k, v in given.items() if v is not False and v not in (None, "", [])}
    for name in ("motions", "cycles"):
        if name in arguments:
            arguments[name] = " ".join(str(v) for v in arguments[name])
    return {k: "yes" if v is True else v for k, v in arguments.items()}


@dataclass(frozen=True)
class HtmlReport:
    """A finished page: its HTML, and a sentence for each thing missing in the folder and thus in the page."""

    html: str
    missing: tuple[str, ...]

    def save(self, path: str | Path) -> None:
        """Writes the page, replacing an earlier one; raises `OutputError`."""
        write_text(path, self.html)


def render(
    template: str, sections: Sections, *, title: str, missing: Sequence[str], replay: str = "", **data: Any
) -> HtmlReport:
    """Fills a page: a file of `templates/` with the figures of its `sections`, a sentence for each thing that is
    `missing`, an HTML page to be opened inside (`replay`, empty for none), and `data` for the template. Raises
    `ConfigError` for figures without Plotly, `OutputError` if a file that the page shows cannot be read."""
    plots = {
        f"{figure.name}-{i}": {"data": plot.data, "layout": plot.layout}
        for figure in chain.from_iterable(sections.values())
        for i, plot in enumerate(figure.plots, start=1)
    }
    shared = {"title": title, "missing": tuple(missing), "sections": sections, "plots": plots, "replay": replay}
    try:
        return HtmlReport(_environment().get_template(template).render(**shared, **data), tuple(missing))
    except jinja2.UndefinedError as error:
        raise ConfigError(f"{title}: the folder's files hold other values than were written ({error})") from None


@contextmanager
def leaving_out(what: str, missing: list[str]) -> Iterator[None]:
    """Leaves out of the page what the block cannot read or make, and adds a sentence that says so."""
    try:
        yield
    except FastMimicError as error:
        missing.append(f"{error}: without {what}")


def plotly_bundle() -> str:
    """Plotly's JavaScript from its Python package; raises `ConfigError` if it is not installed."""
    said = "the report's plots need Plotly, which is not installed: pip install 'fastmimic[report]'"
    return str(optional("plotly.offline", ConfigError(said)).get_plotlyjs())


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
    text = json.dumps(plain(value), ensure_ascii=False, separators=(",", ":"), allow_nan=False)
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
