"""Excerpts of a source to imitate: whole motions, and the cycles of long takes."""

import json
import traceback
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic import __version__
from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import ClipError, FastMimicError
from fastmimic.base.files import write_text
from fastmimic.clips.catalogue import open_clip, open_parts
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import detect_format
from fastmimic.clips.segment import DISCRETE, Segment, SegmentConfig, as_one_cycle, find_segments
from fastmimic.dataset.sources import DatasetSource
from fastmimic.motion.motion import Motion
from fastmimic.primitive.discrete import MAX_S
from fastmimic.retargeting.retarget import is_one_cycle

SOURCES: Final = "sources"
_DESCRIBED: Final = ("name", "gait", "footfall", "confidence", "licence", "credit")
WHOLE: Final = "whole"  # gait of an excerpt without a search for cycles: a robot motion, or given frames


@dataclass(frozen=True, kw_only=True)
class Excerpt:
    """One motion of a source. Its gait, footfall and confidence are as in `fastmimic.clips.segment.Segment`, or `WHOLE`
    and 1 without a search for cycles; its speed is in the animal's size, or the robot's for a robot motion."""

    name: str  # unique within the source
    source: DatasetSource
    frames: tuple[int, int] | None = None  # (first, end) in the source; None for all of it
    digest: str  # of its content: 16 hexadecimal digits
    gait: str
    footfall: str | None = None
    confidence: float = 1.0
    repeats: bool  # whether it counts as a cycle
    period_s: float
    speed_m_per_s: float
    yaw_rate_rad_per_s: float
    robot: str | None = None  # of a robot motion; None for an animal's
    licence: str | None
    credit: str | None

    @property
    def described(self) -> dict[str, Any]:
        """Its part of a record: description, source, and licence."""
        first, end = self.frames or (None, None)
        said = {"source": self.source.place, "first_frame": first, "end_frame": end, "piece": self.digest}
        return said | {name: getattr(self, name) for name in _DESCRIBED}

    def open(self) -> Clip | Motion:
        """The clip or motion; raises `FastMimicError` if it cannot be read or has changed since the survey."""
        piece = _open(self.source, self.frames)
        if not isinstance(piece, Motion):
            piece = replace(piece, is_cycle=self.repeats, meta={**piece.meta, "name": self.name})
        if digest_of(piece) != self.digest:
            raise ClipError(f"{self.source}: has changed since it was looked through; build again")
        return piece


@dataclass(frozen=True)
class Survey:
    """Result of a search through a source."""

    source: DatasetSource
    pieces: tuple[Excerpt, ...] = ()  # excerpts to imitate
    skipped: str | None = None  # why there are none; None if there are
    failed: str | None = None  # why the source cannot be read; None if it can
    looked: str | None = None  # settings and state of the source at the time (see `look_of`); None if unknown

    @property
    def problem(self) -> str | None:
        """Why there are no excerpts, with the source's name; None if there are."""
        said = self.failed or self.skipped
        return said if said is None or said.startswith(self.source.place) else f"{self.source}: {said}"


def survey(source: DatasetSource, confidence: float, discrete: bool = False) -> Survey:
    """Searches a source for excerpts, with the least confidence of cycles; with `discrete`, movement that does not
    repeat counts, too. Errors become part of the result."""
    try:
        looked, opened = look_of(source, confidence, discrete), _open(source)
        if isinstance(opened, Motion):
            found = Survey(source, (_of_motion(source, opened),))
        elif source.frames is not None:
            segment = replace(as_one_cycle(opened), gait=WHOLE, confidence=1.0)
            found = Survey(source, (_piece(source, opened, source.frames, segment, repeats=is_one_cycle(opened)),))
        else:
            parts = open_parts(source.place, **source.overrides)
            surveys = [_of_take(source, first, take, confidence, discrete) for first, take in parts]
            pieces = tuple(piece for part in surveys for piece in part.pieces)
            found = Survey(source, pieces) if pieces else surveys[0]
        return replace(found, looked=looked)
    except Exception as error:  # noqa: BLE001 - one source's defect, of which there may be a thousand others
        return Survey(source, failed=reason_of(error))


def look_of(source: DatasetSource, confidence: float, discrete: bool) -> str | None:
    """The inputs of a `survey`, with a file's size and time, in words; equal inputs need no new survey. Returns None
    for a motion's name, which has no file to compare."""
    files = [source.place, *([] if source.point_map is None else [source.point_map])]
    try:
        states = [Path(place).stat() for place in files]
    except OSError:
        return None
    said = ", ".join(f"{state.st_size} bytes of {state.st_mtime_ns}" for state in states)
    return f"{said}, confidence {confidence}, discrete {discrete}, fastmimic {__version__}"


def reason_of(error: Exception) -> str:
    """The reason of a failure in one line; for a defect with its type and place."""
    if isinstance(error, FastMimicError):
        said = str(error)
    elif isinstance(error, MemoryError):
        said = "not enough memory"
    else:
        at = traceback.extract_tb(error.__traceback__)[-1]
        said = f"unexpected {type(error).__name__} in {Path(at.filename).name}:{at.lineno}: {error}"
    return " ".join(said.split())


