"""Which motions are tracked, which not, and why: all named ones, and cycles cut at random from the dog's long takes.

    python benchmarks/motions.py [--robot a1] [--cycles 60] [--seed 0] [--duration 10] [--method mbc]
                                 [--out runs/motions] [--write]

Nothing is optimised: each motion is retargeted and run as it is, one nominal and three perturbed episodes. A motion is
tracked if none of them ends in a fall. Prints the table, writes it and its figures to `--out`; `--write` puts it
between the markers in docs/motions.md. Needs `fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from docs_table import put
from motion_survey import Surveyed, random_cycles, summary, survey, table

import fastmimic as fm
from fastmimic.base.files import replace_file
from fastmimic.clips.catalogue import motion_names, open_clip

PAGE = Path(__file__).resolve().parent.parent / "docs" / "motions.md"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--cycles", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--method", default="mbc")
    parser.add_argument("--out", type=Path, default=Path("runs/motions"))
    parser.add_argument("--write", action="store_true", help="put the table into docs/motions.md")
    args = parser.parse_args()
    robot = fm.load_robot(args.robot)
    clips = {
        "Named motions": [open_clip(name, robot=robot) for name in motion_names()],
        "Random cycles": random_cycles(args.cycles, np.random.default_rng(args.seed)),
    }
    rows: dict[str, list[Surveyed]] = {}
    for title, group in clips.items():
        rows[title] = []
        for clip in group:
            row = survey(clip, robot, duration_s=args.duration, method=args.method, seed=args.seed)
            print(f"{row.name}: {'tracked' if row.tracked else 'fell'}", file=sys.stderr, flush=True)
            rows[title].append(row)
    everything = [row for group in rows.values() for row in group]
    command = f"python benchmarks/motions.py --robot {robot.name} --cycles {args.cycles} --seed {args.seed}"
    parts = [f"`{command}`, method `{args.method}`, {args.duration:g} s.", f"All: {summary(everything)}"]
    parts += [f"### {title}\n\n{summary(group)}\n\n{table(group)}" for title, group in rows.items() if group]
    text = "\n\n".join(parts)
    print(text)
    args.out.mkdir(parents=True, exist_ok=True)
    figures = {title: [row.as_dict() for row in group] for title, group in rows.items()}
    replace_file(args.out / "motions.json", lambda f: f.write(json.dumps(figures, indent=1).encode()))
    replace_file(args.out / "motions.md", lambda f: f.write(f"{text}\n".encode()))
    if args.write:
        put(PAGE, "motions", text)


if __name__ == "__main__":
    main()
