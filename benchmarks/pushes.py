"""Pushes of the trunk, under the controller and under variants of its feedback: the table of docs/robustness.md.

    python benchmarks/pushes.py [--motions dog:trot …] [--speeds 0.25 0.5 0.75 1.0] [--episodes 8] [--write]

A push lasts 0.1 s and changes the trunk's speed by 0.25 to 1 m/s, if its feet do not hold against it; it comes 1 s
after the start, from random phases, forwards, backwards, to the left and to the right. The motions are executable ones
(`--executable`), not optimised. Motions of the dog need `fastmimic data fetch`, or FASTMIMIC_DATA. `--write` puts the
table between the markers in docs/robustness.md.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from marked import put

from fastmimic.control.config import ControllerConfig, default_config
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import Start
from fastmimic.experiments.ablations import ABLATIONS
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.simulation.conditions import Conditions, Disturbance

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"
MOTIONS = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps", "trot", "walk", "dog:canter")
DIRECTIONS = (("push", 1.0), ("push", -1.0), ("side-push", 1.0), ("side-push", -1.0))
VARIANTS = ("", "paper-footholds", "constant-gains")
PUSHED_AT_S, EPISODE_S = 1.0, 5.0
BACK_M_PER_S, BACK_RAD = 0.15, 0.1  # as near as a robot is to its reference again


def config_of(variant: str) -> ControllerConfig:
    return ABLATIONS[variant].change(default_config()) if variant else default_config()


def pushed(
    robot: Robot, motion: Motion, config: ControllerConfig, kind: str, speed: float, episodes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether each of the (episodes,) robots stays up, its reward, and after how long it is back in its motion, s."""
    sample = np.random.default_rng(0).integers(motion.n_samples, size=episodes)
    start = Start(sample, np.zeros((episodes, 12)), np.zeros((episodes, 3)), np.zeros(episodes, np.int64))
    conditions = Conditions(disturbances=(Disturbance(kind, (speed * robot.mass,), PUSHED_AT_S),))
    found = run_episodes(
        robot, motion, start=start, duration_s=EPISODE_S, config=config, conditions=conditions, log=True
    )
    assert found.log is not None
    is_, due = found.log.observation, found.log.demonstration
    off = np.linalg.norm(is_["lin_vel"][..., :2] - due["lin_vel"][..., :2], axis=-1)
    tilt = np.abs(np.sum(is_["root_quat"] * due["root_quat"], axis=-1))
    away = (off > BACK_M_PER_S) | (2 * np.arccos(np.minimum(tilt, 1.0)) > BACK_RAD)
    last = away.shape[1] - np.argmax(away[:, ::-1], axis=1)
    return ~found.fell, found.reward, np.where(away.any(axis=1), last / found.log.rate_hz - PUSHED_AT_S, 0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--motions", nargs="*", default=MOTIONS)
    parser.add_argument("--speeds", nargs="*", type=float, default=(0.25, 0.5, 0.75, 1.0))
    parser.add_argument("--episodes", type=int, default=8, help="of each direction and speed")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/robustness.md")
    args = parser.parse_args()
    robot, rows = load_robot(args.robot), []
    lines = [
        "| motion | feedback | " + " | ".join(f"{v:g} m/s along, across" for v in args.speeds) + " | back after, s |",
        "| --- | --- |" + " --- |" * (len(args.speeds) + 1),
    ]
    for name in args.motions:
        motion, _ = find_motion(name).retarget(robot)
        for variant in VARIANTS:
            config, cells, back = config_of(variant), [], []
            for speed in args.speeds:
                up: dict[str, list[float]] = {}
                for kind, sign in DIRECTIONS:
                    stays, reward, after = pushed(robot, motion, config, kind, sign * speed, args.episodes)
                    up.setdefault(kind, []).append(float(stays.mean()))
                    rows.append(
                        {
                            "motion": name,
                            "robot": robot.name,
                            "variant": variant or "default",
                            "direction": kind,
                            "speed_m_per_s": sign * speed,
                            "survived": float(stays.mean()),
                            "reward_mean": float(reward.mean()),
                        }
                    )
                    if speed == max(args.speeds):
                        back += after[stays].tolist()
                cells.append(", ".join(f"{100 * np.mean(shares):.0f}%" for shares in up.values()))
            late = f"{np.median(back):.2f}" if back else "–"
            lines.append(f"| `{name}` | {variant or 'default'} | " + " | ".join(cells) + f" | {late} |")
    text = "\n".join(
        [
            *lines,
            "",
            f"Stays up for {EPISODE_S - PUSHED_AT_S:g} s after a push, {2 * args.episodes} pushes along and as"
            f" many across for each speed; last column: the median survivor of {max(args.speeds):g} m/s is within"
            f" {BACK_M_PER_S:g} m/s and {BACK_RAD:g} rad of its reference for good.",
        ]
    )
    print(json.dumps({"rows": rows}) if args.json else text)
    if args.write:
        put(PAGE, "pushes", text)


if __name__ == "__main__":
    main()
