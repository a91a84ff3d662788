from dataclasses import dataclass

import pytest

from fastmimic.base.errors import ClipError, ConfigError
from fastmimic.base.registry import Registry


@dataclass(frozen=True)
class Gear:
    name: str
    ratio: float = 1.0


def gears() -> Registry[Gear]:
    return Registry("gear", [Gear("low", 3.0), Gear("high", 0.5)])


def test_is_a_mapping_in_the_order_of_registration() -> None:
    registry = gears()
    added = registry.register(Gear("crawl", 9.0))
    assert list(registry) == ["low", "high", "crawl"]
    assert len(registry) == 3
    assert registry["crawl"] is added
    assert [gear.ratio for gear in registry.values()] == [3.0, 0.5, 9.0]
    assert "low" in registry
    assert "reverse" not in registry
    assert registry.get("reverse") is None


def test_an_unknown_name_lists_the_names() -> None:
    with pytest.raises(ConfigError, match=r"unknown gear 'lwo'; there are low, high; did you mean 'low'\?"):
        gears()["lwo"]


def test_a_name_is_given_once() -> None:
    registry = gears()
    with pytest.raises(ConfigError, match="there is a gear 'low' already"):
        registry.register(Gear("low"))
    with pytest.raises(ConfigError, match="needs a name"):
        registry.register(Gear(""))
    assert registry.pop("low").ratio == 3.0
    registry.register(Gear("low"))


def test_a_registry_has_its_own_error() -> None:
    with pytest.raises(ClipError, match="unknown format 'x'"):
        Registry[Gear]("format", error=ClipError)["x"]
