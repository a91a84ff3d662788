"""Retargeting: an animal's clip becomes a consistent reference motion of a robot.

After Peng et al. 2020 (section IV): the kinematic motion, in which the robot's feet and trunk move as the animal's.
From it optimal control (`fastmimic.trajectory`) makes the nearest motion that the robot can execute, by one rule for
every clip. The steps are in these modules:

    track              keypoints → trunk and toe targets at the robot's size → a continuous motion, closed if a cycle
    contact_schedule   the detected contacts (`motion.contacts`) as a clean schedule
    feet               footholds within reach, and smooth swings between them
    fit, pose          the trunk's height, and joints within their ranges
    steps              calls all of the above on one clip; without a cycle, the trunk no lower than folded legs allow
    report             what changed
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError, ConfigError, check_positive
from fastmimic.base.text import plain
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Provenance
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.report import RetargetReport, make_report, with_executable
from fastmimic.retargeting.steps import DOG_SCALE, Retargeting, whether_cycle
from fastmimic.retargeting.track import extract
from fastmimic.robot import Robot, load_robot
from fastmimic.trajectory.executable import nearest_executable

DOG_LEG_LENGTH_M: Final = 0.4 / DOG_SCALE  # so that other robots scale by their own
_DOG_TRUNK_M: Final = 0.4
_OWN_SIZE: Final = 1.15  # of an animal that is not as large as the dog
_REACH: Final = 0.83  # of a leg in motion, share of its length: the dog's and the horse's
MIN_FRAMES: Final = 8
_SCALES: Final = (0.01, 100.0)  # of a robot to an animal that anybody has; beyond them a unit is wrong


def retarget(
    clip: Clip | str | Path,
    robot: Robot | str = "a1",
    *,
    rate_hz: float = 500.0,
    scale: float | None = None,
    cycle: bool | None = None,
    velocity: Array | None = None,
    config: RetargetConfig | None = None,
    executable: bool = True,
    falls: Callable[[Robot, Motion], float] | None = None,
) -> tuple[Motion, RetargetReport]:
    """Turns an animal's clip into a reference motion of a robot; returns it with a report of the changes.

    Args:
        clip, robot: the animal's keypoints, and the robot; names and files as for `open_clip` and `load_robot`.
        rate_hz: of the motion; a cycle's period becomes a whole number of samples.
        scale: animal's to robot's size; if None the clip's own or the ratio of leg lengths (0.825 for a dog on the A1).
        cycle: whether the clip is one period; if None what the clip says, else whether it closes.
        velocity: (3,) of a cycle, instead of its own: forwards, to the left, m/s, turning, rad/s, the robot's.
        config: settings at the A1's size, `RetargetConfig()` if None.
        executable: whether the motion is the nearest one that the robot can execute; its `animal` is then the
            kinematic motion. A robot's own motion, and one that is not made consistent (`RetargetConfig`), stay as they
            are.
        falls: share of perturbed starts from which a robot falls with a motion; see `nearest_executable`.

    The motion's `provenance` holds the report as well. Raises `ConfigError` unless rate and scale are positive, and
    `ClipError` if the clip is too short; `MotionError` if no motion near it is executable.
    """
    robot = load_robot(robot)
    clip = clip if isinstance(clip, Clip) else open_clip(clip, robot=robot)
    _check(clip, rate_hz, scale)
    scale = choose_scale(clip, robot) if scale is None else float(scale)
    config = config or RetargetConfig()
    work = Retargeting(clip, robot, rate_hz, scale, cycle, config.for_robot(robot))
    work.prepare_source()
    work.make_track()
    work.choose_height()
    work.schedule_contacts()
    if velocity is not None:
        work.change_velocity(velocity)
    work.fit()
    report = make_report(work)
    provenance = Provenance(
        name=clip.origin.name or "motion",
        robot=robot.name,
        source=replace(clip.origin, name=None, licence=None, credit=None),
        licence=clip.origin.licence,
        credit=clip.origin.credit,
        retarget=plain(report),
        held_s=work.held / clip.rate_hz if work.held else None,
    )
    motion = replace(work.motion, provenance=provenance)
    if not executable or work.own_body or not config.consistent:
        return motion, report
    found = nearest_executable(robot, motion, falls=falls)
    report = with_executable(report, found.figures)
    return replace(found.motion, provenance=replace(provenance, retarget=plain(report))), report


def choose_scale(clip: Clip, robot: Robot) -> float:
    """The clip's own scale, else the ratio of leg lengths."""
    if clip.scale is not None:
        return float(clip.scale)
    return robot.leg_length / (clip.leg_length_m if clip.leg_length_m is not None else _leg_length(clip))


def _leg_length(clip: Clip) -> float:
    """An animal's leg length by how far its legs reach, m; the dog's of `DOG_SCALE` if it is about as large. Legs that
    reach less far may be folded, so that a small animal has a short trunk as well."""
    reach = np.percentile(np.linalg.norm(clip.toes_w - clip.hips_w, axis=-1), 95, axis=0)
    own = reach.max() / _REACH
    trunk = np.median(np.linalg.norm(clip.point("neck") - clip.point("pelvis"), axis=1))
    if own == 0.0:
        raise ClipError(f"{clip.origin}: every paw is at its hip; there is no leg to scale by")
    large, small = own > _OWN_SIZE * DOG_LEG_LENGTH_M, own < DOG_LEG_LENGTH_M / _OWN_SIZE
    return float(own) if large or (small and trunk < _DOG_TRUNK_M / _OWN_SIZE) else DOG_LEG_LENGTH_M


def _check(clip: Clip, rate_hz: float, scale: float | None) -> None:
    check_positive(rate_hz, "the rate of a motion", shown=f"{rate_hz} Hz")
    if scale is not None:
        check_positive(scale, "the scale")
        if not _SCALES[0] <= scale <= _SCALES[1]:
            raise ConfigError(
                f"the scale, robot's by animal's size, is {_SCALES[0]:g} to {_SCALES[1]:g}, found {scale:g}"
            )
    if min(clip.n_frames, round((clip.n_frames - 1) / clip.rate_hz * rate_hz)) < MIN_FRAMES:
        found = f"{clip.n_frames} at {clip.rate_hz:g} Hz"
        raise ClipError(f"{clip.origin}: retargeting needs at least {MIN_FRAMES} frames, found {found}; cut longer")


def is_one_cycle(clip: Clip) -> bool:
    """Whether `retarget` takes a clip for one cycle by default: if the clip says so, or if its ends meet."""
    config = RetargetConfig()
    return whether_cycle(clip, extract(clip, clip.scale or 1.0, config.roll_share), None, config)[0]
