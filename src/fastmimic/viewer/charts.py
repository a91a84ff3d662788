"""The panel's charts: reward, gait strip and leg table. Without viser."""

import html
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.episode.reward import REWARD_TERMS, reward_weights
from fastmimic.render.figure_style import INK, LEG_LINES, MUTED
from fastmimic.viewer.marks import contact_flags, friction_use

if TYPE_CHECKING:
    from fastmimic.viewer.take import Take


PLOT_POINTS: Final = 300
STRIP_S: Final = 1.6
_STRIP_WIDTH: Final = 300
_LEFT: Final = 62
_ROW: Final = 9
_LEG_GAP: Final = 5
_KINDS: Final = (("wanted", "wanted"), ("measured", "loaded"), ("stance", "stance"))


def plot_series() -> tuple[dict[str, Any], ...]:
    """uPlot's series: time, the five terms with their weights, the reward, and the cursor."""

    def line(label: str, color: str, width: float, **more: Any) -> dict[str, Any]:
        return {"label": label, "stroke": color, "width": width, "points": {"show": False}, **more}

    terms = [
        line(f"{term.label} × {weight:g}", term.color, 1.5, dash=list(term.dash))
        for term, weight in zip(REWARD_TERMS.values(), reward_weights(), strict=True)
    ]
    return ({"label": "t, s"}, *terms, line("reward", INK, 2.5), line("now", "#ff0033", 2))


def plot_key() -> str:
    """HTML: the colours of the reward's terms."""
    terms = [f'<b style="color:{term.color}">{term.label}</b>' for term in REWARD_TERMS.values()]
    return ", ".join([*terms, f'<b style="color:{INK}">reward</b>'])


def plot_base(take: "Take") -> Array:
    """The reward of an episode for the plot (≤ `PLOT_POINTS`, 7): time, five terms, reward."""
    assert take.terms is not None
    assert take.reward is not None
    rows = np.unique(np.linspace(0, take.rows - 1, min(PLOT_POINTS, take.rows)).round().astype(np.int64))
    return np.column_stack([rows / take.rate_hz, take.terms[rows], take.reward[rows]])


def plot_data(base: Array, time_s: float) -> tuple[Array, ...]:
    """The plot's eight arrays: those of `plot_base` and a cursor at `time_s`, s."""
    now = np.array([np.interp(time_s, base[:, 0], column) for column in base.T])
    now[0] = time_s
    at = int(np.searchsorted(base[:, 0], time_s))
    rows = np.insert(base, at, [now, now], axis=0)
    cursor = np.full(len(rows), np.nan)
    cursor[at : at + 2] = 0.0, 1.0
    return (*(np.ascontiguousarray(column) for column in rows.T), cursor)


def gait_strip(take: "Take", row: int, now: float = 0.5) -> str:
    """An SVG of wanted (outlined), loaded (filled) and planned (hatched) stance about a row of a take. `now` is the
    place of the present as a share of the strip: 1 shows the past only."""
    samples = round(STRIP_S * take.rate_hz)
    left_row = row - round(now * samples)
    first, end = max(left_row, 0), min(left_row + samples + 1, take.rows)
    leg_height = len(_KINDS) * _ROW + _LEG_GAP
    height = len(LEGS) * leg_height + 14
    parts = [
        f'<svg viewBox="0 0 {_STRIP_WIDTH} {height}" width="100%" role="img" aria-label="gait strip"'
        ' style="display:block;background:#fff;padding:0 16px 0 4px;box-sizing:border-box">'
    ]

    def x(at: float) -> float:
        return _LEFT + (at - left_row) / samples * (_STRIP_WIDTH - _LEFT)

    def write(text: str, x: float, y: float, anchor: str, colour: str) -> None:
        parts.append(f'<text x="{x}" y="{y}" font-size="8.5" text-anchor="{anchor}" fill="{colour}">{text}</text>')

    for leg, name in enumerate(LEGS):
        colour = LEG_LINES[leg].color
        parts.append(
            f'<pattern id="h{leg}" width="3" height="3" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
            f'<rect width="1.4" height="3" fill="{colour}"/></pattern>'
        )
        fills = {"wanted": "none", "measured": colour, "stance": f"url(#h{leg})"}
        for k, (kind, label) in enumerate(_KINDS):
            y = leg * leg_height + k * _ROW
            write(f"{name} {label}" if k == 0 else label, _LEFT - 4, y + 7.5, "end", INK)
            flags = getattr(take, kind)
            for a, b in [] if flags is None else runs(flags[first:end, leg]):
                left, right = x(first + a), x(first + b)
                parts.append(
                    f'<rect x="{left:.1f}" y="{y + 1}" width="{max(right - left, 0.5):.1f}" height="{_ROW - 2}"'
                    f' fill="{fills[kind]}" stroke="{colour}" stroke-width="0.8"/>'
                )
    middle, bottom = x(row), len(LEGS) * leg_height
    parts.append(f'<line x1="{middle}" x2="{middle}" y1="0" y2="{bottom}" stroke="#ff0033" stroke-width="1.4"/>')
    ends = [(0.0, f"−{now * STRIP_S:g} s"), (now, "now")] + ([(1.0, f"+{(1 - now) * STRIP_S:g} s")] if now < 1 else [])
    for share, text in ends:
        anchor = "start" if share == 0 else "end" if share == 1 else "middle"
        write(text, _LEFT + share * (_STRIP_WIDTH - _LEFT), bottom + 9, anchor, MUTED)
    return "".join([*parts, "</svg>"])


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(first, end) of each run of True in (t,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def leg_table(take: "Take", row: int) -> str:
    """An HTML table of the legs: wanted, measured and planned contact, load, and use of the friction pyramid."""
    flags, use = contact_flags(take, row), friction_use(take, row)
    head = "".join(f"<th>{h}</th>" for h in ("", "wanted", "loaded", "state", "f<sub>z</sub>", "friction"))
    lines = []
    for leg, name in enumerate(LEGS):
        cells = [
            f'<b style="color:{LEG_LINES[leg].color}">{name}</b>',
            "◯" if flags["wanted"][leg] else "–",
            "" if take.measured is None else "●" if flags["measured"][leg] else "–",
            "" if take.stance is None else "☐ stance" if flags["stance"][leg] else "swing",
            "" if take.force is None else f"{take.force[row, leg, 2]:.0f} N",
            "" if np.isnan(use[leg]) else f"{100 * use[leg]:.0f} %",
        ]
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    style = "width:100%;font-size:12px;text-align:center;border-collapse:collapse;font-variant-numeric:tabular-nums"
    return f'<table style="{style}"><tr>{head}</tr>{"".join(lines)}</table>'


def status_line(take: "Take", row: int) -> str:
    """HTML: title and caption, the time, and the reward at this step."""
    reward = "" if take.reward is None else f" · reward now <b>{take.reward[row]:.2f}</b>"
    fallen = take.fell_at is not None and row >= take.fell_at
    state = ' · <b style="color:#b03060">fallen</b>' if fallen else ""
    title, caption = html.escape(take.title), html.escape(take.caption)
    return f'<div style="font-size:13px;padding:4px 10px"><b>{title}</b> · {caption}{reward}{state}</div>'
