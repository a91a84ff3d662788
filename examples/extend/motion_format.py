"""Adds a motion format: ten keypoints a frame as JSON lines. A file in it is then retargeted like any other.

python examples/extend/motion_format.py

Set FASTMIMIC_EXTENSIONS to this file, and the command line reads such files too: `fastmimic retarget walk.jsonl`.
"""

import json
import tempfile
from pathlib import Path

import numpy as np

import fastmimic as fm
from fastmimic.clips.formats import FORMATS, Content, Format


def detect(content: Content) -> bool:
    return content.start.startswith('{"keypoints"')


def parse(text: str, fps: float | None) -> fm.Clip:
    points = [json.loads(line)["keypoints"] for line in text.splitlines()]
    return fm.Clip(points_w=np.array(points), rate_hz=fps or 120.0)


FORMATS.register(Format("keypoint-lines", "keypoints as JSON lines", (".jsonl",), detect, parse))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "walk.jsonl"
        frames = fm.open_clip("walk").points_w.tolist()  # stands in for your own recording
        file.write_text("".join(json.dumps({"keypoints": frame}) + "\n" for frame in frames))
        clip = fm.open_clip(file)
    motion, report = fm.retarget(clip, fm.load_robot("a1"), cycle=True)
    print(f"{clip.origin.format}: {clip.n_frames} frames become {motion.n_samples} samples")
    print("\n".join(report.lines()))
