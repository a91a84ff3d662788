"""Settings as data: checks, packed records, reading and documentation out of the fields' metadata."""

import dataclasses
import runpy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from fastmimic.base.configuration import (
    changed,
    check,
    documented,
    pack,
    parameter,
    parameters,
    record_fields,
)
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import record_dtype

DESCRIBE = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "hooks.py"))["describe"]


@documented
@dataclass(frozen=True)
class Gains:
    """Gains of a joint."""

    stiffness: float = parameter(30.0, unit="N·m/rad", above=0.0, scale="size", about="of the position error")
    offset: tuple[float, float] = parameter((0.0, 0.5), unit="m", low=None, about="of the target")
    kind: Literal["off", "on"] = parameter("on", choices=("off", "on"), key="is_on", about="whether it acts")
    steps: int = parameter(3, low=1, high=5, about="of the plan")
    smooth: bool = parameter(True, about="whether targets are filtered")
    rate_hz: float = parameter(500.0, key="", about="of the loop, Hz")


@dataclass(frozen=True)
class Whole:
    gains: Gains = dataclasses.field(default_factory=Gains)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stiffness": 0.0}, "stiffness must be positive, found 0.0"),
        ({"stiffness": float("nan")}, "stiffness must be finite"),
        ({"stiffness": "high"}, "stiffness must be a number"),
        ({"offset": (0.0, 0.0, 0.0)}, "offset must have 2 numbers"),
        ({"offset": (0.0, float("inf"))}, "offset must be finite"),
        ({"kind": "of"}, "kind must be one of off, on"),
        ({"steps": 6}, r"steps must be in \[1, 5\], found 6"),
        ({"steps": 2.5}, "steps must be a whole number"),
        ({"smooth": 1}, "smooth must be true or false"),
        ({"rate_hz": -1.0}, "rate_hz must not be negative"),
    ],
)
def test_a_value_out_of_its_range_is_refused_by_name(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"robot: gains.{message}"):
        check(Whole(dataclasses.replace(Gains(), **changes)), "robot: ")


def test_what_is_in_range_passes() -> None:
    check(Whole(), "")
    check(Gains(offset=(-1.0, -2.0), steps=5), "")


def test_records_hold_choices_as_numbers_and_scale_what_has_a_scale() -> None:
    record = np.zeros(1, record_dtype(record_fields(Gains)))
    pack(Gains(), record, {"size": 2.0})
    assert record.dtype.names == ("stiffness", "offset", "is_on", "steps", "smooth")
    assert record["stiffness"] == 60.0
    assert record["is_on"] == 1
    assert record["smooth"] == 1.0
    np.testing.assert_array_equal(record["offset"][0], (0.0, 0.5))


def test_changes_are_converted_to_the_kind_of_the_field() -> None:
    found = changed(Whole(), {"gains": {"stiffness": 2, "offset": [1, 2], "steps": 4.0}}, "file")
    assert found.gains == Gains(stiffness=2.0, offset=(1.0, 2.0), steps=4)
    assert type(found.gains.stiffness) is float
    assert type(found.gains.steps) is int


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 2.5, True, "3"])
def test_a_whole_number_is_nothing_else(value: Any) -> None:
    with pytest.raises(ConfigError, match="'steps' must be of the kind of 3"):
        changed(Gains(), {"steps": value}, "file")


def test_documentation_follows_from_the_fields() -> None:
    assert "stiffness: of the position error, N·m/rad." in str(Gains.__doc__)
    rows = {row[0]: row[1:] for row in DESCRIBE(Gains)}
    assert rows["stiffness"] == ("30", "N·m/rad", "> 0", "of the position error")
    assert rows["offset"][:3] == ("0, 0.5", "m", "")
    assert rows["steps"][2] == "[1, 5]"
    assert rows["kind"][2] == "off, on"
    assert list(rows) == list(parameters(Gains))
