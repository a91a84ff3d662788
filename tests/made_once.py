"""What many commands make anew and few tests look at: made once in a process, or small."""

import io
import pickle
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from matplotlib.figure import Figure

from fastmimic.clips.clip import Clip
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.report import RetargetReport
from fastmimic.robot import Robot

_made: dict[bytes, tuple[Motion, RetargetReport]] = {}
_drawn: dict[str, bytes] = {}


@pytest.fixture(autouse=True)
def made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal clips are retargeted once, for `tests/retargeting` says how; of figures of the same name all are made, as
    Matplotlib's objects, and the first one is drawn, for `tests/report` draws all, in fewer pixels."""
    module = import_module("fastmimic.retargeting.retarget")
    retarget = module.retarget

    def remembered(clip: Clip, robot: Robot, **options: Any) -> tuple[Motion, RetargetReport]:
        body = [getattr(robot, field.name) for field in fields(robot) if field.name != "base_spec"]
        key = pickle.dumps((clip, body, options))
        if key not in _made:
            _made[key] = retarget(clip, robot, **options)
        motion, report = _made[key]
        return replace(motion, provenance=pickle.loads(pickle.dumps(motion.provenance))), report

    savefig = Figure.savefig

    def drawn(figure: Figure, file: BinaryIO, **options: Any) -> None:
        options["dpi"] = 40
        if isinstance(file, io.BytesIO):
            savefig(figure, file, **options)
            return
        name = Path(file.name).stem  # that of a temporary file: without its random ending
        if name not in _drawn:
            content = io.BytesIO()
            savefig(figure, content, **options)
            _drawn[name] = content.getvalue()
        file.write(_drawn[name])

    monkeypatch.setattr(Figure, "savefig", drawn)
    monkeypatch.setattr(module, "retarget", remembered)
