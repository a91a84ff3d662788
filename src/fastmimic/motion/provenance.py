"""Where a motion comes from and how it was made: typed records, kept as JSON text in the motion's file."""

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, TypeVar

import msgspec
import numpy as np

from fastmimic.base.arrays import Array, Indices
from fastmimic.base.errors import MotionError
from fastmimic.base.text import number
from fastmimic.clips.clip import ClipOrigin

_Kind = TypeVar("_Kind")


@dataclass(frozen=True)
class Span:
    """Samples [start, end) of a blend; for a foot, of a stance, or of a swing if `stands` is False."""

    start: int
    end: int
    stands: bool = True

    def smooth_step(self, sample: Indices) -> Array:
        """Blend weight (k,) at samples (k,): from 0 to 1 by a polynomial with continuous second derivative."""
        u = np.clip((sample - self.start) / max(self.end - self.start, 1), 0.0, 1.0)
        return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


@dataclass(frozen=True)
class StitchedSegment:
    """One segment of a stitched motion; the first has no transition."""

    name: str  # of its motion
    part: int  # index of its motion among the whole's `parts`
    cycles: int  # requested
    first: int  # sample; neighbours meet in the middle of their transition
    last: int  # sample, exclusive
    shift: int  # sample t of the whole is sample (t − shift) mod n of the part
    trunk: Span | None  # blend of the trunk into this segment
    feet: tuple[Span, Span, Span, Span] | None  # stances or swings in which the legs switch to it
    rebuilt: Span | None  # samples of the transition, which belong to no part


@dataclass(frozen=True)
class DmpRecord:
    """The DMPs that made a motion (`fastmimic.primitive.MotionDmp`), with a value for each of `names`: `goal` and
    `amplitude` as modulated, `fitted_goal` as fitted to the demonstration. `primitive` is "discrete", or None."""

    n_basis: int
    alpha: float
    fit_rms: dict[str, float]
    names: tuple[str, ...]
    goal: tuple[float, ...]
    amplitude: tuple[float, ...]
    fitted_goal: tuple[float, ...]
    foot_samples_out_of_reach: tuple[int, ...]
    foot_shift_to_reach_m: tuple[float, ...]
    primitive: str | None = None

    def __post_init__(self) -> None:
        if not len(self.names) == len(self.goal) == len(self.amplitude) == len(self.fitted_goal):
            raise MotionError("'dmp': 'goal', 'amplitude' and 'fitted_goal' must have a number for each of 'names'")

    def modulation(self) -> Iterator[tuple[str, float, float, float]]:
        """Name, goal, fitted goal and amplitude of each dimension."""
        return zip(self.names, self.goal, self.fitted_goal, self.amplitude, strict=True)


@dataclass(frozen=True)
class StitchRecord:
    """How a motion was stitched: its segments, the samples at which later cycles start, figures of the transitions by
    name; of an optimised one the `parameters` by name and the DMPs of each segment."""

    segments: tuple[StitchedSegment, ...]
    cycle_starts: tuple[int, ...]
    transitions: tuple[dict[str, int | float], ...]
    parameters: dict[str, float] | None = None
    dmp: tuple[DmpRecord | None, ...] | None = None

    def __post_init__(self) -> None:
        if self.dmp is not None and len(self.dmp) != len(self.segments):
            raise MotionError("'stitch.dmp' must have an entry for each of 'stitch.segments'")


@dataclass(frozen=True)
class MadeWith:
    """The method of an optimised motion, and the name of its controller's parameters (None for its own ones)."""

    method: str
    config: str | None


@dataclass(frozen=True)
class RetargetBound:
    """A bound within which a motion counts as the animal's, and why it is not kept; `value` is None if unknown."""

    name: str
    value: float | None
    limit: float
    met: bool
    reason: str = ""

    def __str__(self) -> str:
        why = f" ({self.reason})" if self.reason else ""
        return f"{self.name}: {number(self.value, 4)} of {self.limit:.3g}{why}"


class RetargetOutcome(msgspec.Struct, frozen=True):
    """What is read again of a report of retargeting: the scale from the animal's size, and the bounds."""

    scale: float | None = None
    bounds: tuple[RetargetBound, ...] = ()


@dataclass(frozen=True)
class Provenance:
    """Where a motion comes from and how it was made.

    `source` is the clip's own, without what stands here; `retarget` is a `RetargetReport.as_dict`: see `retargeted`.
    The end of a motion without a cycle is held for `held_s`.
    """

    name: str = "motion"
    robot: str | None = None
    source: ClipOrigin | None = None
    licence: str | None = None
    credit: str | None = None
    retarget: dict[str, Any] | None = None
    held_s: float | None = None
    dmp: DmpRecord | None = None
    stitch: StitchRecord | None = None
    made_with: MadeWith | None = None

    def as_dict(self) -> dict[str, Any]:
        """JSON types for `from_dict`. An unknown licence is null."""
        return {"licence": None} | _plain(self)

    @classmethod
    def from_dict(cls, found: Any) -> "Provenance":
        """Reads what `as_dict` made. Raises `MotionError`, which names the key, for a malformed value."""
        made = _typed(found, cls, "$")
        _ = made.retargeted
        return made

    @property
    def origin(self) -> ClipOrigin:
        """`source`, or one that says nothing."""
        return self.source or ClipOrigin()

    @property
    def retargeted(self) -> RetargetOutcome:
        """What is known of its retargeting."""
        return _typed(self.retarget or {}, RetargetOutcome, "$.retarget")

    @property
    def assumed(self) -> tuple[str, ...]:
        """Assumptions made in reading the clip, as sentences."""
        return self.origin.assumed

    @property
    def stitched(self) -> StitchRecord:
        """`stitch`; raises `MotionError` if the motion was not stitched."""
        if self.stitch is None:
            raise MotionError(f"motion '{self.name}' is not a stitched one")
        return self.stitch


def _typed(found: Any, kind: type[_Kind], at: str) -> _Kind:
    try:
        return msgspec.convert(found, kind)
    except msgspec.ValidationError as error:
        raise MotionError(f"provenance: {error}".replace("`$", f"`{at}")) from None


def _plain(value: Any) -> Any:
    """JSON types; a dataclass leaves out what is None by default."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if not is_dataclass(value):
        return value
    found = {f: _plain(getattr(value, f.name)) for f in fields(value)}
    return {f.name: v for f, v in found.items() if v is not None or f.default is MISSING}
