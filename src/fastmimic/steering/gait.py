"""One gait of a steered robot as the kernels take it, and where another one can go over to it."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.rotations import rotate_planar
from fastmimic.steering.gait_field import RATE_HZ, GaitField

LANDED: Final = 0.95  # share of a swing at whose end its foot is where the gaits have it
_LOW_M: Final = 0.002
SPARE: Final = 1.1  # of a velocity that a slower gait takes over, so that a trembling stick changes nothing
_ENOUGH_S: Final = 0.15  # time until a foot that stands lifts off that is as good as more
_LATE_S: Final = 0.03  # by which a foot may lift off later, at once
_NEVER: Final = 1.0  # s: more than all that may be
_NEARLY: Final = 1.5  # a moment is good whose cost is at most so many times the least one
_SMALL: Final = 1e-4  # and so much more, s²
_COLUMNS: Final = (
    *("step", "turn", "root_z", "tilt", "lin_vel", "ang_vel", "lin_acc", "ang_acc", "leg_lin_acc", "leg_ang_acc"),
    "foot",
)  # of `COURSE`, which are mixed


class Gait:
    """A gait of `field` at all its velocities, `n` rows a period: what kernels are `given` (the grid, values (k, n, w),
    the schedule, gains per velocity) and the `gains` (g,). `until` (n, 4): rows until a foot lands, 0 in stance."""

    def __init__(self, field: GaitField) -> None:
        n_gaits, self.n = field.rows.shape
        columns = [field.rows[name].reshape(n_gaits, self.n, -1) for name in _COLUMNS]
        # and how far each foot that stands rolls on the ground in a row
        values = np.concatenate([*columns, _rolls(field.rows)], axis=-1)
        tilt = values[..., 4:8]
        tilt *= np.where(np.sum(tilt * tilt[-1, 0], axis=-1, keepdims=True) < 0, -1.0, 1.0)
        middle = field.rows[n_gaits // 2 - 1]
        self.field, self.gains = field, field.gains.reshape(-1)
        self.contact = np.ascontiguousarray(middle["contact"])
        self.until = _rows_until(self.contact != 0)
        stops = _stops(self.contact, middle["foot"][..., 2].max(axis=-1))
        schedule = self.contact, self.until, stops, (self.contact != 0).sum(axis=0) / RATE_HZ
        self.given = (field.forwards, field.sideways, field.turning), values, schedule, field.gains.shape[1]
        stands = self.contact != 0
        # s until a foot lands or lifts off, and since it did
        self._change_s = np.maximum(self.until, _rows_until(~stands)) / RATE_HZ
        self._since_s = np.maximum(_rows_until(stands[::-1]), _rows_until(~stands[::-1]))[::-1] / RATE_HZ

    def rows_from(self, other: "Gait") -> NDArray[np.int64]:
        """For each row of another gait (m,) the row of this one to go over to; -1 where it is better to wait.

        The same feet should stand, and land and lift off as soon. A foot may lift off at that moment, if the other gait
        has it do so just before; none lands, as it would land hard: a pace has no row to go over to from a trot."""
        before, after = other.contact[:, None] != 0, self.contact[None] != 0
        changes_s, changed_s, since_s = self._change_s[None], other._change_s[:, None], self._since_s[None]
        apart = changes_s - changed_s
        apart = np.where(before & after, np.minimum(changes_s, _ENOUGH_S) - np.minimum(changed_s, _ENOUGH_S), apart)
        apart = np.where(before & ~after, np.where(since_s > _LATE_S, _NEVER, since_s), apart)
        apart = np.where(~before & after, _NEVER, apart)
        cost = (apart**2).sum(axis=-1)
        least = cost.min(axis=1)
        good = least < min(_NEARLY * least.min() + _SMALL, _NEVER**2)
        return np.where(good, cost.argmin(axis=1), -1)


def _rows_until(events: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rows until the next one at which something is so (n, 4), 0 where it is."""
    return np.array([np.argmax(np.roll(events, -row, axis=0), axis=0) for row in range(len(events))])


def _rolls(rows: Records) -> Array:
    """How far each foot that stands moves on the ground until the next row, as a ball does, (k, t, 8), m."""
    feet, stands = rows["foot"][..., :2], rows["contact"][..., None] != 0
    after = rotate_planar(rows["turn"][..., None], np.roll(feet, -1, axis=1)) + rows["step"][:, :, None]
    rolls = (after - feet) * (stands & np.roll(stands, -1, axis=1))
    rolls[-1] = 0.0  # who stands does not roll
    return np.asarray(rolls.reshape(*rows.shape, 8))


def _stops(contact: NDArray[Any], height: Array) -> NDArray[np.int64]:
    """Whether the robot can come to stand at a row (t,): where as many feet stand as ever, and the others are at their
    lowest; of the greatest `height` of a foot, m."""
    most = contact.sum(axis=1) == contact.sum(axis=1).max()
    return np.asarray(most & (height <= height[most].min() + _LOW_M), np.int64)
