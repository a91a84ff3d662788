"""Robots that are drawn: within their ranges, over all of each range, and the same for the same generator."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError
from fastmimic.simulation.conditions import (
    Range,
    draw_uniform,
    make_world,
    other_ranges,
    other_robots,
    parse_range,
    usual_range,
    usual_ranges,
)
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, DisturbanceKind

RANGES = (Range("friction", 0.4, 1.2), Range("payload", 0.0, 3.0), Range("push", -5.0, 5.0))


def test_every_disturbance_that_robots_of_a_batch_can_differ_in_has_a_usual_range() -> None:
    assert set(usual_ranges()) == {n for n, k in DISTURBANCES.items() if k.per_robot and not k.sensed}
    for name, (lower, upper) in usual_ranges().items():
        kind = DISTURBANCES[name]
        assert usual_range(name) == Range(name, lower, upper)
        assert np.isinf(kind.nominal) or lower <= kind.nominal <= upper, "the robot as it is must not be an outsider"


def test_the_documentation_lists_them() -> None:
    page = (Path(__file__).parents[2] / "docs" / "robustness.md").read_text(encoding="utf-8")
    for name, (lower, upper) in usual_ranges().items():
        ends = f"{lower:g} … {upper:g} {DISTURBANCES[name].unit}".strip().replace("-", "−")
        assert f"| `{name}` | {ends} | {'yes' if DISTURBANCES[name].differs else 'no'} |" in page, name


@pytest.mark.parametrize("n", [2, 3, 8])
def test_of_as_many_parts_of_a_range_as_robots_each_has_one(n: int) -> None:
    robots, ranges = other_robots(n), other_ranges()
    assert [d.name for d in robots] == [name for name, kind in DISTURBANCES.items() if kind.differs]
    for d, r in zip(robots, ranges, strict=True):
        share = (np.array(d.values) - r.lower) / (r.upper - r.lower)
        assert sorted(np.floor(share * n).astype(int)) == list(range(n))
    assert robots == other_robots(n), "results of several runs compare"


def test_divided_robots_are_the_same_ones() -> None:
    robots = other_robots(6)
    world = make_world([replace(d, values=d.values[2:5]) for d in robots], 3, "mujoco")
    payload = next(d for d in robots if d.name == "payload")
    np.testing.assert_array_equal(world["payload"], payload.values[2:5])


def test_a_range_is_written_by_name_or_with_its_ends() -> None:
    assert parse_range("friction") == usual_range("friction")
    assert parse_range(" com-y = -0.02:0.01 ") == Range("com-y", -0.02, 0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("friction=0.4", "written name=lower:upper"),
        ("friction=a:b", "written name=lower:upper"),
        ("=1:2", "written name=lower:upper"),
        ("friction=1.2:0.4", "takes a range within 0.05 to 2, found 1.2 to 0.4"),
        ("friction=0.4:nan", "takes a range within"),
        ("top-speed=20:inf", "takes a range within"),
        ("fricton", "did you mean 'friction'"),
        ("fricton=0.4:1.2", "did you mean 'friction'"),
        ("gusts", "'gusts' cannot differ between robots"),
        ("gusts=0:0.01", "'gusts' cannot differ between robots"),
    ],
)
def test_ranges_that_cannot_be_are_refused(text: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DISTURBANCES, "gusts", DisturbanceKind("gusts", per_robot=False))
    with pytest.raises(ConfigError, match=message):
        parse_range(text)


def test_two_ranges_of_one_disturbance_are_refused() -> None:
    with pytest.raises(ConfigError, match="the range of 'friction' is given twice"):
        draw_uniform([usual_range("friction"), Range("friction", 0.4, 1.0)], 1, np.random.default_rng(0))
