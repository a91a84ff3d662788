"""The reference of a steered robot: gaits of a field mixed by the velocity, step by step.

A foot that stands keeps its place in the world, whatever the trunk does, but for rolling as its ball does. One that
swings leaves from there and comes to where the present mixture of gaits has it; while the robot accelerates, a little
against that (the lean of an inverted pendulum). So the velocity can change at any moment, and no foot slides. The
wanted velocity is approached with bounded acceleration and jerk. If none is wanted, the robot stands as soon as all
feet are on the ground.

Where a field has a slower gait that can do what is wanted, such as a walk, the robot goes over to it, and back, at the
next moment at which the same feet stand in both. Feet go on from where they are, and what else differs fades (as in
games: Bollo 2018, "Inertialization"). A gait that cannot be slow, such as a canter, is entered and left by the field's
passages.
"""

from itertools import pairwise, permutations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.vectors import copy
from fastmimic.reference.course import make_work, put_at, put_joints, to_body
from fastmimic.reference.table import GAIN_SAMPLES
from fastmimic.steering.gait import LANDED, SPARE, Gait
from fastmimic.steering.gait_field import RATE_HZ, GaitField, Passage

_ACCELERATION: Final = (2.0, 1.5, 6.0)  # forwards and sideways, m/s², and turning, rad/s²
_STRETCHED: Final = 0.85  # share of the acceleration forwards that is left out near a gait's top speed
_JERK_S: Final = 0.12  # until the acceleration is that great
_SETTLE_S: Final = 0.25  # time constant of the last approach to the wanted velocity
_STILL: Final = (0.05, 0.05, 0.1)  # m/s, m/s, rad/s: a robot whose velocity is below that can stand
_STAND_S: Final = 0.15  # between a gait and standing
_CENTRED_S: Final = 0.3  # time constant with which a standing trunk moves to the middle of its feet
_FADE_S: Final = 0.25  # in which the difference of two gaits fades
_CALM: Final = (0.03, 0.03, 0.05)  # m/s, m/s, rad/s: near enough to the velocity at which a passage begins
_CALM_RATE: Final = (0.3, 0.3, 0.6)  # and its rate, 1/s
_LATE: Final = 5  # rows by which a passage may begin later

_TURN, _HEIGHT, _TILT, _MOTION, _FOOT, _ROLL = 2, 3, slice(4, 8), 8, 26, 38  # columns of a gait's values
_WIDTH: Final = 46
_FEET: Final = np.array([[_FOOT + 3 * leg, _FOOT + 3 * leg + 1] for leg in range(4)])

STEERED: Final = record_dtype(
    [
        *floats(position=(), pose=3, wanted=3, velocity=3, rate=3, stands=(), jump=(), fades=(), offset=_WIDTH),
        *floats(foothold=(4, 2), away=(4, 2), lifted=(4, 2), leaving=(4, 2), since=4, lasts=4),
        *floats(before=(4, 3), feet=(4, 3)),
        *integers(swings=4, standing=(), synced=()),
    ]
)
"""A steered reference: the `position` in the gaits' period, rows; x, y, m, and yaw, rad, of its root; the `wanted`
velocity, the present one and its rate, heading frame, m, rad, s; the share of standing in the mixture; the sum of the
distances moved by synchronisation, m; the `offset` of the gait before from the present one, which `fades` from 1 to
0. Of each foot: its place while it stands, world, m; how far `away` it is from where the gaits have it, heading frame,
m, and how far when it lifted off, `leaving` at so many m/s; the time since then and until it is where the gaits have
it, s; where the `feet` are, and were `before` the last step, body frame, m."""

_MIXTURE: Final = record_dtype([*floats(weight=9, values=_WIDTH, tilt=4), *integers(gait=9)])


