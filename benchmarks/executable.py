"""Motions made executable by optimal control: reward against the animal, falls, and whether every limit is kept.

    python benchmarks/executable.py [--robots a1 go2] [--motions dog:trot …] [--cycles 0] [--seed 0] [--episodes 8]
                                    [--duration 10] [--kinematic] [--json] [--write]

Nothing is optimised by CMA-ES: each motion is made executable and run as it is, one nominal and else perturbed
episodes, under the default controller. `--cycles N` adds N cycles cut at random from the dog's long takes, as in
benchmarks/motions.py. `--kinematic` runs the animal's kinematic motions as well. Limits are checked by MuJoCo's
inverse dynamics at 500 Hz: torque, and torque with speed, at their highest; friction at 99 % of the instants; support
is the acceleration that the standing feet cannot give, g RMS. `--write` puts the table into docs/method.md. Needs
`fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put
from motion_survey import random_cycles

import fastmimic as fm
from fastmimic.base.errors import FastMimicError
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip
from fastmimic.clips.data import data_folder
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.feasibility import demands
from fastmimic.episode.loop import share_of_falls
from fastmimic.episode.reward import Scorer
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import make_clocks, reference_table
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.robot.state import MEMORY, OBSERVATION
from fastmimic.trajectory import solved

PAGE = Path(__file__).resolve().parent.parent / "docs" / "method.md"
MOTIONS = (
    *("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps", "trot", "pace", "turn", "side-step", "walk"),
    *("dog:canter", "run:462:489", "run:427:454"),
)
STATE = ("root_pos", "root_quat", "lin_vel", "ang_vel", "joint_pos", "joint_vel")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["a1", "go2"])
    parser.add_argument("--motions", nargs="*", default=list(MOTIONS))
    parser.add_argument("--cycles", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--kinematic", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    solved.PACKAGED = Path()  # the time is that of solving
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()  # no solution is remembered from before
    rows = []
    for name in args.robots:
        robot = fm.load_robot(name)
        clips = {motion: named(motion, robot) for motion in args.motions}
        cuts = random_cycles(args.cycles, np.random.default_rng(args.seed)) if args.cycles else []
        clips |= {clip.origin.name: clip for clip in cuts}
        for motion, clip in clips.items():
            row = {"motion": motion, "robot": name, **measured(robot, clip, args)}
            print(" ".join(f"{k}={shown(v)}" for k, v in row.items()), file=sys.stderr, flush=True)
            rows.append(row)
    if args.json:
        print(json.dumps({"rows": rows}, indent=1))
    if args.write:
        put(PAGE, "executable", table(rows))


def table(rows: list[dict[str, Any]]) -> str:
    """Rows as Markdown."""
    lines = [
        "| motion | robot | speed, m/s (share) | reward | against the animal (bound) | fell | kinematic: reward (fell)"
        " | torque, at speed, joint speed, friction | solve, s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        motion, robot = row["motion"], row["robot"]
        kinematic = f"{row['kinematic_reward']:.3f} ({row['kinematic_fell']:.0%})" if "kinematic_reward" in row else ""
        if not row["converged"]:
            lines.append(f"| `{motion}` | {robot} | none found | | | | {kinematic} | | {row['solve_s']:.1f} |")
            continue
        limits = ", ".join(
            f"{row['limits'][name]:.2f}" for name in ("torque", "torque_at_speed", "joint_speed", "friction")
        )
        lines.append(
            f"| `{motion}` | {robot} | {row['speed_m_per_s']:.2f} ({row['speed_share']:.2f}) | {row['reward']:.3f}"
            f" | {row['reward_animal']:.3f} ({row['bound_animal']:.3f}) | {row['fell']:.0%} | {kinematic} | {limits}"
            f" | {row['solve_s']:.1f} |"
        )
    return "\n".join(lines)


def named(name: str, robot: Robot) -> Clip:
    """A clip by its name, or frames A:B of the dog's run by `run:A:B`."""
    if not name.startswith("run:"):
        return open_clip(name, robot=robot)
    first, end = (int(part) for part in name.split(":")[1:])
    return open_clip(data_folder() / "dog_keypoints" / "dog_run00_joint_pos.txt", frames=(first, end))


def measured(robot: Robot, clip: Clip, args: argparse.Namespace) -> dict[str, Any]:
    """One row: the solver's effort, rewards, falls and limits."""
    found: dict[str, Any] = {}
    if args.kinematic:
        animal = retarget(clip, robot, cycle=True, executable=False)[0]
        metrics = fm.evaluate(animal, robot, episodes=args.episodes, duration_s=args.duration).as_dict()
        found |= {"kinematic_reward": metrics["reward_mean"], "kinematic_fell": metrics["fell"]}
    start = time.process_time()
    try:
        motion, report = retarget(clip, robot, cycle=True, falls=share_of_falls)
    except FastMimicError as error:
        return found | {"solve_s": time.process_time() - start, "converged": False, "error": str(error)}
    figures = report.executable
    assert figures is not None
    solve_s = time.process_time() - start
    metrics = fm.evaluate(motion, robot, episodes=args.episodes, duration_s=args.duration).as_dict()
    needs = demands(robot, motion, sample_s=0.002, percentile=99)
    highest = demands(robot, motion, sample_s=0.002, percentile=100)
    return found | {
        "solve_s": solve_s,
        "iterations": figures.iterations,
        "converged": True,
        "margins": figures.margins,
        "speed_m_per_s": report.after.speed_m_per_s * figures.speed_share,
        "speed_share": figures.speed_share,
        "reward": metrics["reward_mean"],
        "reward_animal": metrics["reward_animal"],
        "bound_animal": bound(robot, motion),
        "fell": metrics["fell"],
        "limits": {
            "joint_speed": highest.joint_speed,
            "torque": highest.torque,
            "torque_at_speed": highest.torque_at_speed,
            "friction": needs.friction,
            "support": needs.lacking,
        },
    }


def bound(robot: Robot, motion: Motion) -> float:
    """Reward against the animal of a robot that does exactly what the executable motion does."""
    assert motion.animal is not None
    own = reference_table(motion, robot)
    animal = reference_table(replace(motion.animal, demonstration=motion), robot)
    config = ControllerConfig()
    scorer, memory = Scorer(robot, animal, 1, config, config.rate_hz), np.zeros(1, MEMORY)
    clock, state = make_clocks(motion, 1), np.zeros(1, OBSERVATION)
    for sample in range(len(own)):
        clock["sample"] = sample
        for name in STATE:
            state[name] = own[name][sample]
        scorer.score(clock, state, memory)
    return float(scorer.tallies["reward_sum"][0] / len(own))


def shown(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + " ".join(f"{k}={shown(v)}" for k, v in value.items()) + "}"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
