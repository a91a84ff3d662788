"""The controls and displays of a live session; held keys and a gamepad are in `steering.js`."""

import html
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fastmimic.base.errors import FastMimicError
from fastmimic.play.live_world import FRICTION
from fastmimic.play.session import playable_methods
from fastmimic.steering.steered import Steered
from fastmimic.viewer import panel
from fastmimic.viewer.panel import Panel

if TYPE_CHECKING:
    from fastmimic.play.page import LiveScene, PlayPage
    from fastmimic.viewer.take import Take
    from fastmimic.viewer.viewer import Cameras

_PACES: Final = {"real time": 1.0, "× 0.5": 0.5, "× 0.25": 0.25, "× 0.1": 0.1}
_DIRECTIONS: Final = {"← left": 90.0, "→ right": -90.0, "↑ ahead": 0.0, "↓ back": 180.0}
_MOTION_KEYS: Final = ("1", "2", "3", "4", "5", "6", "7", "8", "9", "0")
_IN_FORCE: Final = "● "  # before a button's name
_MAX_IMPULSE: Final = 20.0
_MAX_PAYLOAD_KG: Final = 6.0
_THERE_RGB: Final = "#1a7f37"
_ON_THE_WAY_RGB: Final = "#9a6700"
_TROUBLE_RGB: Final = "#b03060"
_VELOCITY: Final = ("forwards, m/s", "to the left, m/s", "turn to the left, rad/s")  # sliders of a steered robot
_STICK: Final = "steer"  # first word of the stick's field, which identifies it
IDLE: Final = f"{_STICK} +0.00 +0.00 +0.00"
_HIDDEN: Final = ("ghost", "names")  # at first; the ghost of a good follower is inside the robot


