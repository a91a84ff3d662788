"""The documentation's tables of parameters, made from the settings classes."""

import dataclasses
import runpy
from pathlib import Path
from typing import Any

import pytest

import fastmimic
from fastmimic.base.configuration import parameters
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.safety import SafetyLimits
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.simulation.config import SensorConfig

HOOKS = Path(fastmimic.__file__).parents[2] / "docs" / "hooks.py"


def test_the_page_has_every_parameter() -> None:
    page = runpy.run_path(str(HOOKS))["on_page_markdown"]("<!-- parameters -->")
    for kind in (EstimatorConfig, SafetyLimits, SensorConfig):
        for name in parameters(kind):
            assert f"| {name} |" in page


@pytest.mark.parametrize("kind", [ControllerConfig, EstimatorConfig, SafetyLimits])
def test_every_parameter_says_what_it_means(kind: Any) -> None:
    parts = [kind, *(type(getattr(kind(), f.name)) for f in dataclasses.fields(kind) if f.name not in parameters(kind))]
    for part in filter(dataclasses.is_dataclass, parts):
        assert all(known.about for known, _ in parameters(part).values())