class Steered:
    """The steered reference of one robot: `place` is (1,) of `STEERED`, `gains` are (g,) of `GAINS`, those of the
    present gait's velocities one after another. Not thread-safe. It can take the place of a `LiveReference`."""

    motion = goal = "steer"
    trouble = None
    demonstration = None  # recovery steps would be another gait; those of a trot can go anywhere as they are

    def __init__(self, field: GaitField) -> None:
        self.field = field
        self._gaits = [Gait(each) for each in reversed(field.chain())]  # the slowest first
        self._ways = {(one, other): one.rows_from(other) for one, other in permutations(self._gaits, 2)}
        self._passages = {
            between: (passage, Gait(passage.field))
            for pair in pairwise(self._gaits)
            for between, passage in zip((pair, pair[::-1]), pair[1].field.passages or (), strict=False)
        }
        self._gait = self._gaits[0]
        self._passing: tuple[Passage, Gait] | None = None  # and what comes after it
        self.place = np.zeros(1, STEERED)
        self._scratch = self.place.copy()
        self._work = np.zeros(1, _MIXTURE)[0], make_work(field.robot, 1.0 / RATE_HZ)[0]
        self._told = self._asked = np.zeros(3)
        self._choose()
        self.put(0.0, 0.0, 0.0)

    @property
    def gains(self) -> NDArray[Any]:
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
        _put(*self._gait.given, self.place[0], *self._work)

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
        _advance(*self._gait.given, place[0], *self._work, 1.0 + max(haste, 0.0))
        if place["synced"][0]:
            moved = base_xy - place["pose"][0, :2]
            place["pose"][0, :2] = base_xy
            place["foothold"] += moved
            place["jump"] += np.hypot(*moved)

    def fill(self, rows: Records, *, scored: bool = False) -> None:
        """Fills rows (t,) of `SAMPLE` with the reference from now on, in its root's present heading frame; `scored` or
        not is the same."""
        self._scratch[0] = self.place[0]
        _fill(*self._gait.given, self._scratch[0], *self._work, rows)

    def _change_gait(self) -> None:
        """Goes over to the first of the preferred gaits that has the present velocity, as soon as the same feet stand,
        or by a passage; to a slower one only if that has what is asked for to spare, so that a trembling stick changes
        nothing."""
        place, now, row = self.place[0], self._gait, int(self.place["position"][0])
        if self._passing is not None:
            passage, gait = self._passing
            if row >= passage.n:
                self._passing = None
                self._go_over(gait, (passage.arrive + row - passage.n) % gait.n)
                place["wanted"] = gait.field.nearest(self._asked)
            return
        gait = self._next_gait(now)
        place["wanted"] = now.field.nearest(self._asked)
        if gait is now:
            return
        if place["standing"] == 1:
            if place["stands"] == 1.0:
                self._gait = gait
                _put(*gait.given, place, *self._work)
        elif place["stands"] > 0.0:
            return
        elif (now, gait) in self._passages:
            self._pass(gait, row)
        elif (other := self._ways[gait, now][row]) >= 0:
            self._go_over(gait, other)
            place["wanted"] = gait.field.nearest(self._asked)

    def _next_gait(self, now: Gait) -> Gait:
        """The first of the preferred gaits that can follow the present one, or standing."""
        place = self.place[0]
        if place["standing"] == 1:
            slow = [gait for gait in self._preferred if gait.field.passages is None]
            return next((gait for gait in slow if gait in self._ample), slow[0])
        for gait in self._preferred:
            spared = gait in self._ample or self._gaits.index(gait) > self._gaits.index(now)
            fits = gait.field.passages is None and gait.field.has(place["velocity"])
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
        _advance(*self._gait.given, scratch, *self._work, 1.0)
        before, after = self._values(place), self._values(scratch)
        feet = before[_FEET] + place["away"]
        speed = (after[_FEET] + scratch["away"] - feet) * RATE_HZ
        self._gait, place["position"], place["fades"] = gait, row, 0.0
        self._scratch[0] = place
        scratch["position"] = (row + 1) % gait.n
        own, then = self._values(place), self._values(scratch)
        place["offset"][:_ROLL] = (before - own)[:_ROLL]
        place["offset"][_FEET], place["fades"] = 0.0, 1.0
        place["away"] = feet - own[_FEET]
        place["lifted"], place["leaving"] = place["away"], speed - (then - own)[_FEET] * RATE_HZ
        place["since"], place["lasts"] = 0.0, LANDED * np.maximum(gait.until[row], 1) / RATE_HZ

    def _values(self, place: Any) -> Array:
        """What the present gait has at a place (`_WIDTH`,)."""
        _mix(*self._gait.given[:2], place, self._work[0])
        return np.array(self._work[0]["values"])


