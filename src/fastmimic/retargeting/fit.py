"""Turns a track into a kinematic motion of the robot: feet planted, joints within their ranges."""

from dataclasses import dataclass, replace

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar
from fastmimic.motion.contacts import Stances, contact_mask
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.feet import plant_feet
from fastmimic.retargeting.pose import Pose, folding_rise, motion_of, solve_pose
from fastmimic.retargeting.reach import Reach, footholds
from fastmimic.retargeting.track import TrunkTrack
from fastmimic.robot import Robot


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted motion, without provenance, with its track and its pose. `raw_w` (t, 4, 3) are the animal's foot paths
    under that track, world; z is the height above the ground."""

    motion: Motion
    track: TrunkTrack
    raw_w: Array
    pose: Pose


@dataclass(frozen=True, eq=False)
class Fitter:
    """The constants of a fit: the animal's `track` at the robot's size, and the nominal base `height`, m."""

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
        return self.track.cycle is not None

    def fit(self, offset: Array) -> Fitted:
        """The motion with the feet shifted by `offset` (4, 2) against the robot's hips, m."""
        raw_w = self._animal_feet(offset)
        if not self.config.consistent:
            return self._with_feet(raw_w, raw_w + np.array([0.0, 0.0, self.robot.foot_radius]), 0.0)
        planted = self._planted(raw_w)
        if self.periodic:
            return self._with_feet(raw_w, planted, self.config.max_raising_m)
        rise = folding_rise(self.robot, self.track, planted, self.height, self.config, self.rate_hz)
        track = replace(self.track, root_z=self.track.root_z + rise)
        raised = replace(self, track=track, height=self.height + float(rise.mean()))
        return raised._with_feet(raw_w, raised._planted(raw_w), 0.0)

    def _with_feet(self, raw_w: Array, feet_w: Array, max_raising: float) -> Fitted:
        """The motion with its feet at (t, 4, 3), world, m."""
        pose = solve_pose(
            self.robot,
            self.track,
            feet_w,
            self.height,
            self.config,
            max_lowering=self.config.max_lowering_m,
            max_raising=max_raising,
        )
        contact = contact_mask(self.stances, len(self.track.root_z))
        return Fitted(motion_of(pose, self.track, contact, self.rate_hz), self.track, raw_w, pose)

    def _animal_feet(self, offset: Array) -> Array:
        """The animal's foot paths (t, 4, 3) under the robot's hips, world; z is the height above the ground."""
        track = self.track
        local = self.robot.hip_pos_b[:, :2] + offset + track.toe_from_hip
        xy = track.root_xy[:, None] + rotate_planar(track.heading[:, None], local)
        return np.concatenate([xy, track.toe_height[..., None]], axis=-1)

    def _planted(self, raw_w: Array) -> Array:
        linger = round(self.config.swing.linger_s * self.rate_hz)
        holds = footholds(raw_w, self.track, self.stances, self.reach, linger)
        highest, ground_z = self.reach.clearance, self.robot.foot_radius
        return plant_feet(raw_w, self.track, self.stances, holds, highest, ground_z, self.rate_hz, self.config.swing)
