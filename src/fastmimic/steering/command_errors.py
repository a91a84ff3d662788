"""How well a steered robot follows its velocities."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat

_HELD_S: Final = 0.5  # least duration of a command that is measured: a stick that moves gives many shorter ones
_MEAN_S: Final = 1.0  # at the end of a command, over which its velocity is measured
_STRIDE_S: Final = 0.5  # over which the velocity of a response is averaged
_REACHED: Final = 0.63  # share of a change, of which the time is the response
_CHANGE: Final = (0.5, 0.2, 1.0)  # least change whose response is measured, m/s, m/s, rad/s


@dataclass
class CommandErrors:
    """Of each command that held half a second or longer, the errors of the mean velocity, m/s, and turn rate, rad/s,
    in its last second; and of greater changes the time until 63 % of it, s."""

    velocity: list[float] = field(default_factory=list)
    yaw_rate: list[float] = field(default_factory=list)
    response_s: list[float] = field(default_factory=list)

    def add(self, observation: NDArray[Any], wanted: Array, dt: float, fell: NDArray[np.bool_] | None = None) -> None:
        """Adds a run: states (t,) of `OBSERVATION`, the velocity wanted (t, 3), heading frame, at steps of `dt`, s. A
        command in which the robot `fell` (t,) counts only there."""
        moved = rotate_planar(-yaw_from_quat(observation["root_quat"]), observation["lin_vel"][:, :2])
        velocity = np.column_stack([moved, observation["ang_vel"][:, 2]])
        smooth = uniform_filter1d(velocity, max(1, round(_STRIDE_S / dt)), axis=0, mode="nearest")
        changes = np.flatnonzero(np.diff(wanted, axis=0).any(axis=1)) + 1
        for first, last in pairwise([0, *changes, len(wanted)]):
            if (last - first) * dt < _HELD_S or (fell is not None and fell[first:last].any()):
                continue
            error = velocity[max(first, last - round(_MEAN_S / dt)) : last].mean(axis=0) - wanted[first]
            self.velocity.append(float(np.hypot(*error[:2])))
            self.yaw_rate.append(abs(float(error[2])))
            change = wanted[first] - smooth[first]
            for axis in np.flatnonzero(np.abs(change) > _CHANGE):
                reached = (smooth[first:last, axis] - smooth[first, axis]) / change[axis] >= _REACHED
                if reached.any():
                    self.response_s.append(float(np.argmax(reached)) * dt)

    def as_dict(self) -> dict[str, float | None]:
        """Medians, JSON-serialisable; None without values."""
        found = {"velocity_error_m_s": self.velocity, "yaw_rate_error_rad_s": self.yaw_rate}
        found["response_ms"] = [1e3 * s for s in self.response_s]
        return {name: float(np.median(values)) if values else None for name, values in found.items()}
