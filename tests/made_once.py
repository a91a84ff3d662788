"""What many commands make anew and few tests look at: made once in a process, or small."""

import pickle
from dataclasses import fields, replace
from importlib import import_module
from typing import Any

import pytest

from fastmimic.clips.clip import Clip
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.report import RetargetReport
from fastmimic.robot import Robot

_made: dict[bytes, tuple[Motion, RetargetReport]] = {}


@pytest.fixture(autouse=True)
def made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal clips are retargeted once, for `tests/retargeting` says how; figures have fewer pixels."""
    module = import_module("fastmimic.retargeting.retarget")
    retarget = module.retarget

    def remembered(clip: Clip, robot: Robot, **options: Any) -> tuple[Motion, RetargetReport]:
        body = [getattr(robot, field.name) for field in fields(robot) if field.name != "base_spec"]
        key = pickle.dumps((clip, body, options))
        if key not in _made:
            _made[key] = retarget(clip, robot, **options)
        motion, report = _made[key]
        return replace(motion, provenance=pickle.loads(pickle.dumps(motion.provenance))), report

    monkeypatch.setattr(module, "retarget", remembered)
    monkeypatch.setattr("fastmimic.render.figure_style.DPI", 40)