def _open(source: DatasetSource, frames: tuple[int, int] | None = None) -> Clip | Motion:
    """The source, or `frames` of it if it is a clip."""
    if Path(source.place).is_file() and detect_format(source.place) == "npz":
        if source.overrides or source.frames is not None:
            raise ClipError(
                f"{source.place}: is already a robot motion; frames, fps, up, scale and point map are of clips"
            )
        return Motion.load(source.place)
    return open_clip(source.place, frames=source.frames or frames, **source.overrides)


def _of_motion(source: DatasetSource, motion: Motion) -> Excerpt:
    robot = motion.provenance.robot
    if robot is None:
        raise ClipError(f"{source.place}: does not say whose motion it is ('robot' in its meta)")
    return Excerpt(
        name=source.name,
        source=source,
        digest=digest_of(motion),
        gait=WHOLE,
        repeats=motion.cycle is not None,
        period_s=motion.period_s,
        speed_m_per_s=float(np.linalg.norm(motion.root_lin_vel_w[:, :2], axis=1).mean()),
        yaw_rate_rad_per_s=float(motion.root_ang_vel_w[:, 2].mean()),
        robot=robot,
        licence=motion.provenance.licence or source.licence,
        credit=motion.provenance.credit or source.credit,
    )


def _of_take(source: DatasetSource, first: int, take: Clip, confidence: float, discrete: bool) -> Survey:
    """Excerpts of a take, or of the part of one that begins at frame `first`; the whole of a short clip that is one
    cycle by its description or its ends."""

    def excerpt(frames: tuple[int, int], segment: Segment, repeats: bool) -> Excerpt:
        start, end = frames
        return _piece(source, take.cut(start, end), (first + start, first + end), segment, repeats=repeats)

    segments = find_segments(take)
    cycles = [(segment, segment.cycle) for segment in segments if segment.cycle is not None]
    found = [excerpt(frames, segment, True) for segment, frames in cycles if segment.confidence >= confidence]
    short = take.n_frames <= SegmentConfig().longest_s * take.rate_hz
    if not found and short and is_one_cycle(take):
        segment = replace(as_one_cycle(take), confidence=1.0)
        found.append(excerpt((0, take.n_frames), segment, True))
    elif discrete:
        for segment in segments:
            frames = (segment.start, segment.end)
            if segment.gait == DISCRETE and segment.end - segment.start <= MAX_S * take.rate_hz:
                found.append(excerpt(frames, segment, False))
    if found:
        return Survey(source, tuple(found))
    doubtful = f"{len(cycles)} cycles, none with a confidence of {confidence:g}"
    return Survey(source, skipped=f"{take.n_frames} frames hold {doubtful if cycles else 'nothing that repeats'}")


def _piece(source: DatasetSource, cut: Clip, frames: tuple[int, int], segment: Segment, *, repeats: bool) -> Excerpt:
    whole = frames == (0, cut.n_frames) and source.frames is None and "parts" not in cut.meta
    name = source.name if whole else f"{source.name}-{frames[0]}-{frames[1]}"
    return Excerpt(
        name=name,
        source=source,
        frames=None if whole else frames,
        digest=digest_of(replace(cut, is_cycle=repeats)),
        gait=segment.gait,
        footfall=segment.footfall,
        confidence=round(segment.confidence, 4),
        repeats=repeats,
        period_s=cut.n_frames / cut.rate_hz,
        speed_m_per_s=segment.speed_m_per_s,
        yaw_rate_rad_per_s=segment.yaw_rate_rad_per_s,
        licence=cut.meta.get("licence") or source.licence,
        credit=cut.meta.get("credit") or source.credit,
    )


def digest_of(piece: Clip | Motion) -> str:
    """16 hexadecimal digits of an excerpt's content, without its name and place."""
    if not isinstance(piece, Motion):
        turned = [] if piece.root_quat_wxyz is None else [piece.root_quat_wxyz]
        said = repr((piece.rate_hz, piece.is_cycle, piece.leg_length_m, piece.scale))
        return fingerprint(piece.points_w, *turned, said.encode())
    found: list[bytes | NDArray[Any]] = []
    for motion in (piece, piece.target):
        found += [motion.root_pos_w, motion.root_quat_wxyz, motion.joint_pos, motion.contact]
        found.append(repr((motion.rate_hz, None if motion.cycle is None else motion.cycle.tolist())).encode())
    return fingerprint(*found)


def save_survey(folder: Path, found: Survey) -> None:
    """Saves a survey; raises `OutputError` if it cannot."""
    write_text(survey_file(folder, found.source), json.dumps(asdict(found), indent=1, allow_nan=False))


def survey_file(folder: Path, source: DatasetSource) -> Path:
    """The file of a source's survey in a library."""
    return folder / SOURCES / f"{source.key}.json"
