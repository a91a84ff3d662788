"""Blind on stairs, slopes and rough ground: who stays up, how far they come, and what remains of the motion.

    python benchmarks/terrain.py [--robot a1] [--motions trot …] [--terrains stairs-up=0.05 …] [--episodes 64]
                                 [--observe truth] [--seed 0] [--json] [--write]

Episodes begin on the terrain itself, at different places and phases, perturbed as in `fastmimic evaluate`, and last
10 s, or as long as the motion takes for 6 m: one slower than 0.6 m/s would not make 5 m in 10 s. A robot survives if it
has not fallen by then. Beside it is the share that has also made 5 m of way, from cycle to cycle, and the style
distance of its feet from the demonstration's until a fall (`style_distance`), a mean over the episodes. Motions are
cyclic and retargeted, not optimised. Stairs of 0.1 m are for the walk alone. Those of the dog need `fastmimic data
fetch`, or FASTMIMIC_DATA. Intervals are Wilson's. `--write` puts the table between the markers in docs/robustness.md.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put
from shares import interval, shown

from fastmimic.base.errors import ConfigError
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import mean_of_known, style_distance
from fastmimic.episode.plan import perturbed_start
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.runs.loading import find_motion
from fastmimic.simulation.conditions import Conditions, TerrainLevel, parse_terrain

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"
MOTIONS = ("trot", "pace", "walk", "dog:right-turn")
TERRAINS = ("rough=0.05", "slope=15", "side-slope=10", "stairs-up=0.05", "stairs-down=0.05")
HIGH, HIGH_FOR = ("stairs-up=0.1", "stairs-down=0.1"), "walk"
EPISODE_S, WAY_M, ROOM = 10.0, 5.0, 1.2  # room: of the time that the motion takes for the way


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--motions", nargs="+", default=MOTIONS)
    parser.add_argument("--terrains", nargs="+", help="in place of the usual ones, for all motions")
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--observe", default="truth", choices=("truth", "sensors"))
    parser.add_argument("--seed", type=int, default=0, help="of starts, places and ground")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/robustness.md")
    args = parser.parse_args()
    robot = load_robot(args.robot)
    found: dict[str, Any] = {name: {} for name in ("survival", "way", "metres", "style_distance", "intervals")}
    found["seconds"] = {}
    for name in args.motions:
        motion, _ = find_motion(name).retarget(robot)
        seconds = found["seconds"][name] = length(motion)
        for text in args.terrains or (*TERRAINS, *(HIGH if name == HIGH_FOR else ())):
            terrain = parse_terrain(text)
            conditions = Conditions(observe=args.observe, terrain=terrain, seed=args.seed)
            figures = walked(robot, motion, conditions, seconds, args.episodes)
            for part, value in figures.items():
                found[part].setdefault(terrain.name, {}).setdefault(name, {})[f"{terrain.values[0]:g}"] = value
            print(f"{name} on {terrain}: {figures}", file=sys.stderr, flush=True)
    text = table(found, args)
    print(json.dumps({"robot": robot.name, **found}, indent=1) if args.json else text)
    if args.write:
        put(PAGE, "terrain", text)


def length(motion: Motion) -> float:
    """Length of an episode, s."""
    if motion.cycle is None:
        raise ConfigError(f"'{motion.name}' does not repeat; give motions that lead on")
    speed = np.hypot(*motion.cycle[:2]) / motion.period_s
    return max(EPISODE_S, float(np.ceil(ROOM * WAY_M / max(speed, 0.05))))


def walked(robot: Robot, motion: Motion, conditions: Conditions, seconds: float, episodes: int) -> dict[str, Any]:
    """The figures of one motion on one terrain."""
    start = perturbed_start(episodes, motion.n_samples, np.random.default_rng(conditions.seed))
    done = run_episodes(robot, motion, start=start, duration_s=seconds, conditions=conditions, log=True)
    up, metres = ~done.fell, np.array([way(done, motion, i) for i in range(episodes)])
    style = np.array([style_until_fall(done, motion, robot, i) for i in range(episodes)])
    return {
        "survival": float(up.mean()),
        "way": float((up & (metres >= WAY_M)).mean()),
        "metres": float(metres.mean()),
        "style_distance": mean_of_known(style),
        "intervals": interval(up),
    }


def way(done: Rollout, motion: Motion, episode: int) -> float:
    """Way of a robot until its fall, m: from where it is at the start of a cycle to where it is at the next one, and at
    the end."""
    path = done.course.observation["root_pos"][episode, : done.steps[episode], :2]
    marks = np.concatenate([path[:: motion.n_samples], path[-1:]])
    return float(np.linalg.norm(np.diff(marks, axis=0), axis=1).sum())


def style_until_fall(done: Rollout, motion: Motion, robot: Robot, episode: int) -> float:
    """Style distance of a robot's feet; NaN for less than a cycle."""
    steps = int(done.steps[episode])
    if steps < motion.n_samples:
        return float("nan")
    feet = foot_positions(robot, done.course.observation["joint_pos"][episode, :steps])
    wanted = done.course.demonstration["foot_pos"][episode, :steps]
    return style_distance(feet, wanted, motion.target.foot_pos_b)


def table(found: dict[str, Any], args: argparse.Namespace) -> str:
    """As Markdown."""
    lines = ["| terrain | motion | stays up | and 5 m of way | way, m | style distance |", "| --- " * 6 + "|"]
    for name, motions in found["survival"].items():
        for motion, levels in motions.items():
            for level in levels:
                of = {part: values[name][motion][level] for part, values in found.items() if part != "seconds"}
                ground = TerrainLevel(name, (float(level),))
                up = shown(of["survival"], of["intervals"])
                figures = f"{of['way']:.0%} | {of['metres']:.1f} | {of['style_distance']:.2f}"
                lines.append(f"| {ground} | `{motion}` | {up} | {figures} |")
    lengths = ", ".join(f"`{motion}` {seconds:g} s" for motion, seconds in found["seconds"].items())
    said = (
        f"{args.robot}, blind, observing the {args.observe}: {args.episodes} episodes each, with the 95 % interval."
        f" Lengths of the episodes: {lengths}. Way and style distance are means until a fall."
    )
    return "\n".join([*lines, "", said])


if __name__ == "__main__":
    main()
