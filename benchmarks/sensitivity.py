"""What each kind of parameter of a motion is worth by itself, and what it costs in style.

    python benchmarks/sensitivity.py [--motions NAME ...] [--write]

One parameter at a time is moved over its range, everything else as retargeted: baseline and amplitude of each foot's
height and ground plane, the trunk's height and pitch, and each foot's phase and duty factor, which no method optimises.
A value's worth is the mean objective (reward less the penalty for lost clearance) over a nominal and three perturbed
episodes, less that of the motion as it is. For each kind the table has the best value that was found, its style
distance, and the share of the values that made it worse. With `--write` it goes between the markers in
docs/comparison.md. Recorded motions need `fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from marked import put
from numpy.typing import NDArray

import fastmimic as fm
from fastmimic.episode.metrics import style_distance
from fastmimic.episode.plan import Start, perturbed_start
from fastmimic.motion.contacts import stances_of
from fastmimic.optimize.parameters import FEET_AND_TRUNK
from fastmimic.optimize.problem import ImitationProblem
from fastmimic.primitive import MotionDmp
from fastmimic.primitive.motion_dmp import foot_table

Array = NDArray[np.float64]

DOCS = Path(__file__).resolve().parent.parent / "docs"
MOTIONS = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps")
SHARES = (-0.5, -0.25, -0.1, 0.1, 0.25, 0.5)  # of the way to the bound
TIMING = 0.04  # cycles: largest change of phase and duty
EPISODES, EPISODE_S = 4, 5.0
KINDS = (
    *("height of a foot: baseline", "height of a foot: amplitude"),
    *("path of a foot: baseline", "path of a foot: amplitude"),
    *("height of the trunk", "pitch of the trunk", "phase of a foot", "duty factor of a foot"),
)


class Change(NamedTuple):
    """One value of one parameter: its kind, and the reference (t,) of `SAMPLE` that it makes."""

    kind: str
    table: NDArray[Any]


def kind_of(parameter: str) -> str:
    dimension, what = parameter.split(".")
    if dimension.startswith("root"):
        return "pitch of the trunk" if dimension.endswith("pitch") else "height of the trunk"
    of = "height" if dimension.endswith("_z") else "path"
    return f"{of} of a foot: {'baseline' if what == 'goal' else 'amplitude'}"


def modulations(problem: ImitationProblem) -> Iterator[Change]:
    lower, upper = problem.bounds
    for i, parameter in enumerate(problem.parameters):
        for share in SHARES:
            x = problem.initial
            x[i] += share * (upper[i] - x[i] if share > 0 else x[i] - lower[i])
            yield Change(kind_of(parameter.name), problem.tables(x[None])[0])


def timings(problem: ImitationProblem) -> Iterator[Change]:
    table = problem.tables(problem.initial[None])[0]
    n = len(table)
    for leg in range(4):
        stances = stances_of(table["contact"][:, leg] > 0, periodic=True)
        if not 0 < sum(s.duration for s in stances) < n:
            continue
        for share in SHARES:
            shift = share * TIMING * n
            yield Change("phase of a foot", warped(problem, table, leg, shifted(shift)))
            yield Change("duty factor of a foot", warped(problem, table, leg, longer_stances(stances, n, shift)))


def shifted(by: float) -> Callable[[Array], Array]:
    return lambda t: t + by


def longer_stances(stances: list[Any], n: int, by: float) -> Callable[[Array], Array]:
    """Which of the old samples each sample shows, if every stance lasts longer by its share of `by` samples, about its
    middle."""
    of = by / len(stances)
    old, new = [], []
    for stance in stances:
        old += [stance.touch_down, stance.lift_off]
        new += [stance.touch_down - of / 2, stance.lift_off + of / 2]
    order = np.argsort(old)
    old_edges, new_edges = np.array(old, float)[order], np.array(new, float)[order]
    around = [np.concatenate([e - n, e, e + n, e + 2 * n]) for e in (new_edges, old_edges)]
    return lambda t: np.interp(t, around[0], around[1])


def warped(problem: ImitationProblem, table: NDArray[Any], leg: int, warp: Callable[[Array], Array]) -> NDArray[Any]:
    """The reference with one leg's course and contacts at other times."""
    n, rate_hz = len(table), problem.config.rate_hz
    at = warp(np.arange(n, dtype=float))
    result = table.copy()
    for axis in range(3):
        course = table["foot_pos"][:, leg, axis]
        result["foot_pos"][:, leg, axis] = np.interp(at % n, np.arange(n + 1), np.append(course, course[0]))
    result["contact"][:, leg] = table["contact"][np.round(at).astype(int) % n, leg]
    feet = foot_table(problem.robot, result["foot_pos"][None], rate_hz)
    result["foot_pos"], result["joint_pos"], velocity = feet.foot_pos_b[0], feet.joint_pos[0], feet.joint_vel[0]
    result["joint_vel"] = velocity
    result["joint_acc"] = (np.roll(velocity, -1, axis=0) - np.roll(velocity, 1, axis=0)) * (0.5 * rate_hz)
    return result


def scores(problem: ImitationProblem, tables: NDArray[Any]) -> Array:
    """Mean objective of each reference (m, t), (m,)."""
    steps = round(EPISODE_S * problem.config.rate_hz)
    start = perturbed_start(EPISODES, tables.shape[1], np.random.default_rng(0))
    found = []
    for episode in range(EPISODES):
        same = start.part(slice(episode, episode + 1))
        each = np.zeros(len(tables), int)
        of_all = Start(same.sample[each], same.joint_offset[each], same.velocity_offset[each])
        found.append(np.concatenate([problem.score(r) for r in problem.rollout(tables, of_all, steps)]))
    return np.mean(found, axis=0)


def rows(name: str, robot: fm.Robot) -> list[str]:
    """The table's rows of one motion."""
    demonstration, _ = fm.retarget(fm.open_clip(name, robot=robot), robot)
    dmp = MotionDmp.fit(demonstration, robot)
    problem = ImitationProblem(robot, demonstration, dmp, group=FEET_AND_TRUNK)
    changes = [*modulations(problem), *timings(problem)]
    base = problem.tables(problem.initial[None])[0]
    worth = scores(problem, np.stack([base, *(c.table for c in changes)]))
    gain = worth[1:] - worth[0]
    lines = []
    for kind in KINDS:
        mine = [i for i, c in enumerate(changes) if c.kind == kind]
        if not mine:
            continue
        best = max(mine, key=lambda i: gain[i])
        style = style_distance(changes[best].table["foot_pos"], base["foot_pos"])
        worse = np.mean(gain[mine] < 0)
        lines.append(
            f"| `{name}` | {kind} | {worth[0]:.3f} | {gain[best]:+.4f} | {style:.2f} | {gain[mine].min():+.3f}"
            f" | {worse:.0%} of {len(mine)} |"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=MOTIONS)
    parser.add_argument("--write", action="store_true", help="put the table into docs/comparison.md")
    args = parser.parse_args()
    robot = fm.load_robot("a1")
    table = [
        "| motion | what is moved | as it is | best change | its style distance | worst change | values that lose |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in args.motions:
        print(f"{name} …", file=sys.stderr, flush=True)
        table += rows(name, robot)
    print("\n".join(table))
    if args.write:
        put(DOCS / "comparison.md", "sensitivity", "\n".join(table))


if __name__ == "__main__":
    main()
