"""Values as text."""

import math
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError, LogError
from fastmimic.base.files import read_json, write_json
from fastmimic.base.text import csv_text, markdown_table, number, plain


def test_plain_values_are_those_of_json() -> None:
    given = {"a": np.float64(1.5), "b": (np.int64(2), math.nan), "c": np.array([1, np.inf]), "d": Path("x"), "e": True}
    assert plain(given) == {"a": 1.5, "b": [2, None], "c": [1.0, None], "d": "x", "e": True}


def test_numbers_have_decimals_or_are_a_dash() -> None:
    assert (number(0.12345), number(0.5, 0, 100.0), number(None), number(math.nan)) == ("0.123", "50", "–", "–")


def test_csv_has_the_columns_asked_for() -> None:
    assert csv_text(("a", "b"), [{"a": 1, "b": None, "c": 2}, {"a": "x, y"}]) == 'a,b\n1,\n"x, y",\n'


def test_markdown_has_a_rule_under_its_header() -> None:
    assert markdown_table(("a", "b"), [("1", "2")]) == ["| a | b |", "| --- | --- |", "| 1 | 2 |"]


def test_json_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"ä": np.float32(0.5), "n": math.nan})
    assert read_json(tmp_path / "a.json") == {"ä": 0.5, "n": None}


@pytest.mark.parametrize(
    ("text", "said"), [(None, "no such file"), ("{", "cannot be read"), ("[1]", "does not hold a JSON object")]
)
def test_one_line_for_json_that_cannot_be_used(tmp_path: Path, text: str | None, said: str) -> None:
    if text is not None:
        (tmp_path / "a.json").write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_json(tmp_path / "a.json")
    with pytest.raises(LogError, match=said):
        read_json(tmp_path / "a.json", LogError)
