"""`fastmimic segment`: finds the locomotion cycles in a long take."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from fastmimic.commands import options as opt
from fastmimic.commands.console import note, put, put_json, put_table

if TYPE_CHECKING:
    from fastmimic.clips.segment import Segment


@dataclass(frozen=True, kw_only=True)
class SegmentTake:
    """Finds the cycles in a take of any length. Prints first frame and end, gait, period, speed and yaw rate of each
    segment, and its cycle that closes best, for 'imitate --frames A:B'. Standing and non-periodic movement are listed
    too; 'imitate --frames A:B --discrete' runs such a movement once. Speeds are the animal's.
    """

    take: Annotated[Positional[str], opt.option("FILE|NAME")]
    """A clip, or a name from 'fastmimic motions'."""
    json: opt.JsonFlag = False
    figure: Annotated[Path | None, opt.option("FILE.png")] = None
    """Also draw the segments over time, with feet, speed and heading."""
    file: opt.FileReading

    def run(self) -> int:
        """Prints the segments; returns the exit status."""
        from fastmimic.clips.catalogue import open_clip
        from fastmimic.clips.segment import DISCRETE, find_segments

        figure = None if self.figure is None else opt.check_writable(self.figure, ".png", ".pdf", ".svg")
        clip = open_clip(self.take, **self.file.overrides())
        segments = find_segments(clip)
        if self.json:
            put_json({"segments": [asdict(segment) for segment in segments]})
        else:
            put_table([_HEAD, *(_row(segment, clip.rate_hz) for segment in segments)])
            periodic = [segment for segment in segments if segment.cycle is not None]
            if periodic:
                first, end = max(periodic, key=lambda s: s.confidence).cycle or (0, 0)
                note(f"to imitate a cycle: fastmimic imitate {self.take} --frames {first}:{end}")
            once = next((segment for segment in segments if segment.gait == DISCRETE), None)
            if once is not None:
                note(
                    "to imitate a non-periodic movement: "
                    f"fastmimic imitate {self.take} --frames {once.start}:{once.end} --discrete"
                )
        if figure is not None:
            from fastmimic.render.figure_style import save
            from fastmimic.report.inspection import segments_figure

            save(segments_figure(clip, segments, Path(self.take).stem), figure)
            if not self.json:
                put(f"figure in {figure}")
        return 0


_HEAD = ("frames", "gait", "footfall", "period", "best cycle", "confidence", "speed, m/s", "yaw, rad/s")


def _row(segment: "Segment", rate_hz: float) -> tuple[str, ...]:
    periodic = segment.period_frames is not None and segment.cycle is not None
    return (
        f"{segment.start}:{segment.end}",
        segment.gait,
        segment.footfall or "",
        f"{segment.period_frames:g} ({segment.period_frames / rate_hz:.2f} s)" if segment.period_frames else "",
        "{}:{}".format(*segment.cycle) if periodic and segment.cycle else "",
        f"{segment.confidence:.2f}",
        f"{segment.speed_m_s:.2f}",
        f"{segment.yaw_rate_rad_s:+.2f}",
    )
