"""Sources of a library, and their excerpts to imitate: whole motions, and the cycles of long takes."""

import csv
import fnmatch
import io
import os
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from fastmimic import __version__
from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import ClipError, ConfigError, FastMimicError, LibraryError
from fastmimic.clips.catalogue import check_name, open_clip, open_parts, parse_frames
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import detect_format, suffixes
from fastmimic.clips.segment import DISCRETE, Segment, SegmentConfig, as_one_cycle, find_segments
from fastmimic.motion.motion import Motion
from fastmimic.primitive.discrete import MAX_S
from fastmimic.retargeting.retarget import is_one_cycle

SOURCES: Final = "sources"
_DESCRIBED: Final = ("name", "gait", "footfall", "confidence", "licence", "credit")
Cut = Literal["cycles", "segments", "whole"]
"""What is taken out of a take: its cycles, its movements that do not repeat as well, or all of it as one motion."""
WHOLE: Final = "whole"  # gait of an excerpt without a search for cycles: a robot motion, or given frames
NO_CLIPS: Final = (
    *("license*", "licence*", "copying*", "notice*", "readme*", "changelog*", "requirements*.txt", ".*"),
    *("config.json", "metrics.json", "environment.json", "deployment.json", "checkpoint*.npz", "policy.npz"),
)
"""Files of a folder that are never clips."""
_LICENCES: Final = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "LICENCE.txt", "COPYING")
_COLUMNS: Final = ("source", "frames", "fps", "up", "scale", "point_map", "licence", "credit")


@dataclass(frozen=True)
class DatasetSource:
    """A clip, a take, or a robot motion.

    Attributes:
        place: path, or a name of `fastmimic motions`.
        frames: (first, end) of one motion; None to search all of it for motions.
        fps, up, scale, point_map: as in `fastmimic.clips.catalogue.open_clip`.
        licence, credit: of the recording, if the source itself has none.
    """

    place: str
    frames: tuple[int, int] | None = None
    fps: float | None = None
    up: str | None = None
    scale: float | None = None
    point_map: str | None = None
    licence: str | None = None
    credit: str | None = None

    @property
    def overrides(self) -> dict[str, Any]:
        """Arguments of `open_clip` besides the place and the frames."""
        names = ("fps", "up", "scale", "point_map")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @property
    def name(self) -> str:
        """A file's name without its suffix, or the motion's name."""
        path = Path(self.place)
        return path.stem if path.suffix else self.place

    @property
    def key(self) -> str:
        """12 hexadecimal digits that identify the source, independent of its content."""
        return fingerprint(asdict(self))[:12]

    def __str__(self) -> str:
        return self.place if self.frames is None else f"{self.place} {self.frames[0]}:{self.frames[1]}"


def find_sources(
    place: str | Path, *, exclude: Sequence[str] = (), licence: str | None = None, credit: str | None = None
) -> list[DatasetSource]:
    """The sources of a folder, of a list, or a single one.

    Args:
        place: a folder, searched at any depth; a list: `.csv` with a header that has `source` and optionally frames,
            fps, up, scale, point_map, licence and credit, or `.list` with one source per line; else one file or name.
            Paths in a list are relative to it.
        exclude: patterns of files in a folder to leave out, such as `*_raw.txt`.
        licence, credit: of sources without their own.

    Raises `LibraryError` if nothing is there, or a line of the list cannot be read, and `ClipError` for an unknown or
    unfetched name outside a list.
    """
    path = Path(place)
    if os.path.isdir(path):
        found = _in_folder(path, exclude, licence, credit)
        if not found:
            raise LibraryError(f"{path}: no clips in this folder; files that may be end in {', '.join(suffixes())}")
        return found
    if path.suffix == ".list" or (path.suffix == ".csv" and _is_list(path)):
        return _of_list(path, {"licence": licence, "credit": credit})
    if not os.path.exists(path) and (path.suffix or "/" in str(place)):
        raise LibraryError(f"{place}: no such file or folder")
    if not os.path.exists(path):
        check_name(str(place))
    return [DatasetSource(str(path.resolve()) if os.path.isfile(path) else str(place), licence=licence, credit=credit)]


def _in_folder(folder: Path, exclude: Sequence[str], licence: str | None, credit: str | None) -> list[DatasetSource]:
    found = []
    for path in sorted(folder.rglob("*")):
        name = path.name.lower()
        left_out = any(fnmatch.fnmatch(name, pattern) for pattern in NO_CLIPS) or any(
            fnmatch.fnmatch(path.name, p) or fnmatch.fnmatch(str(path.relative_to(folder)), p) for p in exclude
        )
        if path.is_file() and path.suffix.lower() in suffixes() and not left_out:
            found.append(DatasetSource(str(path.resolve()), licence=licence or _beside(path, folder), credit=credit))
    return found


def _beside(path: Path, top: Path) -> str | None:
    """The first line of the licence file next to a file, or above it within the folder."""
    for folder in path.parents:
        for name in _LICENCES:
            try:
                lines = (folder / name).read_text(encoding="utf-8", errors="replace").splitlines()
            except OSError:
                continue
            first = next((line.strip() for line in lines if line.strip()), None)
            if first is not None:
                return first[:200]
        if folder == top:
            return None
    return None


