"""Loading the motions that a live session plays."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from fastmimic.clips.synthesis import GAITS
from fastmimic.motion.motion import Motion
from fastmimic.reference.motion_set import IN_PLACE, in_place
from fastmimic.reference.standing import STAND, standing
from fastmimic.robot import Robot
from fastmimic.runs.loading import MotionSource, find_motion

DEFAULTS: Final = (STAND, IN_PLACE, "walk", "trot", "pace", "turn", "side-step", "spin", "backward-trot", "bound")


def load_motions(
    sources: Sequence[str | MotionSource], robot: Robot, progress: Callable[[int, int], None] | None = None
) -> dict[str, Motion]:
    """Motions by the names used in a session; raises `FastMimicError` for unknown ones or files that cannot be read.

    Args:
        sources: names, clips, robot motions (.npz) or folders of runs; also "stand" and "in-place".
        progress: called with (motions loaded, motions in all).
    """
    found: dict[str, Motion] = {}
    for i, given in enumerate(sources):
        source = find_motion(given) if isinstance(given, str) else given
        name = source.name
        if name == STAND:
            motion = standing(robot)
        elif name == IN_PLACE:
            motion = in_place(robot)
        else:
            motion = source.load(robot)
            name = name if name in GAITS or ":" in name else _short(name, motion)
        if name in found:
            name = _distinct(name, found)
        found[name] = motion
        if progress is not None:
            progress(i + 1, len(sources))
    return found


def _short(source: str, motion: Motion) -> str:
    path = Path(source)
    if path.is_dir():
        return path.resolve().name
    return motion.name if path.stem == "motion" else path.stem


def _distinct(name: str, taken: Mapping[str, Motion]) -> str:
    k = 2
    while f"{name} ({k})" in taken:
        k += 1
    return f"{name} ({k})"
