"""Which records belong to a library now, and why others do not.

Records stay when what they were made of changes. A record belongs to a library if it is of its recipe, of a piece that
a source has, and of the robot as it is; of several that only began otherwise, it is the last.
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
    """A record that does not belong to the library any more.

    Attributes:
        id, name, robot, seed: of the record.
        why: in words.
        instead: the record of the same search that was begun later; None if that is not why.
    """

    id: str
    name: str
    robot: str
    seed: int
    why: str
    instead: str | None = None


@dataclass(frozen=True, eq=False)
class Membership:
    """What a library is to hold.

    Attributes:
        recipe: the digest of how motions are made; None if it cannot be read.
        robots: the digests of robots' descriptions, by name or file.
        pieces: of all sources, by digest.
        unreadable: the damaged files that say so, a line each. What may belong to them is kept.
        sources_known: whether none of them is a source's.
        problems: of sources without pieces, why there are none, a line each.
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
        """What a record says, of its piece as the source has it now: the same content may be found elsewhere, or under
        another licence."""
        there = self.pieces.get(record["piece"])
        if there is None:
            return record
        own = (piece for piece in there if (piece.source.place, piece.name) == (record["source"], record["name"]))
        return record | next(own, there[0]).described


def robot_of(record: Mapping[str, Any]) -> str:
    """Which robot a record is about: its name, or its file."""
    return str(record["robot_file"] or record["robot"])


def search_of(record: Mapping[str, Any]) -> Search:
    """What two records have in common that only began otherwise."""
    robot, digest, recipe = (intern(said) for said in (robot_of(record), record["robot_digest"], record["recipe"]))
    return record["piece"], robot, record["seed"], digest, recipe


def save_robot(folder: Path, robot: str, digest: str) -> None:
    """Keeps the digest of a robot's description; raises `OutputError` if it cannot."""
    text = json.dumps({"robot": robot, "digest": digest}, indent=1)
    key = hashlib.sha256(robot.encode()).hexdigest()[:12]
    write_text(folder / ROBOTS / f"{key}.json", text)


def load_robots(folder: Path) -> tuple[dict[str, str], list[str]]:
    """The digests of robots' descriptions when they were last built for, by name or file; and the files that cannot be
    read, a line each."""
    found, unreadable = {}, []
    for path in sorted((folder / ROBOTS).glob("*.json")):
        try:
            said = json.loads(path.read_text(encoding="utf-8"))
            found[str(said["robot"])] = str(said["digest"])
        except (OSError, ValueError, TypeError, KeyError) as error:
            unreadable.append(f"{ROBOTS}/{path.name}: cannot be read ({error}); the next build for its robot mends it")
    return found, unreadable
