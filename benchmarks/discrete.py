"""Pieces of the dog's takes that do not repeat: fitted, tracked as retargeted, optimised, tracked again.

    python benchmarks/discrete.py [--robot a1] [--pieces dog_walk09:2404:2450 …] [--iterations 20]
                                  [--population 6] [--seed 0] [--longest 10] [--out runs/discrete] [--write]

By default every piece of up to 10 s that `fastmimic segment` calls discrete in the five takes, and the left turn of
dog_walk09, which barely repeats. Each is retargeted, run once from its start and three times with perturbed joints and
velocity, optimised (mbc-dmp, one set of parameters for all), and run like that again. Beside that stands what the two
primitives make of it: the greatest error of a foot in the fit of a discrete DMP, and of a rhythmic one over the whole
piece. What is finished is kept in `--out` and not run again. Needs `fastmimic data fetch`, or FASTMIMIC_DATA. `--write`
puts the table between the markers in docs/segment.md.
"""

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put

import fastmimic as fm
from fastmimic.base.files import replace_file
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.data import data_folder
from fastmimic.clips.segment import DISCRETE, find_segments
from fastmimic.episode.feasibility import demands, describe_fall, reasons
from fastmimic.primitive import MotionDmp, RhythmicDmp
from fastmimic.primitive.discrete import MAX_S
from fastmimic.primitive.motion_dmp import FEET, phases, to_coordinates
from fastmimic.runs.loading import find_motion

TAKES = ("dog_walk00", "dog_walk03", "dog_walk09", "dog_run00", "dog_turn00")
TURN = "dog_walk09:2404:2450"
EPISODES = 4
PAGE = Path(__file__).resolve().parent.parent / "docs" / "segment.md"


def take(name: str) -> Path:
    """The file of a take."""
    return data_folder() / "dog_keypoints" / f"{name}_joint_pos.txt"


def all_pieces(longest_s: float) -> list[str]:
    """The left turn, and every discrete piece of the takes that lasts no longer."""
    found = [TURN]
    for name in TAKES:
        clip = open_clip(take(name))
        frames = longest_s * clip.rate_hz
        pieces = [s for s in find_segments(clip) if s.gait == DISCRETE and s.end - s.start <= frames]
        found += [f"{name}:{s.start}:{s.end}" for s in pieces]
    return found


def fit_errors(motion: fm.Motion, robot: fm.Robot) -> dict[str, float]:
    """The greatest error of any foot's coordinate, m, fitted with either primitive."""
    dmp = MotionDmp.fit(motion, robot)
    samples = to_coordinates(motion, dmp.twist)
    rhythmic = RhythmicDmp.fit(samples, motion.period_s, dmp.primitive.n_basis)
    made = {
        "discrete": dmp.primitive.position(motion.n_samples),
        "rhythmic": rhythmic.position(phases(motion.n_samples)),
    }
    return {name: float(np.abs((y - samples)[:, FEET]).max()) for name, y in made.items()}


def run(piece: str, robot: fm.Robot, iterations: int, population: int, seed: int, out: Path) -> dict[str, Any]:
    """One row, from `out` if it is there."""
    file = out / f"{piece.replace(':', '-')}.json"
    if file.exists():
        return json.loads(file.read_text())
    print(f"{piece} …", file=sys.stderr, flush=True)
    name, first, end = piece.split(":")
    clip = open_clip(take(name), robot=robot, frames=(int(first), int(end)), cycle=False)
    motion, report = find_motion(clip).retarget(robot)
    result = fm.imitate(motion, robot, iterations=iterations, population=population, seed=seed)
    before, after = (fm.evaluate(m, robot, episodes=EPISODES, seed=seed, log=True) for m in (motion, result.motion))
    fell = np.flatnonzero(after.rollout.fell)
    fall = describe_fall(robot, after.rollout, int(fell[0])) if len(fell) else None
    travel = motion.root_pos_w[-1, :2] - motion.root_pos_w[0, :2]
    row = {
        "piece": piece,
        "duration_s": motion.period_s,
        "held_s": motion.provenance.held_s,
        "travel_m": float(np.hypot(*travel)),
        "turn_deg": report.after.yaw_deg,
        "height_m": [float(motion.root_pos_w[i, 2]) for i in (0, -1)],
        "unmet": [bound.name for bound in report.bounds if not bound.met],
        "fit_error_m": fit_errors(motion, robot),
        "reward": [float(e.rollout.reward[0]) for e in (before, after)],
        "reward_perturbed": [float(e.rollout.reward[1:].mean()) for e in (before, after)],
        "fell": [[bool(f) for f in e.rollout.fell] for e in (before, after)],
        "first_fall_s": None if fall is None else fall.time_s,
        "reasons": [f"{r.kind}: {r.text}" for r in (reasons(demands(robot, motion), fall) if fall is not None else ())],
        "metrics": result.metrics(),
    }
    result.motion.save(file.with_suffix(".npz"))
    replace_file(file, lambda f: f.write(json.dumps(row, indent=1).encode()))
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [
        "| piece | s (held) | travel, turn | height, first to last | reward before → after | perturbed"
        f" | fell of {EPISODES} | foot error of the fit, mm: discrete, rhythmic | why it fell |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        held = f" ({row['held_s']:.1f})" if row["held_s"] else ""
        (a, b), (c, d), (e, f) = row["reward"], row["reward_perturbed"], map(sum, row["fell"])
        error, (first, last) = row["fit_error_m"], row["height_m"]
        why = "; ".join(row["reasons"][:2])
        lines.append(
            f"| {row['piece'].replace(':', ' ', 1)} | {row['duration_s']:.2f}{held}"
            f" | {row['travel_m']:.2f} m, {row['turn_deg']:+.0f}° | {first:.2f} → {last:.2f} m"
            f" | {a:.3f} → {b:.3f} | {c:.3f} → {d:.3f} | {e} → {f}"
            f" | {1e3 * error['discrete']:.1f}, {1e3 * error['rhythmic']:.0f} | {why or '–'} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--pieces", nargs="*", help="TAKE:FIRST:END")
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--population", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--longest", type=float, default=10.0, metavar="S", help="leaves out longer pieces; 30 at most")
    parser.add_argument("--out", type=Path, default=Path("runs/discrete"))
    parser.add_argument("--write", action="store_true", help="put the table into docs/segment.md")
    args = parser.parse_args()
    for piece in args.pieces or ():
        if not re.fullmatch(r"\w+:\d+:\d+", piece):
            parser.error(f"a piece is TAKE:FIRST:END, such as {TURN}; found '{piece}'")
    robot = fm.load_robot(args.robot)
    args.out.mkdir(parents=True, exist_ok=True)
    pieces = args.pieces or all_pieces(min(args.longest, MAX_S))
    rows = [run(piece, robot, args.iterations, args.population, args.seed, args.out) for piece in pieces]
    counts = [sum(not any(row["fell"][i]) for row in rows) for i in (0, 1)]
    command = (
        f"python benchmarks/discrete.py --robot {robot.name} --iterations {args.iterations} --population"
        f" {args.population} --seed {args.seed} --longest {args.longest:g}"
    )
    said = (
        f"`{command}`. Tracked without a fall in all {EPISODES} episodes: {counts[0]} of {len(rows)} as retargeted,"
        f" {counts[1]} optimised."
    )
    text = f"{said}\n\n{table(rows)}"
    print(text)
    if args.write:
        put(PAGE, "discrete", text)


if __name__ == "__main__":
    main()
