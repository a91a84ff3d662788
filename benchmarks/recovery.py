"""Pushes with recovery and without, and what each of its parts does: the table of docs/robustness.md.

    python benchmarks/recovery.py [--motions dog:trot …] [--episodes 8] [--write]

Pushes of 0.1 s, 1 s after the start from random phases; the controller is told the truth. Motions of the dog need
`fastmimic data fetch`, or FASTMIMIC_DATA. `--write` puts the table between the markers in docs/robustness.md.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from marked import put

from fastmimic.control.config import ControllerConfig, default_config
from fastmimic.control.config_parts import RecoveryConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import Start, nominal_start
from fastmimic.experiments.compare import PAPER_MOTIONS
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, Disturbance

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"
LEVELS = {
    "push": (-18.0, -14.0, -10.0, -6.0, 6.0, 10.0, 14.0, 18.0),
    "side-push": (-10.0, -8.0, -6.0, -4.0, -2.0, 2.0, 4.0, 6.0, 8.0, 10.0),
}
PUSHED_AT_S, EPISODE_S = 1.0, 3.5
NEVER = 1e9  # s
VARIANTS = {
    "off": RecoveryConfig(),
    "re-synchronised": RecoveryConfig(enabled=True),
    "and waits": RecoveryConfig(enabled=True, phase_rate=0.0),
    "and slows to 0.7": RecoveryConfig(enabled=True, phase_rate=0.7),
    "and steps wider": RecoveryConfig(enabled=True, foothold_feedback=(0.05, 0.08)),
    "only steps wider": RecoveryConfig(enabled=True, resync_time=NEVER, foothold_feedback=(0.05, 0.08)),
}


def pushed(robot: Robot, motion: Motion, config: ControllerConfig, kind: str, episodes: int) -> np.ndarray:
    """(levels, episodes, 2) of survived and reward."""
    levels = LEVELS[kind]
    sample = np.random.default_rng(0).integers(motion.n_samples, size=episodes)
    n = episodes * len(levels)
    start = Start(np.tile(sample, len(levels)), np.zeros((n, 12)), np.zeros((n, 3)), np.zeros(n, np.int64))
    values = tuple(float(v) for v in np.repeat(levels, episodes))
    conditions = Conditions(disturbances=(Disturbance(kind, values, PUSHED_AT_S),))
    rollout = run_episodes(robot, motion, start=start, duration_s=EPISODE_S, config=config, conditions=conditions)
    return np.stack([~rollout.fell, rollout.reward], axis=-1).reshape(len(levels), episodes, 2)


def withstood(levels: Sequence[float], survived: np.ndarray) -> str:
    """The levels about 0 that no episode fell at."""
    whole = survived.mean(axis=1) >= 0.95
    lower = upper = 0.0
    for level, holds in zip(levels[::-1], whole[::-1], strict=True):
        if level < 0:
            if not holds:
                break
            lower = level
    for level, holds in zip(levels, whole, strict=True):
        if level > 0:
            if not holds:
                break
            upper = level
    return f"{lower:g} … {upper:g}".replace("-", "−")


def row(robot: Robot, motion: Motion, name: str, episodes: int) -> str:
    """One variant on one motion."""
    config = dataclasses.replace(default_config(), recovery=VARIANTS[name])
    undisturbed = run_episodes(robot, motion, start=nominal_start(1), duration_s=EPISODE_S, config=config)
    cells = []
    for kind, levels in LEVELS.items():
        found = pushed(robot, motion, config, kind, episodes)
        cells += [withstood(levels, found[..., 0]), f"{found[..., 0].mean():.0%}", f"{found[..., 1].mean():.3f}"]
    return f"| `{motion.name}` | {name} | {' | '.join(cells)} | {undisturbed.reward[0]:.3f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=list(PAPER_MOTIONS))
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--write", action="store_true", help="put it into docs/robustness.md")
    args = parser.parse_args()
    robot = load_robot("a1")
    lines = [
        "| motion | recovery | push, N·s | survived | reward | side-push, N·s | survived | reward | undisturbed |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for source in args.motions:
        motion = load_motion(source, robot)
        for name in args.variants:
            lines.append(row(robot, motion, name, args.episodes))
            print(lines[-1], flush=True)
    forwards, sideways = (f"{max(levels):g}" for levels in LEVELS.values())
    text = "\n".join(
        [
            *lines,
            "",
            f"Withstood without a fall in {args.episodes} episodes of {EPISODE_S:g} s from random phases; share"
            f" survived and mean reward over all pushes up to ±{forwards} N·s along and ±{sideways} N·s across.",
        ]
    )
    print(text)
    if args.write:
        put(PAGE, "recovery", text)


if __name__ == "__main__":
    main()
