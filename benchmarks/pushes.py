"""Pushes of the trunk, in eight directions from eight phases: who stays up, and who is back in the motion.

    python benchmarks/pushes.py [--robot a1] [--motions dog:trot …] [--speeds 0.25 0.5 0.75 1.0]
                                [--variants no-step-timing …] [--minute 32] [--json] [--write]

A push lasts 0.1 s and changes the trunk's speed by 0.25 to 1 m/s, if its feet do not hold against it; it comes 1 s
after the start. A robot survives if it has not fallen 4 s later, and has rejoined its motion if 1.5 s after the push
it takes no recovery steps any more and is within 0.15 m/s and 0.1 rad of its reference for good. The same follows with
sensors alone, under variants of the feedback (ablations) at the highest speed, and for a minute with a push of up to
that speed every 3 s. One variant is no ablation: `raibert-lh`, Raibert footholds under convex MPC with constant gains,
as Quadruped-PyMPC has them, in our code. Motions are retargeted, not optimised. Those of the dog need `fastmimic data
fetch`, or FASTMIMIC_DATA. Intervals are Wilson's.
`--write` puts the table between the markers in docs/robustness.md.
"""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put
from shares import interval

from fastmimic.base.configuration import changed
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import Start, perturbed_start
from fastmimic.experiments.ablations import ABLATIONS
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.simulation.conditions import Conditions, Disturbance
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PUSH_DURATION_S, DisturbanceKind

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"
MOTIONS = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps", "trot", "walk", "dog:canter")
VARIANTS = ("no-recovery-steps", "raibert-lh")
PEER = "raibert-lh"
DIRECTIONS, PHASES = 8, 8
PUSHED_AT_S, EPISODE_S, REJOINED_S = 1.0, 5.0, 1.5
BACK_M_PER_S, BACK_RAD = 0.15, 0.1  # as near as a robot is to its reference again
EVERY_S, MINUTE_S = 3.0, 60.0


