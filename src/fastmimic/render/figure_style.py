"""What all figures share: colours, plain axes, and saving.

Colours are Okabe and Ito's (2008), safe for colour-blind readers; line styles also tell the series apart. Only
matplotlib's object interface is used: no pyplot, no rcParams.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fastmimic.base.errors import OutputError
from fastmimic.base.files import replace_file

DPI: Final = 150
INK: Final = "#222222"
MUTED: Final = "#6b6b6b"
STANCE: Final = "#e9e9e6"
LIMIT: Final = "#b03060"

Dash = str | tuple[float, tuple[float, ...]]


class Line(NamedTuple):
    """Colour and dash pattern of a series, as `Axes.plot` names them."""

    color: str
    linestyle: Dash
    linewidth: float


DEMONSTRATION: Final = Line("#009e73", (0, (5, 1.6)), 1.8)
BEFORE: Final = Line("#d55e00", (0, (1.2, 1.2)), 1.6)
AFTER: Final = Line("#0072b2", "solid", 1.8)
LEG_LINES: Final = (  # FR, FL, RR, RL: right orange, left blue; front solid, rear dashed
    Line("#d55e00", "solid", 1.6),
    Line("#0072b2", "solid", 1.6),
    Line("#e69f00", (0, (3, 1.4)), 1.6),
    Line("#56b4e9", (0, (3, 1.4)), 1.6),
)
SERIES_LINES: Final = (  # four series that are not legs
    Line(INK, "solid", 1.6),
    Line("#cc79a7", "solid", 1.6),
    Line("#009e73", (0, (3, 1.4)), 1.6),
    Line("#8a6bbf", (0, (3, 1.4)), 1.6),
)


def new_figure(width: float, height: float, title: str, below: float | None = None) -> Figure:
    """An empty figure of `width` × `height` inches, its title at the top left. With `below`, inches for what stands
    below the panels, these have fixed margins: the figure is then drawn once in place of three times to find them."""
    figure = Figure(figsize=(width, height), layout="constrained" if below is None else None, facecolor="white")
    FigureCanvasAgg(figure)
    y = None if below is None else 1.0 - 0.09 / height  # given one, a constrained layout leaves it no room
    figure.suptitle(title, x=0.012, y=y, ha="left", va="top", fontsize=13, fontweight="bold", color=INK)
    if below is not None:
        figure.subplots_adjust(0.75 / width, below / height, 1.0 - 0.12 / width, 1.0 - 0.62 / height, 0.25, 0.28)
    return figure


def tidy(
    axes: Axes, title: str = "", xlabel: str = "", ylabel: str = "", grid: Literal["both", "x", "y"] = "both"
) -> None:
    """Gives `axes` the common look: no box, a light grid across an axis or both, labels with their units."""
    axes.set_title(title, loc="left", fontsize=10, color=INK)
    axes.set_xlabel(xlabel, fontsize=9, color=MUTED)
    axes.set_ylabel(ylabel, fontsize=9, color=MUTED)
    axes.tick_params(labelsize=8, color=MUTED, labelcolor=INK, length=3)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#bbbbbb")
    axes.grid(True, axis=grid, color="#e3e3e3", linewidth=0.6)
    axes.set_axisbelow(True)


def write_at(
    axes: Axes, text: str, place: tuple[float, float], offset: tuple[float, float], size: float, **more: Any
) -> None:
    """Writes `text`, centred `offset` points from a place."""
    style = {"ha": "center", "color": INK} | more
    axes.annotate(text, place, xytext=offset, textcoords="offset points", fontsize=size, **style)


def legend_below(figure: Figure, axes: Axes | None = None, more: Sequence[Artist] = (), size: float = 9) -> None:
    """Writes the labels of `axes` and of `more` in a line below all panels."""
    handles = [*(axes.get_legend_handles_labels()[0] if axes is not None else ()), *more]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=size, frameon=False)


def save(figure: Figure, path: str | Path) -> None:
    """Writes `figure` as PNG, PDF or SVG, by the ending of `path`, whole or not at all; raises `OutputError`."""
    suffix = Path(path).suffix.lower().lstrip(".")
    if suffix not in ("png", "pdf", "svg"):
        raise OutputError(f"{path}: a figure can be saved as .png, .pdf or .svg, not {suffix or 'without ending'!r}")
    replace_file(path, lambda file: figure.savefig(file, format=suffix, dpi=DPI))
