"""Contact modes, nodes and footholds of a motion: the fixed order in which feet touch down and lift off."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.motion.motion import Motion


class Foothold(NamedTuple):
    """One stance of one leg, and the node at which its foot touches down."""

    leg: int
    node: int


@dataclass(frozen=True, eq=False)
class ContactModes:
    """The nodes of a motion with M contact modes; in each the same feet stand.

    Attributes:
        first, end: (M,) samples of each mode.
        contact: (M, 4) feet in stance.
        steps: (M,) intervals between nodes in each mode.
        sample: (N,) of each node; not whole numbers.
        mode: (N,) of the interval that begins at each node.
        stands: (N, 4) feet at their foothold, at touch-down and lift-off as well.
        loaded: (N, 4) feet that may push: not at touch-down and lift-off, where the force is 0.
        landing: (N, 4) feet that touch down at the next node.
        leaving: (N, 4) feet that lifted off at the node before.
        footholds: of all stances.
        foothold: (N, 4) index of the foothold of a foot that stands or lands, else −1.
        laps: (N, 4) periods by which that foothold's own node is before this node's period.
        periodic: whether the last interval leads to node 0.
    """

    first: NDArray[np.int_]
    end: NDArray[np.int_]
    contact: NDArray[np.bool_]
    steps: NDArray[np.int_]
    sample: Array
    mode: NDArray[np.int_]
    stands: NDArray[np.bool_]
    loaded: NDArray[np.bool_]
    landing: NDArray[np.bool_]
    leaving: NDArray[np.bool_]
    footholds: tuple[Foothold, ...]
    foothold: NDArray[np.int_]
    laps: NDArray[np.int_]
    periodic: bool

    @property
    def n_nodes(self) -> int:
        return len(self.sample)

    @property
    def before(self) -> NDArray[np.int_]:
        """(N,) node before each; the first of a motion that does not repeat has itself."""
        k = np.arange(self.n_nodes) - 1
        return k % self.n_nodes if self.periodic else np.maximum(k, 0)

    @property
    def after(self) -> NDArray[np.int_]:
        """(N,) node after each; the last of a motion that does not repeat has itself."""
        k = np.arange(self.n_nodes) + 1
        return k % self.n_nodes if self.periodic else np.minimum(k, self.n_nodes - 1)

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(N,) nodes with a neighbour on either side, where the dynamics hold."""
        inner = np.ones(self.n_nodes, dtype=np.bool_)
        inner[[0, -1]] = self.periodic
        return inner

    @classmethod
    def of(cls, motion: Motion, node_s: float) -> "ContactModes":
        """The modes of a motion, with nodes about `node_s` apart."""
        n, periodic = motion.n_samples, motion.cycle is not None
        last = n if periodic else n - 1
        changes = np.flatnonzero((motion.contact[1:] != motion.contact[:-1]).any(axis=1)) + 1
        first = np.array([0, *changes[changes < last]])
        end = np.append(first[1:], last)
        contact = motion.contact[first]
        steps = np.maximum(1, np.round((end - first) * motion.dt / node_s).astype(int))
        sample = np.concatenate([a + (b - a) * np.arange(m) / m for a, b, m in zip(first, end, steps, strict=True)])
        mode = np.repeat(np.arange(len(first)), steps)
        if not periodic:
            sample, mode = np.append(sample, last), np.append(mode, len(first) - 1)
        now = contact[mode]
        earlier = np.roll(now, 1, axis=0)
        if not periodic:
            earlier[0], now[-1] = now[0], earlier[-1]
        modes = cls(
            first,
            end,
            contact,
            steps,
            sample,
            mode,
            stands=now | earlier,
            loaded=now & earlier,
            landing=np.zeros_like(now),
            leaving=np.zeros_like(now),
            footholds=(),
            foothold=np.full(now.shape, -1),
            laps=np.zeros(now.shape, dtype=int),
            periodic=periodic,
        )
        return modes._with_footholds()

    def _with_footholds(self) -> "ContactModes":
        found: list[Foothold] = []
        starts = np.concatenate([[0], np.cumsum(self.steps)])
        for leg in range(4):
            for first_mode, count in self._stances(leg):
                nodes = starts[first_mode] + np.arange(
                    sum(self.steps[(first_mode + i) % len(self.steps)] for i in range(count)) + 1
                )
                if count == len(self.steps) and self.periodic:
                    nodes = nodes[:-1]  # a foot that never lifts off
                elif starts[first_mode] > 0 or self.periodic:
                    nodes = np.append(starts[first_mode] - 1, nodes)
                    self.landing[(starts[first_mode] - 1) % self.n_nodes, leg] = True
                if count < len(self.steps) and (self.periodic or nodes[-1] < self.n_nodes - 1):
                    nodes = np.append(nodes, nodes[-1] + 1)
                    self.leaving[nodes[-1] % self.n_nodes, leg] = True
                place = nodes % self.n_nodes
                self.foothold[place, leg] = len(found)
                self.laps[place, leg] = nodes // self.n_nodes
                found.append(Foothold(leg, int(starts[first_mode])))
        self.landing[self.stands] = self.leaving[self.stands] = False  # a swing of one interval
        return ContactModes(**{**self.__dict__, "footholds": tuple(found)})

    def _stances(self, leg: int) -> list[tuple[int, int]]:
        """First mode and number of modes of each stance; one that crosses a cycle's end counts once."""
        down, count = self.contact[:, leg], len(self.steps)
        if down.all():
            return [(0, count)]
        begins = [i for i in range(count) if down[i] and not (down[i - 1] if i or self.periodic else False)]
        found = []
        for i in begins:
            length = 1
            while down[(i + length) % count] and (self.periodic or i + length < count):
                length += 1
            found.append((i, length))
        return found

    def at_nodes(self, values: Array, following: Array) -> Array:
        """Values (n, …) of the motion's samples at the nodes (N, …); `following` (…) is the one after the last."""
        return interpolated(values, following, self.sample)

    def swings(self, leg: int) -> list[NDArray[np.int_]]:
        """Nodes of each swing of a leg."""
        return runs_of(~self.stands[:, leg], self.periodic)


def runs_of(holds: NDArray[np.bool_], periodic: bool) -> list[NDArray[np.int_]]:
    """Nodes (N,) of each run in which a condition holds; one that crosses a cycle's end counts once."""
    if holds.all():
        return [np.arange(len(holds))]
    turn = int(np.argmin(holds)) if periodic else 0
    order = np.roll(np.arange(len(holds)), -turn)
    at = np.flatnonzero(holds[order])
    return [order[part] for part in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(part)]


def interpolated(values: Array, following: Array, sample: Array) -> Array:
    """Values (n, …) at places (k,) in [0, n], not whole numbers; `following` (…) is the one after the last."""
    extended = np.concatenate([values, following[None]])
    whole = np.minimum(np.floor(sample).astype(int), len(values) - 1)
    share = (sample - whole).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(extended[whole] * (1 - share) + extended[whole + 1] * share)
