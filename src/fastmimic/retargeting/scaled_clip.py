"""From an animal's keypoints to trunk pose and toe targets at the robot's size (Peng et al. 2020, section IV)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import matrix_from_quat, rotate_planar
from fastmimic.clips.clip import Clip


@dataclass(frozen=True, eq=False)
class ScaledClip:
    """Trunk pose and toes of a clip at the robot's scale, frame by frame.

    Attributes:
        rate_hz: frames a second.
        root_xy: (t, 2) middle of neck and pelvis, world, m.
        root_z: (t,) its height above the ground on which the toes stand, m.
        heading: (t,) rad, continuous.
        tilt: (t, 2) roll and pitch, rad.
        hip_height: mean height of hips and shoulders above the ground, m.
        toe_from_hip: (t, 4, 2) horizontal hip→toe vectors in the heading frame, m.
        toe_height: (t, 4) above each leg's own ground, m.
        toe_speed: (t, 4) horizontal, world, m/s.
    """

    rate_hz: float
    root_xy: Array
    root_z: Array
    heading: Array
    tilt: Array
    hip_height: float
    toe_from_hip: Array
    toe_height: Array
    toe_speed: Array

    def held(self, frames: int) -> "ScaledClip":
        """The recording with its last frame repeated `frames` times, at rest."""
        longer: dict[str, Any] = {}
        for name in ("root_xy", "root_z", "heading", "tilt", "toe_from_hip", "toe_height"):
            values = getattr(self, name)
            longer[name] = np.concatenate([values, np.repeat(values[-1:], frames, axis=0)])
        return replace(self, **longer, toe_speed=np.concatenate([self.toe_speed, np.zeros((frames, 4))]))

    def turned(self, angle: float) -> "ScaledClip":
        """The motion with the trunk's heading turned by `angle` rad; its path and toes stay."""
        return replace(self, heading=self.heading + angle, toe_from_hip=rotate_planar(-angle, self.toe_from_hip))


def extract(clip: Clip, scale: float, roll_share: float) -> ScaledClip:
    """Trunk pose and toe targets of a clip, scaled from the animal's to the robot's size.

    Heading and pitch are those of the line from pelvis to neck. Roll is `roll_share` (`RetargetConfig`) of that of the
    mean line between left and right shoulders and hips. Mean roll and pitch are removed, because they depend on the
    marker positions. If the clip has its trunk's orientation, that is used instead.
    """
    neck, pelvis = clip.point("neck"), clip.point("pelvis")
    if clip.root_quat_wxyz is not None:
        R = matrix_from_quat(clip.root_quat_wxyz)
        heading = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
        pitch = -np.arcsin(np.clip(R[:, 2, 0], -1, 1))
        tilt = np.stack([np.arctan2(R[:, 2, 1], R[:, 2, 2]), pitch], axis=-1)
    else:
        spine = neck - pelvis
        heading = np.unwrap(np.arctan2(spine[:, 1], spine[:, 0]))
        pitch = -np.arctan2(spine[:, 2], np.linalg.norm(spine[:, :2], axis=-1))
        across = clip.hips_w[:, [1, 3]] - clip.hips_w[:, [0, 2]]
        lateral = (across / np.linalg.norm(across, axis=-1, keepdims=True)).mean(axis=1)
        roll = roll_share * np.arctan2(lateral[:, 2], np.linalg.norm(lateral[:, :2], axis=-1))
        tilt = np.stack([roll, pitch], axis=-1)
        tilt -= tilt.mean(axis=0)
    toes = clip.toes_w * scale
    ground = np.percentile(toes[..., 2], 10, axis=0)
    velocity = np.gradient(toes[..., :2], 1.0 / clip.rate_hz, axis=0)
    hip_to_toe = (toes - scale * clip.hips_w)[..., :2]
    root = scale * 0.5 * (neck + pelvis)
    return ScaledClip(
        rate_hz=clip.rate_hz,
        root_xy=root[:, :2],
        root_z=root[:, 2] - ground.mean(),
        heading=heading,
        tilt=tilt,
        hip_height=float(scale * clip.hips_w[..., 2].mean() - ground.mean()),
        toe_from_hip=rotate_planar(-heading[:, None], hip_to_toe),
        toe_height=toes[..., 2] - ground,
        toe_speed=np.linalg.norm(velocity, axis=-1),
    )
