"""Which records belong to a library now, and why others do not.

Records stay when their inputs change. A record belongs to a library if it has its recipe, an excerpt of a source, and
the robot's present description; among those that differ only in their start, the last one belongs.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any, Final

from fastmimic.base.files import write_text
from fastmimic.dataset.excerpts import Excerpt
from fastmimic.dataset.records import Record

Search = tuple[str, str, int, str, str]

ROBOTS: Final = "robots"

OTHER_RECIPE: Final = "made otherwise"
OTHER_SOURCE: Final = "its source has changed or is gone"
OTHER_ROBOT: Final = "its robot has changed"


@dataclass(frozen=True)
class Superseded:
    """A record that no longer belongs to the library, `why`, and the later record of the same search, if any
    (`instead`)."""

    id: str
    name: str
    robot: str
    seed: int
    why: str
    instead: str | None = None


@dataclass(frozen=True, eq=False)
class Membership:
    """The inputs that decide which records belong to a library.

    Attributes:
        recipe: digest of the recipe; None if it cannot be read.
        robots: digests of robots' descriptions, by name or file.
        pieces: excerpts of all sources, by digest.
        unreadable: damaged files of recipe, sources and robots, one line each. Records that may depend on them are
            kept.
        sources_known: whether no source's file is damaged.
        problems: why sources have no excerpts, one line each.
    """

    recipe: str | None
    robots: Mapping[str, str]
    pieces: Mapping[str, Sequence[Excerpt]]
    unreadable: tuple[str, ...]
    sources_known: bool
    problems: tuple[str, ...]

    def why_not(self, record: Mapping[str, Any]) -> str | None:
        """Why a record does not belong to the library; None if it does."""
        if self.recipe is not None and record["recipe"] != self.recipe:
            return OTHER_RECIPE
        if self.sources_known and record["piece"] not in self.pieces:
            return OTHER_SOURCE
        if self.robots.get(robot_of(record), record["robot_digest"]) != record["robot_digest"]:
            return OTHER_ROBOT
        return None

    def described(self, record: Record) -> Record:
        """The record with the excerpt's present description: the source or licence of the same content may change."""
        there = self.pieces.get(record["piece"])
        if there is None:
            return record
        own = (piece for piece in there if (piece.source.place, piece.name) == (record["source"], record["name"]))
        return record | next(own, there[0]).described


def robot_of(record: Mapping[str, Any]) -> str:
    """A record's robot: its name, or its file."""
    return str(record["robot_file"] or record["robot"])


def search_of(record: Mapping[str, Any]) -> Search:
    """Key of a search, the same for records that differ only in their start."""
    robot, digest, recipe = (intern(said) for said in (robot_of(record), record["robot_digest"], record["recipe"]))
    return record["piece"], robot, record["seed"], digest, recipe


def save_robot(folder: Path, robot: str, digest: str) -> None:
    """Saves the digest of a robot's description; raises `OutputError` if it cannot."""
    text = json.dumps({"robot": robot, "digest": digest}, indent=1)
    key = hashlib.sha256(robot.encode()).hexdigest()[:12]
    write_text(folder / ROBOTS / f"{key}.json", text)


def load_robots(folder: Path) -> tuple[dict[str, str], list[str]]:
    """The digests of robots' descriptions in the last build, by name or file; and the unreadable files, one line
    each."""
    found, unreadable = {}, []
    for path in sorted((folder / ROBOTS).glob("*.json")):
        try:
            said = json.loads(path.read_text(encoding="utf-8"))
            found[str(said["robot"])] = str(said["digest"])
        except (OSError, ValueError, TypeError, KeyError) as error:
            unreadable.append(f"{ROBOTS}/{path.name}: cannot be read ({error}); the next build for its robot mends it")
    return found, unreadable
