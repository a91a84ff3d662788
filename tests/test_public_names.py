"""The public names: all of them are there, and the documentation uses no others."""

import re
from pathlib import Path

import pytest

import fastmimic as fm

ROOT = Path(__file__).parent.parent


def test_every_name_is_there_and_hides_no_room() -> None:
    pytest.importorskip("gymnasium")
    assert all(hasattr(fm, name) for name in fm.__all__)
    rooms = {path.name for path in Path(fm.__file__).parent.iterdir() if path.is_dir()}
    assert not rooms & set(fm.__all__)
    assert set(fm.__all__) <= set(dir(fm))


def test_the_documented_names_are_public() -> None:
    pages = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"^::: fastmimic\.(\w+)$", pages, flags=re.M))
    assert len(documented) > 30
    assert documented <= set(fm.__all__)


def test_an_unknown_name() -> None:
    with pytest.raises(AttributeError, match="module 'fastmimic' has no attribute 'imitat'"):
        _ = fm.imitat  # type: ignore[attr-defined]