@inlined
def _between(axis: Array, value: float) -> Any:
    """The node of an axis before a value, or the last but one, and the share of the way to the next, in [0, 1]."""
    i = 0
    while i < axis.shape[0] - 2 and value > axis[i + 1]:
        i += 1
    return i, min(max((value - axis[i]) / (axis[i + 1] - axis[i]), 0.0), 1.0)


@kernel
def _mix(grid: Any, values: Array, s: Any, mixture: Any) -> None:
    """The mixture of gaits for the present velocity at the present position."""
    forwards, sideways, most_turning = grid
    i, a = _between(forwards, s.velocity[0])
    j, b = _between(sideways, s.velocity[1])
    most = (1.0 - a) * most_turning[i] + a * most_turning[i + 1]
    turning = min(max(s.velocity[2] / most, -1.0), 1.0)
    k, c = (0, turning + 1.0) if turning < 0.0 else (1, turning)
    count = 0
    for p in range(2):
        for q in range(2):
            for r in range(2):
                mixture.gait[count] = ((i + p) * sideways.shape[0] + j + q) * 3 + k + r
                share = (a if p else 1.0 - a) * (b if q else 1.0 - b) * (c if r else 1.0 - c)
                mixture.weight[count] = (1.0 - s.stands) * share
                count += 1
    mixture.gait[8], mixture.weight[8] = values.shape[0] - 1, s.stands
    n = values.shape[1]
    row = int(s.position) % n
    u = s.position - np.floor(s.position)
    mixture.values[:] = 0.0
    for g in range(9):
        if mixture.weight[g] == 0.0:
            continue
        now, then = values[mixture.gait[g], row], values[mixture.gait[g], (row + 1) % n]
        for column in range(_WIDTH):
            mixture.values[column] += mixture.weight[g] * ((1.0 - u) * now[column] + u * then[column])
    if s.fades > 0.0:
        left = s.fades * s.fades * (3.0 - 2.0 * s.fades)
        for column in range(_WIDTH):
            mixture.values[column] += left * s.offset[column]
    norm = 0.0
    for column in range(4, 8):
        norm += mixture.values[column] ** 2
    for column in range(4, 8):
        mixture.tilt[column - 4] = mixture.values[column] / np.sqrt(norm)


@kernel
def _feet(schedule: Any, s: Any, mixture: Any, work: Any, dt: float) -> None:
    """Moves the feet by `dt` s of the gaits' time, with the root and the mixture as they are now."""
    contact, until, _ = schedule
    row = int(s.position) % contact.shape[0]
    cos, sin = np.cos(s.pose[2]), np.sin(s.pose[2])
    lean = mixture.values[_HEIGHT] / GRAVITY
    for leg in range(4):
        x, y = mixture.values[_FOOT + 3 * leg], mixture.values[_FOOT + 3 * leg + 1]
        if contact[row, leg] == 1 or s.stands > 0.0:
            if s.swings[leg] == 1:
                s.swings[leg] = 0
                fx, fy = x + s.away[leg, 0], y + s.away[leg, 1]
                s.foothold[leg, 0] = s.pose[0] + cos * fx - sin * fy
                s.foothold[leg, 1] = s.pose[1] + sin * fx + cos * fy
            dx, dy = s.foothold[leg, 0] - s.pose[0], s.foothold[leg, 1] - s.pose[1]
            ax, ay = cos * dx + sin * dy - x, -sin * dx + cos * dy - y
            s.leaving[leg, 0], s.leaving[leg, 1] = (ax - s.away[leg, 0]) / work.dt, (ay - s.away[leg, 1]) / work.dt
            s.away[leg, 0], s.away[leg, 1] = ax, ay
        else:
            if s.swings[leg] == 0:
                s.swings[leg], s.since[leg] = 1, 0.0
                s.lasts[leg] = LANDED * max(until[row, leg], 1) * work.dt
                copy(s.away[leg], s.lifted[leg])
            u = min(s.since[leg] / s.lasts[leg], 1.0)
            moved = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            going = u * (1.0 - u) ** 3 * (1.0 + 3.0 * u) * s.lasts[leg]  # begins with slope 1 in time
            for k in range(2):
                goal = -lean * s.rate[k]
                s.away[leg, k] = (1.0 - moved) * s.lifted[leg, k] + going * s.leaving[leg, k] + moved * goal
            s.since[leg] += dt
    for leg in range(4):
        copy(s.feet[leg], s.before[leg])
        for k in range(3):
            s.feet[leg, k] = mixture.values[_FOOT + 3 * leg + k] + (s.away[leg, k] if k < 2 else 0.0)
        to_body(mixture.tilt, mixture.tilt, 0.0, mixture.values[_HEIGHT], work.tilt, s.feet[leg])


