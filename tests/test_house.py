"""The structure of the package: floors, names, sizes."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

import fastmimic

PACKAGE = Path(fastmimic.__file__).parent
TABLE = PACKAGE.parent.parent / "docs" / "contributing.md"
LARGEST = 400
SAME_MEANING = {"__init__.py", "config.py", "driver.py"}
"""File names that mean the same thing in every folder."""


def floors() -> list[list[str]]:
    """Rooms of each floor from below, left to right."""
    text = TABLE.read_text(encoding="utf-8").split("<!-- floors:begin -->")[1].split("<!-- floors:end -->")[0]
    rows = [line for line in text.splitlines() if re.match(r"\| \d", line)]
    return [re.findall(r"`(\w+)/`", row) for row in reversed(rows)]


def modules() -> Iterator[tuple[str, Path]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path.relative_to(PACKAGE).as_posix(), path


def imported(path: Path) -> Iterator[tuple[str, int]]:
    """Rooms that a file imports, with the line."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module] if node.module != "fastmimic" else [f"fastmimic.{a.name}" for a in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            if name.startswith("fastmimic."):
                yield name.split(".")[1], node.lineno


def test_the_table_names_every_room_once() -> None:
    named = [room for floor in floors() for room in floor]
    assert len(floors()) <= 7
    assert sorted(named) == sorted(p.name for p in PACKAGE.iterdir() if p.is_dir() and (p / "__init__.py").exists())


def test_rooms_import_from_below_and_from_their_left() -> None:
    place = {room: (level, i) for level, floor in enumerate(floors()) for i, room in enumerate(floor)}
    wrong = []
    for name, path in modules():
        if "/" not in name:  # the root: the public names, and the command line
            continue
        here = place[name.split("/")[0]]
        wrong += [f"{name}:{line} imports {room}" for room, line in imported(path) if place.get(room, here) > here]
    assert not wrong, "\n" + "\n".join(wrong)


def test_no_class_has_two_meanings() -> None:
    where = defaultdict(list)
    for name, path in modules():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                where[node.name].append(name)
    assert not {k: v for k, v in where.items() if len(v) > 1}


def test_no_file_name_has_two_meanings() -> None:
    """A verb's file is named like the verb, and may be named like the file that does its work."""
    where = defaultdict(list)
    for name, path in modules():
        if path.name not in SAME_MEANING and not name.startswith("commands/"):
            where[path.name].append(name)
    assert not {k: v for k, v in where.items() if len(v) > 1}


@pytest.mark.parametrize(("name", "path"), [pytest.param(n, p, id=n) for n, p in modules()])
def test_no_file_is_too_large(name: str, path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LARGEST
