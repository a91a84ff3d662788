"""Makes a motion consistent: a trunk that the standing feet can carry, and joints within their limits. Retargeting,
stitching and changes of tempo share these steps and differ in the position of the feet."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.motion.ground import GroundDemand, ground_demand
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.balance import balance
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.cycle import TrunkTrack
from fastmimic.retargeting.pose import Pose, motion_of, unlimited_pose
from fastmimic.retargeting.spline import InnerSpline, TrunkSpline
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
        periodic = self.track.cycle is not None
        spline = TrunkSpline(n, self.rate_hz, True, hz) if periodic else InnerSpline(n, self.rate_hz, hz)
        sample = np.arange(0, n, max(1, round(self.config.balance.sample_s * self.rate_hz)))

        def demand_of(coefficients: Array) -> GroundDemand:
            track, feet_w = moved(spline.values(coefficients))
            pose = unlimited_pose(self.robot, track, feet_w, height)
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
