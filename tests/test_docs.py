"""The documentation: sentences short enough to read, lines short enough to review, and names that exist."""

import re
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

import fastmimic

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
WORDS = 25
"""Mean number of words in a sentence, at most."""
CHARACTERS = 120
WRITTEN = re.compile(r"^<!-- ([\w-]+):begin.*?^<!-- \1:end", re.MULTILINE | re.DOTALL)
"""What a program writes into a page."""
FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
NOT_PROSE = re.compile(r"\s*(\||#|<|\$\$|!\[|:::)")

pages = pytest.mark.parametrize("page", [pytest.param(page, id=page.name) for page in PAGES])


def sentences(text: str) -> list[str]:
    """The sentences outside code, tables, headings and comments; an item of a list is a paragraph."""
    text = re.sub(r"<!--.*?-->", "", FENCE.sub("\n\n", text), flags=re.DOTALL)
    found = []
    for block in re.split(r"\n\s*\n", text):
        lines = "\n".join(line for line in block.splitlines() if not NOT_PROSE.match(line))
        for paragraph in re.split(r"\n(?=\s*(?:[-*]|\d+\.)\s)", lines):
            plain = re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "code", " ".join(paragraph.split())))
            found += [sentence for sentence in re.split(r"(?<=[.!?])\s+", plain) if re.search(r"\w", sentence)]
    return found


def words(sentence: str) -> int:
    return len(re.findall(r"\w[\w'’./-]*", sentence))


@pytest.mark.parametrize("page", [pytest.param(p, id=p.name) for p in PAGES if sentences(p.read_text("utf-8"))])
def test_sentences_are_short(page: Path) -> None:
    counted = [words(sentence) for sentence in sentences(page.read_text(encoding="utf-8"))]
    assert sum(counted) / len(counted) <= WORDS


@pages
def test_lines_outside_tables_are_short(page: Path) -> None:
    lines = FENCE.sub("", WRITTEN.sub("", page.read_text(encoding="utf-8"))).splitlines()
    long = [line for line in lines if len(line) > CHARACTERS and not line.startswith(("|", "<"))]
    assert not [line for line in long if " " in line.strip("- ")]  # a single link may be longer


@pages
def test_files_that_are_named_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = set(re.findall(r"(?<![\w/.])((?:src|docs|tests|benchmarks|examples|\.ci)/[\w./-]+\.\w+)", text))
    assert not sorted(name for name in named if not (ROOT / name).exists())
    package = Path(fastmimic.__file__).parent
    rooms = "|".join(folder.name for folder in package.iterdir())
    inside = re.findall(rf"`((?:{rooms})/[\w/]*\.py)`", text)
    assert not sorted(name for name in inside if not (package / name).exists())
    links = {link.split("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", text))}
    local = {link for link in links if link and not re.match(r"[a-z]+:", link)}
    assert not sorted(link for link in local if not (page.parent / link).exists())


def resolves(name: str) -> bool:
    """Whether a dotted name is a module of the package, or an attribute of one."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            module = find_spec(".".join(parts[:end])) is not None
        except ModuleNotFoundError:
            continue
        if module:
            file = Path(find_spec(".".join(parts[:end])).origin)  # type: ignore[union-attr, arg-type]
            sources = [source for source in (file, file.with_suffix(".pyi")) if source.exists()]
            text = "".join(source.read_text(encoding="utf-8") for source in sources)
            if end == 1 < len(parts) and parts[1] in fastmimic.__all__:
                return True
            return end == len(parts) or re.search(rf"\b{parts[end]}\b", text) is not None
    return False


@pages
def test_modules_that_are_named_exist(page: Path) -> None:
    named = set(re.findall(r"\bfastmimic(?:\.[A-Za-z_]\w*)+", page.read_text(encoding="utf-8")))
    named = {name for name in named if not name.endswith((".git", ".extensions", ".egg"))}
    assert not sorted(name for name in named if not resolves(name))


def test_extras_that_are_named_exist() -> None:
    texts = [*PAGES, *(ROOT / "src").rglob("*.py"), *(ROOT / "tests").rglob("*.py")]
    named = {extra for path in texts for extra in re.findall(r"fastmimic\[([a-z0-9,]+)\]", path.read_text("utf-8"))}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert {extra for names in named for extra in names.split(",")} <= set(extras)
