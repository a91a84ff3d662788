"""The motion nearest to an animal's that a robot can execute, from the optimal control problem's solution."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fastmimic.base.errors import MotionError
from fastmimic.motion.limits import use_of_limits
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.node import METRES, ROWS
from fastmimic.trajectory.program import Program, Solution
from fastmimic.trajectory.sampled import sampled
from fastmimic.trajectory.solve import LIMITS
from fastmimic.trajectory.solved import Remembered
from fastmimic.trajectory.windows import Guess

_RETRIES: Final[tuple[dict[str, float], ...]] = (
    {"contact_m_per_s": 0.5},
    {"contact_m_per_s": 0.5, "clearance_share": 0.3},
    {"contact_m_per_s": 0.5, "clearance_share": 0.3, "friction": 0.5, "torque_share": 0.95},
)
"""Margins that a problem without a solution gives up, in this order."""
_SHORTER: Final = {"window_s": 2.0, "overlap_s": 0.7}
"""Windows of a passage that still has none after the first: there is less at once to agree on."""
_CHECKED_EVERY_S: Final = 0.002
_FRICTION: Final = 0.6  # at 99 % of the instants
_TIGHTER: Final[tuple[dict[str, float], ...]] = (
    {"friction": 0.36},
    {"friction": 0.36, "torque_share": 0.75, "speed_share": 0.9},
)
"""Margins that a motion gets while it exceeds a limit between the nodes: the first ones where friction alone does, and
the others while one is exceeded still."""
_STEADIER: Final[tuple[dict[str, float], ...]] = (
    {"least_force": 0.08},
    {"capture_weight": 1000.0, "acceleration_weight": 3e-3, "capture_m": 0.06},
    {"capture_weight": 1000.0, "capture_m": 0.03, "loading": 3.0},
)
"""Margins that a motion gets instead, one after another, while the robot falls with it."""
_FURTHER: Final = 2.0  # times the cost, at which such margins are not taken: what is left is another motion
_PASSAGE_TIGHTER: Final = {"knee_m": 0.06, "window_strides": True}
_PASSAGE_STEADIER: Final = {"knee_m": 0.09}
"""What a passage gets with them: speed gives way where it is too high, and knees are higher, since a loaded foot gives
way by 2 cm, so that a calf touches the ground where an animal crouches before it runs."""


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
        most: greatest share of each limit, between the nodes as well, by inverse dynamics at 500 Hz; of friction that
            at 99 % of the instants, as share of 0.6.
        margins: settings that differ from the default ones: margins given up since no motion keeps them, or added since
            the motion exceeded a limit or the robot fell.
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
    most: dict[str, float]
    margins: dict[str, float]
    fell: float
    iterations: int
    cost: float

    @property
    def exceeded(self) -> list[str]:
        """Limits that are exceeded between the nodes."""
        return [name for name, most in self.most.items() if most > 1]

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
            f"greatest share of each limit (friction: the coefficient), and of the time at it less a margin: {used}",
            *(f"exceeded between the nodes: {name}, {most:.2f} of it" for name, most in self.most.items() if most > 1),
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

    `animal` is a kinematic motion of the robot: feet and trunk as the animal's, contacts clean. A motion that exceeds a
    limit between the nodes is solved again with more margin. `falls` gives the share of perturbed starts from which a
    robot falls with a motion: while it falls, other margins are tried, and the motion that falls least is returned.
    Raises `MotionError` if no motion keeps the limits; the message says which. A cycle is solved anew from the animal's
    motion, a passage, which takes longer, from the best motion so far, whose margins it keeps.
    """
    problem = Program(robot, animal, config or TrajectoryConfig())
    best, tighter = _within_limits(problem, {}), dict[str, float]()

    def with_more(margins: dict[str, float], of_passage: dict[str, float]) -> Executable | None:
        try:
            if animal.cycle is not None:
                return _within_limits(problem, {**tighter, **margins})
            return _within_limits(problem, {**best.figures.margins, **margins, **of_passage}, best.solution.guess)
        except MotionError:
            return None

    for more in _TIGHTER if best.figures.exceeded == ["friction"] else _TIGHTER[1:]:
        other = with_more(more, _PASSAGE_TIGHTER) if best.figures.exceeded else None
        nearer = other and other.figures.cost < _FURTHER * best.figures.cost
        if other and nearer and max(other.figures.most.values()) < max(best.figures.most.values()):
            best, tighter = other, more
    if falls is None:
        return best
    fell = falls_with(falls, robot, best.motion)
    for more in _STEADIER:
        other = with_more(more, _PASSAGE_STEADIER) if fell else None
        if other and (share := falls_with(falls, robot, other.motion)) < fell:
            best, fell = other, share
    return replace(best, figures=replace(best.figures, fell=fell))


