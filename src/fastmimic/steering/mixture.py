"""The mixture of a gait's velocities, step by step, as kernels: velocity, trunk and feet of a steered reference."""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.vectors import copy
from fastmimic.reference.course import put_at, put_joints, to_body
from fastmimic.reference.table import GAIN_SAMPLES
from fastmimic.steering.gait import LANDED

_ACCELERATION: Final = (2.0, 1.5, 6.0)  # forwards and sideways, m/s², and turning, rad/s²
_STRETCHED: Final = 0.85  # share of the acceleration forwards that is left out near a gait's top speed
_JERK_S: Final = 0.12  # until the acceleration is that great
_SETTLE_S: Final = 0.15  # time constant of the last approach to the wanted velocity
_STILL: Final = (0.05, 0.05, 0.1)  # m/s, m/s, rad/s: a robot whose velocity is below that can stand
_STAND_S: Final = 0.15  # between a gait and standing
_CENTRED_S: Final = 0.3  # time constant with which a standing trunk moves to the middle of its feet
_FORESEEN: Final = 0.25  # of a stance, by which a foot lands ahead for a velocity to come; a pendulum asks for 0.5
_GOAL_S: Final = 0.03  # time constant with which a swinging foot takes up another goal
_AHEAD_S: Final = 0.01  # step in which the velocity is foreseen
_STEADY: Final = 1e-3  # m/s, m/s² and rad: a velocity that does not change
_FADE_S: Final = 0.1  # in which the difference of two gaits fades

_TURN, _HEIGHT, _TILT, _MOTION, _FOOT, ROLL = 2, 3, slice(4, 8), 8, 26, 38  # columns of a gait's values
WIDTH: Final = 46
FEET: Final = slice(_FOOT, _FOOT + 12)

STEERED: Final = record_dtype(
    [
        *floats(position=(), pose=3, wanted=3, velocity=3, rate=3, stands=(), jump=()),
        *floats(fades=(), offset=WIDTH, parting=WIDTH),
        *floats(foothold=(4, 2), away=(4, 3), lifted=(4, 3), leaving=(4, 3), goal=(4, 3), since=4, lasts=4),
        *floats(before=(4, 3), feet=(4, 3)),
        *integers(swings=4, standing=(), synced=()),
    ]
)
"""A steered reference: the `position` in the gaits' period, rows; x, y, m, and yaw, rad, of its root; the `wanted`
velocity, the present one and its rate, heading frame, m, rad, s; the share of standing in the mixture; the sum of the
distances moved by synchronisation, m; the `offset` of the gait before from the present one, which `fades` from 1 to
0, and its rate when it began to, `parting`. Of each foot: its place while it stands, world, m; how far `away` it is
from where the gaits have it, heading frame, m, and how far when it lifted off, `leaving` at so many m/s; the `goal` in
which its swing is to end, likewise; the time since then and until it is there, s; where the `feet` are, and were
`before` the last step, body frame, m."""

MIXTURE: Final = record_dtype([*floats(weight=9, values=WIDTH, tilt=4, ahead=(2, 3)), *integers(gait=9)])


@inlined
def _between(axis: Array, value: float) -> Any:
    """The node of an axis before a value, or the last but one, and the share of the way to the next, in [0, 1]."""
    i = 0
    while i < axis.shape[0] - 2 and value > axis[i + 1]:
        i += 1
    return i, min(max((value - axis[i]) / (axis[i + 1] - axis[i]), 0.0), 1.0)


@kernel
def mix(grid: Any, values: Array, s: Any, mixture: Any) -> None:
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
        for column in range(WIDTH):
            mixture.values[column] += mixture.weight[g] * ((1.0 - u) * now[column] + u * then[column])
    if s.fades > 0.0:
        left, going = s.fades**2 * (3.0 - 2.0 * s.fades), s.fades**2 * (1.0 - s.fades) * _FADE_S
        for column in range(WIDTH):
            mixture.values[column] += left * s.offset[column] + going * s.parting[column]
    norm = 0.0
    for column in range(4, 8):
        norm += mixture.values[column] ** 2
    for column in range(4, 8):
        mixture.tilt[column - 4] = mixture.values[column] / np.sqrt(norm)


