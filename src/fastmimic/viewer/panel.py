"""The controls beside the scene: playback, what is shown, and the charts."""

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fastmimic.viewer.charts import gait_strip, leg_table, plot_base, plot_data, plot_key, plot_series, status_line
from fastmimic.viewer.clock import REPEATS
from fastmimic.viewer.scene import LAYERS

if TYPE_CHECKING:
    from fastmimic.viewer.server import Viewer
    from fastmimic.viewer.take import Take

SPEEDS: Final = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)
_REPEAT_WORDS: Final = {"all": "everything", "cycle": "this cycle", "off": "nothing"}
_CYCLES: Final = {"first": 0, "− 1": -1, "+ 1": 1}
_STEP_S: Final = 0.01
_FRAMES: Final = {"− 10 ms": -1, "+ 10 ms": 1}
_XRAY: Final = 0.35
_CHARTS_WIDTH: Final = 320  # pixels
_CONTROLS_WIDTH: Final = 300

_KEY: Final = """\
<div style="font-size:12px;line-height:1.5;padding:0 10px">
<b style="color:#009e73">green, translucent</b> the demonstration; its paths are dashed<br>
<b>◯</b> ring under a foot: the schedule wants it down · <b>●</b> disc: it is loaded · <b>☐</b> square: the planner
has it in stance<br>
<b style="color:#b2182b">arrow</b> ground's force · <b>black line</b> force asked for ·
<b style="color:#785ef0">pyramid</b> friction: the arrow's tip stays in its square<br>
<b style="color:#d21e8c">ball, cross +</b> centre of mass, and where it is above the ground · <b>cube, cross ×</b> the
demonstration's<br>
legs: <b style="color:#d55e00">FR</b> <b style="color:#0072b2">FL</b> <b style="color:#e69f00">RR</b>
<b style="color:#56b4e9">RL</b><br>
reward: {terms}
</div>"""


