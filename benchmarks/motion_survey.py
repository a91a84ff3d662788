"""Which motions are tracked without a fall, which not, and why not: one rule for every motion."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.errors import ClipError, MotionError
from fastmimic.clips.clip import Clip
from fastmimic.clips.data import data_folder
from fastmimic.clips.formats import read_clip
from fastmimic.episode.feasibility import Demands, Fall, Reason, demands, describe_fall, reasons
from fastmimic.episode.loop import share_of_falls
from fastmimic.imitation.evaluate import evaluate
from fastmimic.retargeting.retarget import retarget
from fastmimic.retargeting.track import extract, pose_mismatch
from fastmimic.robot import Robot

EPISODES: Final = 4
"""One nominal, the others perturbed."""
SHORTEST_S: Final = 0.4
LONGEST_S: Final = 1.2
LEAST_TAKE_S: Final = 5.0
"""A shorter file is a cut already."""


@dataclass(frozen=True)
class Surveyed:
    """One motion of a survey.

    Attributes:
        name: of the motion.
        speed_m_per_s, yaw_rad_per_s: the animal's at the robot's size.
        period_s: of the motion.
        steps: whether any foot is lifted.
        mismatch: how badly the cut closed, see `pose_mismatch`.
        reward: of each episode, the nominal one first.
        fell: which episodes ended in a fall.
        first_fall_s: the earliest; None without.
        unmet: names of the fidelity bounds that the retargeting did not meet.
        needs: what the demonstration asks.
        fall: the first episode that fell; None without.
        reasons: which limits are exceeded; without a fall, those of the demonstration alone.
        refused: why there is no executable motion; the figures are then those of the kinematic one.
    """

    name: str
    speed_m_per_s: float
    yaw_rad_per_s: float
    period_s: float
    steps: bool
    mismatch: float
    reward: tuple[float, ...]
    fell: tuple[bool, ...]
    first_fall_s: float | None
    unmet: tuple[str, ...]
    needs: Demands
    fall: Fall | None
    reasons: tuple[Reason, ...]
    refused: str | None = None

    @property
    def tracked(self) -> bool:
        """Whether there is a motion that the robot can execute, and no episode ended in a fall."""
        return self.refused is None and not any(self.fell)

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {**asdict(self), "tracked": self.tracked}


def random_cycles(count: int, rng: np.random.Generator, folder: str | Path | None = None) -> list[Clip]:
    """Cycles cut from the long takes of the recorded dog as anyone could cut them, without looking.

    A take and a first frame at random; of the ends 0.4 to 1.2 s later the one at which the pose comes nearest to the
    first frame's (`pose_mismatch`). Whatever the dog does there is taken for a cycle.

    Args:
        count: how many.
        rng: of takes and first frames.
        folder: the data folder, see `data_folder`.

    Raises:
        ClipError: the takes are not there.
    """
    files = sorted((data_folder(folder) / "dog_keypoints").glob("*_joint_pos.txt"))
    takes = {file.name.removesuffix("_joint_pos.txt"): read_clip(file) for file in files}
    takes = {name: take for name, take in takes.items() if take.n_frames >= LEAST_TAKE_S * take.rate_hz}
    if not takes:
        raise ClipError(
            f"no recordings of the dog in {data_folder(folder)}: run 'fastmimic data fetch', or set FASTMIMIC_DATA to a"
            " folder that has dog_keypoints"
        )
    names, cycles = list(takes), []
    for _ in range(count):
        name = names[rng.integers(len(names))]
        take = takes[name]
        shortest, longest = round(SHORTEST_S * take.rate_hz), round(LONGEST_S * take.rate_hz)
        start = int(rng.integers(take.n_frames - longest))
        ends = range(start + shortest, start + longest + 1)
        end = min(ends, key=lambda e: _mismatch(take.cut(start, e)))
        cut = take.cut(start, end)
        cycles.append(replace(cut, is_cycle=True).named(f"{name} {start}:{end}"))
    return cycles


def survey(
    clip: Clip,
    robot: Robot,
    *,
    duration_s: float = 10.0,
    method: str = "mbc",
    episodes: int = EPISODES,
    seed: int = 0,
) -> Surveyed:
    """Retargets a clip, runs it as it is, and says what it asks and what came of it.

    Args:
        clip: the motion.
        robot: who is to do it.
        duration_s: of an episode.
        method: whose controller; nothing is optimised.
        episodes: the first nominal, the others perturbed.
        seed: of the perturbations.

    Raises:
        FastMimicError: the clip cannot be read as a motion, or there is no such method.
    """
    refused = None
    try:
        motion, report = retarget(clip, robot, falls=share_of_falls)
    except MotionError as error:
        refused = str(error)
        motion, report = retarget(clip, robot, executable=False)
    run: dict[str, Any] = {"episodes": episodes, "seed": seed, "method": method}
    rollout = evaluate(motion, robot, duration_s=duration_s, **run).rollout
    needs, fall = demands(robot, motion), None
    if rollout.fell.any():
        which = int(np.flatnonzero(rollout.fell)[0])
        until = min(duration_s, (int(rollout.steps[which]) + 2) / motion.rate_hz)
        logged = evaluate(motion, robot, duration_s=until, log=True, **run).rollout
        fall = describe_fall(robot, logged, which)
    falls = rollout.steps[rollout.fell] / motion.rate_hz
    return Surveyed(
        name=motion.name,
        speed_m_per_s=report.after.speed_m_per_s,
        yaw_rad_per_s=float(np.radians(report.after.yaw_deg)) / motion.period_s,
        period_s=motion.period_s,
        steps=not motion.contact.all(),
        mismatch=_mismatch(clip),
        reward=tuple(float(r) for r in rollout.reward),
        fell=tuple(bool(f) for f in rollout.fell),
        first_fall_s=float(falls.min()) if len(falls) else None,
        unmet=tuple(bound.name for bound in report.bounds if not bound.met),
        needs=needs,
        fall=fall,
        reasons=reasons(needs, fall),
        refused=refused,
    )


def summary(rows: Sequence[Surveyed]) -> str:
    """The fractions in words: all motions, those in which a foot is lifted, and what the falls' first reasons are."""
    stepping = [row for row in rows if row.steps]
    lines = [f"tracked: {_of(rows)}; of those that take steps: {_of(stepping)}"]
    fallen = [row for row in rows if not row.tracked]
    if fallen:
        kinds = ["refused" if row.refused else row.reasons[0].kind for row in fallen]
        counts = ", ".join(f"{kind} {kinds.count(kind)}" for kind in dict.fromkeys(kinds))
        lines.append(f"first reason of the falls: {counts}")
    return "\n".join(lines)


def table(rows: Sequence[Surveyed]) -> str:
    """The rows as Markdown."""
    lines = [
        "| motion | speed, m/s | turn, rad/s | reward nominal | mean | fell | first fall, s | exceeded |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        at = "–" if row.first_fall_s is None else f"{row.first_fall_s:.2f}"
        lines.append(
            f"| `{row.name}` | {row.speed_m_per_s:.2f} | {row.yaw_rad_per_s:+.2f} | {row.reward[0]:.3f}"
            f" | {np.mean(row.reward):.3f} | {sum(row.fell)} of {len(row.fell)} | {at} | {_exceeded(row)} |"
        )
    return "\n".join(lines)


def _exceeded(row: Surveyed) -> str:
    kinds: dict[str, list[str]] = {}
    for reason in row.reasons:
        kinds.setdefault(reason.kind, []).append(reason.text)
    said = "; ".join(f"**{kind}**: {', '.join(texts)}" for kind, texts in kinds.items())
    return said or "–"


def _of(rows: Sequence[Surveyed]) -> str:
    return f"{sum(row.tracked for row in rows)} of {len(rows)}"


def _mismatch(clip: Clip) -> float:
    return pose_mismatch(extract(clip, 1.0, 0.5))
