"""One gait of a steered robot as the kernels take it."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.rotations import rotate_planar
from fastmimic.steering.change import rows_until
from fastmimic.steering.gait_field import RATE_HZ, GaitField

LANDED: Final = 0.95  # share of a swing at whose end its foot is where the gaits have it
_LOW_M: Final = 0.002
SPARE: Final = 1.1  # of a velocity that a slower gait takes over, so that a trembling stick changes nothing
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
        self.contact, self.until = field.contact, rows_until(field.contact)
        stops = _stops(self.contact, middle["foot"][..., 2].max(axis=-1))
        schedule = self.contact.astype(np.int64), self.until, stops, self.contact.sum(axis=0) / RATE_HZ
        self.given = (field.forwards, field.sideways, field.turning), values, schedule, field.gains.shape[1]


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
