"""The motion nearest to an animal's that a robot can execute, from the optimal control problem's solution."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import (
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    rotate_planar,
    trunk_quaternion,
)
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.contact_modes import ContactModes, interpolated
from fastmimic.trajectory.node import METRES, ROWS
from fastmimic.trajectory.program import Program, Solution, displacement
from fastmimic.trajectory.solved import Remembered

_RETRIES: Final[tuple[dict[str, float], ...]] = (
    {"contact_m_per_s": 0.5},
    {"contact_m_per_s": 0.5, "clearance_share": 0.3},
    {"contact_m_per_s": 0.5, "clearance_share": 0.3, "friction": 0.5, "torque_share": 0.95},
)
"""Margins that a problem without a solution gives up, in this order."""
_SHORTER: Final = {"window_s": 2.0, "overlap_s": 0.7}
"""Windows of a passage that still has none after the first: there is less at once to agree on."""
_CHECKED_S: Final = 20.0
_MOMENT_S: Final = 1e-4  # for rates of joint angles
_STEADIER: Final[tuple[dict[str, float], ...]] = (
    {"least_force": 0.08},
    {"capture_weight": 1000.0, "acceleration_weight": 3e-3, "capture_m": 0.06},
    {"capture_weight": 1000.0, "capture_m": 0.03, "loading": 3.0},
)
"""Margins that a motion gets instead, one after another, while the robot falls with it."""


@dataclass(frozen=True)
class ExecutableFigures:
    """What changed from the animal's motion to the executable one, and which limits held it back.

    Attributes:
        speed_share: mean speed, share of the animal's.
        period_s: the animal's period, and the executable one's.
        duration_s: greatest change of a contact mode's duration.
        trunk_m, trunk_deg: RMS change of x, y (along the animal's own way) and z, and of roll, pitch and yaw.
        peak: greatest use of each limit, share of the robot's own: 1 is its limit. `friction` is the coefficient.
        active: share of the time at which a limit, with its margin, is reached.
        margins: settings that differ from the default ones: margins given up since no motion keeps them, or margins
            added since the robot fell.
        fell: share of the starts from which the robot falls with it all the same; NaN if it was not tried.
        iterations, cost: of the solver.
    """

    speed_share: float
    period_s: tuple[float, float]
    duration_s: float
    trunk_m: tuple[float, ...]
    trunk_deg: tuple[float, ...]
    peak: dict[str, float]
    active: dict[str, float]
    margins: dict[str, float]
    fell: float
    iterations: int
    cost: float

    def lines(self) -> list[str]:
        """For a human."""
        moved = [f"{a} {1e3 * v:.0f} mm" for a, v in zip("xyz", self.trunk_m, strict=True)]
        moved += [f"{a} {v:.1f}°" for a, v in zip(("roll", "pitch", "yaw"), self.trunk_deg, strict=True)]
        before, after = self.period_s
        used = ", ".join(f"{name} {self.peak[name]:.2f} ({100 * self.active[name]:.0f} %)" for name in self.peak)
        margins = ", ".join(f"{name} {value:g}" for name, value in self.margins.items())
        return [
            f"executable: speed × {self.speed_share:.3f}; period {before:.4f} → {after:.4f} s; contact modes longer or"
            f" shorter by up to {1e3 * self.duration_s:.0f} ms",
            f"trunk changed by {', '.join(moved)} RMS",
            f"greatest share of each limit, and the share of the time at it: {used}",
            *([f"margins changed: {margins}"] if margins else []),
            *([f"falls all the same from {100 * self.fell:.0f} % of the perturbed starts"] * (self.fell > 0)),
        ]


@dataclass(frozen=True, eq=False)
class Executable:
    """An executable motion.

    Attributes:
        motion: it; its `animal` is the given motion, aligned by phase.
        figures: what changed.
        solution: of the optimal control problem.
    """

    motion: Motion
    figures: ExecutableFigures
    solution: Solution


def nearest_executable(
    robot: Robot,
    animal: Motion,
    config: TrajectoryConfig | None = None,
    *,
    falls: Callable[[Robot, Motion], float] | None = None,
) -> Executable:
    """The motion nearest to `animal` that the robot can execute.

    `animal` is a kinematic motion of the robot: feet and trunk as the animal's, contacts clean. `falls` gives the share
    of perturbed starts from which a robot falls with a motion. While it falls, more margins are tried, and the motion
    that falls least is returned; a passage longer than 20 s is not tried. Raises `MotionError` if no motion keeps the
    limits; the message says which. A cycle is then solved anew from the animal's motion, a passage, which takes longer,
    from the motion that falls least so far, whose margins it keeps.
    """
    config = config or TrajectoryConfig()
    problem = Program(robot, animal, config)
    best = _within_limits(problem, {})
    if falls is None or (animal.cycle is None and animal.period_s > _CHECKED_S):
        return best
    fell = falls_with(falls, robot, best.motion)
    for more in _STEADIER:
        if fell == 0:
            break
        known, start = ({}, None) if animal.cycle is not None else (best.figures.margins, best.solution.variables)
        try:
            other = _within_limits(problem, {**known, **more}, start)
        except MotionError:
            continue
        if (share := falls_with(falls, robot, other.motion)) < fell:
            best, fell = other, share
    return replace(best, figures=replace(best.figures, fell=fell))


def falls_with(falls: Callable[[Robot, Motion], float], robot: Robot, motion: Motion) -> float:
    """The share `falls` of a robot with a motion, found once for each if `falls` is this package's own: another's may
    change."""
    if not falls.__module__.startswith("fastmimic."):
        return falls(robot, motion)
    names = ("root_pos_w", "root_quat_wxyz", "joint_pos", "joint_vel", "root_lin_vel_w", "root_ang_vel_w", "contact")
    given = [*(getattr(motion, name) for name in names), np.zeros(3) if motion.cycle is None else motion.cycle]
    known = Remembered(repr((falls.__qualname__, robot.said, motion.rate_hz)), given, outcome=True)
    if (found := known.read()) is None:
        found = {"fell": np.array(falls(robot, motion))}
        known.keep(found)
    return float(found["fell"])


def executable_between(robot: Robot, guess: Motion, config: TrajectoryConfig | None = None) -> Executable:
    """The motion nearest to `guess` that joins the two executable motions of which its first and last samples are
    parts, in the same time. `guess` does not repeat. Raises `MotionError` as `nearest_executable` does."""
    config = replace(config or TrajectoryConfig(), keep_time=True, keep_speed=True)
    return _within_limits(Program(robot, guess, config, joins=True), {})


def _within_limits(problem: Program, margins: dict[str, float], start: Array | None = None) -> Executable:
    """Of a problem with these margins; those of `_RETRIES` are given up while it has no solution, a long passage's in
    shorter windows and from the window before the one that had none: what keeps the margins keeps fewer of them, too.
    Where the solver diverges both with all of them and with those of the last given up, none between helps, but for a
    long passage's shorter windows. With a first guess (n,), a solution with other margins, none is given up."""
    long = not problem.modes.periodic and problem.motion.period_s > _SHORTER["window_s"]
    retries = () if start is not None else _RETRIES
    first = 0
    for given_up in ({}, *({**given_up, **_SHORTER} if long else given_up for given_up in retries)):
        changed = {**margins, **given_up}
        program = _with_margins(problem, changed)
        solution = program.solve(start, first)
        if solution.converged:
            return Executable(sampled(program, solution), _figures(program, solution, changed), solution)
        if solution.so_far is not None:
            start, first = solution.so_far, solution.first
        elif solution.diverged and not given_up and retries and not long:
            program = _with_margins(problem, {**margins, **retries[-1]})
            if (solution := program.solve()).diverged:
                break
    raise MotionError(
        f"no motion of {program.robot.name} near '{program.motion.name}' keeps the limits: {_worst(program, solution)}"
        f" ({solution.status} after {solution.iterations} iterations)"
    )


def _with_margins(problem: Program, changed: dict[str, float]) -> Program:
    return replace(problem, config=replace(problem.config, **changed))  # type: ignore[arg-type]


def _figures(program: Program, solution: Solution, margins: dict[str, float]) -> ExecutableFigures:
    animal = program.animal
    peak = {name: peak for name, (peak, _) in solution.use.items()}
    active = {name: active for name, (_, active) in solution.use.items()}
    wanted = np.column_stack([solution.stride * animal["position"][:, :2], animal["position"][:, 2:], animal["angles"]])
    change = np.sqrt(np.mean((solution.coordinates[:, :6] - wanted) ** 2, axis=0))
    period = program.motion.period_s, float(solution.time[-1])
    return ExecutableFigures(
        speed_share=solution.stride * period[0] / period[1],
        period_s=period,
        duration_s=float(np.abs(solution.durations - program.animal_durations).max()),
        trunk_m=tuple(change[:3].tolist()),
        trunk_deg=tuple(np.degrees(change[3:]).tolist()),
        peak=peak,
        active=active,
        margins=margins,
        fell=np.nan,
        iterations=solution.iterations,
        cost=solution.cost,
    )


_LIMITS = {
    "dynamics": "the wrench that the feet can give",
    "feet": "footholds and swing heights",
    "torque": "joint torque",
    "driving": "joint torque at speed",
    "speed": "joint speed",
    "friction": "friction",
    "knees": "height of the knees",
    "apart": "distance between two legs",
    "turning": "angular acceleration",
}


def _worst(program: Program, solution: Solution) -> str:
    """The limit that is exceeded most, by how much and when."""
    low, high = program.bounds_of_rows()
    rows = program.rows(solution.variables)
    excess = np.maximum(low - rows, rows - high)[: solution.tried + 1]
    node, row = np.unravel_index(int(np.argmax(excess)), excess.shape)
    name = next(name for name, part in ROWS.items() if part.start <= row < part.stop)
    amount = float(excess[node, row])
    size = f"{1e3 * amount / METRES:.0f} mm" if name in ("feet", "knees", "apart") else f"{100 * amount:.0f} %"
    return f"{_LIMITS[name]} by {size} at {solution.time[node]:.2f} s"


def sampled(program: Program, solution: Solution) -> Motion:
    """The solution at the rate of the animal's motion; the period becomes a whole number of samples."""
    robot, animal, modes = program.robot, program.motion, program.modes
    last = max(2, round(solution.time[-1] * animal.rate_hz))
    n = last if modes.periodic else last + 1
    time = np.arange(n) * solution.time[-1] / last  # of the solution
    stretch = last / animal.rate_hz / solution.time[-1]
    wide = _Path(program, solution)
    root, rates = wide.root(time)
    before, joints, after = (wide.joints(time + moment) for moment in (-_MOMENT_S, 0.0, _MOMENT_S))
    contact = modes.contact[np.searchsorted(np.cumsum(solution.durations)[:-1], time + 1e-9, side="right")]
    motion = Motion(
        rate_hz=animal.rate_hz,
        root_pos_w=root[:, :3],
        root_quat_wxyz=trunk_quaternion(root[:, 5], root[:, 3:5]),
        joint_pos=joints,
        joint_vel=(after - before) / (2 * _MOMENT_S * stretch),
        foot_pos_b=foot_positions(robot, joints),
        contact=contact,
        root_lin_vel_w=rates[:, :3] / stretch,
        root_ang_vel_w=_angular_velocity(root, rates) / stretch,
        cycle=_cycle(program, solution, root[0]) if modes.periodic else None,
        provenance=animal.provenance,
    )
    return replace(motion, animal=aligned(animal, modes, solution, time))


def _cycle(program: Program, solution: Solution, root: Array) -> Array:
    """(dx, dy, dyaw) of a period in the heading frame of the first sample, from its x, y, …, yaw (6,)."""
    step, turn = program.displacement
    moved = rotate_planar(turn, root[:2]) + solution.stride * step - root[:2]
    return np.array([*rotate_planar(-root[5], moved), turn])


def aligned(animal: Motion, modes: ContactModes, solution: Solution, time: Array) -> Motion:
    """The animal's motion at the phases of the executable one at `time` (t,), s: its pose and velocities of the same
    share of the same contact mode."""
    nodes = np.append(modes.sample, modes.end[-1]) if modes.periodic else modes.sample
    sample = np.interp(time, solution.time, nodes)
    moved, turn = displacement(animal)

    def at(values: Array, following: Array) -> Array:
        return interpolated(values, following if modes.periodic else values[-1], sample)

    position = animal.root_pos_w - np.array([*animal.root_pos_w[0, :2], 0.0])
    end = np.array([*moved, position[0, 2]])
    following = quat_multiply(quat_from_yaw(turn), animal.root_quat_wxyz[0])
    if following @ animal.root_quat_wxyz[-1] < 0:
        following = -following
    quat = at(animal.root_quat_wxyz, following)

    def turned(vector: Array) -> Array:
        return np.array([*rotate_planar(turn, vector[:2]), vector[2]])

    return Motion(
        rate_hz=animal.rate_hz,
        root_pos_w=at(position, end),
        root_quat_wxyz=quat / np.linalg.norm(quat, axis=1, keepdims=True),
        joint_pos=at(animal.joint_pos, animal.joint_pos[0]),
        joint_vel=at(animal.joint_vel, animal.joint_vel[0]),
        foot_pos_b=at(animal.foot_pos_b, animal.foot_pos_b[0]),
        contact=animal.contact[np.minimum(np.floor(sample + 1e-9).astype(int), animal.n_samples - 1)],
        root_lin_vel_w=at(animal.root_lin_vel_w, turned(animal.root_lin_vel_w[0])),
        root_ang_vel_w=at(animal.root_ang_vel_w, turned(animal.root_ang_vel_w[0])),
        cycle=animal.cycle,
        provenance=animal.provenance,
    )


class _Path:
    """The solution as functions of time; a cycle's with the periods before and after it.

    Halfway between two nodes a path has their mean and the speed from one to the other; in between it is cubic. Where
    nodes are evenly spaced it is a quadratic spline with the problem's own accelerations, so that it keeps the limits
    that the nodes keep.
    """

    def __init__(self, program: Program, solution: Solution) -> None:
        from scipy.interpolate import PchipInterpolator

        modes, q, time = program.modes, solution.coordinates, solution.time
        if modes.periodic:
            step, turn = solution.stride * program.displacement[0], program.displacement[1]
            before, after = q.copy(), q.copy()
            before[:, :2], before[:, 5] = rotate_planar(-turn, q[:, :2] - step), q[:, 5] - turn
            after[:, :2], after[:, 5] = rotate_planar(turn, q[:, :2]) + step, q[:, 5] + turn
            time, period = time[:-1], time[-1]
            q, time = np.concatenate([before, q, after]), np.concatenate([time - period, time, time + period])
        self.robot, turned = program.robot, trunk_quaternion(q[:, 5], q[:, 3:5])
        feet = q[:, None, :3] + quat_rotate(turned[:, None], foot_positions(program.robot, q[:, 6:]))
        self._root, self._feet, self._joints = (_smooth(time, values) for values in (q[:, :6], feet, q[:, 6:]))
        swings = np.tile(~modes.stands, (len(time) // modes.n_nodes + 1, 1))[: len(time)]
        self._swings = PchipInterpolator(time, np.repeat(swings, 3, axis=1).astype(float))

    def root(self, time: Array) -> tuple[Array, Array]:
        """Position, roll, pitch, yaw (t, 6) and their rates."""
        return self._root(time), self._root(time, 1)

    def joints(self, time: Array) -> Array:
        """Joint angles (t, 12): a standing leg's by its foot's path, a swinging one's by their own; between two nodes
        from the one to the other."""
        root = self._root(time)
        quat = trunk_quaternion(root[:, 5], root[:, 3:5])
        foot_b = quat_rotate_inverse(quat[:, None], self._feet(time) - root[:, None, :3])
        standing = np.unwrap(inverse_kinematics(self.robot, foot_b)[0], axis=0)
        return np.asarray(standing + self._swings(time) * (self._joints(time) - standing))


def _smooth(time: Array, values: Array) -> Any:
    """A path near values (n, …) at the nodes' times (n,); it begins and ends at the first and last of them."""
    from scipy.interpolate import CubicHermiteSpline

    steps = np.diff(time).reshape(-1, *[1] * (values.ndim - 1))
    slopes = np.diff(values, axis=0) / steps
    at = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1]), time[-1:]])
    through = np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])
    return CubicHermiteSpline(at, through, np.concatenate([slopes[:1], slopes, slopes[-1:]]))


def _angular_velocity(root: Array, rates: Array) -> Array:
    """(t, 3) rad/s, world, from roll, pitch, yaw and their rates in columns 3 to 5."""
    pitch, yaw = root[:, 4], root[:, 5]
    roll_rate, pitch_rate, yaw_rate = rates[:, 3:].T
    planar = rotate_planar(yaw, np.stack([np.cos(pitch) * roll_rate, pitch_rate], axis=1))
    return np.column_stack([planar, yaw_rate - np.sin(pitch) * roll_rate])
