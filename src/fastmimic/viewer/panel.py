"""The controls: playback and layers; the charts: reward, gait strip and leg table."""

import html
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fastmimic.base.arrays import Array, stretches
from fastmimic.base.conventions import LEGS
from fastmimic.episode.reward import REWARD_TERMS, reward_weights
from fastmimic.render.figure_style import INK, LEG_LINES, MUTED
from fastmimic.viewer.scene import LAYERS, RobotScene
from fastmimic.viewer.take import Take, contact_flags, friction_use

if TYPE_CHECKING:
    import viser

    from fastmimic.viewer.viewer import Cameras, Player, Repeat, Viewer

_SPEEDS: Final = {f"× {speed:g}": speed for speed in (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)}
_REPEATS: "Final[dict[str, Repeat]]" = {"everything": "all", "this cycle": "cycle", "nothing": "off"}
_CYCLES: Final = {"first": -(10**9), "− 1": -1, "+ 1": 1}  # cycles to go
_STEP_S: Final = 0.01
_FRAMES: Final = {"− 10 ms": -1, "+ 10 ms": 1}
_XRAY: Final = 0.35
_CHARTS_WIDTH: Final = 320  # pixels
_CONTROLS_WIDTH: Final = 300
PLOT_POINTS: Final = 300
STRIP_S: Final = 1.6
_STRIP_WIDTH: Final = 300
_LEFT: Final = 62
_ROW: Final = 9
_LEG_GAP: Final = 5
_KINDS: Final = (("wanted", "wanted"), ("measured", "loaded"), ("stance", "stance"))


class Panel:
    """Controls docked at the right, with a heading."""

    def __init__(self, gui: "viser.GuiApi", heading: str) -> None:
        self._gui = gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_CONTROLS_WIDTH)
        gui.add_html(f'<div style="font-size:15px;font-weight:700;padding:2px 10px">{html.escape(heading)}</div>')

    def _add_camera(self, cameras: "Cameras") -> None:
        self._follow = self._gui.add_checkbox("follow the robot", True)
        self._gui.add_button("Reset the view").on_click(lambda event: cameras.reset(event.client))

    @property
    def follow(self) -> bool:
        """Whether the view follows the robots."""
        return bool(self._follow.value)


class ViewerPanel(Panel):
    """viser's GUI elements and their effects on a viewer's player, which moves its robots, and on the episode shown."""

    def __init__(self, viewer: "Viewer", cameras: "Cameras", heading: str, episodes: int) -> None:
        super().__init__(viewer.server.gui, heading)
        self._player, self._lock, self._robots = viewer.player, viewer.lock, viewer.robots
        gui, robots = self._gui, self._robots
        self.version = 0  # counts the changes that the scene must follow
        self._add_playback(cameras)
        if episodes > 1:
            chosen = gui.add_dropdown("episode", tuple(str(i) for i in range(episodes)), initial_value="0")
            chosen.on_update(lambda _event: viewer.choose(int(str(chosen.value))))
        self._add_layers()
        with charts_window(gui, "Charts"):
            self._charts = [_TakeCharts(gui, scene, alone=len(robots) == 1) for scene in robots]
        with gui.add_folder("Key", expand_by_default=False):
            gui.add_html(Path(__file__).with_name("key.html").read_text(encoding="utf-8").format(terms=plot_key()))

    def show(self, row: int) -> None:
        player = self._player
        self._time.value = min(row / player.rate_hz, self._time.max)
        cycles = len(player.cycle_starts)
        text = f"cycle {player.cycle + 1} of {cycles}" if cycles > 1 else "one pass"
        self._cycle.content = f'<div style="font-size:12px;padding:0 10px">{text}</div>'
        for charts in self._charts:
            charts.show(row)

    def show_playing(self) -> None:
        """Labels the button by its next effect."""
        self._play.label = "Pause" if self._player.playing else "Play"

    def set_takes(self) -> None:
        """Adopts the takes now in the scenes."""
        self._time.max = max(_last_s(self._player), 0.0)

    def _add_playback(self, cameras: "Cameras") -> None:
        gui, player = self._gui, self._player
        self._play = gui.add_button("Pause")
        self._time: Any = gui.add_slider("time, s", 0.0, _last_s(player), round(1.0 / player.rate_hz, 6), 0.0)
        self._cycle = gui.add_html("")
        cycles = gui.add_button_group("cycle", tuple(_CYCLES))
        frames = gui.add_button_group("step", tuple(_FRAMES))
        speed = gui.add_dropdown("speed", tuple(_SPEEDS), initial_value="× 1")
        repeat = gui.add_dropdown("repeat", tuple(_REPEATS))
        self._add_camera(cameras)

        def go_to(row: int) -> None:
            player.playing = False
            player.seek(row)

        def step_frames() -> None:
            go_to(player.row + _FRAMES[str(frames.value)] * max(1, round(_STEP_S * player.rate_hz)))

        def set_course() -> None:
            player.speed, player.repeat = _SPEEDS[str(speed.value)], _REPEATS[str(repeat.value)]

        @self._time.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # otherwise set by `show`
                self._change(lambda: go_to(round(float(self._time.value) * player.rate_hz)))

        self._play.on_click(lambda _event: self._change(player.toggle))
        cycles.on_click(lambda _event: self._change(lambda: player.step_cycle(_CYCLES[str(cycles.value)])))
        frames.on_click(lambda _event: self._change(step_frames))
        for choice in (speed, repeat):
            choice.on_update(lambda _event: self._change(set_course))
        self._follow.on_update(lambda _event: self._change())

    def _change(self, act: Callable[[], None] | None = None) -> None:
        """Changes the player between two pictures."""
        with self._lock:
            if act is not None:
                act()
            self.show_playing()
            self.version += 1

    def _add_layers(self) -> None:
        robots = self._robots
        with self._gui.add_folder("Show", expand_by_default=False):
            add_layer_boxes(self._gui, robots)
            xray = self._gui.add_checkbox("robot translucent", False)

            @xray.on_update
            def _(_event: Any) -> None:
                for scene in robots:
                    scene.set_opacity(_XRAY if xray.value else None)


