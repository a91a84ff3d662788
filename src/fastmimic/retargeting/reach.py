"""The reach of a robot's legs, and footholds within it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEFT
from fastmimic.base.rotations import rotate_planar
from fastmimic.motion.contacts import Stances, contact_mask
from fastmimic.retargeting.track import TrunkTrack, WorldPath
from fastmimic.robot import Robot

_STEP = 5  # samples between two checks of reach


@dataclass(frozen=True, eq=False)
class Reach:
    """Reach of the legs with the base at its nominal height.

    Attributes:
        hip_height: of the abduction axes above the centres of standing feet, m.
        longest, shortest: leg in its plane within the knees' limits, m.
        hips: (4, 2) abduction joint origins in the heading frame, m.
        lateral_offset: (4,) from there to the leg's plane, m.
        abduction: largest inward angle, rad.
    """

    hip_height: float
    longest: float
    shortest: float
    hips: Array
    lateral_offset: Array
    abduction: float

    @classmethod
    def of_robot(cls, robot: Robot, base_height: float, margin_rad: float) -> "Reach":
        """With knees and abduction joints `margin_rad` inside their limits."""
        a, b = robot.thigh_length, robot.calf_length
        knees = np.stack([robot.joint_lower[2::3] + margin_rad, robot.joint_upper[2::3] - margin_rad])
        lengths = np.sqrt(a * a + b * b + 2 * a * b * np.cos(knees))
        inward = np.where(LEFT, -robot.joint_lower[0::3], robot.joint_upper[0::3])
        return cls(
            hip_height=base_height + float(robot.hip_pos_b[:, 2].mean()) - robot.foot_radius,
            longest=float(lengths.max(axis=0).min()),
            shortest=float(lengths.min(axis=0).max()),
            hips=robot.hip_pos_b[:, :2],
            lateral_offset=np.asarray(robot.lateral_offset),
            abduction=float(inward.min()) - margin_rad,
        )

    @property
    def clearance(self) -> float:
        """Largest height of a foot under its hip, m."""
        return self.hip_height - self.shortest

    def forward(self, leg: int, lateral: Array, drop: Array) -> Array:
        """Largest distance (k,) of a foot ahead of its hip, at `lateral` and `drop` (k,) from the abduction axis, m."""
        square = self.longest**2 - drop**2 - lateral**2 + self.lateral_offset[leg] ** 2
        return np.sqrt(np.maximum(square, 0.0))

    def inward(self, leg: int, drop: Array) -> Array:
        """Largest distance (k,), m, of a foot inwards of its abduction axis, `drop` (k,) below it, m."""
        a, d = self.abduction, abs(float(self.lateral_offset[leg]))
        along = (drop - d * np.sin(a)) / np.cos(a)
        return np.asarray(along * np.sin(a) - d * np.cos(a))

    def longest_stance(self, speed: float, linger_s: float) -> float:
        """Longest stance, s, within the leg's reach at a speed of travel, m/s."""
        drop = np.array([self.hip_height])
        sweep = 2 * min(float(self.forward(leg, self.lateral_offset[[leg]], drop)[0]) for leg in range(4))
        return sweep / max(speed, 1e-3) - 2 * linger_s


def foot_offsets(robot: Robot, track: TrunkTrack, stances: Stances, stance_width: float) -> Array:
    """Constant shifts (4, 2) of the feet against the robot's hips, m.

    The positions of shoulder, hip and toe markers belong to the animal's build, not to its motion. The mean footholds
    are shifted fore-aft under the centre of mass, and laterally to `stance_width` outside the abduction axis (a share
    of the lateral link). Left and right shift alike.
    """
    side = np.where(LEFT, 1.0, -1.0)
    stands = contact_mask(stances, len(track.root_z))
    mean = np.zeros((4, 2))
    for leg in range(4):
        if stands[:, leg].any():
            mean[leg] = track.toe_from_hip[stands[:, leg], leg].mean(axis=0)
    outward = np.repeat((side * mean[:, 1]).reshape(2, 2).mean(axis=1), 2)
    forward = robot.com_b[0] - robot.hip_pos_b[:, 0].mean() - mean[:, 0].mean()
    width = stance_width * np.abs(robot.lateral_offset)
    return np.stack([np.full(4, forward), side * (width - outward)], axis=-1)


def footholds(raw_w: Array, track: TrunkTrack, stances: Stances, reach: Reach, linger: int) -> list[list[Array]]:
    """The foothold (2,), world, m, of each stance of each foot. It is the mean of the animal's path in stance, weighted
    towards mid-stance, and moved into reach from touch-down to lift-off. `raw_w` (n, 4, 3) are the animal's foot paths,
    world, m. The foot must also be in reach for `linger` samples before and after the stance."""
    sway = np.concatenate([track.root_xy, track.root_z[:, None] - track.root_z.mean()], axis=1)
    trunk = WorldPath(sway, track)
    result = []
    for leg, spans in enumerate(stances):
        path = WorldPath(raw_w[:, leg], track)
        holds = []
        for span in spans:
            last = span.lift_off + linger
            when = np.append(np.arange(span.touch_down - linger, last, _STEP), last)
            if not path.periodic:
                when = np.clip(when, 0, path.n - 1)
            raw = path.read(np.arange(*span))
            weight = np.sin(np.pi * (np.arange(len(raw)) + 0.5) / len(raw)) ** 2
            hold = np.asarray(weight @ raw[:, :2] / weight.sum())
            holds.append(hold + _into_reach(hold, leg, trunk.read(when), track, when, reach))
        result.append(holds)
    return result


def _into_reach(hold: Array, leg: int, trunk: Array, track: TrunkTrack, when: NDArray[np.int_], reach: Reach) -> Array:
    """The displacement (2,), world, that brings a foothold into reach of a trunk (k, 3): x, y, z above its mean."""
    heading = track.heading_at(when)
    local = rotate_planar(-heading, hold - trunk[:, :2]) - reach.hips[leg]
    roll, pitch = track.tilt[when % len(track.tilt)].T
    x, y = reach.hips[leg]
    drop = reach.hip_height + trunk[:, 2] - np.sin(pitch) * x + np.sin(roll) * y
    side = np.sign(reach.lateral_offset[leg])
    sideways = side * max(0.0, float((-reach.inward(leg, drop) - side * local[:, 1]).max()))
    limit = reach.forward(leg, local[:, 1] + sideways, drop)
    lowest, highest = float((-limit - local[:, 0]).max()), float((limit - local[:, 0]).min())
    forward = 0.5 * (lowest + highest) if lowest > highest else float(np.clip(0.0, lowest, highest))
    return rotate_planar(heading[len(heading) // 2], np.array([forward, sideways]))
