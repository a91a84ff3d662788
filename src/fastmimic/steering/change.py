"""Where a gait can go over to another one: at moments at which the same feet stand in both."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Flags

_ENOUGH_S: Final = 0.15  # time until a foot that stands lifts off that is as good as more
_LATE_S: Final = 0.03  # by which a foot may lift off later, at once
_NEVER: Final = 1.0  # s: more than all that may be
_NEARLY: Final = 1.5  # a moment is good whose cost is at most so many times the least one
_SMALL: Final = 1e-4  # and so much more, s²


def rows_between(one: Flags, other: Flags, rate_hz: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The rows to go over to from one gait to the other, and back; none at all if there are none in one direction:
    where feet fit by chance, as from a pace to a trot, the sway of the trunk does not."""
    there, back = rows_to_change(one, other, rate_hz), rows_to_change(other, one, rate_hz)
    if min(there.max(), back.max()) < 0:
        there[:] = back[:] = -1
    return there, back


def rows_to_change(before: Flags, after: Flags, rate_hz: float) -> NDArray[np.int64]:
    """For each row of one gait (m,) the row of another one to go over to; -1 where it is better to wait. Feet stand
    `before` (m, 4) and `after` (n, 4), at `rate_hz`.

    The same feet should stand, and land and lift off as soon. A foot may lift off at that moment, if the gait after has
    it do so just before; none lands, as it would land hard: from a trot there is no row of a pace to go over to."""
    changed_s = _rows_until_change(before)[:, None] / rate_hz
    changes_s, since_s = _rows_until_change(after) / rate_hz, _rows_until_change(after[::-1])[::-1] / rate_hz
    before = before[:, None]
    apart = changes_s - changed_s
    apart = np.where(before & after, np.minimum(changes_s, _ENOUGH_S) - np.minimum(changed_s, _ENOUGH_S), apart)
    apart = np.where(before & ~after, np.where(since_s > _LATE_S, _NEVER, since_s), apart)
    apart = np.where(~before & after, _NEVER, apart)
    cost = (apart**2).sum(axis=-1)
    least = cost.min(axis=1)
    good = least < min(_NEARLY * least.min() + _SMALL, _NEVER**2)
    return np.where(good, cost.argmin(axis=1), -1)


def rows_until(events: Flags) -> NDArray[np.int64]:
    """Rows until the next one at which something is so (n, 4), 0 where it is."""
    return np.array([np.argmax(np.roll(events, -row, axis=0), axis=0) for row in range(len(events))])


def _rows_until_change(stands: Flags) -> NDArray[np.int64]:
    """Rows until a foot lands or lifts off (n, 4)."""
    return np.maximum(rows_until(stands), rows_until(~stands))