class PlayPanel(Panel):
    """viser's GUI elements and their effects on a page's session."""

    def __init__(self, page: "PlayPage", cameras: "Cameras", heading: str) -> None:
        gui = page.server.gui
        super().__init__(gui, heading)
        self._pacer, self._history, self._session = page.pacer, page.history, page.session
        self._steering = (0.0, 0.0, 0.0)
        self._mistake: str | None = None
        self._state = gui.add_html("")
        self._pause = gui.add_button("Pause")
        self._pause.on_click(lambda _event: self._toggle())
        self._sliders: dict[str, Any] = {}
        self._groups: dict[str, Any] = {}  # of buttons, one of which is in force
        reference = self._session.reference
        if isinstance(reference, Steered):
            self._add_velocity(reference)
        else:
            self._groups["motion"] = motions = gui.add_button_group("motion", self._session.motions.names)
            motions.on_click(lambda _event: self._do(lambda: self._session.switch(_name(motions))))
        self._add_push()
        self._add_world()
        self._add_view(page.scene, cameras)
        self._add_keys()
        self._add_charts()

    def show(self, take: "Take", plot: tuple[Any, ...]) -> None:
        row = take.rows - 1
        self._state.content = self._status()
        in_force = {"motion": getattr(self._session.reference, "goal", ""), "controller": self._session.method}
        for kind, group in self._groups.items():
            names = [option.removeprefix(_IN_FORCE) for option in group.options]
            options = tuple(_IN_FORCE * (name == in_force[kind]) + name for name in names)
            if options != group.options:  # else the browser draws them again
                group.options = options
        self._figures.content = self._numbers()
        self._strip.content = panel.gait_strip(take, row, now=1.0)
        self._table.content = panel.leg_table(take, row)
        if len(plot[0]) > 1:
            self._plot.data = plot

    def _status(self) -> str:
        session, pacer = self._session, self._pacer
        on, left, turning, reward = self._history.mean()
        colour = _THERE_RGB if session.reference.goal == session.motion else _ON_THE_WAY_RGB
        if session.fallen or session.reference.trouble or self._mistake:
            colour = _TROUBLE_RGB
        factor = "paused" if pacer.paused else f"{100 * pacer.realtime_factor:.0f} % of real time"
        slow = f' style="color:{_TROUBLE_RGB}"' if not pacer.paused and pacer.realtime_factor < 0.95 else ""
        where = html.escape(self._mistake or session.state)
        return (
            '<div style="font-size:13px;line-height:1.5;padding:0 10px;font-variant-numeric:tabular-nums;'
            f'white-space:nowrap;overflow:hidden"><b style="color:{colour}">{where}</b><br>'
            f"<span{slow}>{factor}</span> · {session.method} · reward <b>{reward:.2f}</b><br>"
            f"↑ {on:z.2f}, ← {left:z.2f} m/s, ↺ {turning:z.2f} rad/s</div>"
        )

    def _numbers(self) -> str:
        session = self._session
        median, p99 = session.control_us
        wanted = []
        if isinstance(session.reference, Steered):
            values = ", ".join(f"{v:z.2f}" for v in session.reference.place["wanted"][0])
            wanted.append(("wanted, m/s, m/s, rad/s", values))
        rows = (
            ("control step, median", f"{median:.0f} µs"),
            ("99 of 100 below", f"{p99:.0f} µs of {1e6 * session.dt:.0f}"),
            *wanted,
            ("falls", f"{session.falls}"),
            ("simulated", f"{session.time_s:.0f} s"),
        )
        cells = "".join(f'<tr><td>{a}</td><td style="text-align:right">{b}</td></tr>' for a, b in rows)
        return f'<table style="width:100%;font-size:12px;font-variant-numeric:tabular-nums">{cells}</table>'

    def _do(self, what: Callable[[], object]) -> None:
        """Acts on the session between its steps."""
        with self._pacer.lock:
            try:
                self._mistake = None
                what()
            except FastMimicError as error:
                self._mistake = str(error)

    def _add_velocity(self, reference: Steered) -> None:
        """Sliders of the velocity, which keys and stick add to."""
        for name, (least, most) in zip(_VELOCITY, reference.field.ends().T.round(2).tolist(), strict=True):
            self._sliders[name] = self._gui.add_slider(name, least, most, 0.05, 0.0)
            self._sliders[name].on_update(lambda _event: self._steer())

        @self._gui.add_button("Stop", hint="stand").on_click
        def _(_event: Any) -> None:
            for slider in self._sliders.values():
                slider.value = 0.0
            self._steer()

    def _steer(self) -> None:
        """Adds keys and stick to the sliders: full deflection is the limit of the velocity."""
        if not self._session.steered:
            return
        left, on, aside = self._steering
        velocity = [
            float(slider.value) + stick * float(slider.max if stick > 0 else -slider.min)
            for slider, stick in zip(self._sliders.values(), (on, aside, left), strict=True)
        ]
        self._do(lambda: self._session.steer(velocity))

    def _add_push(self) -> None:
        gui, session = self._gui, self._session
        with gui.add_folder("Push"):
            impulse = gui.add_slider("impulse, N·s", 1.0, _MAX_IMPULSE, 0.5, 4.0)
            ways = gui.add_button_group("push", tuple(_DIRECTIONS))
            angle = gui.add_slider("direction, °", -180, 180, 5, 90, hint="from the heading, positive to the left")
            push = gui.add_button("Push", color="orange")
            limp = gui.add_button("Motors off", hint="it falls, and gets up by itself")

        def shove(degrees: float) -> None:
            self._do(lambda: session.push(float(impulse.value), float(np.radians(degrees))))

        self._shove = lambda: shove(float(angle.value))
        self._limp = lambda: self._do(session.fall)

        ways.on_click(lambda _event: shove(_DIRECTIONS[str(ways.value)]))
        push.on_click(lambda _event: self._shove())
        limp.on_click(lambda _event: self._limp())

    def _add_world(self) -> None:
        gui, session = self._gui, self._session
        with gui.add_folder("Robot and ground"):
            self._groups["controller"] = method = gui.add_button_group("controller", playable_methods())
            friction: Any = gui.add_slider("friction", *FRICTION, 0.05, round(session.world.friction, 2))
            payload: Any = gui.add_slider("payload, kg", 0.0, _MAX_PAYLOAD_KG, 0.1, 0.0)

        method.on_click(lambda _event: self._do(lambda: session.set_method(_name(method))))
        friction.on_update(lambda _event: self._do(lambda: session.world.set_friction(float(friction.value))))
        payload.on_update(lambda _event: self._do(lambda: session.world.set_payload(float(payload.value))))

    def _add_view(self, scene: "LiveScene", cameras: "Cameras") -> None:
        gui, pacer = self._gui, self._pacer
        with gui.add_folder("View", expand_by_default=False):
            pace: Any = gui.add_dropdown("time", tuple(_PACES))
            self._add_camera(cameras)
            panel.add_layer_boxes(gui, [scene], _HIDDEN)

        @pace.on_update
        def _(_event: Any) -> None:
            pacer.pace = _PACES[str(pace.value)]

    def _add_keys(self) -> None:
        gui, session = self._gui, self._session
        with gui.add_folder("Keys and gamepad"):
            self._field = gui.add_text("stick", IDLE, hint="what held keys and the gamepad's left stick ask for")
            gui.add_html(_beside("help.html") + steering_script())

        @self._field.on_update
        def _(_event: Any) -> None:
            found = read_steering(str(self._field.value))
            if found is not None:
                self._steering = found
                self._steer()

        def at(offset: int) -> None:
            names = session.motions.names
            session.switch(names[(names.index(session.reference.goal) + offset) % len(names)])

        def command(label: str, key: Any, what: Callable[[], None]) -> None:
            gui.add_command(label, hotkey=key).on_trigger(lambda _event: what())

        command("Pause or go on", "space", self._toggle)
        command("Push", "P", self._shove)
        command("Motors off", "X", self._limp)
        if session.steered:
            return
        command("Motion before", "pageup", lambda: self._do(lambda: at(-1)))
        command("Next motion", "pagedown", lambda: self._do(lambda: at(1)))
        for key, name in zip(_MOTION_KEYS, session.motions.names, strict=False):
            command(f"Motion: {name}", key, partial(self._do, partial(session.switch, name)))

    def _toggle(self) -> None:
        with self._pacer.lock:
            self._pacer.paused = not self._pacer.paused
        self._pause.label = "Go on" if self._pacer.paused else "Pause"  # its next effect

    def _add_charts(self) -> None:
        gui, plot = self._gui, self._history.plot()
        with panel.charts_window(gui, "Live"):
            self._strip = gui.add_html("")
            data = tuple(np.repeat(column, 2) for column in plot) if len(plot[0]) < 2 else plot
            self._plot = panel.reward_plot(gui, data, panel.plot_series()[:-1], 170, legend=False)
            gui.add_html(f'<div style="font-size:12px;line-height:1.5;padding:0 10px">reward: {panel.plot_key()}</div>')
            self._figures = gui.add_html("")
            with gui.add_folder("Legs in numbers", expand_by_default=False):
                self._table = gui.add_html("")


def _name(group: Any) -> str:
    return str(group.value).removeprefix(_IN_FORCE)


def steering_script() -> str:
    """HTML that starts `steering.js` once; needed because an inserted script element would not run."""
    pixel = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="
    code = html.escape(_beside("steering.js").replace("FIELD", _STICK), quote=True)
    return f'<img src="{pixel}" alt="" width="1" height="1" style="position:absolute" onload="{code}">'


def _beside(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def read_steering(text: str) -> tuple[float, float, float] | None:
    """(turn to the left, forwards, sideways to the left), each in [−1, 1], from the field's text; None for another."""
    found = re.fullmatch(rf"{_STICK}" + r" ([+-]\d\.\d\d)" * 3, text.strip())
    if found is None:
        return None
    left, on, aside = (min(max(float(v), -1.0), 1.0) for v in found.groups())
    return left, on, aside
