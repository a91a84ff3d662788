"""A recording at the robot's size (`ScaledClip`; Peng et al. 2020, section IV), and as a continuous motion at the
control rate (`TrunkTrack`); a cycle is closed about its constant-twist motion.

Low-pass filter and resampling use the Fourier series of one period, so that a cycle closes in position, velocity and
acceleration. A recording that is not a cycle, less its end-to-end line, counts as half of an odd periodic signal (a
sine series), which keeps value and slope at both ends.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Indices
from fastmimic.base.rotations import (
    matrix_from_quat,
    planar_exp,
    planar_log,
    roll_pitch_from_quat,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.clips.clip import Clip
from fastmimic.motion.contacts import Stance, Stances
from fastmimic.motion.motion import Motion

_FILTER_ORDER: Final = 4


@dataclass(frozen=True, eq=False)
class ScaledClip:
    """Trunk pose and toes of a clip at the robot's scale, frame by frame."""

    rate_hz: float  # frames a second
    root_xy: Array  # (t, 2) middle of neck and pelvis, world, m
    root_z: Array  # (t,) its height above the ground on which the toes stand, m
    heading: Array  # (t,) rad, continuous
    tilt: Array  # (t, 2) roll and pitch, rad
    hip_height: float  # mean height of hips and shoulders above the ground, m
    toe_from_hip: Array  # (t, 4, 2) horizontal hip→toe vectors in the heading frame, m
    toe_height: Array  # (t, 4) above each leg's own ground, m
    toe_speed: Array  # (t, 4) horizontal, world, m/s

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


