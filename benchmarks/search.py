"""The search as it is against the full one of 200 iterations and episodes of 5 s: simulated seconds and reward.

    python benchmarks/search.py [--motions trot …] [--configs default paper] [--robot a1] [--out runs/search]
                                [--json] [--write]

Both searches optimise the same motion with the same seed, one after the other. Their results are scored over 10 s from
one nominal and 15 perturbed starts that neither has seen. Finished rows are kept in `--out` and not run again.
`--write` puts the table into docs/results.md. Motions of the dog need `fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put
from results import CLAIMED, DURATION_S, PAGE, REPORTED

import fastmimic as fm
from fastmimic.base.files import replace_file
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import MOST_ITERATIONS, CmaSettings, optimize
from fastmimic.optimize.problem import Objective
from fastmimic.optimize.stitched import make_problem
from fastmimic.robot import Robot

FULL_S = 5.0
EPISODES = 16


def measured(motion: Motion, robot: Robot, config: str) -> dict[str, Any]:
    """One row: the motion as it is, after the full search, and after the usual one."""
    method = METHODS["mbc-dmp"]
    row: dict[str, Any] = {"motion": motion.name, "config": config, "before": scored(motion, robot, config)}
    for name in ("full", "usual"):
        began = time.process_time()
        settings = method.configure(config)
        problem = make_problem(robot, motion, group=method.parameters, objective=Objective(FULL_S), config=settings)
        if name == "full":
            problem.steps = max(problem.steps, round(FULL_S * settings.rate_hz))
        optimum = optimize(problem, CmaSettings(MOST_ITERATIONS if name == "full" else None))
        row[name] = {
            "iterations": len(optimum.history.best),
            "simulated_s": optimum.simulated_s,
            "cpu_s": time.process_time() - began,
            **scored(problem.motion(optimum.x), robot, config),
        }
    row["share"] = row["usual"]["simulated_s"] / row["full"]["simulated_s"]
    return row


def scored(motion: Motion, robot: Robot, config: str) -> dict[str, Any]:
    figures = fm.evaluate(motion, robot, config=config, duration_s=DURATION_S, episodes=EPISODES, seed=1).as_dict()
    return {name: figures[name] for name in ("reward_mean", "reward_animal", "fell")}


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [
        "| motion | configuration | reward before | full search | search | fell: before / full / search"
        " | iterations | simulated, s | share of the full search's |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        before, full, usual = row["before"], row["full"], row["usual"]
        lines.append(
            f"| `{row['motion']}` | {row['config']} | {before['reward_mean']:.4f} | {full['reward_mean']:.4f}"
            f" | {usual['reward_mean']:.4f} | {before['fell']:.0%} / {full['fell']:.0%} / {usual['fell']:.0%}"
            f" | {usual['iterations']} | {usual['simulated_s']:.0f} | {row['share']:.2f} |"
        )
    gained = [row["usual"]["reward_mean"] - row["full"]["reward_mean"] for row in rows]
    said = f"In the median {np.median([row['share'] for row in rows]):.2f} of the full search's simulated seconds;"
    said += f" reward {np.median(gained):+.4f} in the median, {min(gained):+.4f} at the least."
    return "\n".join([*lines, "", said])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="*", default=[*CLAIMED, *REPORTED])
    parser.add_argument("--configs", nargs="*", default=["default", "paper"])
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--out", type=Path, default=Path("runs/search"))
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/results.md")
    args = parser.parse_args()
    robot = fm.load_robot(args.robot)
    rows = []
    for config in args.configs:
        for name in args.motions:
            file = args.out / f"{robot.name}-{config}-{name.replace(':', '_')}.json"
            if not file.exists():
                print(f"{name}, {config} …", file=sys.stderr, flush=True)
                row = measured(fm.load_motion(name, robot).target, robot, config)
                file.parent.mkdir(parents=True, exist_ok=True)
                replace_file(file, lambda f, row=row: f.write(json.dumps(row, indent=1).encode()))  # type: ignore[misc]
            rows.append(json.loads(file.read_text(encoding="utf-8")))
    if args.json:
        print(json.dumps({"rows": rows}, indent=1))
    if args.write:
        put(PAGE, "search", table(rows))
    elif not args.json:
        print(table(rows))


if __name__ == "__main__":
    main()
