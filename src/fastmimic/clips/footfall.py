"""Names the gait of four legs from their phases (Hildebrand 1965). In a symmetrical gait left and right are half a
cycle apart. The fore foot's lag behind the hind foot of its side, in cycles, then distinguishes pace (0), walk (1/4)
and trot (1/2)."""

from typing import Final

from fastmimic.base.arrays import Array

FOOTFALLS: Final = ("walk", "trot", "pace", "canter", "gallop", "bound")
_SQUARE: Final = 0.125  # cycles: half way between pace, walk and trot


def footfall_of(phases: Array) -> str:
    """The gait of legs with phases (4,), cycles, in the common order; one of `FOOTFALLS`."""

    def apart(a: int, b: int) -> float:
        return float(abs((phases[a] - phases[b] + 0.5) % 1.0 - 0.5))

    fr, fl, rr, rl = range(4)
    fore, hind = apart(fr, fl), apart(rr, rl)
    if fore > 0.5 - 1.5 * _SQUARE and hind > 0.5 - 1.5 * _SQUARE:  # symmetrical
        diagonal = (apart(fr, rl) + apart(fl, rr)) / 2
        lateral = (apart(fr, rr) + apart(fl, rl)) / 2
        if lateral < _SQUARE:
            return "pace"
        return "trot" if diagonal < _SQUARE else "walk"
    if fore < _SQUARE / 2 and hind < _SQUARE / 2:
        return "bound"
    if min(apart(fr, rl), apart(fl, rr)) < _SQUARE / 2:
        return "canter"  # three beats: one diagonal lands together
    return "gallop"