class _TakeCharts:
    def __init__(self, gui: "viser.GuiApi", scene: RobotScene, *, alone: bool) -> None:
        self._scene = scene
        self._status, self._strip = gui.add_html(""), gui.add_html("")
        self._plot: Any = None
        if scene.take.terms is not None:
            data = plot_data(plot_base(scene.take), 0.0)
            self._plot = reward_plot(gui, data, plot_series(), 190 if alone else 130, legend=alone)
        with gui.add_folder("Legs in numbers", expand_by_default=alone):
            self._table = gui.add_html("")

    def show(self, row: int) -> None:
        take = self._scene.take
        row = take.clamp(row)
        self._status.content = status_line(take, row)
        self._table.content = leg_table(take, row)
        self._strip.content = gait_strip(take, row)
        if self._plot is not None:
            self._plot.data = plot_data(plot_base(take), row / take.rate_hz)


def charts_window(gui: "viser.GuiApi", title: str) -> Any:
    """A window for charts at the left; on a phone a section of the sheet."""
    window = gui.add_panel()
    window.dock_left()
    window.set_width(_CHARTS_WIDTH)
    return window.add_tab(title)


def add_layer_boxes(gui: "viser.GuiApi", robots: Sequence[RobotScene], hidden: Sequence[str] = ()) -> None:
    """A check box for each layer of the first robot; the `hidden` ones are hidden at first."""

    def show(layer: str, box: Any, _event: Any = None) -> None:
        for scene in robots:
            scene.set_layer(layer, bool(box.value))

    for layer in robots[0].layers:
        box = gui.add_checkbox(LAYERS[layer], layer not in hidden)
        box.on_update(partial(show, layer, box))
        show(layer, box)


def reward_plot(gui: "viser.GuiApi", data: Any, series: Any, height: int, *, legend: bool) -> Any:
    return gui.add_uplot(
        data=data,
        series=series,
        scales={"x": {"time": False}, "y": {"auto": False, "min": 0.0, "max": 1.05}},
        axes=({"size": 34}, {"size": 44}),
        legend={"show": legend, "live": False},
        cursor={"show": False},
        height=height,
    )


def _last_s(player: "Player") -> float:
    return float(np.round(max(player.rows - 1, 1) / player.rate_hz, 6))


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


def plot_base(take: Take) -> Array:
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


def gait_strip(take: Take, row: int, now: float = 0.5) -> str:
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
            for a, b in [] if flags is None else stretches(flags[first:end, leg]):
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


def leg_table(take: Take, row: int) -> str:
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


def status_line(take: Take, row: int) -> str:
    """HTML: title and caption, the time, and the reward at this step."""
    reward = "" if take.reward is None or np.isnan(take.reward[row]) else f" · reward now <b>{take.reward[row]:.2f}</b>"
    fallen = take.fell_at is not None and row >= take.fell_at
    state = ' · <b style="color:#b03060">fallen</b>' if fallen else ""
    title, caption = html.escape(take.title), html.escape(take.caption)
    return f'<div style="font-size:13px;padding:4px 10px"><b>{title}</b> · {caption}{reward}{state}</div>'
