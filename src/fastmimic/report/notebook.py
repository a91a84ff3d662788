"""How motions and results look in a notebook: figures, plot and video."""

import tempfile
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from fastmimic.base.errors import RobotError
from fastmimic.base.text import number
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.rollout import Rollout
from fastmimic.imitation.evaluate import Evaluation
from fastmimic.imitation.imitate import Imitation
from fastmimic.motion.motion import Motion
from fastmimic.report.figures import motion_figure, render_run, run_figure
from fastmimic.report.html_page import Picture, embedded
from fastmimic.robot import load_robot


def as_html(shown: Motion | Evaluation | Imitation) -> str:
    """HTML of what a cell returns: of a motion its figure, of an evaluation its table, of a result the video, if
    anything can draw, table and tracking. Of a motion for a robot that is no built-in one, the text alone."""
    if isinstance(shown, Imitation):
        columns = {"before": shown.before, "after": shown.after}
        return _video(shown) + _table(columns) + _picture(run_figure(shown))
    if isinstance(shown, Evaluation):
        return f"<pre>{escape(repr(shown.motion))}</pre>" + _table({shown.method: shown.rollout})
    text = f"<pre>{escape(repr(shown))}</pre>"
    try:
        return text + _picture(motion_figure(shown, load_robot(str(shown.provenance.robot))))
    except RobotError:
        return text


def _table(columns: dict[str, Rollout]) -> str:
    figures = [Metrics.of(rollout) for rollout in columns.values()]
    rows = {
        "": list(columns),
        "reward against the animal": [number(m.reward_animal) for m in figures],
        "reward": [number(m.reward_mean) for m in figures],
        "fell": [f"{m.fell:.0%}" for m in figures],
        "drift, m/s": [number(m.drift_m_per_s) for m in figures],
    }
    cells = ("".join(f"<td>{escape(cell)}</td>" for cell in (name, *values)) for name, values in rows.items())
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def _picture(figure: Figure) -> str:
    return f'<img style="max-width: 100%" src="{Picture.of(figure).url}">'


def _video(result: Imitation) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mp4"
        if not render_run(result, path):
            return ""
        url = embedded(path, "video/mp4")
    return f'<video style="max-width: 100%" controls loop autoplay muted src="{url}"></video>'