@kernel
def _put(grid: Any, values: Array, schedule: Any, gains: int, s: Any, mixture: Any, work: Any) -> None:
    _mix(grid, values, s, mixture)
    cos, sin = np.cos(s.pose[2]), np.sin(s.pose[2])
    stops = schedule[2]
    for row in range(stops.shape[0]):  # the last at which it could stand: a foot lifts off soon
        if stops[row] == 1 and stops[(row + 1) % stops.shape[0]] == 0:
            s.position = row
    for leg in range(4):
        x, y = mixture.values[_FOOT + 3 * leg], mixture.values[_FOOT + 3 * leg + 1]
        s.foothold[leg, 0] = s.pose[0] + cos * x - sin * y
        s.foothold[leg, 1] = s.pose[1] + sin * x + cos * y
    _feet(schedule, s, mixture, work, 0.0)
    _feet(schedule, s, mixture, work, 0.0)


@kernel
def _advance(
    grid: Any, values: Array, schedule: Any, gains: int, s: Any, mixture: Any, work: Any, tempo: float
) -> None:
    """Advances by one control step, in which the feet go on by `tempo` of them."""
    dt = work.dt
    still = True
    for k in range(3):
        still = still and abs(s.wanted[k]) < _STILL[k]
    _change_velocity(s, grid[0][-1], dt)
    s.fades = max(s.fades - dt / _FADE_S, 0.0)
    if s.standing == 1:
        s.stands = min(s.stands + dt / _STAND_S, 1.0)
        if s.stands == 1.0 and not still:
            s.standing = 0
    else:
        s.stands = max(s.stands - dt / _STAND_S, 0.0)
    _mix(grid, values, s, mixture)
    x, y, turn = mixture.values[0], mixture.values[1], mixture.values[_TURN]
    if s.stands > 0.0:  # to the middle of the feet
        turn = 0.0
        x = s.stands * dt / _CENTRED_S * 0.25 * s.away[:, 0].sum()
        y = s.stands * dt / _CENTRED_S * 0.25 * s.away[:, 1].sum()
    cos, sin = np.cos(s.pose[2] + 0.5 * turn), np.sin(s.pose[2] + 0.5 * turn)
    if s.stands == 0.0:
        for leg in range(4):
            dx, dy = tempo * mixture.values[_ROLL + 2 * leg], tempo * mixture.values[_ROLL + 2 * leg + 1]
            s.foothold[leg, 0] += cos * dx - sin * dy
            s.foothold[leg, 1] += sin * dx + cos * dy
    s.pose[0] += cos * x - sin * y
    s.pose[1] += sin * x + cos * y
    s.pose[2] += turn
    s.synced = 0
    if s.stands == 0.0:
        s.position += tempo
        if s.position >= values.shape[1]:
            s.position -= values.shape[1]
            s.synced = 1
        _mix(grid, values, s, mixture)
        for k in range(3):
            still = still and abs(s.velocity[k]) < 2.0 * _STILL[k]
        if still and schedule[2][int(s.position) % values.shape[1]] == 1:
            s.standing = 1
    _feet(schedule, s, mixture, work, tempo * dt)