def resample_periodic(samples: Array, rate_hz: float, n_out: int, cutoff_hz: float) -> Array:
    """Low-passed samples (n_out, ...), evenly over one period, from (n, ...) at times i / rate_hz. `cutoff_hz` is the
    half-power frequency of the zero-phase filter (Butterworth, fourth order, forwards and backwards)."""
    n = len(samples)
    spectrum = np.fft.rfft(samples, axis=0)
    frequency = np.fft.rfftfreq(n, 1.0 / rate_hz)
    gain = 1.0 / (1.0 + (frequency / cutoff_hz) ** (2 * _FILTER_ORDER))
    if n % 2 == 0:
        gain[-1] = 0.0  # the phase of the Nyquist component is unknown
    spectrum = spectrum * gain.reshape(-1, *[1] * (samples.ndim - 1))
    return np.fft.irfft(spectrum[: n_out // 2 + 1], n=n_out, axis=0) * (n_out / n)


def resample_open(samples: Array, rate_hz: float, n_out: int, cutoff_hz: float) -> Array:
    """Like `resample_periodic` for a recording that is not a cycle: n frames cover (n − 1) / rate_hz."""
    n = len(samples)
    shape = (-1, *[1] * (samples.ndim - 1))
    line = samples[0] + (samples[-1] - samples[0]) * (np.arange(n) / (n - 1)).reshape(shape)
    rest = samples - line
    odd = np.concatenate([rest, -rest[-2:0:-1]])
    smooth = resample_periodic(odd, rate_hz, 2 * n_out, cutoff_hz)[:n_out]
    return smooth + samples[0] + (samples[-1] - samples[0]) * (np.arange(n_out) / n_out).reshape(shape)


def extrapolate_next(samples: Array) -> Array:
    """The frame after the last one of a cycle: its step is the mean of the steps before and after the seam."""
    return samples[-1] + 0.5 * ((samples[-1] - samples[-2]) + (samples[1] - samples[0]))


def closing_error(samples: Array) -> Array:
    """Difference (...) between the frame after the last one of (n, ...) and frame 0."""
    return extrapolate_next(samples) - samples[0]


@dataclass(frozen=True, eq=False)
class TrunkTrack:
    """Trunk and animal's foot paths on the output grid; the samples of a cycle repeat, moved by `cycle`."""

    root_xy: Array  # (t, 2) world, m
    root_z: Array  # (t,) world, m
    heading: Array  # (t,) rad, continuous
    tilt: Array  # (t, 2) roll and pitch, rad
    toe_from_hip: Array  # (t, 4, 2) in the heading frame, m
    toe_height: Array  # (t, 4) m
    cycle: Array | None  # (dx, dy, dyaw) in sample 0's heading frame, or None

    @classmethod
    def of(cls, motion: Motion) -> "TrunkTrack":
        """Of a robot's motion: `toe_from_hip` is from the root, `toe_height` of the feet's centres."""
        heading, feet = np.unwrap(yaw_from_quat(motion.root_quat_wxyz)), motion.foot_pos_w
        return cls(
            root_xy=np.array(motion.root_pos_w[:, :2]),
            root_z=np.array(motion.root_pos_w[:, 2]),
            heading=heading,
            tilt=np.column_stack(roll_pitch_from_quat(motion.root_quat_wxyz)),
            toe_from_hip=rotate_planar(-heading[:, None], feet[..., :2] - motion.root_pos_w[:, None, :2]),
            toe_height=feet[..., 2],
            cycle=None if motion.cycle is None else np.array(motion.cycle),
        )

    def heading_at(self, sample: Indices) -> Array:
        """Heading (k,) at samples (k,), also outside [0, n) of a cycle."""
        if self.cycle is None:
            return self.heading[sample]
        n = len(self.heading)
        return np.asarray(self.heading[sample % n] + (sample // n) * self.cycle[2])

    def moved(self, points_w: Array, cycles: int) -> Array:
        """World points (..., 2) moved by a number of cycles, backwards if negative."""
        assert self.cycle is not None, "a motion without a cycle does not repeat"
        origin, angle = self.root_xy[0], self.cycle[2]
        step = rotate_planar(self.heading[0], self.cycle[:2])
        for _ in range(abs(cycles)):
            if cycles > 0:
                points_w = origin + step + rotate_planar(angle, points_w - origin)
            else:
                points_w = origin + rotate_planar(-angle, points_w - origin - step)
        return points_w

    def at_twist(self, twist: Array, steps: Array, hips_b: Array) -> "TrunkTrack":
        """A cycle that moves by `twist` (3,) instead of its own: forwards, to the left, m, turning, rad, in a period.
        Each foot's path goes on as its `steps` (t, 4) from `step_times` do; `hips_b` (4, 2) are the feet's origins, m.

        What the trunk does about its mean motion stays, and the feet under it in the middle of their stances: both are
        taken from the frame that moves with the own mean twist, exp(share · ξ), to that which moves with the new one.
        """
        assert self.cycle is not None, "a motion without a cycle has no mean twist"
        n, own = len(self.heading), planar_log(self.cycle)
        share = np.arange(n) / n
        ahead = float(np.mean(self.heading - own[2] * share))
        own[:2] = rotate_planar(self.heading[0] - ahead, own[:2])

        def moved(points_w: Array, share: Array) -> Array:
            (before, angle), (after, turned) = planar_exp(own, share), planar_exp(twist, share)
            local = rotate_planar(-ahead - angle, points_w - self.root_xy[0]) - rotate_planar(-angle, before)
            return self.root_xy[0] + rotate_planar(ahead, after + rotate_planar(turned, local))

        feet = self.root_xy[:, None] + rotate_planar(self.heading[:, None], hips_b + self.toe_from_hip)
        root, heading = moved(self.root_xy, share), self.heading + (twist[2] - own[2]) * share
        toes = rotate_planar(-heading[:, None], moved(feet, steps / n) - root[:, None]) - hips_b
        way = rotate_planar(ahead - self.heading[0], planar_exp(twist, np.ones(()))[0])
        return replace(self, root_xy=root, heading=heading, toe_from_hip=toes, cycle=np.append(way, twist[2]))


def step_times(stances: Stances, n: int) -> Array:
    """How far the feet of a cycle of `n` samples are on their way (n, 4), samples: while one stands the middle of its
    stance; while it swings from that to the next, from rest to rest."""
    times = np.tile(np.arange(n, dtype=float)[:, None], 4)
    for leg, spans in enumerate(stances):
        later = [*spans[1:], *(Stance(first.touch_down + n, first.lift_off + n) for first in spans[:1])]
        for now, then in zip(spans, later, strict=True):
            index = np.arange(now.touch_down, then.touch_down)
            share = np.clip((index + 1 - now.lift_off) / (then.touch_down + 1 - now.lift_off), 0.0, 1.0)
            middle, going = 0.5 * (now.touch_down + now.lift_off), share**3 * (10 - 15 * share + 6 * share**2)
            step = 0.5 * (then.touch_down + then.lift_off) - middle
            times[index % n, leg] = middle + going * step - index // n * n
    return times


def steps(xy: Array, heading: Array, cycle: Array | None) -> tuple[Array, Array]:
    """To the next sample: the root's step (t, 2) in the heading frame, m, and the heading's turn (t,), rad. The last
    ones lead to the first sample of the next cycle; without a cycle they repeat the previous ones."""
    if cycle is not None:
        end = xy[0] + rotate_planar(float(heading[0]), cycle[:2])
        whole = heading[0] + cycle[2]
        whole += 2 * np.pi * np.round((heading[-1] - whole) / (2 * np.pi))  # the last step is a small one
    else:
        end, whole = 2 * xy[-1] - xy[-2], 2 * heading[-1] - heading[-2]
    step = rotate_planar(-heading, np.diff(np.concatenate([xy, end[None]]), axis=0))
    return step, np.diff(np.append(heading, whole))


class WorldPath:
    """A path (n, 3) in the world that can be read and written beyond the seam of a cycle."""

    def __init__(self, samples: Array, track: TrunkTrack) -> None:
        self.samples = samples.copy()
        self.track = track
        self.n = len(samples)
        self.periodic = track.cycle is not None

    def read(self, index: Indices) -> Array:
        """Points (k, 3) at samples (k,), also outside [0, n) of a cycle."""
        if not self.periodic:
            return self.samples[index]
        points = self.samples[index % self.n].copy()
        self._move(points, index // self.n, 1)
        return points

    def write(self, index: Indices, points: Array) -> None:
        """Sets points (k, 3) at samples (k,)."""
        points = points.copy()
        if self.periodic:
            self._move(points, index // self.n, -1)
            index = index % self.n
        self.samples[index] = points

    def _move(self, points: Array, cycle_index: Indices, sign: int) -> None:
        for k in np.unique(cycle_index):
            if k != 0:
                points[cycle_index == k, :2] = self.track.moved(points[cycle_index == k, :2], sign * int(k))


def cycle_displacement(source: ScaledClip) -> Array:
    """(dx, dy, dyaw) of one period of a clip, in frame 0's heading frame; frame t would repeat frame 0."""
    steps = rotate_planar(-source.heading[:-1], np.diff(source.root_xy, axis=0))
    last = rotate_planar(source.heading[-1], 0.5 * (steps[0] + steps[-1]))
    displacement = source.root_xy[-1] + last - source.root_xy[0]
    dx, dy = rotate_planar(-source.heading[0], displacement)
    return np.array([dx, dy, extrapolate_next(source.heading) - source.heading[0]])


def pose_mismatch(source: ScaledClip) -> float:
    """Distance of the frame after the last from frame 0, relative to the spread of poses within the clip: 0 for a cycle
    that closes, about 1.4 for unrelated frames. A pose is feet against hips and the heights of feet and root, m."""
    n = len(source.root_z)
    pose = np.concatenate([source.toe_from_hip.reshape(n, -1), source.toe_height, source.root_z[:, None]], axis=1)
    spread = np.sqrt(np.sum(np.var(pose, axis=0)))
    return float(np.linalg.norm(closing_error(pose)) / max(spread, 1e-6))


def track_of(source: ScaledClip, n_out: int, trunk_hz: float, foot_hz: float, displacement: Array | None) -> TrunkTrack:
    """A recording on `n_out` samples, low-passed; a cycle that moves by its `displacement` (3,) is closed as well.

    Planar motion of a cycle is taken in the moving frame of the constant-twist motion exp(share · log(dx, dy, dyaw)),
    where a cycle is periodic whether it turns or not. The closing error is spread evenly over the cycle, and the
    Fourier series closes position, velocity and acceleration.
    """
    n, start, yaw0 = len(source.root_xy), source.root_xy[0], source.heading[0]
    root_xy, heading, cycle = source.root_xy, source.heading, displacement

    def frame(share: Array, twist: Array) -> tuple[Array, Array]:
        offset, angle = planar_exp(twist, share)
        return start + rotate_planar(yaw0, offset), yaw0 + angle

    def smooth(values: Array, cutoff_hz: float) -> Array:
        if displacement is None:
            return resample_open(values, source.rate_hz, n_out, cutoff_hz)
        share = (np.arange(n) / n - 0.5).reshape(-1, *[1] * (values.ndim - 1))
        return resample_periodic(values - share * closing_error(values), source.rate_hz, n_out, cutoff_hz)

    if displacement is None:
        root_xy, heading = smooth(root_xy, trunk_hz), smooth(heading, trunk_hz)
    else:
        twist = planar_log(displacement)
        origin, angle = frame(np.arange(n) / n, twist)
        local_xy = smooth(rotate_planar(-angle, root_xy - origin), trunk_hz)
        local_yaw = smooth(heading - angle, trunk_hz)
        origin, angle = frame(np.arange(n_out) / n_out, twist)
        root_xy, heading = origin + rotate_planar(angle, local_xy), angle + local_yaw
        end, end_angle = frame(np.ones(()), twist)
        way = end + rotate_planar(end_angle, local_xy[0]) - root_xy[0]
        cycle = np.array([*rotate_planar(-heading[0], way), displacement[2]])
    return TrunkTrack(
        root_xy=root_xy,
        root_z=smooth(source.root_z, trunk_hz),
        heading=heading,
        tilt=smooth(source.tilt, trunk_hz),
        toe_from_hip=smooth(source.toe_from_hip, foot_hz),
        toe_height=np.maximum(smooth(source.toe_height, foot_hz), 0.0),
        cycle=cycle,
    )