@inlined
def _foresee(s: Any, top: float, land: float, stays: float, out: Any) -> None:
    """Of a stance that begins in `land` s, and lasts for so many: `out` (2, 3) is how much faster the trunk will be a
    third into it, and its mean acceleration."""
    for k in range(3):
        out[0, k] = out[1, k] = 0.0
        if abs(s.rate[k]) < _STEADY and abs(s.wanted[k] - s.velocity[k]) < _STEADY:
            continue
        velocity = lands = third = s.velocity[k]
        rate = s.rate[k]
        for i in range(int((land + stays) / _AHEAD_S)):
            velocity, rate = _nearer(k, velocity, rate, s.wanted[k], top, _AHEAD_S)
            if (i + 1) * _AHEAD_S <= land:
                lands = velocity
            if (i + 1) * _AHEAD_S <= land + stays / 3.0:
                third = velocity
        out[0, k], out[1, k] = third - s.velocity[k], (velocity - lands) / stays


@kernel
def _feet(schedule: Any, top: float, s: Any, mixture: Any, work: Any, dt: float) -> None:
    """Moves the feet by `dt` s of the gaits' time, with the root and the mixture as they are now."""
    contact, until, _, stances = schedule
    row = int(s.position) % contact.shape[0]
    cos, sin = np.cos(s.pose[2]), np.sin(s.pose[2])
    lean = mixture.values[_HEIGHT] / GRAVITY
    for leg in range(4):
        x, y = mixture.values[_FOOT + 3 * leg], mixture.values[_FOOT + 3 * leg + 1]
        # the gaits' landing foot is half a stance ahead of the hip: it moves on the ground when the velocity changes
        ahead_x = 0.5 * stances[leg] * (s.rate[0] - y * s.rate[2])
        ahead_y = 0.5 * stances[leg] * (s.rate[1] + x * s.rate[2])
        if contact[row, leg] == 1 or s.stands > 0.0:
            if s.swings[leg] == 1:
                s.swings[leg] = 0
                fx, fy = x + s.away[leg, 0] - ahead_x * dt, y + s.away[leg, 1] - ahead_y * dt
                s.foothold[leg, 0] = s.pose[0] + cos * fx - sin * fy
                s.foothold[leg, 1] = s.pose[1] + sin * fx + cos * fy
            dx, dy = s.foothold[leg, 0] - s.pose[0], s.foothold[leg, 1] - s.pose[1]
            ax, ay = cos * dx + sin * dy - x, -sin * dx + cos * dy - y
            s.leaving[leg, 0], s.leaving[leg, 1] = (ax - s.away[leg, 0]) / work.dt, (ay - s.away[leg, 1]) / work.dt
            s.away[leg, 0], s.away[leg, 1] = ax, ay
            s.leaving[leg, 2] = s.away[leg, 2] = 0.0
        else:
            if s.swings[leg] == 0:
                s.swings[leg], s.since[leg] = 1, 0.0
                s.lasts[leg] = LANDED * max(until[row, leg], 1) * work.dt
                copy(s.away[leg], s.lifted[leg])
            share = min(dt / _GOAL_S, 1.0) if s.since[leg] > 0.0 else 1.0
            s.since[leg] += dt
            u = min(s.since[leg] / s.lasts[leg], 1.0)
            moved = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            going = u * (1.0 - u) ** 3 * (1.0 + 3.0 * u) * s.lasts[leg]  # begins with slope 1 in time
            w = min(LANDED * s.since[leg] / s.lasts[leg], 1.0)
            coming = -(w**4) * (1.0 - w) * s.lasts[leg] / LANDED  # ends with it
            _foresee(s, top, max(s.lasts[leg] - s.since[leg], 0.0), stances[leg], mixture.ahead)
            faster, rate = mixture.ahead[0], mixture.ahead[1]
            gx = _FORESEEN * stances[leg] * (faster[0] - y * faster[2]) - lean * rate[0]
            gy = _FORESEEN * stances[leg] * (faster[1] + x * faster[2]) - lean * rate[1]
            s.goal[leg, 0] += share * (gx - s.goal[leg, 0])
            s.goal[leg, 1] += share * (gy - s.goal[leg, 1])
            for k in range(3):
                s.away[leg, k] = (1.0 - moved) * s.lifted[leg, k] + going * s.leaving[leg, k] + moved * s.goal[leg, k]
            s.away[leg, 0] -= coming * ahead_x  # lands at rest
            s.away[leg, 1] -= coming * ahead_y
    for leg in range(4):
        copy(s.feet[leg], s.before[leg])
        for k in range(3):
            s.feet[leg, k] = mixture.values[_FOOT + 3 * leg + k] + s.away[leg, k]
        to_body(mixture.tilt, mixture.tilt, 0.0, mixture.values[_HEIGHT], work.tilt, s.feet[leg])


