"""The search for the regulator's costs and the swing joints' gains: CMA-ES, on motions that no table has.

    python benchmarks/tune.py [--minutes 13] [--processes 2] [--seed 1] [--out runs/tune.json]

The score is the mean over the tuning motions of 0.3 of the undisturbed reward, 0.35 of that with pushes along and
across, 0.15 of that with sensors on a floor of friction 0.5, and 0.2 of that on rough ground and down stairs; a robot
that falls gets nothing from then on. The search begins at the defaults and prints its mean after each generation. How
the defaults came about is in docs/method.md. Needs `fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import dataclasses
import json
import time
from functools import cache
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import cma
import numpy as np

from fastmimic.base.configuration import changed
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip
from fastmimic.clips.data import data_folder
from fastmimic.clips.synthesis import gait, keypoints
from fastmimic.control.config import ControllerConfig
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot, load_robot
from fastmimic.simulation.conditions import Conditions, Disturbance, parse_terrain

POPULATION, STEP = 12, 0.35
PUSHES = (("push", 1.0, 3), ("push", -1.0, 3), ("side-push", 1.0, 3), ("side-push", -1.0, 3))  # m/s, episodes
TERRAINS = ("rough=0.05", "stairs-down=0.05")
WEIGHTS = np.array([0.3, 0.35, 0.15, 0.2])

# which numbers move together; all are positive and move by factors
PARAMETERS: tuple[tuple[str, tuple[int, ...] | None], ...] = (
    ("regulator.position_weight", (0, 1)),
    ("regulator.position_weight", (2,)),
    ("regulator.rotation_weight", (0, 1)),
    ("regulator.rotation_weight", (2,)),
    ("regulator.velocity_weight", (0, 1)),
    ("regulator.velocity_weight", (2,)),
    ("regulator.turning_weight", (0, 1, 2)),
    *((f"regulator.{name}", None) for name in ("foothold_weight", "landing_weight", "linear_cost", "angular_cost")),
    *((f"regulator.{name}", None) for name in ("force_cost", "foot_cost", "loading_s", "leg_mass")),
    *((f"swing.{name}", None) for name in ("joint_stiffness", "joint_damping")),
)


def clips() -> tuple[tuple[str, Clip], ...]:
    """The tuning motions, each with the name of its robot."""
    pace, data = gait("pace"), data_folder()
    return (
        ("a1", open_clip("anim:turn")),
        ("go2", open_clip("anim:in-place")),
        ("a1", open_clip("bound")),
        ("a1", keypoints(dataclasses.replace(pace, speed=0.0, lateral_speed=0.12, period=0.85, half_width=0.06))),
        ("go2", keypoints(dataclasses.replace(pace, speed=0.1, period=0.75))),
        ("a1", open_clip(str(data / "deepmimic_motions" / "dog_trot.txt"))),
        ("a1", open_clip(str(data / "dog_keypoints" / "dog_run00_joint_pos.txt"), frames=(441, 468))),
    )


@cache
def motions() -> tuple[tuple[Robot, Motion], ...]:
    """The tuning motions, made executable."""
    robots = {name: load_robot(name) for name in ("a1", "go2")}
    return tuple((robots[name], retarget(clip, robots[name])[0]) for name, clip in clips())


def moved(u: np.ndarray) -> dict[str, dict[str, Any]]:
    """The changes to the defaults: each times exp(u)."""
    changes: dict[str, dict[str, Any]] = {}
    for x, (path, index) in zip(u, PARAMETERS, strict=True):
        part, name = path.split(".")
        found = changes.setdefault(part, {})
        old = found.get(name, getattr(getattr(ControllerConfig(), part), name))
        factor = float(np.exp(x))
        found[name] = factor * old if index is None else [factor * v if i in index else v for i, v in enumerate(old)]
    return changes


def score(u: np.ndarray) -> float:
    """Minus the mean score, for a search that minimises."""
    config, rows = changed(ControllerConfig(), moved(u), "tuned"), []
    slippery = Conditions(observe="sensors", disturbances=(Disturbance("friction", (0.5,)),))
    for robot, motion in motions():
        calm = evaluate(motion, robot, episodes=2, duration_s=3.0, seed=11, config=config)
        pushed = [
            evaluate(
                motion,
                robot,
                episodes=n,
                duration_s=4.0,
                seed=5,
                config=config,
                conditions=Conditions(disturbances=(Disturbance(kind, (speed * robot.mass,)),)),
            )
            for kind, speed, n in PUSHES
        ]
        sensed = evaluate(motion, robot, episodes=2, duration_s=3.0, seed=7, config=config, conditions=slippery)
        rough = [
            evaluate(
                motion,
                robot,
                episodes=3,
                duration_s=5.0,
                seed=9,
                config=config,
                conditions=Conditions(terrain=parse_terrain(terrain)),
            )
            for terrain in TERRAINS
        ]
        parts = ([calm], pushed, [sensed], rough)
        rewards = [float(np.mean([e.rollout.reward.mean() for e in part])) for part in parts]
        rows.append(WEIGHTS @ rewards)
    return -float(np.mean(rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=13.0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="a file for the best costs (JSON)")
    args = parser.parse_args()
    options = {"popsize": POPULATION, "seed": args.seed, "verbose": -9, "CMA_diagonal": True}
    search = cma.CMAEvolutionStrategy(np.zeros(len(PARAMETERS)), STEP, options)
    began = time.monotonic()
    with Pool(args.processes) as pool:
        print(f"defaults: {-pool.map(score, [np.zeros(len(PARAMETERS))])[0]:.4f}", flush=True)
        while time.monotonic() - began < 60 * args.minutes:
            candidates = search.ask()
            found = pool.map(score, candidates, chunksize=1)
            search.tell(candidates, found)
            print(f"generation {search.countiter}: best {-min(found):.4f}, median {-np.median(found):.4f}", flush=True)
            print(json.dumps(moved(search.mean)), flush=True)
    if args.out is not None:
        args.out.write_text(json.dumps(moved(search.mean), indent=1))


if __name__ == "__main__":
    main()
