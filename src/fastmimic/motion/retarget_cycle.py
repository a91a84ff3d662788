"""A recording as a continuous motion: closed as a cycle about its constant-twist motion, or as it is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.motion.retarget_signal import close, extrapolate_next, resample_open, resample_periodic
from fastmimic.motion.retarget_source import Source
from fastmimic.rotations import rotate_planar

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Track:
    """Trunk and raw foot paths on the output grid; a cycle's samples repeat moved by `cycle`.

    Attributes:
        rate_hz: of the samples, exactly n / period.
        root_xy: (t, 2) world, m.
        root_z: (t,) m.
        heading: (t,) rad, continuous.
        tilt: (t, 2) roll and pitch, rad.
        toe_from_hip: (t, 4, 2) in the heading frame, m.
        toe_height: (t, 4) m.
        cycle: (dx, dy, dyaw) in sample 0's heading frame, or None.
        closure_error: largest foot position error (m) and yaw-free trunk error (m) that closing removed.
    """

    root_xy: Array
    root_z: Array
    heading: Array
    tilt: Array
    toe_from_hip: Array
    toe_height: Array
    cycle: Array | None

    def moved(self, points_w: Array, cycles: int) -> Array:
        """Points (..., 2) of the world one or several cycles later (earlier if negative)."""
        if self.cycle is None:
            raise ValueError("not a cycle")
        origin, angle = self.root_xy[0], self.cycle[2]
        step = rotate_planar(self.heading[0], self.cycle[:2])
        for _ in range(abs(cycles)):
            if cycles > 0:
                points_w = origin + step + rotate_planar(angle, points_w - origin)
            else:
                points_w = origin + rotate_planar(-angle, points_w - origin - step)
        return points_w


def planar_exp(twist: Array, share: Array) -> tuple[Array, Array]:
    """Displacement (..., 2) and rotation (...) after `share` (...) of the planar twist (vx, vy, ω)."""
    angle = share * twist[2]
    a, b = np.sinc(angle / np.pi), angle / 2 * np.sinc(angle / (2 * np.pi)) ** 2
    x, y = share * twist[0], share * twist[1]
    return np.stack([a * x - b * y, b * x + a * y], axis=-1), angle


def planar_log(cycle: Array) -> Array:
    """The twist (vx, vy, ω) whose exponential is the planar displacement (dx, dy, dyaw)."""
    angle = cycle[2]
    a, b = np.sinc(angle / np.pi), angle / 2 * np.sinc(angle / (2 * np.pi)) ** 2
    x, y = cycle[:2]
    return np.array([a * x + b * y, -b * x + a * y, angle * (a * a + b * b)]) / (a * a + b * b)


def cycle_displacement(source: Source) -> Array:
    """(dx, dy, dyaw) of one period of a clip whose frame t would repeat frame 0, in frame 0's heading frame."""
    heading_end = extrapolate_next(source.heading)
    # the missing step is extrapolated in the heading frame, so that a turning clip keeps turning
    steps = rotate_planar(-source.heading[:-1], np.diff(source.root_xy, axis=0))
    last = rotate_planar(source.heading[-1], 0.5 * (steps[0] + steps[-1]))
    displacement = source.root_xy[-1] + last - source.root_xy[0]
    dx, dy = rotate_planar(-source.heading[0], displacement)
    return np.array([dx, dy, heading_end - source.heading[0]])


def track_cycle(source: Source, n_out: int, trunk_hz: float, foot_hz: float) -> Track:
    """Closes a cycle and resamples it to `n_out` samples."""
    n = len(source.root_xy)
    cycle = cycle_displacement(source)
    twist = planar_log(cycle)
    start, yaw0 = source.root_xy[0], source.heading[0]

    def frame(share: Array) -> tuple[Array, Array]:
        offset, angle = planar_exp(twist, share)
        return start + rotate_planar(yaw0, offset), yaw0 + angle

    origin, angle = frame(np.arange(n) / n)
    local_xy = rotate_planar(-angle, source.root_xy - origin)
    local_yaw = source.heading - angle

    def smooth(values: Array, cutoff: float) -> Array:
        return resample_periodic(close(values)[0], source.rate_hz, n_out, cutoff)

    origin, angle = frame(np.arange(n_out) / n_out)
    heading = angle + smooth(local_yaw, trunk_hz)
    root_xy = origin + rotate_planar(angle, smooth(local_xy, trunk_hz))
    # the displacement is given in sample 0's heading frame, and sample 0 has moved a little in closing and smoothing
    end_offset, end_angle = frame(np.float64(1.0))
    first = rotate_planar(-yaw0, root_xy[0] - start)
    end = end_offset + rotate_planar(end_angle, first)
    moved = rotate_planar(-heading[0], end - root_xy[0])
    return Track(
        root_xy=root_xy,
        root_z=smooth(source.root_z, trunk_hz),
        heading=heading,
        tilt=smooth(source.tilt, trunk_hz),
        toe_from_hip=smooth(source.toe_from_hip, foot_hz),
        toe_height=smooth(source.toe_height, foot_hz),
        cycle=np.array([moved[0], moved[1], cycle[2]]),
    )


def track_open(source: Source, n_out: int, trunk_hz: float, foot_hz: float) -> Track:
    """Resamples a recording that is not a cycle to `n_out` samples."""

    def smooth(values: Array, cutoff: float) -> Array:
        return resample_open(values, source.rate_hz, n_out, cutoff)

    return Track(
        root_xy=smooth(source.root_xy, trunk_hz),
        root_z=smooth(source.root_z, trunk_hz),
        heading=smooth(source.heading, trunk_hz),
        tilt=smooth(source.tilt, trunk_hz),
        toe_from_hip=smooth(source.toe_from_hip, foot_hz),
        toe_height=smooth(source.toe_height, foot_hz),
        cycle=None,
    )
