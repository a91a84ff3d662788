"""Solves a problem by IPOPT, in one piece or in windows, or remembers the answer."""

import logging
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.signals import interrupts_kept
from fastmimic.trajectory.costs import quadratic_costs
from fastmimic.trajectory.ipopt import make_solver
from fastmimic.trajectory.node import ROWS
from fastmimic.trajectory.solved import Remembered
from fastmimic.trajectory.windows import Guess, windows_of

if TYPE_CHECKING:
    from fastmimic.trajectory.program import Program

_LOG = logging.getLogger(__name__)
LIMITS: Final = ("torque", "torque at speed", "joint speed", "friction")
_AT_LIMIT: Final = 1e-3


def answered(problem: "Program", start: Guess, first: int = 0) -> dict[str, Array]:
    """The solver's answer: in one piece, or in windows if the motion does not repeat and is long. Before node `first`
    the start is a solution already."""
    everything = np.arange(problem.modes.n_nodes)
    windows = windows_of(problem.modes, problem.animal_steps, problem.config, first)
    bounds, rows = problem.bounds_of_variables(), problem.bounds_of_rows()
    if len(windows) == 1 and first == 0:
        return _answer(problem, everything, start.variables, problem.given, bounds, rows)
    answers = list[dict[str, Array]]()
    for window in windows:
        if answers:
            _LOG.info("%s: %.0f of %.0f s are solved", problem.motion.name, window.begins_s, windows[-1].ends_s)
        given, so_far = window.given(problem, start.way), start
        held = window.held(problem, start.variables, bounds, rows)
        answers.append(_answer(problem, window.nodes, start.variables, given, *held))
        start = window.followed(problem, start, answers[-1]["variables"])
        if not answers[-1]["converged"]:
            break
    return {
        **answers[-1],
        "variables": start.variables,
        "way": start.way,
        "tried": np.array(window.nodes[-1]),
        "so_far": so_far.variables,
        "way_so_far": so_far.way,
        "first": np.array(windows[max(len(answers) - 2, 0)].nodes[0]),
        "use": _use(problem, start.variables),
        "cost": np.sum([answer["cost"] for answer in answers]),
        "iterations": np.sum([answer["iterations"] for answer in answers]),
    }


def _answer(
    problem: "Program",
    nodes: NDArray[np.int_],
    start: Array,
    given: Array,
    bounds: tuple[Array, Array],
    rows: tuple[Array, Array],
) -> dict[str, Array]:
    """The solver's answer for some nodes (k,), or what it answered to the same problem before. `start` and `bounds`
    are of all variables (n,), `given` (N, 91) and `rows` of all nodes (N, 93); the answer has the variables that the
    nodes use."""
    used = np.unique(problem.index[nodes])
    index = np.searchsorted(used, problem.index[nodes])
    first, low, high = start[used], bounds[0][used], bounds[1][used]
    within = rows[0][nodes], rows[1][nodes]
    smooth, wanted = quadratic_costs(problem)
    outside = np.ones(problem.n)
    outside[used] = 0.0
    inside = abs(smooth) @ outside == 0.0
    smooth, wanted = smooth[inside][:, used], wanted[inside]
    parts = (given[nodes], low, high, *within, smooth.data, wanted, first)
    known = Remembered(repr((problem.config, problem.robot.said)), [index, *parts])
    if (found := known.read()) is not None:
        return found
    solver, (least, most) = make_solver(
        problem.functions, index, given[nodes], within, (smooth, wanted), problem.config
    )
    with interrupts_kept(solver.interrupts):
        answer = solver(x0=first, lbx=low, ubx=high, lbg=least, ubg=most)
    stats, w = solver.stats(), start.copy()
    w[used] = np.array(answer["x"]).ravel()
    found = {
        "variables": w[used],
        "use": _use(problem, w),
        "cost": np.array(float(answer["f"])),
        "converged": np.array(bool(stats["success"])),
        "status": np.array(str(stats["return_status"])),
        "iterations": np.array(int(stats["iter_count"])),
    }
    if stats["success"]:
        known.keep(found)
    return found


def _use(problem: "Program", variables: Array) -> Array:
    """(4, 2) of `LIMITS`: the greatest use, share of the robot's own, and the share of the time at the limit with
    its margin. Friction is the coefficient."""
    modes, rows, (low, high) = problem.modes, problem.rows(variables), problem.bounds_of_rows()
    at_limit = (np.minimum(rows - low, high - rows) < _AT_LIMIT) & (low < high)
    force = variables[problem.at["force"] : problem.at["durations"]].reshape(-1, 4, 3)
    loaded = np.where(modes.loaded & modes.moves[:, None], force[..., 2], np.inf)
    values = {
        ("torque",): problem.config.torque_share * np.abs(rows[:, ROWS["torque"]]),
        ("driving",): 0.5 * np.abs(rows[:, ROWS["driving"]]),
        ("speed",): np.abs(rows[:, ROWS["speed"]]),
        ("friction",): np.abs(force[..., :2]).max(axis=-1) / loaded,
    }
    peak = [value[modes.moves].max() for value in values.values()]
    active = [np.any([at_limit[:, ROWS[row]].any(axis=1) for row in names], axis=0).mean() for names in values]
    return np.column_stack([peak, active])
