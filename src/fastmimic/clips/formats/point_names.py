"""Which of a file's points are the ten: maps for known sets of names, and a guess from the words in other names."""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import msgspec

from fastmimic.base.conventions import LEGS
from fastmimic.base.files import packaged
from fastmimic.clips.clip import POINT_NAMES

PointMap = Mapping[str, str]


class _Words(msgspec.Struct, frozen=True):
    """Words of names, in lower case. Those of a part are the best first."""

    right: frozenset[str]
    left: frozenset[str]
    fore: frozenset[str]
    hind: frozenset[str]
    says_fore: frozenset[str]  # parts that only a foreleg has
    says_hind: frozenset[str]  # those of a hind leg
    legs: dict[str, frozenset[str]]
    shoulder: tuple[str, ...]
    hip: tuple[str, ...]
    toe: tuple[str, ...]
    middle: dict[str, tuple[str, ...]]
    tip: frozenset[str]


_SAID: Final = packaged("fastmimic.clips.formats", "point_names.json", _Words)
BUILT_IN: Final = packaged("fastmimic.clips.formats", "point_maps.json", dict[str, PointMap])
"""Default maps, tried in this order: the dog of Zhang et al. (2018), where `.end` is a joint's end site; the 39 points
of Ye et al. (2024), with DeepLabCut's spelling of thigh, where `back_base` is at the withers; the horses of the Vienna
Horse Data Collection (hoof, front or hind, left or right). Without hips, these are inferred (`with_hips`)."""
HIP_NAMES: Final = POINT_NAMES[2:6]

UNKNOWN: Final = "?"  # in a map that is not complete

_WORD: Final = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


def guess(names: Sequence[str]) -> dict[str, str]:
    """The point that each of the ten is by its name: side, fore or hind, and part; `UNKNOWN` where there is none, or
    two that say the same. A foot that is neither fore nor hind is a hind foot if no other is."""
    words = {name: _words(name) for name in names}
    middle = {name: said for name, said in words.items() if not set(said) & _SAID.tip}
    found = {part: _best(middle, [spelling.split() for spelling in order]) for part, order in _SAID.middle.items()}
    legs = {name: _leg(said) for name, said in words.items()}
    for leg in LEGS:
        own = {name: said for name, said in words.items() if legs[name] == leg}
        unsaid = {name: said for name, said in words.items() if leg[0] == "R" and legs[name] == f"?{leg[1]}"}
        for part, order in ((f"{leg}_hip", (*_SAID.shoulder, *_SAID.hip)), (f"{leg}_toe", _SAID.toe)):
            parts = [[word] for word in order]
            best = _best(own, parts)
            found[part] = best if best != UNKNOWN else _best(unsaid, parts)
    return {name: found[name] for name in POINT_NAMES}


def _words(name: str) -> list[str]:
    """`LeftUpLeg` and `left_up_leg` → left, up, leg, upleg."""
    words = [word.lower() for word in _WORD.findall(name)]
    return words + [a + b for a, b in pairwise(words)]


def _leg(words: Sequence[str]) -> str | None:
    """The leg that a name's words belong to; `?R` and `?L` if only the side is known, None if not even that."""
    said = set(words)
    for leg, spellings in _SAID.legs.items():
        if said & spellings:
            return leg
    if bool(said & _SAID.right) == bool(said & _SAID.left):
        return None
    side = "R" if said & _SAID.right else "L"
    if said & _SAID.fore:
        return f"F{side}"
    if said & (_SAID.hind | _SAID.says_hind):
        return f"R{side}"
    return f"F{side}" if said & _SAID.says_fore else f"?{side}"


def _best(words: Mapping[str, Sequence[str]], order: Sequence[Sequence[str]]) -> str:
    """The name with the first of the parts in `order`; of several with the same part, the one with fewest words."""
    for part in order:
        having = [name for name, said in words.items() if set(part) <= set(said)]
        fewest = min((len(words[name]) for name in having), default=0)
        having = [name for name in having if len(words[name]) == fewest]
        if len(having) == 1:
            return having[0]
    return UNKNOWN
