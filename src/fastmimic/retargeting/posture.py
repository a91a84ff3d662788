"""What of an animal's postures a robot can take in a recording that does not repeat.

A cycle has one posture, about which everything is periodic. Who sits down or gets up has two or more: the attitude that
counts as level is that of the tallest of them, and a girdle goes no lower than its folded legs allow, moment by moment:
an animal sits on its rump, a robot on its feet. The trunk keeps its pitch as far as its upper end is then no higher
than it stands.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.reach import Reach
from fastmimic.retargeting.report import MIN_CLEARANCE_SHARE
from fastmimic.retargeting.scaled_clip import ScaledClip
from fastmimic.robot import Robot

_TALL_M: Final = 0.03
"""Frames that are so much lower than the tallest have 1/e of its weight."""
_ROOM_M: Final = 0.05
"""Of a folded leg beyond its shortest: its foot stands ahead of the hip, or behind it, and its knee off the ground."""
_SOFT_M: Final = 0.02
"""Over which a girdle comes to rest at its lowest height."""


def levelled(source: ScaledClip) -> ScaledClip:
    """With the attitude that it has where it stands tallest taken for level; before, it was the mean."""
    weight = np.exp((source.root_z - source.root_z.max()) / _TALL_M)
    return replace(source, tilt=source.tilt - weight @ source.tilt / weight.sum())


def within_folded_legs(source: ScaledClip, robot: Robot, lowered_m: float, config: RetargetConfig) -> ScaledClip:
    """With shoulders and hips no lower than legs that are folded, and lifted as the animal's, need: the trunk is raised
    as a whole, and levelled as far as its other end would be higher than it stands.

    Args:
        source: at the robot's size, level.
        robot: legs and hips.
        lowered_m: by how much the base will be below the animal's.
        config: margins, and the least clearance of a swing.
    """
    mean = float(source.root_z.mean())
    height = source.hip_height + source.root_z - mean - lowered_m  # of the hips' middle above the ground
    shortest = Reach.of_robot(robot, 0.0, config.reach_margin_rad).shortest
    lift = np.maximum(MIN_CLEARANCE_SHARE * source.toe_height, config.swing.min_clearance_m)
    x = robot.hip_pos_b[:, 0].reshape(2, 2).mean(axis=1)  # of shoulders and hips
    slope = -np.sin(source.tilt[:, 1])
    girdle = height[:, None] + slope[:, None] * x
    least = shortest + _ROOM_M + lift.reshape(-1, 2, 2).max(axis=2)
    rise = (_no_lower(girdle, least) - girdle).max(axis=1, keepdims=True)
    raised = -_no_lower(-(girdle + rise), -np.maximum(height.max(), least))
    raised = np.where(rise > 0, raised, girdle)
    new_slope = slope + ((raised - girdle) @ np.array([1.0, -1.0])) / (x[0] - x[1])
    rise = (raised - girdle)[:, 0] - (new_slope - slope) * x[0]
    changed = np.any(raised != girdle, axis=1)
    pitch = np.where(changed, -np.arcsin(np.clip(new_slope, -1.0, 1.0)), source.tilt[:, 1])
    root_z = source.root_z + np.where(changed, rise, 0.0)
    return replace(
        source,
        root_z=root_z,
        tilt=np.stack([source.tilt[:, 0], pitch], axis=-1),
        hip_height=source.hip_height + float(root_z.mean()) - mean,
    )


def _no_lower(value: Array, least: Array) -> Array:
    """The greater of the two, with a smooth passage; `value` itself where it is well above."""
    above = value - least
    soft = least + (above + _SOFT_M) ** 2 / (4 * _SOFT_M)
    return np.where(above >= _SOFT_M, value, np.where(above <= -_SOFT_M, least, soft))