def _is_list(path: Path) -> bool:
    if not os.path.isfile(path):
        return True  # a missing list, rather than a motion of that name
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = next(csv.reader(file), [])
    except (OSError, UnicodeDecodeError, csv.Error):
        return False
    return "source" in [cell.strip() for cell in header]


def _of_list(path: Path, known: Mapping[str, Any]) -> list[DatasetSource]:
    try:
        text = path.read_text(encoding="utf-8-sig")  # with a byte-order mark, as spreadsheets write it
    except FileNotFoundError:
        raise LibraryError(f"{path}: no such list") from None
    except (OSError, UnicodeDecodeError) as error:
        raise LibraryError(f"{path}: not a readable list of sources ({error})") from None
    rows: list[tuple[int, Mapping[str, str]]]
    if path.suffix == ".csv":
        reader = csv.DictReader(io.StringIO(text), skipinitialspace=True)
        unknown = sorted(set(reader.fieldnames or ()) - set(_COLUMNS))
        if unknown:
            raise LibraryError(f"{path}: unknown column '{unknown[0]}'; there are {', '.join(_COLUMNS)}")
        rows = [(reader.line_num, row) for row in reader]
    else:
        lines = (line.split("#", 1)[0].strip() for line in text.splitlines())
        rows = [(number, {"source": line}) for number, line in enumerate(lines, 1) if line]
    found = [_of_row(path, number, row, known) for number, row in rows]
    if not found:
        raise LibraryError(f"{path}: the list is empty")
    return found


def _of_row(path: Path, number: int, row: Mapping[str, str | None], known: Mapping[str, Any]) -> DatasetSource:
    given = {name: value.strip() for name, value in row.items() if name and value and value.strip()}
    if "source" not in given:
        raise LibraryError(f"{path}, line {number}: no source")
    place = given.pop("source")
    beside = path.parent / place
    kinds: dict[str, Callable[[str], Any]] = {"fps": float, "scale": float}
    kinds["frames"] = partial(parse_frames, where="frames")
    kinds["point_map"] = lambda text: str((path.parent / text).resolve())
    try:
        values = {name: kinds.get(name, str)(text) for name, text in given.items()}
        return DatasetSource(str(beside.resolve()) if os.path.exists(beside) else place, **{**known, **values})
    except (ValueError, ConfigError) as error:
        raise LibraryError(f"{path}, line {number}: {error}") from None


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
            piece = replace(piece.named(self.name), is_cycle=self.repeats)
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


def survey(source: DatasetSource, confidence: float, cut: Cut = "cycles") -> Survey:
    """Searches a source for excerpts, with the least confidence of cycles. Errors become part of the result."""
    try:
        looked, opened = look_of(source, confidence, cut), _open(source)
        if isinstance(opened, Motion):
            found = Survey(source, (_of_motion(source, opened),))
        elif source.frames is not None:
            found = _whole(source, source.frames[0], opened)
        else:
            of_part = _whole if cut == "whole" else partial(_of_take, confidence=confidence, discrete=cut == "segments")
            surveys = [of_part(source, first, take) for first, take in open_parts(source.place, **source.overrides)]
            pieces = tuple(piece for part in surveys for piece in part.pieces)
            found = Survey(source, pieces) if pieces else surveys[0]
        return replace(found, looked=looked)
    except Exception as error:  # noqa: BLE001 - one source's defect, of which there may be a thousand others
        return Survey(source, failed=reason_of(error))


def look_of(source: DatasetSource, confidence: float, cut: Cut) -> str | None:
    """The inputs of a `survey` in words, with a file's size and time, to see if they changed; None without a file."""
    files = [source.place, *([] if source.point_map is None else [source.point_map])]
    try:
        states = [Path(place).stat() for place in files]
    except OSError:
        return None
    said = ", ".join(f"{state.st_size} bytes of {state.st_mtime_ns}" for state in states)
    return f"{said}, confidence {confidence}, {cut}, fastmimic {__version__}"


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
            given = "frames, fps, up, scale and point map"
            raise ClipError(f"{source.place}: is already a robot motion; {given} are of clips")
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


def _whole(source: DatasetSource, first: int, take: Clip) -> Survey:
    """A take, or a part of one that begins at frame `first`, as it is from start to end."""
    segment = replace(as_one_cycle(take), gait=WHOLE, confidence=1.0)
    frames = (first, first + take.n_frames)
    return Survey(source, (_piece(source, take, frames, segment, repeats=is_one_cycle(take)),))


def _of_take(source: DatasetSource, first: int, take: Clip, confidence: float, discrete: bool) -> Survey:
    """Excerpts of a take, or of its part that begins at frame `first`; the whole of a short clip that is one cycle."""

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
    whole = frames == (0, cut.n_frames) and source.frames is None and cut.origin.parts is None
    return Excerpt(
        name=source.name if whole else f"{source.name}-{frames[0]}-{frames[1]}",
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
        licence=cut.origin.licence or source.licence,
        credit=cut.origin.credit or source.credit,
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


def survey_file(folder: Path, source: DatasetSource) -> Path:
    """The file of a source's survey in a library."""
    return folder / SOURCES / f"{source.key}.json"
