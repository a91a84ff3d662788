"""Small valid motion files, made up, in each text format."""

import json
from pathlib import Path

import numpy as np

from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats.csv_motion import COLUMN_NAMES
from fastmimic.motion.motion import Motion

UP, FORWARD, LEFT = 1, 2, 0  # axes of a y-up keypoint file: x left, y up, z forward
KEYPOINT_COLUMNS = {
    **{0: "pelvis", 3: "neck"},
    **{6: "FL_hip", 11: "FR_hip", 16: "RL_hip", 20: "RR_hip"},
    **{10: "FL_toe", 15: "FR_toe", 19: "RL_toe", 23: "RR_toe"},
}
TOE_HEIGHT, HIP_HEIGHT = 0.02, 0.37


def keypoint_values(n_frames: int = 12) -> np.ndarray:
    """(n, 27, 3) of a stiff dog that slides forward at 1 cm a frame; hips 0.35 m above the toes, y up."""
    points = np.zeros((n_frames, 27, 3))
    points[..., UP] = HIP_HEIGHT
    for index, forward, left, height in [
        (3, 0.4, 0.0, HIP_HEIGHT),
        (6, 0.4, 0.04, HIP_HEIGHT),
        (11, 0.4, -0.04, HIP_HEIGHT),
        (16, 0.0, 0.04, HIP_HEIGHT),
        (20, 0.0, -0.04, HIP_HEIGHT),
        (10, 0.41, 0.05, TOE_HEIGHT),
        (15, 0.42, -0.06, TOE_HEIGHT),
        (19, 0.01, 0.07, TOE_HEIGHT),
        (23, 0.02, -0.08, TOE_HEIGHT),
    ]:
        points[:, index] = np.array([left, height, forward])
    points[..., FORWARD] += 0.01 * np.arange(n_frames)[:, None]
    return points


def table_text(values: np.ndarray, separator: str = ",\t") -> str:
    """One row of the first axis a line."""
    return "".join(separator.join(f"{v:.5f}" for v in frame.ravel()) + "\n" for frame in values)


def keypoint_text(n_frames: int = 12) -> str:
    return table_text(keypoint_values(n_frames))


def take_text(clip: Clip, cycles: int) -> str:
    """Several cycles of a straight gait as a keypoint file of 60 frames a second."""
    points = clip.points_w
    step = (points[-1] - points[0])[:2].mean(axis=0) * clip.n_frames / (clip.n_frames - 1)
    take = np.concatenate([points + k * step for k in range(cycles)])[:: round(clip.rate_hz / 60)]
    values = np.zeros((len(take), 27, 3))
    for index, name in KEYPOINT_COLUMNS.items():
        values[:, index, [FORWARD, LEFT, UP]] = take[:, POINT_NAMES.index(name)]
    return table_text(values)


STANDING = [0.0, 0.8, -1.6] * 4  # rad; the A1's crouch
LAIKAGO_STANDING = [0.0, 0.27, -0.86] * 4


def deepmimic_document(n_frames: int = 9) -> dict:
    """A Laikago that slides forward at 1 cm a frame without moving its legs, as a loop."""
    frames = [[0.01 * i, 0.0, 0.438, 0.5, 0.5, 0.5, 0.5, *LAIKAGO_STANDING] for i in range(n_frames)]
    return {
        "LoopMode": "Wrap",
        "FrameDuration": 0.02,
        "EnableCycleOffsetPosition": True,
        "EnableCycleOffsetRotation": False,
        "Frames": frames,
    }


def deepmimic_text(n_frames: int = 9) -> str:
    """With one frame a line, the first on line 7."""
    document = deepmimic_document(n_frames)
    frames = document.pop("Frames")
    head = json.dumps(document, indent=1)[:-2]
    return head + ',\n "Frames": [\n' + ",\n".join(json.dumps(frame) for frame in frames) + "\n]}\n"


def csv_values(n_frames: int = 8) -> np.ndarray:
    """(n, 19): a standing robot that slides forward at 1 cm a frame."""
    row = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0, *STANDING])
    values = np.tile(row, (n_frames, 1))
    values[:, 0] = 0.01 * np.arange(n_frames)
    return values


def csv_text(n_frames: int = 8, *, header: bool = False) -> str:
    return (",".join(COLUMN_NAMES) + "\n" if header else "") + table_text(csv_values(n_frames), ",")


def save_motion(path: Path, n_samples: int = 5) -> Path:
    """A robot motion that stands still."""
    zeros = np.zeros((n_samples, 12))
    motion = Motion(
        rate_hz=50,
        root_pos_w=zeros[:, :3],
        root_quat_wxyz=np.tile([1.0, 0, 0, 0], (n_samples, 1)),
        joint_pos=zeros,
        joint_vel=zeros,
        foot_pos_b=zeros.reshape(-1, 4, 3),
        contact=np.ones((n_samples, 4), dtype=bool),
        root_lin_vel_w=zeros[:, :3],
        root_ang_vel_w=zeros[:, :3],
    )
    motion.save(path)
    return path
