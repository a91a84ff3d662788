"""Pages: templates filled with data, pictures and tables, in one self-contained file."""

import base64
import gzip
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

import jinja2
from markdown_it import MarkdownIt
from markupsafe import Markup
from matplotlib.figure import Figure

from fastmimic import __version__
from fastmimic.base.errors import ConfigError, FastMimicError, OutputError
from fastmimic.base.files import packaged, write_text
from fastmimic.base.text import NONE
from fastmimic.imitation.methods import METHODS
from fastmimic.render import figure_style as style

_CAPTIONS: Final = packaged("fastmimic.report", "captions.json", dict[str, str])


@dataclass(frozen=True)
class Picture:
    """A picture of a page: its `data:` URL, and what it shows, by its file's name or another in `captions.json`."""

    url: str
    text: str

    @classmethod
    def of(cls, source: Path | Figure, name: str = "") -> "Picture":
        """Of a PNG file, or of a figure drawn now; raises `OutputError` if the file cannot be read."""
        if isinstance(source, Path):
            return cls(embedded(source, "image/png"), _CAPTIONS.get(source.name, f"{source.stem.capitalize()}."))
        out = io.BytesIO()
        source.savefig(out, format="png", dpi=0.7 * style.DPI)  # half as large a page, which is no wider
        return cls(_url(out.getvalue(), "image/png"), _CAPTIONS.get(name, name))


@dataclass(frozen=True)
class HtmlReport:
    """A finished page: its HTML, and a sentence for each thing missing in the folder and thus in the page."""

    html: str
    missing: tuple[str, ...]

    def save(self, path: str | Path) -> None:
        """Writes the page, replacing an earlier one; raises `OutputError`."""
        write_text(path, self.html)


def render(template: str, *, title: str, missing: Sequence[str], replay: str = "", **data: Any) -> HtmlReport:
    """Fills a page: a file of `templates/` with a sentence for each thing that is `missing`, an HTML page to be opened
    inside (`replay`, empty for none), and `data` for the template. Raises `ConfigError` for data of another form,
    `OutputError` if a file that the page shows cannot be read."""
    shared = {"title": title, "missing": tuple(missing), "replay": replay}
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


def said_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a command that say something, for a page."""
    arguments = {k.replace("_", "-"): v for k, v in given.items() if v is not False and v not in (None, "", [])}
    for name in ("motions", "cycles"):
        if name in arguments:
            arguments[name] = " ".join(str(v) for v in arguments[name])
    return {k: "yes" if v is True else v for k, v in arguments.items()}


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fastmimic.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.globals |= {"version": __version__, "asset": _asset, "all_methods": METHODS, "NONE": NONE}
    environment.filters |= {"gzip": compressed, "embed": embedded, "markdown": markdown}
    return environment


def _asset(name: str) -> Markup:
    return Markup(resources.files("fastmimic.report").joinpath("templates", name).read_text(encoding="utf-8"))


def compressed(text: str) -> str:
    """A text as stored in the page: gzip, in base64."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def embedded(path: Path, mime: str) -> str:
    """A file as a `data:` URL; raises `OutputError` if it cannot be read."""
    try:
        return _url(path.read_bytes(), mime)
    except OSError as error:
        raise OutputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _url(content: bytes, mime: str) -> str:
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"


def markdown(text: str) -> Markup:
    """HTML of Markdown; its tables can be sorted, and from their third column on have numbers."""
    html = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    table = '<div class="dense scroll"><table class="sortable numbers">'
    return Markup(html.replace("<table>", table).replace("</table>", "</table></div>"))
