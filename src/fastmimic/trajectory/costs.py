"""Costs of a problem beyond those of its nodes: changed durations and stride, forces that change, and the ends."""

from typing import TYPE_CHECKING, Any

import numpy as np

from fastmimic.base.arrays import Array

if TYPE_CHECKING:
    from fastmimic.trajectory.program import Program


def quadratic_costs(problem: "Program") -> tuple[Any, Array]:
    """Sparse E and e of the cost |E w − e|² of changed durations, and of forces that differ between nodes."""
    import scipy.sparse as sp

    modes, config, at = problem.modes, problem.config, problem.at
    count = len(modes.steps)
    root = np.sqrt(config.duration_weight)
    durations = sp.csr_matrix(
        (np.full(count, root), (np.arange(count), at["durations"] + np.arange(count))), (count, problem.n)
    )
    moves = modes.moves & modes.moves[modes.after]
    follows = modes.stands & modes.stands[modes.after] & moves[:, None]
    node, leg = np.nonzero(follows)
    here = at["force"] + (12 * node + 3 * leg)[:, None] + np.arange(3)
    there = at["force"] + (12 * modes.after[node] + 3 * leg)[:, None] + np.arange(3)
    k = here.size
    step = np.repeat(problem.animal_steps[node], 3)
    rate = np.sqrt(config.force_rate_weight / step / problem.animal_durations.sum())
    values = np.concatenate([rate, -rate])
    rates = sp.csr_matrix(
        (values, (np.tile(np.arange(k), 2), np.concatenate([here.ravel(), there.ravel()]))), (k, problem.n)
    )
    stride = sp.csr_matrix(([np.sqrt(config.stride_weight)], ([0], [at["stride"]])), (1, problem.n))
    wanted = [root * problem.animal_durations, np.zeros(k), [np.sqrt(config.stride_weight)]]
    ends, as_animal = _ends(problem)
    return sp.vstack([durations, rates, stride, ends]).tocsr(), np.concatenate([*wanted, as_animal])


def _ends(problem: "Program") -> tuple[Any, Array]:
    """The same of the trunk's velocity at the ends of a motion that does not repeat: the animal's. The joints' is free:
    with those of a faster animal at its last node, a robot sinks."""
    import scipy.sparse as sp

    if problem.modes.periodic:
        return sp.csr_matrix((0, problem.n)), np.zeros(0)
    column = 18 * np.array([0, problem.modes.n_nodes - 2])[:, None] + np.arange(6)
    weight = np.sqrt(problem.config.end_weight) / np.repeat(problem.animal_steps[[0, -2]], 6)
    row = np.arange(column.size)
    places = np.tile(row, 2), np.concatenate([column.ravel(), column.ravel() + 18])
    matrix = sp.csr_matrix((np.concatenate([-weight, weight]), places), (column.size, problem.n))
    return matrix, matrix[:, : problem.at["force"]] @ problem.coordinates().ravel()
