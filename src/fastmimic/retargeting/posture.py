"""Limits the postures of a recording that does not repeat to those that a robot can take.

A cycle has one posture; a recording of sitting down or getting up has two or more, and the tallest counts as level.
Shoulders and hips go no lower than folded legs allow: an animal sits on its rump, a robot on its feet. The trunk keeps
its pitch as long as its upper end stays below standing height.
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
from fastmimic.robot.scaling import length_ratio

# m, at the A1's size
_TALL_M: Final = 0.03  # frames this much lower than the tallest have 1/e of its weight
_ROOM_M: Final = 0.05
"""Added to the shortest leg: a folded leg's foot stands ahead of the hip or behind it, and its knee off the ground."""
_SOFT_M: Final = 0.02  # range of the smooth blend to the lowest height


def levelled(source: ScaledClip, robot: Robot) -> ScaledClip:
    """The clip with its attitude at its tallest as level, instead of the mean attitude."""
    weight = np.exp((source.root_z - source.root_z.max()) / (_TALL_M * length_ratio(robot)))
    return replace(source, tilt=source.tilt - weight @ source.tilt / weight.sum())


def within_folded_legs(source: ScaledClip, robot: Robot, lowered_m: float, config: RetargetConfig) -> ScaledClip:
    """The clip with shoulders and hips no lower than folded legs allow, with feet lifted as high as the animal's. The
    trunk is raised as a whole, and levelled as far as its other end would be higher than it stands. `source` is level
    and at the robot's size; the base is `lowered_m` below the animal's."""
    mean = float(source.root_z.mean())
    height = source.hip_height + source.root_z - mean - lowered_m  # of the hips' middle above the ground
    shortest = Reach.of_robot(robot, 0.0, config.reach_margin_rad).shortest
    lift = np.maximum(MIN_CLEARANCE_SHARE * source.toe_height, config.swing.min_clearance_m)
    x = robot.hip_pos_b[:, 0].reshape(2, 2).mean(axis=1)  # of shoulders and hips
    slope = -np.sin(source.tilt[:, 1])
    girdle = height[:, None] + slope[:, None] * x
    size = length_ratio(robot)
    least = shortest + _ROOM_M * size + lift.reshape(-1, 2, 2).max(axis=2)
    rise = (_no_lower(girdle, least, _SOFT_M * size) - girdle).max(axis=1, keepdims=True)
    raised = -_no_lower(-(girdle + rise), -np.maximum(height.max(), least), _SOFT_M * size)
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


def _no_lower(value: Array, least: Array, soft: float) -> Array:
    """The greater of the two, with a smooth blend of ± `soft` m between them."""
    above = value - least
    passage = least + (above + soft) ** 2 / (4 * soft)
    return np.where(above >= soft, value, np.where(above <= -soft, least, passage))
