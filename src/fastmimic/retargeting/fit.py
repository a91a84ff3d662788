"""Turns a track into a consistent motion: a trunk that the standing feet can carry, and joints within their limits.
Retargeting (`Fitter`), stitching and changes of tempo share the steps of `Consistency`; their feet differ."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar
from fastmimic.motion.contacts import Stances, contact_mask
from fastmimic.motion.ground import GroundDemand, ground_demand
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.balance import TrunkSpline, balance
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.feet import plant_feet
from fastmimic.retargeting.pose import Pose, folding_rise, joint_velocity, motion_of, pose_at, solve_pose
from fastmimic.retargeting.reach import Reach, footholds
from fastmimic.retargeting.track import TrunkTrack
from fastmimic.robot import Robot

EVENNESS: Final = (0.1, 0.4, 1.6, 6.4)
"""Values of `SwingPathConfig.evenness`, tried in this order for a leg with joints that are too fast or at a limit. A
swing of steady speed also reaches less far ahead before it lands."""


@dataclass(frozen=True, eq=False)
class Consistency:
    """The constants of making a motion consistent: the trunk to start from, and the contacts (n, 4)."""

    robot: Robot
    track: TrunkTrack
    contact: NDArray[np.bool_]
    rate_hz: float
    config: RetargetConfig

    def balanced(self, moved: Callable[[Array], tuple[TrunkTrack, Array]], height: float) -> Array:
        """The least deviation (n, 6) of the trunk that the standing feet can carry. Without a cycle it vanishes at both
        ends, because a trunk that is free to move there falls. `moved` gives the trunk and the feet (n, 4, 3), world,
        m, for a deviation of `track`; `height` is the nominal base height, m."""
        n, hz = len(self.contact), self.config.balance.hz
        spline = TrunkSpline(n, self.rate_hz, self.track.cycle is not None, hz)
        sample = np.arange(0, n, max(1, round(self.config.balance.sample_s * self.rate_hz)))

        def demand_of(coefficients: Array) -> GroundDemand:
            track, feet_w = moved(spline.values(coefficients))
            pose = pose_at(self.robot, track, feet_w, height)
            return ground_demand(self.robot, self.motion(pose, track), sample)

        return spline.values(balance(self.robot, spline, demand_of, self.config.balance))

    def balanced_over(self, feet_w: Array) -> TrunkTrack:
        """The balanced trunk over fixed feet (n, 4, 3), world, m."""
        deviation = self.balanced(lambda d: (self.track.deviated(d), feet_w), float(self.track.root_z.mean()))
        return self.track.deviated(deviation)

    def attempts(
        self, solve: Callable[[Array], Pose], beyond: Callable[[Pose], NDArray[np.int_]]
    ) -> Iterator[tuple[Pose, NDArray[np.int_]]]:
        """Yields poses, with ever more even swings of legs beyond a limit, and each leg's samples (4,) beyond one.
        `solve` gives the pose for an evenness (4,) of each leg's swings, `beyond` its samples (4,) beyond a limit."""
        evenness = np.full(4, self.config.swing.evenness)
        for more in (*EVENNESS, None):
            pose = solve(evenness)
            samples = beyond(pose)
            yield pose, samples
            if more is None or not samples.any():
                return
            evenness[samples > 0] = more

    def motion(self, pose: Pose, track: TrunkTrack) -> Motion:
        """The motion of a pose with these contacts."""
        return motion_of(pose, track, self.contact, self.rate_hz)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted motion, without provenance, with its trunk after balancing and its pose. `raw_w` (t, 4, 3) are the
    animal's foot paths under that trunk, world; z is the height above the ground. `smoothed` counts how many times each
    leg's swings were made more even to keep joint speeds."""

    motion: Motion
    track: TrunkTrack
    raw_w: Array
    pose: Pose
    smoothed: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Fitter:
    """The constants of a fit: the animal's `track` at the robot's size, and the nominal base `height`, m."""

    robot: Robot
    track: TrunkTrack
    stances: Stances
    height: float
    rate_hz: float
    config: RetargetConfig

    @cached_property
    def consistency(self) -> Consistency:
        """The steps shared with stitching."""
        contact = contact_mask(self.stances, len(self.track.root_z))
        return Consistency(self.robot, self.track, contact, self.rate_hz, self.config)

    @property
    def reach(self) -> Reach:
        """Of the legs at the nominal height."""
        return Reach.of_robot(self.robot, self.height, self.config.reach_margin_rad)

    @property
    def periodic(self) -> bool:
        return self.track.cycle is not None

    def fit(self, offset: Array) -> Fitted:
        """The motion with the feet shifted by `offset` (4, 2) against the robot's hips, m."""
        if not self.config.consistent:
            return self._as_scaled(self._animal_feet(offset))
        if not self.periodic:
            return self._unfolded(offset)._fit(offset, 0.0)
        return self._fit(offset, self.config.max_raising_m)

    def _unfolded(self, offset: Array) -> "Fitter":
        """The fitter with the trunk raised only where folded legs need it."""
        raw_w = self._animal_feet(offset)
        feet_w = self._planted(raw_w, self._footholds(raw_w, self.track), None)
        rise = folding_rise(self.robot, self.track, feet_w, self.height, self.config, self.rate_hz)
        track = replace(self.track, root_z=self.track.root_z + rise)
        return replace(self, track=track, height=self.height + float(rise.mean()))

    def _fit(self, offset: Array, max_raising: float) -> Fitted:
        track, raw_w = self._balanced(self._animal_feet(offset))
        holds = self._footholds(raw_w, track)
        limit = self.config.speed_share * self.robot.joint_speed_limit

        def solve(evenness: Array) -> Pose:
            return self._pose(track, self._planted(raw_w, holds, evenness), max_raising)

        def too_fast(pose: Pose) -> NDArray[np.int_]:
            speed = np.abs(joint_velocity(pose.joint_pos, self.rate_hz, self.periodic))
            return (speed > limit).reshape(-1, 4, 3).sum(axis=(0, 2))

        *earlier, (pose, _) = self.consistency.attempts(solve, too_fast)
        smoothed = np.sum([samples > 0 for _, samples in earlier], axis=0, dtype=int) * np.ones(4, dtype=int)
        return Fitted(self.consistency.motion(pose, track), track, raw_w, pose, tuple(smoothed.tolist()))

    def _as_scaled(self, raw_w: Array) -> Fitted:
        """The robot on the animal's unchanged foot paths."""
        feet_w = raw_w + np.array([0.0, 0.0, self.robot.foot_radius])
        pose = self._pose(self.track, feet_w, 0.0)
        return Fitted(self.consistency.motion(pose, self.track), self.track, raw_w, pose, (0, 0, 0, 0))

    def _pose(self, track: TrunkTrack, feet_w: Array, max_raising: float) -> Pose:
        lowering = self.config.max_lowering_m
        return solve_pose(
            self.robot, track, feet_w, self.height, self.config, max_lowering=lowering, max_raising=max_raising
        )

    def _animal_feet(self, offset: Array) -> Array:
        """The animal's foot paths (t, 4, 3) under the robot's hips, world; z is the height above the ground."""
        track = self.track
        local = self.robot.hip_pos_b[:, :2] + offset + track.toe_from_hip
        xy = track.root_xy[:, None] + rotate_planar(track.heading[:, None], local)
        return np.concatenate([xy, track.toe_height[..., None]], axis=-1)

    def _balanced(self, raw_w: Array) -> tuple[TrunkTrack, Array]:
        """The trunk as the standing feet can move it, and the foot paths shifted under it."""

        def applied(deviation: Array) -> tuple[TrunkTrack, Array]:
            # the feet take a constant shift of the trunk over them, which would change a turning robot's speed
            shift = deviation[:, :2].mean(axis=0)
            deviation[:, :2] -= shift
            moved_w = raw_w.copy()
            shifts = rotate_planar(self.track.heading, np.broadcast_to(shift, (len(raw_w), 2)))
            moved_w[..., :2] -= shifts[:, None]
            return self.track.deviated(deviation), moved_w

        def moved(deviation: Array) -> tuple[TrunkTrack, Array]:
            track, moved_w = applied(deviation)
            return track, self._planted(moved_w, self._footholds(moved_w, self.track), None)

        return applied(self.consistency.balanced(moved, self.height))

    def _footholds(self, raw_w: Array, track: TrunkTrack) -> list[list[Array]]:
        linger = round(self.config.swing.linger_s * self.rate_hz)
        return footholds(raw_w, track, self.stances, self.reach, linger)

    def _planted(self, raw_w: Array, holds: list[list[Array]], evenness: Array | None) -> Array:
        highest, ground_z, swing = self.reach.clearance, self.robot.foot_radius, self.config.swing
        return plant_feet(raw_w, self.track, self.stances, holds, highest, ground_z, self.rate_hz, swing, evenness)