@kernel
def _change_velocity(s: Any, top: float, dt: float) -> None:
    """Brings the velocity nearer to the wanted one; a standing robot has none. Near a gait's `top` speed forwards, m/s,
    where legs are nearly stretched, it accelerates less."""
    for k in range(3):
        most = _ACCELERATION[k]
        fast = min(max(2.5 * s.velocity[0] / top - 1.25, 0.0), 1.0) if k == 0 else 0.0
        rate = min(max((s.wanted[k] - s.velocity[k]) / _SETTLE_S, -most), (1.0 - _STRETCHED * fast) * most)
        change = most / _JERK_S * dt
        s.rate[k] += min(max(rate - s.rate[k], -change), change)
        s.velocity[k] += s.rate[k] * dt
        if s.stands > 0.0:
            s.rate[k], s.velocity[k] = 0.0, 0.0


@kernel
def _fill(grid: Any, values: Array, schedule: Any, gains: int, s: Any, mixture: Any, work: Any, table: Any) -> None:
    x0, y0, yaw0 = s.pose[0], s.pose[1], s.pose[2]
    cos, sin = np.cos(yaw0), np.sin(yaw0)
    for k in range(table.shape[0]):
        _mix(grid, values, s, mixture)
        row = int(s.position) % values.shape[1]
        _sample(mixture, schedule[0][row], s, table[k])
        table[k].gain = _nearest(mixture) * gains + row // GAIN_SAMPLES
        table[k].sync = s.synced if k > 0 else 0
        dx, dy = s.pose[0] - x0, s.pose[1] - y0
        put_at(cos * dx + sin * dy, -sin * dx + cos * dy, s.pose[2] - yaw0, table[k])
        if k > 0:
            if k + 1 < table.shape[0]:
                _advance(grid, values, schedule, gains, s, mixture, work, 1.0)
            continue
        for leg in range(4):
            copy(s.before[leg], work.feet[0, leg])
            copy(s.feet[leg], work.feet[1, leg])
        _advance(grid, values, schedule, gains, s, mixture, work, 1.0)
        for leg in range(4):
            copy(s.feet[leg], work.feet[2, leg])
        put_joints(work, table[0])


@inlined
def _nearest(mixture: Any) -> int:
    """The gait that has most of the mixture."""
    most = 0
    for g in range(9):
        most = g if mixture.weight[g] > mixture.weight[most] else most
    return int(mixture.gait[most])


@kernel
def _sample(mixture: Any, contact: Any, s: Any, out: Any) -> None:
    """One row of the table without joints and pose, in its root's heading frame."""
    mixed = mixture.values
    out.root_pos[0], out.root_pos[1], out.root_pos[2] = 0.0, 0.0, mixed[_HEIGHT]
    copy(mixture.tilt, out.root_quat)
    for k in range(3):
        out.lin_vel[k], out.ang_vel[k] = mixed[_MOTION + k], mixed[_MOTION + 3 + k]
        out.lin_acc[k], out.ang_acc[k] = mixed[_MOTION + 6 + k], mixed[_MOTION + 9 + k]
        out.leg_lin_acc[k], out.leg_ang_acc[k] = mixed[_MOTION + 12 + k], mixed[_MOTION + 15 + k]
    out.lin_acc[0] += s.rate[0]
    out.lin_acc[1] += s.rate[1]
    out.ang_acc[2] += s.rate[2]
    for leg in range(4):
        out.contact[leg] = 1 if s.stands > 0.0 else contact[leg]
        out.swung[leg] = 0.0 if out.contact[leg] == 1 else min(s.since[leg] / s.lasts[leg], 1.0)
        copy(s.feet[leg], out.foot_pos[leg])
