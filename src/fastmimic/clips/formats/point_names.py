"""Which of a file's points are the ten: maps for known sets of names, and a guess from the words in other names."""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

from fastmimic.base.conventions import LEGS
from fastmimic.clips.clip import POINT_NAMES

PointMap = Mapping[str, str]

AI4ANIMATION_DOG: Final[PointMap] = {
    "pelvis": "Hips",
    "neck": "Neck",
    "FR_hip": "RightShoulder",
    "FL_hip": "LeftShoulder",
    "RR_hip": "RightUpLeg",
    "RL_hip": "LeftUpLeg",
    "FR_toe": "RightHand.end",
    "FL_toe": "LeftHand.end",
    "RR_toe": "RightFoot.end",
    "RL_toe": "LeftFoot.end",
}
"""The dog of Zhang et al. (2018); `.end` is a joint's end site."""

_SIDES: Final = {"FR": "front_right", "FL": "front_left", "RR": "back_right", "RL": "back_left"}
SUPERANIMAL: Final[PointMap] = {
    "pelvis": "back_end",
    "neck": "back_base",  # at the withers; `neck_base` is where the neck meets the skull
    **{f"{leg}_hip": f"{side}_thai" for leg, side in _SIDES.items()},
    **{f"{leg}_toe": f"{side}_paw" for leg, side in _SIDES.items()},
}
"""The 39 points of Ye et al. (2024), with DeepLabCut's spelling of thigh."""

VIENNA_HORSE: Final[PointMap] = {
    "pelvis": "Sacrum",
    "neck": "Withers",
    "FR_toe": "HFR",
    "FL_toe": "HFL",
    "RR_toe": "HHR",
    "RL_toe": "HHL",
}
"""The horses of the Vienna Horse Data Collection: hoof, front or hind, left or right."""

OWN_NAMES: Final[PointMap] = {name: name for name in POINT_NAMES}
HIP_NAMES: Final = POINT_NAMES[2:6]
BUILT_IN: Final[Mapping[str, PointMap]] = {
    "AI4Animation's dog": AI4ANIMATION_DOG,
    "AI4AnimationPy's dog": {name: source.replace(".end", "Site") for name, source in AI4ANIMATION_DOG.items()},
    "SuperAnimal-Quadruped": SUPERANIMAL,
    "the common names": OWN_NAMES,
    "the common names, without hips": {name: name for name in POINT_NAMES if name not in HIP_NAMES},
    "Vienna's horses": VIENNA_HORSE,
}
"""Default maps, tried in this order. Without hips, these are inferred (`with_hips`)."""

UNKNOWN: Final = "?"  # in a map that is not complete

_WORD: Final = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_RIGHT: Final = {"r", "right", "rt"}
_LEFT: Final = {"l", "left", "lt"}
_FORE: Final = {"f", "front", "fore", "forelimb", "foreleg", "frontleg"}
_HIND: Final = {"h", "hind", "b", "back", "rear", "hindlimb", "hindleg", "backleg"}
_LEG_WORDS: Final = {
    "FR": {"fr", "rf", "rfront", "rfore"},
    "FL": {"fl", "lf", "lfront", "lfore"},
    "RR": {"rr", "rh", "hr", "br", "rb", "rhind", "rback"},
    "RL": {"rl", "lh", "hl", "bl", "lb", "lhind", "lback"},
}
_SHOULDER: Final = ("shoulder", "scapula", "upperarm", "humerus", "arm")
_HIP: Final = ("hip", "thigh", "thai", "upleg", "upperleg", "femur")
_TOE: Final = ("toe", "paw", "hoof", "foot", "hand", "finger", "fetlock", "ankle", "wrist", "carpus", "hock")
_SAYS_FORE: Final = {*_SHOULDER, "hand", "finger", "wrist", "carpus"}
_SAYS_HIND: Final = {*_HIP, "ankle", "hock"}
_MIDDLE: Final = {
    "pelvis": ("pelvis", "hips", "sacrum", "croup", "rump", "tail base", "tailbase", "tail root", "tail"),
    "neck": ("withers", "neck base", "neckbase", "neck", "cervical", "thorax", "chest"),
}
"""Words of a part, the best first."""
_TIP: Final = {"end", "tip", "mid", "middle"}


def guess(names: Sequence[str]) -> dict[str, str]:
    """The point that each of the ten is by its name: side, fore or hind, and part; `UNKNOWN` where there is none, or
    two that say the same. A foot that is neither fore nor hind is a hind foot if no other is."""
    words = {name: _words(name) for name in names}
    middle = {name: said for name, said in words.items() if not set(said) & _TIP}
    found = {part: _best(middle, [spelling.split() for spelling in order]) for part, order in _MIDDLE.items()}
    legs = {name: _leg(said) for name, said in words.items()}
    for leg in LEGS:
        own = {name: said for name, said in words.items() if legs[name] == leg}
        unsaid = {name: said for name, said in words.items() if leg[0] == "R" and legs[name] == f"?{leg[1]}"}
        for part, order in ((f"{leg}_hip", (*_SHOULDER, *_HIP)), (f"{leg}_toe", _TOE)):
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
    for leg, spellings in _LEG_WORDS.items():
        if said & spellings:
            return leg
    if bool(said & _RIGHT) == bool(said & _LEFT):
        return None
    side = "R" if said & _RIGHT else "L"
    if said & _FORE:
        return f"F{side}"
    if said & (_HIND | _SAYS_HIND):
        return f"R{side}"
    return f"F{side}" if said & _SAYS_FORE else f"?{side}"


def _best(words: Mapping[str, Sequence[str]], order: Sequence[Sequence[str]]) -> str:
    """The name with the first of the parts in `order`; of several with the same part, the one with fewest words."""
    for part in order:
        having = [name for name, said in words.items() if set(part) <= set(said)]
        fewest = min((len(words[name]) for name in having), default=0)
        having = [name for name in having if len(words[name]) == fewest]
        if len(having) == 1:
            return having[0]
    return UNKNOWN
