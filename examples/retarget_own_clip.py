"""Retargets your own keypoints to a robot, and says what that changed.

python examples/retarget_own_clip.py                  keypoints in arrays (here: those of a built-in gait)
python examples/retarget_own_clip.py CLIP [A:B]       a file in any format that FastMimic reads
"""

import sys

import numpy as np

import fastmimic as fm


def clip_from_arrays() -> fm.Clip:
    """What it takes: ten points (frames, 10, 3) in metres with z up, in the order of `POINT_NAMES`, and a rate."""
    animal = fm.open_clip("walk")  # stands in for your own recording
    points_w = np.array(animal.points_w)  # pelvis, neck, four hips or shoulders, four toes; legs FR, FL, RR, RL
    return fm.Clip(points_w=points_w, rate_hz=120.0, is_cycle=True).named("my-walk")


def clip_from_file(path: str, frames: str | None = None) -> fm.Clip:
    """The format is found by the file's content; a path goes through the same checks as on the command line."""
    if frames is None:
        return fm.open_clip(path, robot=robot)
    first, end = (int(n) for n in frames.split(":"))
    return fm.open_clip(path, robot=robot, frames=(first, end))


robot = fm.load_robot("go2")
given = [a for a in sys.argv[1:] if not a.startswith("--")]
clip = clip_from_file(*given) if given else clip_from_arrays()
motion, report = fm.retarget(clip, robot)
for sentence in clip.origin.assumed:
    print(f"assumed: {sentence}")
print("\n".join(report.lines()))

evaluation = fm.evaluate(motion, robot, duration_s=2.0)
print(f"not optimised: reward {evaluation.rollout.reward[0]:.3f} over 2 s")
