"""Figures of a retargeted motion and of the animal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import (
    quat_conjugate,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    rotate_planar,
    rotvec_from_quat,
)
from fastmimic.motion.contacts import Stances, swings_of
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.cycle import TrunkTrack, WorldPath
from fastmimic.retargeting.scaled_clip import ScaledClip
from fastmimic.retargeting.signal import closing_error


@dataclass(frozen=True)
class Closure:
    """Distance of a cycle's end from its beginning: the worst of root and feet, m, and the trunk's rotation, deg."""

    distance_m: float
    angle_deg: float


def slip(feet_w: Array, track: TrunkTrack, stances: Stances) -> Array:
    """Largest horizontal distance (4,), m, of each foot from its touch-down, within a stance."""
    worst = np.zeros(4)
    for leg, spans in enumerate(stances):
        path = WorldPath(feet_w[:, leg], track)
        for span in spans:
            points = path.read(np.arange(*span))[:, :2]
            worst[leg] = max(worst[leg], float(np.linalg.norm(points - points[0], axis=1).max()))
    return worst


def mean_clearance(height: Array, stances: Stances, periodic: bool) -> Array:
    """Mean over each leg's swings of the highest point, (4,), m; 0 for a leg that never swings."""
    n = len(height)
    result = np.zeros(4)
    for leg, spans in enumerate(stances):
        tops = [height[np.arange(a, b) % n, leg].max() for a, b in swings_of(spans, n, periodic)]
        result[leg] = float(np.mean(tops)) if tops else 0.0
    return result


def closure_of_source(source: ScaledClip) -> Closure:
    """The closing error of a cut cycle: feet against the hips, heights, roll and pitch."""
    feet = np.concatenate([source.toe_from_hip, source.toe_height[..., None]], axis=-1)
    distance = np.linalg.norm(closing_error(feet), axis=-1).max()
    return Closure(
        float(max(distance, abs(closing_error(source.root_z)))),
        float(np.degrees(np.linalg.norm(closing_error(source.tilt)))),
    )


def closure_of_motion(motion: Motion, track: TrunkTrack) -> Closure:
    """Sample 0 moved by `cycle` against the last sample continued by its velocity and acceleration."""
    assert motion.cycle is not None
    ahead = _continued(motion.root_pos_w[-3:])
    repeated = np.array([*track.moved(motion.root_pos_w[0, :2], 1), motion.root_pos_w[0, 2]])
    distance = float(np.linalg.norm(ahead - repeated))
    feet = motion.foot_pos_w
    for leg in range(4):
        repeated = np.array([*track.moved(feet[0, leg, :2], 1), feet[0, leg, 2]])
        distance = max(distance, float(np.linalg.norm(_continued(feet[-3:, leg]) - repeated)))
    last = motion.root_quat_wxyz[-1]
    turn = (1.5 * motion.root_ang_vel_w[-1] - 0.5 * motion.root_ang_vel_w[-2]) * motion.dt
    ahead_quat = quat_multiply(quat_from_rotvec(turn), last)
    repeated_quat = quat_multiply(quat_from_yaw(motion.cycle[2]), motion.root_quat_wxyz[0])
    angle = np.linalg.norm(rotvec_from_quat(quat_multiply(ahead_quat, quat_conjugate(repeated_quat))))
    return Closure(distance, float(np.degrees(angle)))


def _continued(last_three: Array) -> Array:
    """The next sample by constant acceleration."""
    a, b, c = last_three
    return a - 3 * b + 3 * c


def mean_speed(velocity_xy: Array, heading: Array) -> float:
    """Length of the mean velocity (t, 2) as seen from the trunk with `heading` (t,), m/s: unlike the path's length it
    does not grow with sway, and unlike the end-to-end distance it does not shrink in a turn."""
    return float(np.linalg.norm(rotate_planar(-heading, velocity_xy).mean(axis=0)))


def trunk_change(animal: TrunkTrack, robot: TrunkTrack) -> Array:
    """RMS change (6,) of the trunk's path about its mean: x, y, z in the heading frame, m; roll, pitch, yaw, rad."""
    planar = rotate_planar(-animal.heading, robot.root_xy - animal.root_xy)
    turned = (robot.heading - animal.heading)[:, None]
    change = np.concatenate([planar, (robot.root_z - animal.root_z)[:, None], robot.tilt - animal.tilt, turned], axis=1)
    return np.asarray(change.std(axis=0))


def support_shares(contact: NDArray[np.bool_]) -> tuple[float, ...]:
    """Share of the time with 0 to 4 feet on the ground."""
    return tuple(float(x) for x in np.bincount(contact.sum(axis=1), minlength=5) / len(contact))
