"""From a track of the animal to a motion of the robot: balance the trunk, plant the feet, keep the limits."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar
from fastmimic.motion.contacts import Stances, contact_mask
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.balance import balance
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.cycle import TrunkTrack
from fastmimic.retargeting.dynamics import GroundDemand, ground_demand
from fastmimic.retargeting.feet import plant_feet
from fastmimic.retargeting.pose import Pose, folding_rise, joint_velocity, root_velocity, solve_pose, unlimited_pose
from fastmimic.retargeting.reach import Reach, footholds
from fastmimic.retargeting.spline import InnerSpline, TrunkSpline
from fastmimic.robot import Robot

_EVENNESS: Final = (0.1, 0.4, 1.6, 6.4)
"""Of the swings of a leg whose joints are too fast, tried one after the other."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted motion and what led to it.

    Attributes:
        motion: the robot's, without provenance.
        track: the trunk after balancing.
        raw_w: (t, 4, 3) the animal's foot paths under that trunk, world; z is the height above the ground.
        pose: clamps and base height.
        smoothed: times that each leg's swings were made more even to keep joint speed.
    """

    motion: Motion
    track: TrunkTrack
    raw_w: Array
    pose: Pose
    smoothed: tuple[int, int, int, int]


@dataclass(frozen=True, eq=False)
class Fitter:
    """What stays the same while a motion is fitted.

    Attributes:
        robot: geometry, limits, inertia.
        track: the animal's trunk and toes at the robot's size.
        stances: of each leg.
        height: nominal height of the base, m.
        rate_hz: of the samples.
        config: settings.
    """

    robot: Robot
    track: TrunkTrack
    stances: Stances
    height: float
    rate_hz: float
    config: RetargetConfig

    @property
    def reach(self) -> Reach:
        """Of the legs at the nominal height."""
        return Reach.of_robot(self.robot, self.height, self.config.reach_margin_rad)

    @property
    def periodic(self) -> bool:
        """Whether the track is a cycle."""
        return self.track.cycle is not None

    def fit(self, offset: Array) -> Fitted:
        """The motion with the feet shifted by `offset` (4, 2) against the robot's hips, m."""
        if not self.config.consistent:
            return self._as_scaled(self._animal_feet(offset))
        if not self.periodic:
            return self._unfolded(offset)._fit(offset, 0.0)
        return self._fit(offset, self.config.max_raising_m)

    def _unfolded(self, offset: Array) -> "Fitter":
        """With the trunk raised where, and only where, folded legs need it."""
        raw_w = self._animal_feet(offset)
        feet_w = self._planted(raw_w, self._footholds(raw_w, self.track), None)
        margin, highest = self.config.limit_margin_rad, self.config.max_raising_m
        rise = folding_rise(self.robot, self.track, feet_w, self.height, highest, margin, self.rate_hz)
        track = replace(self.track, root_z=self.track.root_z + rise)
        return replace(self, track=track, height=self.height + float(rise.mean()))

    def _fit(self, offset: Array, max_raising: float) -> Fitted:
        track, raw_w = self._balanced(self._animal_feet(offset))
        holds = self._footholds(raw_w, track)
        limit = self.config.speed_share * self.robot.joint_speed_limit
        evenness, times = np.full(4, self.config.swing.evenness), np.zeros(4, dtype=int)
        for more in (*_EVENNESS, None):
            feet_w = self._planted(raw_w, holds, tuple(evenness))
            pose = self._pose(track, feet_w, max_raising)
            speed = np.abs(joint_velocity(pose.joint_pos, self.rate_hz, self.periodic))
            too_fast = (speed > limit).reshape(-1, 4, 3).any(axis=(0, 2))
            if more is None or not too_fast.any():
                break
            evenness[too_fast] = more
            times += too_fast
        smoothed = (int(times[0]), int(times[1]), int(times[2]), int(times[3]))
        return Fitted(self._motion(pose, track), track, raw_w, pose, smoothed)

    def _as_scaled(self, raw_w: Array) -> Fitted:
        """The robot on the animal's foot paths as they are."""
        feet_w = raw_w + np.array([0.0, 0.0, self.robot.foot_radius])
        pose = self._pose(self.track, feet_w, 0.0)
        return Fitted(self._motion(pose, self.track), self.track, raw_w, pose, (0, 0, 0, 0))

    def _pose(self, track: TrunkTrack, feet_w: Array, max_raising: float) -> Pose:
        lowering, margin = self.config.max_lowering_m, self.config.limit_margin_rad
        return solve_pose(self.robot, track, feet_w, self.height, lowering, max_raising, margin)

    def _animal_feet(self, offset: Array) -> Array:
        """The animal's foot paths (t, 4, 3) under the robot's hips, world; z is the height above the ground."""
        track = self.track
        local = self.robot.hip_pos_b[:, :2] + offset + track.toe_from_hip
        xy = track.root_xy[:, None] + rotate_planar(track.heading[:, None], local)
        return np.concatenate([xy, track.toe_height[..., None]], axis=-1)

    def _balanced(self, raw_w: Array) -> tuple[TrunkTrack, Array]:
        """The trunk as the standing feet can move it, and the foot paths shifted under it."""
        n = len(raw_w)
        # how a recording that does not repeat begins and ends is its own: a trunk that is free to move there falls
        hz = self.config.balance.hz
        spline = TrunkSpline(n, self.rate_hz, True, hz) if self.periodic else InnerSpline(n, self.rate_hz, hz)
        sample = np.arange(0, n, max(1, round(self.config.balance.sample_s * self.rate_hz)))

        def applied(coefficients: Array) -> tuple[TrunkTrack, Array]:
            # a constant shift of the trunk over its feet is given to the feet: a turning robot would travel at
            # another speed
            deviation = spline.values(coefficients)
            shift = deviation[:, :2].mean(axis=0)
            deviation[:, :2] -= shift
            moved_w = raw_w.copy()
            moved_w[..., :2] -= rotate_planar(self.track.heading, np.broadcast_to(shift, (n, 2)))[:, None]
            return self.track.deviated(deviation), moved_w

        def demand_of(coefficients: Array) -> GroundDemand:
            track, moved_w = applied(coefficients)
            feet_w = self._planted(moved_w, self._footholds(moved_w, self.track), None)
            pose = unlimited_pose(self.robot, track, feet_w, self.height)
            return ground_demand(self.robot, self._motion(pose, track), sample)

        return applied(balance(self.robot, spline, demand_of, self.config.balance))

    def _footholds(self, raw_w: Array, track: TrunkTrack) -> list[list[Array]]:
        linger = round(self.config.swing.linger_s * self.rate_hz)
        return footholds(raw_w, track, self.stances, self.reach, linger)

    def _planted(self, raw_w: Array, holds: list[list[Array]], evenness: tuple[float, ...] | None) -> Array:
        return plant_feet(
            raw_w,
            self.track,
            self.stances,
            holds,
            self.reach.clearance,
            self.robot.foot_radius,
            self.rate_hz,
            self.config.swing,
            evenness,
        )

    def _motion(self, pose: Pose, track: TrunkTrack) -> Motion:
        linear, angular = root_velocity(pose, track, self.rate_hz)
        return Motion(
            rate_hz=self.rate_hz,
            root_pos_w=pose.root_pos_w,
            root_quat_wxyz=pose.root_quat_wxyz,
            joint_pos=pose.joint_pos,
            joint_vel=joint_velocity(pose.joint_pos, self.rate_hz, self.periodic),
            foot_pos_b=pose.foot_pos_b,
            contact=contact_mask(self.stances, len(pose.joint_pos)),
            root_lin_vel_w=linear,
            root_ang_vel_w=angular,
            cycle=track.cycle,
        )