class Panel:
    """viser's GUI elements, and what they do to the viewer."""

    def __init__(self, viewer: "Viewer", heading: str, episodes: Sequence[int]) -> None:
        self._viewer = viewer
        self._gui = viewer.server.gui
        self.version = 0
        """Goes up with each change that the scene must follow."""
        self._gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._gui.main_panel.dock_right()
        self._gui.main_panel.set_width(_CONTROLS_WIDTH)
        self._gui.add_html(f'<div style="font-size:15px;font-weight:700;padding:2px 10px">{html.escape(heading)}</div>')
        self._add_playback(max(episodes))
        self._add_layers()
        self._status: list[Any] = []
        self._tables: list[Any] = []
        self._strips: list[Any] = []
        self._plots: list[Any] = []
        self._bases: list[Any] = []
        self._add_charts()
        with self._gui.add_folder("Key", expand_by_default=False):
            self._gui.add_html(_KEY.format(terms=plot_key()))

    @property
    def follow(self) -> bool:
        """Whether the view follows the robots."""
        return bool(self._follow.value)

    def show(self, row: int) -> None:
        """Brings slider and charts to a row."""
        clock = self._viewer.clock
        self._time.value = min(row / clock.rate_hz, self._time.max)
        cycles = len(clock.cycle_starts)
        text = f"cycle {clock.cycle + 1} of {cycles}" if cycles > 1 else "one pass"
        self._cycle.content = f'<div style="font-size:12px;padding:0 10px">{text}</div>'
        for i, scene in enumerate(self._viewer.robots):
            take = scene.take
            at = take.clamp(row)
            self._status[i].content = status_line(take, at)
            self._tables[i].content = leg_table(take, at)
            self._strips[i].content = gait_strip(take, at)
            if self._plots[i] is not None:
                self._plots[i].data = plot_data(self._bases[i], take.time_at(at))

    def show_playing(self) -> None:
        """Labels the button by what it does next."""
        self._play.label = "Pause" if self._viewer.clock.playing else "Play"

    def set_takes(self) -> None:
        """Takes over the takes that the scenes now show."""
        clock = self._viewer.clock
        self._time.max = max(_last_s(clock.rows, clock.rate_hz), 0.0)
        for i, scene in enumerate(self._viewer.robots):
            if self._plots[i] is not None:
                self._bases[i] = plot_base(scene.take)

    def _add_playback(self, episodes: int) -> None:
        viewer, clock = self._viewer, self._viewer.clock
        self._play = self._gui.add_button("Pause")
        end = _last_s(clock.rows, clock.rate_hz)
        self._time: Any = self._gui.add_slider("time, s", 0.0, end, round(1.0 / clock.rate_hz, 6), 0.0)
        self._cycle = self._gui.add_html("")
        cycles = self._gui.add_button_group("cycle", tuple(_CYCLES))
        frames = self._gui.add_button_group("step", tuple(_FRAMES))
        speed = self._gui.add_dropdown("speed", tuple(f"× {s:g}" for s in SPEEDS), initial_value="× 1")
        repeat = self._gui.add_dropdown("repeat", tuple(_REPEAT_WORDS.values()), initial_value=_REPEAT_WORDS["all"])
        self._follow = self._gui.add_checkbox("follow the robot", True)
        reset = self._gui.add_button("Reset the view")

        @self._play.on_click
        def _(_event: Any) -> None:
            with viewer.lock:
                viewer.clock.toggle()
                self.show_playing()
                self.version += 1

        @self._time.on_update
        def _(event: Any) -> None:
            if event.client is None:
                return  # set by us
            with viewer.lock:
                viewer.clock.playing = False
                viewer.clock.seek(round(float(self._time.value) * viewer.clock.rate_hz))
                self.show_playing()
                self.version += 1

        @cycles.on_click
        def _(_event: Any) -> None:
            with viewer.lock:
                by = _CYCLES[str(cycles.value)]
                if by == 0:
                    viewer.clock.seek(0)
                else:
                    viewer.clock.step_cycle(by)
                self.version += 1

        @frames.on_click
        def _(_event: Any) -> None:
            with viewer.lock:
                viewer.clock.playing = False
                by = _FRAMES[str(frames.value)]
                viewer.clock.seek(viewer.clock.row + by * max(1, round(_STEP_S * viewer.clock.rate_hz)))
                self.show_playing()
                self.version += 1

        @speed.on_update
        def _(_event: Any) -> None:
            with viewer.lock:
                viewer.clock.speed = float(str(speed.value).removeprefix("× "))

        @repeat.on_update
        def _(_event: Any) -> None:
            with viewer.lock:
                viewer.clock.repeat = next(r for r in REPEATS if _REPEAT_WORDS[r] == repeat.value)

        @self._follow.on_update
        def _(_event: Any) -> None:
            self.version += 1

        @reset.on_click
        def _(event: Any) -> None:
            viewer.reset_camera(event.client)

        if episodes > 1:
            chosen = self._gui.add_dropdown("episode", tuple(str(i) for i in range(episodes)), initial_value="0")

            @chosen.on_update
            def _(_event: Any) -> None:
                viewer.choose(int(str(chosen.value)))

    def _add_layers(self) -> None:
        viewer = self._viewer
        with self._gui.add_folder("Show", expand_by_default=False):
            for layer, words in LAYERS.items():
                if layer == "animal" and not any(scene.has_animal for scene in viewer.robots):
                    continue
                self._add_layer(layer, words)
            xray = self._gui.add_checkbox("robot translucent", False)

            @xray.on_update
            def _(_event: Any) -> None:
                for scene in viewer.robots:
                    scene.set_opacity(_XRAY if xray.value else None)

    def _add_layer(self, layer: str, words: str) -> None:
        box = self._gui.add_checkbox(words, True)

        @box.on_update
        def _(_event: Any) -> None:
            for scene in self._viewer.robots:
                scene.set_layer(layer, bool(box.value))

    def _add_charts(self) -> None:
        """In a window of their own on the other side; on a phone a section of the sheet."""
        gui, robots = self._gui, self._viewer.robots
        window = gui.add_panel()
        window.dock_left()
        window.set_width(_CHARTS_WIDTH)
        with window.add_tab("Charts"):
            for scene in robots:
                self._add_take(scene.take, alone=len(robots) == 1)

    def _add_take(self, take: "Take", *, alone: bool) -> None:
        gui = self._gui
        self._status.append(gui.add_html(""))
        self._strips.append(gui.add_html(""))
        self._plots.append(None)
        self._bases.append(None)
        if take.terms is not None:
            self._bases[-1] = plot_base(take)
            self._plots[-1] = gui.add_uplot(
                data=plot_data(self._bases[-1], 0.0),
                series=plot_series(),  # type: ignore[arg-type]
                scales={"x": {"time": False}, "y": {"auto": False, "min": 0.0, "max": 1.05}},
                axes=({"size": 34}, {"size": 44}),
                legend={"show": alone, "live": False},
                cursor={"show": False},
                height=190 if alone else 130,
            )
        with gui.add_folder("Legs in numbers", expand_by_default=alone):
            self._tables.append(gui.add_html(""))


def _last_s(rows: int, rate_hz: float) -> float:
    return float(np.round(max(rows - 1, 1) / rate_hz, 6))
