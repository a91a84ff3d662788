"""What it costs and buys to optimise over several robots: the table of docs/robustness.md.

    python benchmarks/randomize.py [--motions dog:trot …] [--searches mbc nominal mean worst] [--iterations 30]
                                   [--robots 4] [--seed 0] [--out runs/randomize] [--finished] [--write]

Each motion as it is, optimised as usual, and optimised over several robots by their mean and by the worst of them. Each
of these runs on the robot as it is, on robots that no search has met, and through the last stage of
`fastmimic transfer`. What is finished is kept in `--out` and not run again. Motions of the dog need
`fastmimic data fetch`, or FASTMIMIC_DATA; PyBullet: pip install 'fastmimic[pybullet]'. `--write` puts the table between
the markers in docs/robustness.md.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from marked import put

import fastmimic as fm
from fastmimic.base.files import replace_file
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.plan import episode_duration, nominal_start
from fastmimic.experiments.experiment import Subject
from fastmimic.experiments.transfer import STAGES, TransferSettings, run_trials
from fastmimic.imitation.methods import controller_for

MOTIONS: Final = ("dog:trot", "anim:side-steps", "dog:pace", "dog:right-turn")
SEARCHES: Final = {
    "mbc": "nothing (MBC)",
    "nominal": "on the robot as it is",
    "mean": "over {robots}, mean",
    "worst": "over {robots}, worst",
}
HELD_OUT: Final = 32
DURATION_S: Final = 10.0  # of what is measured; as in `fastmimic transfer`
PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"

Settings = argparse.Namespace


def searched(name: str, search: str, out: Path, settings: Settings) -> tuple[fm.Motion, float]:
    """The motion that a search finds, and how long it simulated for it, s."""
    if search == "mbc":
        return fm.load_motion(name, "a1"), 0.0
    stem = f"{name.replace(':', '_')}-{search}"
    checkpoint = out / f"{stem}.checkpoint.npz"
    result = fm.imitate(
        name,
        iterations=settings.iterations,
        seed=settings.seed,
        workers=settings.workers,
        checkpoint=checkpoint,
        resume=checkpoint.is_file(),
        randomize=None if search == "nominal" else fm.Randomization(settings.robots, criterion=search),
    )
    if result.interrupted:
        raise KeyboardInterrupt
    result.motion.save(out / f"{stem}.npz")
    return result.motion, result.simulated_s


def measured(motion: fm.Motion, settings: Settings) -> dict[str, Any]:
    """What a motion is worth on the robot as it is, on others, and through transfer."""
    robot = fm.load_robot("a1")
    method, config = controller_for(motion)
    seconds = episode_duration(motion, DURATION_S)
    nominal = run_episodes(robot, motion, duration_s=seconds, config=config)
    conditions = fm.Conditions(disturbances=fm.Randomization(settings.robots).held_out(HELD_OUT))
    start = nominal_start(HELD_OUT)
    others = run_episodes(robot, motion, start=start, duration_s=seconds, config=config, conditions=conditions)
    trials = run_trials(Subject(method, motion, config), robot, TransferSettings(duration_s=DURATION_S), STAGES[-1:])
    share = nominal.clearance[0] / swing_clearance(motion.target, robot.foot_radius)
    return {
        "nominal": float(nominal.reward[0]),
        "clearance": float(np.nanmin(share)),
        "others": others.reward.tolist(),
        "others_fell": int(others.fell.sum()),
        "transfer": [row["reward_mean"] for row in trials],
        "transfer_fell": sum(row["fell"] > 0 for row in trials),
    }


def row(name: str, search: str, out: Path, settings: Settings) -> dict[str, Any] | None:
    """One row, from `out` if it is there; None if it is not, and only finished ones are wanted."""
    file = out / f"{name.replace(':', '_')}-{search}.json"
    if file.is_file():
        return json.loads(file.read_text())
    if settings.finished:
        return None
    print(f"{name}, {search} …", file=sys.stderr, flush=True)
    motion, simulated_s = searched(name, search, out, settings)
    found = {"motion": name, "search": search, "simulated_s": simulated_s, **measured(motion, settings)}
    replace_file(file, lambda stream: stream.write(json.dumps(found, indent=1).encode()))
    return found


def table(rows: Sequence[dict[str, Any]], settings: Settings) -> str:
    """The rows as Markdown."""
    lines = [
        f"| motion | optimised | robot as it is | {HELD_OUT} others: mean | worst | fell | (c) | least clearance"
        " | simulated, s |",
        f"| {' | '.join(['---'] * 9)} |",
    ]
    for r in rows:
        others, trials = np.array(r["others"]), np.array(r["transfer"])
        fell = f", {r['transfer_fell']} of {len(trials)} fell" if r["transfer_fell"] else ""
        cells = (
            f"`{r['motion']}`",
            SEARCHES[r["search"]].format(robots=settings.robots),
            f"{r['nominal']:.3f}",
            f"{others.mean():.3f}",
            f"{others.min():.3f}",
            str(r["others_fell"]),
            f"{trials.mean():.3f} ± {trials.std():.3f}{fell}",
            f"{r['clearance']:.0%}",
            f"{r['simulated_s']:.0f}" if r["simulated_s"] else "–",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=list(MOTIONS))
    parser.add_argument("--searches", nargs="+", choices=list(SEARCHES), default=list(SEARCHES))
    parser.add_argument("--iterations", type=int, default=30)
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, default=Path("runs/randomize"))
    parser.add_argument("--finished", action="store_true", help="run nothing: the table of what is there")
    parser.add_argument("--write", action="store_true", help="put the table into docs/robustness.md")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    asked = [(name, search) for name in args.motions for search in args.searches]
    rows = [row(name, search, args.out, args) for name, search in asked]
    missing = [f"{name} {search}" for (name, search), found in zip(asked, rows, strict=True) if found is None]
    shown = table([found for found in rows if found is not None], args)
    if missing:
        shown += f"\n\n**Unfinished: {', '.join(missing)}.**"
    print(shown)
    if args.write:
        given = f"--motions {' '.join(args.motions)} --searches {' '.join(args.searches)}"
        given += f" --iterations {args.iterations} --robots {args.robots} --seed {args.seed}"
        put(PAGE, "randomize", f"`python benchmarks/randomize.py {given}`\n\n{shown}")


if __name__ == "__main__":
    main()
