"""The reference of a steered robot: gaits of a field mixed by the velocity, step by step.

A foot that stands keeps its place in the world, whatever the trunk does, but for rolling as its ball does. One that
swings leaves from there and comes to where the mixture of gaits has it for the velocity foreseen in its next stance;
while the robot accelerates, a little against that (the lean of an inverted pendulum). So the velocity can change at any
moment, and no foot slides. The wanted velocity is approached with bounded acceleration and jerk. If none is wanted, the
robot stands when all feet do.

Where a field has a slower gait that can do what is wanted, such as a walk, the robot goes over to it, and back, at the
next moment at which the same feet stand in both. Feet go on from where they are, none lands by the change, and what
else differs fades (as in games: Bollo 2018, "Inertialization"). A gait that cannot be slow is entered and left by the
field's passages.
"""

from itertools import combinations, pairwise, permutations
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError
from fastmimic.reference.course import make_work
from fastmimic.steering.change import rows_between
from fastmimic.steering.gait import LANDED, SPARE, Gait
from fastmimic.steering.gait_field import RATE_HZ, GaitField, Passage
from fastmimic.steering.mixture import FEET, MIXTURE, ROLL, STEERED, advance, fill, mix, put

_CALM: Final = (0.1, 0.05, 0.1)  # m/s, m/s, rad/s: near enough to the velocity at which a passage begins
_CALM_RATE: Final = (1.0, 0.5, 1.0)  # and its rate, 1/s
_ASIDE: Final = (0.15, 0.3)  # m/s to the side and rad/s that may be left out during a passage
_SLOW: Final = 0.4  # share of a passage's speed below which it is none on the way
_LATE: Final = 5  # rows by which a passage may begin later


