"""Named passages of animals' recordings, each as it is from its start to its end, under the default controller.

    python benchmarks/takes.py --data FOLDER … --robot go2 --list clips.csv
                               [--episodes 8] [--seed 0] [--only NAME …] [--out runs/takes] [--json] [--write]
    python benchmarks/takes.py --data FOLDER … --robot go2 --random 20 [--draw 1] …

The list is a table with a header and the columns name, source, start, end: frames of a file that is looked for by its
name at any depth of the folders; an end of -1 is the file's. Kine2Go's list of 40 passages of a dog, a horse and a
Solo8 has this form. `--random` draws that many passages of 2 to 10 s instead, by a generator seeded with `--draw`, out
of the recordings in the folders (.txt, .csv) that last 8 s or longer, each as likely as it is long.

Nothing is chosen for a passage: whether it repeats, its contacts, its speed are found as for any recording, and nothing
is optimised by CMA-ES. A passage that does not repeat is run once, a cycle for 10 s, from one nominal start and else
perturbed ones. It is tracked if no episode falls. Sources that are not there are `missing`. What is finished is kept in
`--out` and not run again. `--write` puts the table into docs/own-animal.md.
"""

import argparse
import csv
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put

import fastmimic as fm
from fastmimic.base.errors import FastMimicError
from fastmimic.base.files import replace_file
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip
from fastmimic.robot import Robot
from fastmimic.runs.loading import find_motion