@kernel
def put(grid: Any, values: Array, schedule: Any, gains: int, s: Any, mixture: Any, work: Any) -> None:
    mix(grid, values, s, mixture)
    cos, sin = np.cos(s.pose[2]), np.sin(s.pose[2])
    stops = schedule[2]
    for row in range(stops.shape[0]):  # the last at which it could stand: a foot lifts off soon
        if stops[row] == 1 and stops[(row + 1) % stops.shape[0]] == 0:
            s.position = row
    for leg in range(4):
        x, y = mixture.values[_FOOT + 3 * leg], mixture.values[_FOOT + 3 * leg + 1]
        s.foothold[leg, 0] = s.pose[0] + cos * x - sin * y
        s.foothold[leg, 1] = s.pose[1] + sin * x + cos * y
    _feet(schedule, grid[0][-1], s, mixture, work, 0.0)
    _feet(schedule, grid[0][-1], s, mixture, work, 0.0)


@kernel
def advance(grid: Any, values: Array, schedule: Any, gains: int, s: Any, mixture: Any, work: Any, tempo: float) -> None:
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
    mix(grid, values, s, mixture)
    x, y, turn = mixture.values[0], mixture.values[1], mixture.values[_TURN]
    if s.stands > 0.0:  # to the middle of the feet
        turn = 0.0
        x = s.stands * dt / _CENTRED_S * 0.25 * s.away[:, 0].sum()
        y = s.stands * dt / _CENTRED_S * 0.25 * s.away[:, 1].sum()
    cos, sin = np.cos(s.pose[2] + 0.5 * turn), np.sin(s.pose[2] + 0.5 * turn)
    if s.stands == 0.0:
        for leg in range(4):
            dx, dy = tempo * mixture.values[ROLL + 2 * leg], tempo * mixture.values[ROLL + 2 * leg + 1]
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
        mix(grid, values, s, mixture)
        for k in range(3):
            still = still and abs(s.velocity[k]) < 2.0 * _STILL[k]
        if still and schedule[2][int(s.position) % values.shape[1]] == 1:
            s.standing = 1
    _feet(schedule, grid[0][-1], s, mixture, work, tempo * dt)


@kernel
def _change_velocity(s: Any, top: float, dt: float) -> None:
    """Brings the velocity nearer to the wanted one; a standing robot has none."""
    for k in range(3):
        s.velocity[k], s.rate[k] = _nearer(k, s.velocity[k], s.rate[k], s.wanted[k], top, dt)
        if s.stands > 0.0:
            s.rate[k], s.velocity[k] = 0.0, 0.0


@inlined
def _nearer(k: int, velocity: float, rate: float, wanted: float, top: float, dt: float) -> tuple[float, float]:
    """One axis of the velocity, and its rate, after so many seconds. Near a gait's `top` speed forwards, m/s, where
    legs are nearly stretched, it accelerates less."""
    most = _ACCELERATION[k]
    fast = min(max(2.5 * velocity / top - 1.25, 0.0), 1.0) if k == 0 else 0.0
    due = min(max((wanted - velocity) / _SETTLE_S, -most), (1.0 - _STRETCHED * fast) * most)
    change = most / _JERK_S * dt
    rate += min(max(due - rate, -change), change)
    return velocity + rate * dt, rate


@kernel
def fill(grid: Any, values: Array, schedule: Any, gains: int, s: Any, mixture: Any, work: Any, table: Any) -> None:
    x0, y0, yaw0 = s.pose[0], s.pose[1], s.pose[2]
    cos, sin = np.cos(yaw0), np.sin(yaw0)
    for k in range(table.shape[0]):
        mix(grid, values, s, mixture)
        row = int(s.position) % values.shape[1]
        _sample(mixture, schedule[0][row], s, table[k])
        most = mixture.gait[np.argmax(mixture.weight)]  # the gait that has most of the mixture
        table[k].gain = most * gains + row // GAIN_SAMPLES
        table[k].sync = s.synced if k > 0 else 0
        dx, dy = s.pose[0] - x0, s.pose[1] - y0
        put_at(cos * dx + sin * dy, -sin * dx + cos * dy, s.pose[2] - yaw0, table[k])
        if k > 0:
            if k + 1 < table.shape[0]:
                advance(grid, values, schedule, gains, s, mixture, work, 1.0)
            continue
        for leg in range(4):
            copy(s.before[leg], work.feet[0, leg])
            copy(s.feet[leg], work.feet[1, leg])
        advance(grid, values, schedule, gains, s, mixture, work, 1.0)
        for leg in range(4):
            copy(s.feet[leg], work.feet[2, leg])
        put_joints(work, table[0])


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
