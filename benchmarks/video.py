"""How fast videos are drawn: frames a second, and how many times faster than they play.

    python benchmarks/video.py [--seconds S] [--high] [--json]

Of the built-in trot with its ghost, as `fastmimic render` draws it, the encoder included: one panel, two side by side,
and 2 x 2. `--high` adds the quality with shadows and reflections. The processor time says how far the cores were shared
with something else: without a graphics card, all cores are busy with drawing.
"""

import argparse
import dataclasses
import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import fastmimic as fm
from fastmimic.base.machine import available_cores
from fastmimic.render.tracks import motion_track
from fastmimic.render.video import render_video


def processor_time() -> float:
    """Of this process and of the encoders that have ended, s."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usage)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="of video")
    parser.add_argument("--high", action="store_true")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    robot = fm.load_robot("a1")
    motion, _ = fm.retarget(fm.open_clip("trot"), robot)
    track = motion_track(motion, args.seconds, "trot", caption="as it is written")
    track = dataclasses.replace(track, ghost=track.pose)
    cases = [("preview", n) for n in (1, 2, 4)] + ([("high", 1)] if args.high else [])
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        render_video(robot, [track], Path(folder) / "warm.mp4", rate_hz=motion.rate_hz, window_s=(0.0, 0.5))
        for quality, panels in cases:
            began, used = time.perf_counter(), processor_time()
            info = render_video(
                robot, [track] * panels, Path(folder) / "video.mp4", rate_hz=motion.rate_hz, quality=quality
            )
            if info is None:
                sys.exit("nothing to draw with on this machine")
            wall, cpu = time.perf_counter() - began, processor_time() - used
            rows.append(
                {
                    "quality": quality,
                    "panels": panels,
                    "frames_per_s": info.frames / wall,
                    "times_real_time": info.seconds / wall,
                    "processor_ms_per_frame": 1000 * cpu / info.frames,
                }
            )
    if args.json:
        print(json.dumps({"cores": available_cores(), "videos": rows}, indent=2))
        return
    print("| quality | panels | frames/s | × real time | processor time, ms a frame |")
    print("| --- | --- | --- | --- | --- |")
    for row in rows:
        print(
            f"| {row['quality']} | {row['panels']} | {row['frames_per_s']:.0f} | {row['times_real_time']:.2f}"
            f" | {row['processor_ms_per_frame']:.1f} |"
        )


if __name__ == "__main__":
    main()
