"""A look at the videos that were written."""

import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np

RATE_HZ = 50.0
"""Samples a second of the tracks that are drawn."""


def read_video(path: Path) -> np.ndarray:
    """All frames of a video, (n, height, width, 3)."""
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return np.stack([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader])


def stream_facts(path: Path) -> str:
    """What ffmpeg says of a video's stream."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=False).stderr
