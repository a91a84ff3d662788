"""`fastmimic segment`: the locomotion cycles of a long take."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from fastmimic.commands.console import note, put, table
from fastmimic.commands.options import check_writable

if TYPE_CHECKING:
    from fastmimic.clips.segment import Segment


@dataclass(frozen=True, kw_only=True)
class SegmentTake:
    """Finds what repeats in a take of any length: first frame and end, gait, period, speed and turning of each segment,
    and the cycle of it that closes best, which 'imitate --frames A:B' takes. Standing and movement that does not
    repeat are listed, too; 'imitate --frames A:B --discrete' has such a movement done once. Speeds are the animal's.
    """

    take: Annotated[Positional[str], arg(metavar="FILE|NAME")]
    """A clip, or a name of 'fastmimic motions'."""
    fps: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames a second of the file, in place of what it says."""
    up: Annotated[str | None, arg(metavar="y|z")] = None
    """Vertical axis of the file, in place of what its points show."""
    point_map: Annotated[Path | None, arg(metavar="FILE.json")] = None
    """Which of a BVH's joints, or of a table's points by name, neck, pelvis, hips and toes are."""
    json: bool = False
    """Print one JSON object instead of a table."""
    figure: Annotated[Path | None, arg(metavar="FILE.png")] = None
    """Also draw the segments over time, with the feet, speed and heading."""

    def run(self) -> int:
        """Prints the segments; returns the exit status."""
        from fastmimic.clips.catalogue import open_clip
        from fastmimic.clips.segment import DISCRETE, find_segments

        figure = None if self.figure is None else check_writable(self.figure, ".png", ".pdf", ".svg")
        overrides: dict[str, Any] = {"fps": self.fps, "up": self.up, "point_map": self.point_map}
        clip = open_clip(self.take, **{name: value for name, value in overrides.items() if value is not None})
        segments = find_segments(clip)
        if self.json:
            put(json.dumps({"segments": [asdict(segment) for segment in segments]}))
        else:
            for line in table([_HEAD, *(_row(segment, clip.rate_hz) for segment in segments)]):
                put(line)
            repeating = [segment for segment in segments if segment.cycle is not None]
            if repeating:
                first, end = max(repeating, key=lambda s: s.confidence).cycle or (0, 0)
                note(f"to imitate a cycle: fastmimic imitate {self.take} --frames {first}:{end}")
            once = next((segment for segment in segments if segment.gait == DISCRETE), None)
            if once is not None:
                note(
                    "to imitate a piece that does not repeat: "
                    f"fastmimic imitate {self.take} --frames {once.start}:{once.end} --discrete"
                )
        if figure is not None:
            from fastmimic.render.figure_style import save
            from fastmimic.report.segments import segments_figure

            save(segments_figure(clip, segments, Path(self.take).stem), figure)
            if not self.json:
                put(f"figure in {figure}")
        return 0


_HEAD = ("frames", "gait", "footfall", "period", "best cycle", "confidence", "speed, m/s", "yaw, rad/s")


def _row(segment: "Segment", rate_hz: float) -> tuple[str, ...]:
    repeats = segment.period_frames is not None and segment.cycle is not None
    return (
        f"{segment.start}:{segment.end}",
        segment.gait,
        segment.footfall or "",
        f"{segment.period_frames:g} ({segment.period_frames / rate_hz:.2f} s)" if segment.period_frames else "",
        "{}:{}".format(*segment.cycle) if repeats and segment.cycle else "",
        f"{segment.confidence:.2f}",
        f"{segment.speed_m_s:.2f}",
        f"{segment.yaw_rate_rad_s:+.2f}",
    )
