"""The search for the regulator's costs: CMA-ES over `RegulatorConfig`, on motions that no table has.

    python benchmarks/tune.py [--minutes 13] [--processes 2] [--seed 1] [--out runs/tune.json]

The score is the mean over the tuning motions of 0.4 of the undisturbed reward, 0.4 of that with pushes along and
across, and 0.2 of that with sensors on a floor of friction 0.5; a robot that falls gets nothing from then on. The
search begins at the defaults and prints its mean after each generation. The defaults are its result, rounded. Needs
`fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import dataclasses
import json
import time
from functools import cache
from multiprocessing import Pool
from pathlib import Path

import cma
import numpy as np

from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip
from fastmimic.clips.data import data_folder
from fastmimic.clips.synthesis import gait, keypoints
from fastmimic.control.config import ControllerConfig
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot, load_robot
from fastmimic.simulation.conditions import Conditions, Disturbance

POPULATION, STEP = 12, 0.5
PUSHES = (("push", 0.8, 3), ("push", -0.8, 3), ("side-push", 0.5, 4), ("side-push", -0.5, 4))  # m/s, episodes
WEIGHTS = np.array([0.4, 0.4, 0.2])

# which numbers of `RegulatorConfig` move together; all are positive and move by factors
PARAMETERS: tuple[tuple[str, tuple[int, ...] | None], ...] = (
    ("position_weight", (0, 1)),
    ("position_weight", (2,)),
    ("rotation_weight", (0, 1)),
    ("rotation_weight", (2,)),
    ("velocity_weight", (0, 1)),
    ("velocity_weight", (2,)),
    ("turning_weight", (0, 1, 2)),
    *((name, None) for name in ("foothold_weight", "landing_weight", "linear_cost", "angular_cost", "force_cost")),
    *((name, None) for name in ("foot_cost", "loading_s", "leg_mass")),
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


def moved(u: np.ndarray) -> RegulatorConfig:
    """The defaults, each times exp(u)."""
    config = RegulatorConfig()
    for x, (name, index) in zip(u, PARAMETERS, strict=True):
        old = getattr(config, name)
        factor = float(np.exp(x))
        new = factor * old if index is None else tuple(factor * v if i in index else v for i, v in enumerate(old))
        config = dataclasses.replace(config, **{name: new})  # type: ignore[arg-type]
    return config


def score(u: np.ndarray) -> float:
    """Minus the mean score, for a search that minimises."""
    config, rows = ControllerConfig(regulator=moved(u)), []
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
        rewards = [float(np.mean([e.rollout.reward.mean() for e in part])) for part in ([calm], pushed, [sensed])]
        rows.append(WEIGHTS @ rewards)
    return -float(np.mean(rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=13.0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="a file for the best costs (JSON)")
    args = parser.parse_args()
    options = {"popsize": POPULATION, "seed": args.seed, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.zeros(len(PARAMETERS)), STEP, options)
    began = time.monotonic()
    with Pool(args.processes) as pool:
        print(f"defaults: {-pool.map(score, [np.zeros(len(PARAMETERS))])[0]:.4f}", flush=True)
        while time.monotonic() - began < 60 * args.minutes:
            candidates = search.ask()
            found = pool.map(score, candidates, chunksize=1)
            search.tell(candidates, found)
            print(f"generation {search.countiter}: best {-min(found):.4f}, median {-np.median(found):.4f}", flush=True)
            print(json.dumps(dataclasses.asdict(moved(search.mean))), flush=True)
    if args.out is not None:
        args.out.write_text(json.dumps({"regulator": dataclasses.asdict(moved(search.mean))}, indent=1))


if __name__ == "__main__":
    main()