def push_at_random(simulation: Any, impulses: np.ndarray, time_s: float) -> None:
    """Every 3 s a push in any direction, of up to an impulse, N s; the same for the same robot and time."""
    number = int(time_s // EVERY_S)
    if number == 0 or time_s - number * EVERY_S >= PUSH_DURATION_S:
        return
    for i, most in enumerate(impulses):
        size, angle = np.random.default_rng((number, i)).uniform((0.0, 0.0), (1.0, 2 * np.pi))
        simulation.trunk_force[i, :2] += most * size / PUSH_DURATION_S * np.array([np.cos(angle), np.sin(angle)])


DISTURBANCES.register(
    DisturbanceKind(
        "pushes", unit="N·s", lower=0.0, upper=500.0, about="a push at random every 3 s", each_step=push_at_random
    )
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--motions", nargs="*", default=MOTIONS)
    parser.add_argument("--speeds", nargs="*", type=float, default=(0.25, 0.5, 0.75, 1.0))
    parser.add_argument("--variants", nargs="*", default=VARIANTS)
    parser.add_argument("--minute", type=int, default=32, help="episodes of a minute; 0 for none")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/robustness.md")
    args = parser.parse_args()
    robot, highest = load_robot(args.robot), max(args.speeds)
    names = ("survival", "rejoined", "sensors", "repeated", "intervals", *args.variants)
    found: dict[str, dict[str, Any]] = {name: {} for name in names}
    for name in args.motions:
        motion, _ = find_motion(name).retarget(robot)
        for part in ("survival", "rejoined", "intervals"):
            found[part][name] = {}
        for speed in args.speeds:
            up, back = pushed(robot, motion, ControllerConfig(), speed)
            key = f"{speed:g}"
            found["survival"][name][key], found["rejoined"][name][key] = float(up.mean()), float(back.mean())
            found["intervals"][name][key] = interval(up)
        found["sensors"][name] = float(pushed(robot, motion, ControllerConfig(), highest, observe="sensors")[0].mean())
        for variant in args.variants:
            config = peer() if variant == PEER else ABLATIONS[variant].change(ControllerConfig())
            found[variant][name] = float(pushed(robot, motion, config, highest)[0].mean())
        if args.minute:
            found["repeated"][name] = minute(robot, motion, highest, args.minute)
        said = {part: values[name] for part, values in found.items() if name in values}
        print(f"{name}: {said}", file=sys.stderr, flush=True)
    text = table(found, args)
    print(json.dumps({"robot": robot.name, **found}, indent=1) if args.json else text)
    if args.write:
        put(PAGE, "pushes", text)


def peer() -> ControllerConfig:
    """The configuration of `PEER`."""
    changes = {"stance": {"forces": "horizon", "feedback": "constant", "leg_momentum": False}}
    return changed(ControllerConfig(), {**changes, "swing": {"foothold": "raibert"}}, PEER)


def pushed(
    robot: Robot, motion: Motion, config: ControllerConfig, speed: float, observe: str = "truth"
) -> tuple[np.ndarray, np.ndarray]:
    """Whether each of 64 robots (64,) stays up, and whether it has rejoined its motion in time."""
    n = DIRECTIONS * PHASES
    sample = np.tile(np.arange(PHASES) * motion.n_samples // PHASES, DIRECTIONS)
    if motion.cycle is None:
        sample[:] = 0
    angle = np.repeat(2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS, PHASES)
    impulse = speed * robot.mass * np.array([np.cos(angle), np.sin(angle)])
    disturbances = tuple(
        Disturbance(kind, tuple(values.tolist()), PUSHED_AT_S)
        for kind, values in zip(("push", "side-push"), impulse, strict=True)
    )
    start = Start(sample, np.zeros((n, 12)), np.zeros((n, 3)), np.arange(n))
    conditions = Conditions(disturbances=disturbances, observe=observe)
    done = run_episodes(
        robot, motion, start=start, duration_s=EPISODE_S, config=config, conditions=conditions, log=True
    )
    assert done.log is not None
    is_, due = done.log.observation, done.log.demonstration
    late = slice(round((PUSHED_AT_S + REJOINED_S) * done.log.rate_hz), None)
    off = np.linalg.norm(is_["lin_vel"][:, late, :2] - due["lin_vel"][:, late, :2], axis=-1)
    same = np.abs(np.sum(is_["root_quat"][:, late] * due["root_quat"][:, late], axis=-1))
    away = done.log.recovering[:, late] | (off > BACK_M_PER_S) | (2 * np.arccos(np.minimum(same, 1.0)) > BACK_RAD)
    return ~done.fell, ~done.fell & ~away.any(axis=1)


def minute(robot: Robot, motion: Motion, speed: float, episodes: int) -> float:
    """Share of episodes of a minute without a fall, with a push of up to `speed` every 3 s."""
    conditions = Conditions(disturbances=(Disturbance("pushes", (speed * robot.mass,)),))
    start = perturbed_start(episodes, motion.n_samples, np.random.default_rng(0))
    done = run_episodes(robot, motion, start=start, duration_s=MINUTE_S, conditions=conditions)
    return float(1.0 - done.fell.mean())


def table(found: dict[str, dict[str, Any]], args: argparse.Namespace) -> str:
    """As Markdown."""
    highest = f"{max(args.speeds):g}"
    heads = ["motion", *(f"{speed:g} m/s" for speed in args.speeds), "back in 1.5 s", "with sensors", "a minute"]
    heads += [f"`{variant}`" for variant in args.variants]
    lines = ["| " + " | ".join(heads) + " |", "| --- |" + " --- |" * (len(heads) - 1)]
    for name in args.motions:
        low, high = found["intervals"][name][highest]
        shares = [found["survival"][name][f"{speed:g}"] for speed in args.speeds]
        cells = [f"{share:.0%}" for share in shares]
        cells[-1] += f" ({low:.0%} to {high:.0%})"
        others = [found["rejoined"][name][highest], found["sensors"][name], found["repeated"].get(name, math.nan)]
        cells += [f"{share:.0%}" for share in (*others, *(found[variant][name] for variant in args.variants))]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    said = (
        f"{args.robot}: share of {DIRECTIONS * PHASES} robots that stay up for {EPISODE_S - PUSHED_AT_S:g} s after a"
        f" push in {DIRECTIONS} directions from {PHASES} phases, with its 95 % interval at {highest} m/s; from there on"
        f" the columns are for {highest} m/s. A minute: share of {args.minute} episodes of a minute with a push of up"
        f" to {highest} m/s every 3 s."
    )
    return "\n".join([*lines, "", said])


if __name__ == "__main__":
    main()
