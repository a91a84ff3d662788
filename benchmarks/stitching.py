"""The paper's four stitched motions, built-in and recorded, on the A1: reward of each segment, and who fell.

    python benchmarks/stitching.py [--combos pace+trot …] [--out runs/stitching] [--iterations 200]
                                   [--part-iterations 200] [--write]

Each motion is optimised by itself once, then the segments of each stitched motion together. Then the result runs from
eight perturbed starts. What is finished is kept in `--out` and not run again. Motions of the dog need
`fastmimic data fetch`, or FASTMIMIC_DATA; without them their rows are left out. `--write` puts the table between the
markers in docs/method.md.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from docs_table import put

import fastmimic as fm
from fastmimic.base.errors import DataError
from fastmimic.base.files import replace_file
from fastmimic.clips.catalogue import describe
from fastmimic.imitation.stitch import PART_POPULATION

COMBOS = (
    "pace+trot",
    "trot+turn+trot",
    "side-step+trot+turn",
    "trot+side-step+backward-trot",
    "dog:pace+dog:trot",
    "dog:trot+dog:right-turn+dog:trot",
    "anim:side-steps+dog:trot+dog:right-turn",
    "dog:trot+anim:side-steps+backward-trot",
)
EPISODES = 8
PAGE = Path(__file__).resolve().parent.parent / "docs" / "method.md"


def part(name: str, iterations: int, out: Path) -> fm.Motion:
    """A motion optimised by itself, from `out` if it is there."""
    file = out / f"{name.replace(':', '_')}.npz"
    if file.exists():
        return fm.Motion.load(file)
    print(f"{name} by itself …", file=sys.stderr, flush=True)
    result = fm.imitate(name, iterations=iterations, population=PART_POPULATION)
    result.motion.save(file)
    return result.motion


def run(combo: str, iterations: int, part_iterations: int, out: Path) -> dict[str, Any]:
    """One row, from `out` if it is there."""
    file = out / f"{combo.replace(':', '_')}.json"
    if file.exists():
        return json.loads(file.read_text())
    names = combo.split("+")
    parts = {name: part(name, part_iterations, out) for name in dict.fromkeys(names)}
    print(f"{combo} …", file=sys.stderr, flush=True)
    result = fm.stitch([parts[name] for name in names], iterations=iterations)
    result.motion.save(file.with_suffix(".npz"))
    perturbed = fm.evaluate(result.motion, episodes=EPISODES)
    row = {"combo": combo, "perturbed": perturbed.as_dict(), "metrics": result.metrics()}
    replace_file(file, lambda f: f.write(json.dumps(row, indent=1).encode()))
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [
        "| segments | s | reward before | own optima | optimised together | by segment | fell before / own / after"
        f" | perturbed: reward, fell of {EPISODES} | transitions: joint speed, torque |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        m, rough = row["metrics"], row["perturbed"]
        own = m["individual_optima"]
        fell = " / ".join("yes" if f else "no" for f in (m["fell"]["before"], own["fell"], m["fell"]["after"]))
        by_segment = ", ".join(f"{s['reward']['after']:.3f}" for s in m["segments"])
        passing = ", ".join(f"{t['joint_speed_share']:.0%}, {t['torque_share']:.0%}" for t in m["transitions"])
        lines.append(
            f"| `{row['combo']}` | {m['duration_s']:.1f} | {m['reward']['before']:.3f} | {own['reward']:.3f}"
            f" | **{m['reward']['after']:.3f}** | {by_segment} | {fell}"
            f" | {rough['reward_mean']:.3f}, {round(EPISODES * rough['fell'])} | {passing} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--combos", nargs="*", default=list(COMBOS))
    parser.add_argument("--out", type=Path, default=Path("runs/stitching"))
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--part-iterations", type=int, default=200)
    parser.add_argument("--write", action="store_true", help="put the table into docs/method.md")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    available = {row.name for row in describe() if row.available}
    rows = []
    for combo in args.combos:
        missing = [name for name in combo.split("+") if name not in available]
        if missing and args.combos == list(COMBOS):
            print(f"{combo} left out: no {', '.join(missing)}", file=sys.stderr)
            continue
        rows.append(run(combo, args.iterations, args.part_iterations, args.out))
        print(table(rows[-1:]).splitlines()[-1], file=sys.stderr, flush=True)
    if not rows:
        raise DataError("no motion of these is available; fetch the data with 'fastmimic data fetch'")
    how = f"A1, {args.part_iterations} iterations for each motion by itself and {args.iterations} for the whole."
    text = f"{table(rows)}\n\n{how}"
    print(text)
    if args.write:
        put(PAGE, "stitching", text)


if __name__ == "__main__":
    main()