PAGE = Path(__file__).resolve().parent.parent / "docs" / "own-animal.md"
LEAST_S = 8.0  # of a recording from which passages are drawn
DRAWN_S = (2.0, 10.0)
MEASURES = (
    *("success", "mpjpe_mm", "mpbpe_root_mm", "root_position_error_m", "root_heading_error_rad"),
    *("joint_velocity_error_rad_s", "acceleration_distance"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", type=Path, required=True)
    parser.add_argument("--robot", default="go2")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--list", type=Path)
    which.add_argument("--random", type=int)
    parser.add_argument("--draw", type=int, default=1)
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", help="names of the list; all if left out")
    parser.add_argument("--out", type=Path, default=Path("runs/takes"))
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    robot = fm.load_robot(args.robot)
    every = drawn(args.data, args.random, args.draw) if args.random else listed(args.list)
    wanted = [row for row in every if not args.only or row["name"] in args.only]
    rows, missing = list[dict[str, Any]](), list[str]()
    for row in wanted:
        path = found_in(args.data, row["source"])
        if path is None:
            missing.append(row["name"])
            continue
        rows.append(kept(args, robot, row, path))
        shown = {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in rows[-1].items()}
        print(" ".join(f"{k}={v}" for k, v in shown.items()), file=sys.stderr, flush=True)
    tracked = sum(row["fell"] == 0 for row in rows)
    if args.json:
        print(json.dumps({"tried": len(rows), "tracked": tracked, "missing": missing, "rows": rows}, indent=1))
    text = table(rows, args.robot, tracked, missing)
    if args.write:
        put(PAGE, "drawn" if args.random else "takes", text)
    elif not args.json:
        print(text)


def listed(path: Path) -> list[dict[str, str]]:
    """The rows of a list."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def drawn(folders: list[Path], count: int, seed: int) -> list[dict[str, str]]:
    """Passages at random, as rows of a list."""
    rng = np.random.default_rng(seed)
    takes = dict[str, Clip]()
    paths = [path for folder in folders for path in folder.rglob("*") if path.suffix in (".txt", ".csv")]
    for path in sorted(paths, key=lambda path: path.name):
        try:
            clip = open_clip(path)
        except FastMimicError:
            continue  # a licence, or a list
        if clip.n_frames / clip.rate_hz >= LEAST_S:
            takes.setdefault(path.name, clip)
    seconds = np.array([clip.n_frames / clip.rate_hz for clip in takes.values()])
    rows = []
    for name in rng.choice(list(takes), size=count, p=seconds / seconds.sum()).tolist():
        clip = takes[name]
        length = min(round(rng.uniform(*DRAWN_S) * clip.rate_hz), clip.n_frames)
        start = int(rng.integers(0, clip.n_frames - length + 1))
        label = f"{Path(name).stem.removesuffix('_joint_pos')} {start}:{start + length}"
        rows.append({"name": label, "source": name, "start": str(start), "end": str(start + length)})
    return rows


def found_in(folders: list[Path], source: str) -> Path | None:
    """The file of that name at any depth of the folders; None if there is none."""
    return next((path for folder in folders for path in sorted(folder.rglob(source)) if path.is_file()), None)


def kept(args: argparse.Namespace, robot: Robot, row: dict[str, str], path: Path) -> dict[str, Any]:
    """A row's figures, from `--out` if they are there."""
    file = args.out / f"{robot.name}-{row['name'].replace(' ', '-').replace(':', '-')}-{args.seed}-{args.episodes}.json"
    if file.exists():
        return dict(json.loads(file.read_text(encoding="utf-8")))
    found = {"name": row["name"], **measured(robot, path, int(row["start"]), int(row["end"]), args)}
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_file(file, lambda f: f.write(json.dumps(found).encode()))
    return found


def measured(robot: Robot, path: Path, start: int, end: int, args: argparse.Namespace) -> dict[str, Any]:
    """Durations, reward and measures of one passage; one that no motion comes near has fallen, with its `error`."""
    began = time.process_time()
    try:
        whole = open_clip(path)
        clip = whole.cut(start, whole.n_frames if end < 0 else end)
        motion, report = find_motion(clip).retarget(robot)
    except FastMimicError as error:
        none = dict.fromkeys(("reward", "reward_animal", *MEASURES, "speed_share"), None)
        return {"fell": 1.0, **none, "wall_s": time.process_time() - began, "error": str(error)}
    solved_s = time.process_time() - began
    figures = fm.evaluate(motion, robot, episodes=args.episodes, seed=args.seed).as_dict()
    changed = report.executable
    return {
        "duration_s": clip.n_frames / clip.rate_hz,
        "cycle": motion.cycle is not None,
        "fell": figures["fell"],
        "reward": figures["reward_mean"],
        "reward_animal": figures["reward_animal"],
        **{name: figures[name] for name in MEASURES if name in figures},
        "speed_share": None if changed is None else changed.speed_share,
        "margins": None if changed is None else changed.margins,
        "solve_s": solved_s,
        "wall_s": time.process_time() - began,
    }


def table(rows: list[dict[str, Any]], robot: str, tracked: int, missing: list[str]) -> str:
    """The rows as Markdown."""
    lines = [
        "| passage | s | reward against the animal | reward | fell | success | mpjpe, mm | root's error, m"
        " | speed, share | wall, s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        if "error" in row:
            lines.append(f"| {row['name']} | none found: {row['error']} | | | | | | | | {row['wall_s']:.0f} |")
            continue
        lines.append(
            f"| {row['name']} | {row['duration_s']:.1f}{' (cycle)' if row['cycle'] else ''}"
            f" | {row['reward_animal']:.3f} | {row['reward']:.3f} | {row['fell']:.0%} | {row['success']:.0%}"
            f" | {row['mpjpe_mm']:.0f} | {row['root_position_error_m']:.2f} | {row['speed_share']:.2f}"
            f" | {row['wall_s']:.0f} |"
        )
    against = [row["reward_animal"] for row in rows if row["reward_animal"] is not None]
    said = f"{robot}: {tracked} of {len(rows)} passages are tracked without a fall in any episode"
    said += f"; reward against the animal {np.median(against):.3f} in the median" if against else ""
    said += f"; sources that were not there: {len(missing)}." if missing else "."
    return "\n".join([*lines, "", said])


if __name__ == "__main__":
    main()