def _most_used(robot: Robot, motion: Motion, skipped_s: float) -> dict[str, float]:
    """Greatest share of each limit that a motion uses by inverse dynamics at 500 Hz, without what its ends have
    skipped; of friction 0.6 at 99 % of the instants."""
    every, skipped = (max(1, round(time_s * motion.rate_hz)) for time_s in (_CHECKED_EVERY_S, skipped_s))
    ends = 0 if motion.cycle is not None else min(skipped, motion.n_samples // 3)
    use = use_of_limits(robot, motion, np.arange(ends, motion.n_samples - ends, every))
    stands = np.isfinite(use.friction)
    slope = np.percentile(use.friction[stands], 99) if stands.any() else 0.0
    used = (use.torque.max(), use.torque_at_speed.max(), use.joint_speed.max(), slope / _FRICTION)
    return dict(zip(LIMITS, map(float, used), strict=True))


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


def _within_limits(problem: Program, margins: dict[str, float], start: Guess | None = None) -> Executable:
    """Of a problem with these margins; those of `_RETRIES` are given up while it has no solution, a long passage's in
    shorter windows and from the window before the one that had none: what keeps the margins keeps fewer of them, too.
    Where the solver diverges both with all of them and with those of the last given up, none between helps, but for a
    long passage's shorter windows. With a first guess, a solution with other margins, none is given up."""
    long = not problem.modes.periodic and problem.motion.period_s > _SHORTER["window_s"]
    retries = () if start is not None else _RETRIES
    first = 0
    for given_up in ({}, *({**given_up, **_SHORTER} if long else given_up for given_up in retries)):
        changed = {**margins, **given_up}
        program = _with_margins(problem, changed)
        solution = program.solve(start, first)
        if solution.converged:
            motion = sampled(program, solution)
            return Executable(motion, _figures(program, solution, motion, changed), solution)
        if solution.so_far is not None:
            start, first = solution.so_far, solution.first
        elif solution.diverged and not given_up and retries and not long:
            program = _with_margins(problem, {**margins, **retries[-1]})
            if (solution := program.solve()).diverged:
                break
    raise MotionError(
        f"no motion of {program.robot.name} near '{program.motion.name}' keeps the limits: {_worst(program, solution)}"
        f" ({'diverges' if solution.diverged else solution.status.replace('_', ' ').lower()}"
        f" after {solution.iterations} iterations)"
    )


def _with_margins(problem: Program, changed: dict[str, float]) -> Program:
    return replace(problem, config=replace(problem.config, **changed))  # type: ignore[arg-type]


def _figures(program: Program, solution: Solution, motion: Motion, margins: dict[str, float]) -> ExecutableFigures:
    animal = program.animal
    peak = {name: peak for name, (peak, _) in solution.use.items()}
    active = {name: active for name, (_, active) in solution.use.items()}
    wanted = np.column_stack([solution.way, animal["position"][:, 2:], animal["angles"]])
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
        most=_most_used(program.robot, motion, 2 * float(np.diff(solution.time).max())),
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
