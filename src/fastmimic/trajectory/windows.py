"""Windows of a long motion that does not repeat, solved one after the other, so that time and memory grow linearly."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.contact_modes import ContactModes
from fastmimic.trajectory.node import GIVEN, ROWS

if TYPE_CHECKING:
    from fastmimic.trajectory.program import Program


@dataclass(frozen=True, eq=False)
class Guess:
    """Variables (n,) of a program, and the way (N, 2) that the trunk follows with them: the animal's x and y at the
    nodes, each window's part with its own stride."""

    variables: Array
    way: Array


@dataclass(frozen=True, eq=False)
class Window:
    """Nodes (k,) that are solved together, from `begins_s` to `ends_s` of the animal's time. All before the first of
    them has been solved; it is its last node that is held."""

    nodes: NDArray[np.int_]
    begins_s: float
    ends_s: float

    def given(self, problem: "Program", way: Array) -> Array:
        """(N, 91) parameters of the nodes; the stride counts from the window's beginning, a place of the way (N, 2)."""
        given, first = problem.given.copy(), int(self.nodes[0])
        given[:, GIVEN["origin"]] = way[first]
        given[:, GIVEN["position"]][:, :2] -= problem.animal["position"][first, :2]
        return given

    def held(
        self, problem: "Program", found: Array, bounds: tuple[Array, Array], rows: tuple[Array, Array]
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """The bounds of all variables (n,) and of all rows (N, 93), with what is solved held at `found` (n,)."""
        modes, at = problem.modes, problem.at
        low, high, least, most = (bound.copy() for bound in (*bounds, *rows))
        if not problem.config.window_strides:
            low[at["stride"]] = high[at["stride"]] = 1.0
        first = int(self.nodes[0])
        if first == 0:
            return (low, high), (least, most)
        standing = np.unique(modes.foothold[: first + 1])
        holds = at["holds"] + 2 * standing[standing >= 0][:, None] + np.arange(2)
        solved = np.concatenate(
            [
                np.arange(18 * (first + 1)),
                at["force"] + np.arange(12 * first),
                at["durations"] + np.arange(modes.mode[first] + 1),
                holds.ravel(),
            ]
        )
        low[solved] = high[solved] = found[solved]
        for name in ("feet", "knees"):  # of the node that is held
            least[first, ROWS[name]], most[first, ROWS[name]] = -np.inf, np.inf
        return (low, high), (least, most)

    def followed(self, problem: "Program", guess: Guess, found: Array) -> Guess:
        """The guess with what the window's variables are found to be; what comes after it is moved along."""
        at, (first, last) = problem.at, self.nodes[[0, -1]]
        w, way, animal = guess.variables.copy(), guess.way.copy(), problem.animal["position"][:, :2]
        used = np.unique(problem.index[self.nodes])
        w[used] = found
        way[self.nodes] = way[first] + w[at["stride"]] * (animal[self.nodes] - animal[first])
        moved = way[last] - guess.way[last]
        way[last + 1 :] += moved
        begun = np.unique(problem.modes.foothold[: last + 1])
        holds = np.setdiff1d(np.arange(len(problem.modes.footholds)), begun)
        later = np.concatenate([18 * np.arange(last + 1, problem.modes.n_nodes), at["holds"] + 2 * holds])
        later = later[~np.isin(later, used)]
        w[later[:, None] + np.arange(2)] += moved
        return Guess(w, way)


def windows_of(modes: ContactModes, step_s: Array, config: TrajectoryConfig, first: int = 0) -> list[Window]:
    """Windows of `window_s` from node `first` on, each of which begins `overlap_s` before the end of the one before;
    one for a cycle, or where the rest is not much longer. `step_s` (N,) are the intervals after the nodes."""
    time, n = np.cumsum(step_s) - step_s, modes.n_nodes
    found = list[Window]()
    while True:
        end = int(np.searchsorted(time, time[first] + config.window_s))
        if modes.periodic or time[-1] - time[min(end, n - 1)] < config.overlap_s:
            return [*found, Window(np.arange(first, n), float(time[first]), float(time[-1]))]
        found.append(Window(np.arange(first, end), float(time[first]), float(time[end])))
        first = int(np.searchsorted(time, time[end] - config.overlap_s))