class Steered:
    """The steered reference of one robot: `place` is (1,) of `STEERED`, `gains` are (g,) of `GAINS`, those of the
    present gait's velocities one after another. Not thread-safe. It can take the place of a `LiveReference`."""

    motion = goal = "steer"
    trouble = None
    demonstration = None  # recovery steps would be another gait; those of a trot can go anywhere as they are

    def __init__(self, field: GaitField) -> None:
        self.field = field
        self._gaits = [Gait(each) for each in reversed(field.chain())]  # the slowest first
        self._passages = {
            between: (passage, Gait(passage.field))
            for pair in pairwise(self._gaits)
            for between, passage in zip((pair, pair[::-1]), pair[1].field.passages or (), strict=False)
        }
        self._ways = {
            pair: np.full_like(rows, -1) if pair in self._passages else rows
            for two in combinations(self._gaits, 2)
            for pair, rows in zip(permutations(two), rows_between(two[0].contact, two[1].contact, RATE_HZ), strict=True)
        }
        self._gait = self._gaits[0]
        self._passing: tuple[Passage, Gait] | None = None  # and what comes after it
        self.place = np.zeros(1, STEERED)
        self._scratch = self.place.copy()
        self._work = np.zeros(1, MIXTURE)[0], make_work(field.robot, 1.0 / RATE_HZ)[0]
        self._told = self._asked = np.zeros(3)
        self._choose()
        self.put(0.0, 0.0, 0.0)

    @property
    def gains(self) -> Records:
        return self._gait.gains

    @property
    def state(self) -> str:
        return "standing" if self.place["stands"][0] > 0 else self._gait.field.name

    def put(self, x: float, y: float, yaw: float) -> None:
        """Begins to stand here in the world, m and rad; what is wanted stays."""
        wanted, self._gait, self._passing = self.place["wanted"].copy(), self._gaits[0], None
        self.place[...] = np.zeros(1, STEERED)
        self.place["pose"], self.place["wanted"] = (x, y, yaw), wanted
        self.place["stands"], self.place["standing"] = 1.0, 1
        put(*self._gait.given, self.place[0], *self._work)

    stand = put

    def steer(self, velocity: Array) -> Array:
        """Requests a velocity (3,): forwards, to the left, m/s, turning to the left, rad/s; returns the nearest one of
        the field, which it takes. Raises `ConfigError` if it is not three finite numbers."""
        if np.array_equal(velocity, self._told):  # as it mostly is, in each control step
            return np.array(self._asked)
        if np.shape(velocity) != (3,) or not np.isfinite(velocity).all():
            raise ConfigError(f"a velocity to steer to has three numbers, found {velocity}")
        nearest = [gait.field.nearest(velocity) for gait in self._gaits]
        self._told, self._asked = np.array(velocity), min(nearest, key=lambda v: float(np.linalg.norm(v - velocity)))
        self._choose()
        self.place["wanted"] = self._gait.field.nearest(self._asked)
        return np.array(self._asked)

    def _suits(self, now: Gait, gait: Gait) -> bool:
        """Whether a passage leads about to what is asked for, straight ahead and not much slower, or there is no other
        way: one of the gaits cannot stand."""
        aside, slow = np.abs(self._asked[1:]), _SLOW * self._passages[now, gait][0].before
        both_stand = now.field.can_stand and gait.field.can_stand
        return not both_stand or bool(self._asked[0] > slow and (aside <= _ASIDE).all())

    def _choose(self) -> None:
        """All gaits, those first that come nearest to what is asked for, of equal ones the slowest; and of the gaits
        that have it, those that have some to spare."""

        def missing(gait: Gait) -> float:
            field = gait.field
            return 0.0 if field.has(self._asked) else float(np.linalg.norm(field.nearest(self._asked) - self._asked))

        self._preferred = sorted(self._gaits, key=missing)
        self._ample = [gait for gait in self._gaits if gait.field.has(SPARE * self._asked)]

    def update(self) -> None:
        """Nothing: all happens in `advance`."""

    def advance(self, base_xy: Array, haste: float = 0.0) -> None:
        """Advances by a control step that ended with the base at (2,), world, m, which x and y follow at the start of a
        cycle. With the controller's `haste` the feet advance by so much more."""
        place = self.place
        self._change_gait()
        advance(*self._gait.given, place[0], *self._work, 1.0 + max(haste, 0.0))
        if place["synced"][0]:
            moved = base_xy - place["pose"][0, :2]
            place["pose"][0, :2] = base_xy
            place["foothold"] += moved
            place["jump"] += np.hypot(*moved)

    def fill(self, rows: Records, *, scored: bool = False) -> None:
        """Fills rows (t,) of `SAMPLE` with the reference from now on, in its root's heading frame, `scored` or not."""
        self._scratch[0] = self.place[0]
        fill(*self._gait.given, self._scratch[0], *self._work, rows)

    def _change_gait(self) -> None:
        """Goes over to the first of the preferred gaits that has the present velocity, as soon as the same feet stand,
        or by a passage; to a slower one only if that has some to spare: a trembling stick changes nothing. A passage
        goes straight ahead: who is to turn stands between two gaits, if both can, or stays in one that has it."""
        place, now, row = self.place[0], self._gait, int(self.place["position"][0])
        if self._passing is not None:
            passage, gait = self._passing
            if row >= passage.n:
                self._passing = None
                self._go_over(gait, (passage.arrive + row - passage.n) % gait.n)
            return
        gait = self._next_gait(now)
        place["wanted"] = now.field.nearest(self._asked)
        if gait is now:
            return
        if place["standing"] == 1:
            place["wanted"] = 0.0
            if place["stands"] == 1.0:
                self._gait = gait
                put(*gait.given, place, *self._work)
        elif place["stands"] > 0.0:
            return
        elif (now, gait) in self._passages and self._suits(now, gait):
            self._pass(gait, row)
        elif (other := self._ways[now, gait][row]) >= 0:
            self._go_over(gait, other)
        elif (self._ways[now, gait] < 0).all() and not now.field.has(self._asked):
            place["wanted"] = 0.0  # it comes to stand, and begins anew

    def _next_gait(self, now: Gait) -> Gait:
        """The first of the preferred gaits that can follow the present one, or standing."""
        place = self.place[0]
        if place["standing"] == 1:
            slow = [gait for gait in self._preferred if gait.field.can_stand]
            return next((gait for gait in slow if gait in self._ample), slow[0])
        for gait in self._preferred:
            spared = gait in self._ample or self._gaits.index(gait) > self._gaits.index(now)
            fits = gait.field.can_stand and gait.field.has(place["velocity"])
            if gait is now or (spared and (fits or (now, gait) in self._passages)):
                return gait
        return now

    def _pass(self, gait: Gait, row: int) -> None:
        """Comes to the velocity at which a passage to another gait begins, and takes it at its row."""
        place, (passage, way) = self.place[0], self._passages[self._gait, gait]
        place["wanted"] = passage.before, 0.0, 0.0
        late = (row - passage.leave) % self._gait.n
        calm = np.abs(place["wanted"] - place["velocity"]) < _CALM
        if late < _LATE and calm.all() and (np.abs(place["rate"]) < _CALM_RATE).all():
            self._go_over(way, late)
            self._passing = passage, gait
            place["velocity"] = place["wanted"] = passage.after, 0.0, 0.0
            place["rate"] = 0.0

    def _go_over(self, gait: Gait, row: int) -> None:
        """Goes on at a row of another gait. What the gaits differ in begins to fade; feet are as far away from where
        the new gait has them as they are, and those in the air move on as they do."""
        place, scratch = self.place[0], self._scratch[0]
        self._scratch[0] = place
        advance(*self._gait.given, scratch, *self._work, 1.0)
        before, after = self._values(place), self._values(scratch)
        feet = before[FEET].reshape(4, 3) + place["away"]
        speed = (after[FEET].reshape(4, 3) + scratch["away"] - feet) * RATE_HZ
        self._gait, place["position"], place["fades"] = gait, row, 0.0
        self._scratch[0] = place
        scratch["position"] = (row + 1) % gait.n
        own, then = self._values(place), self._values(scratch)
        rate = (after - before - (then - own)) * RATE_HZ
        place["offset"][:ROLL], place["parting"][:ROLL] = (before - own)[:ROLL], rate[:ROLL]
        place["offset"][FEET] = place["parting"][FEET] = 0.0
        place["fades"] = 1.0
        place["away"] = feet - own[FEET].reshape(4, 3)
        place["lifted"], place["leaving"] = place["away"], speed - (then - own)[FEET].reshape(4, 3) * RATE_HZ
        place["wanted"] = gait.field.nearest(self._asked)
        place["since"], place["lasts"] = 0.0, LANDED * np.maximum(gait.until[row], 1) / RATE_HZ

    def _values(self, place: Any) -> Array:
        """What the present gait has at a place (`WIDTH`,)."""
        mix(*self._gait.given[:2], place, self._work[0])
        return np.array(self._work[0]["values"])
