"""Which difference between simulation and (c) costs a motion its reward, and what the stance's two options change.

    python benchmarks/transfer_ablation.py [--motion anim:side-steps] [--others dog:trot …] [--trials 3]
                                           [--out runs/transfer-ablation.json] [--write]

From the conditions of the optimisation to those of `fastmimic transfer` (c), one difference at a time, without
optimisation, with the controller as it is, with each option alone and with both. The same for other motions, from
which the options could be seen to do harm. What is finished in `--out` is kept and not run again. `--write` puts the
tables between the markers in docs/robustness.md. Motions of the dog need `fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from marked import put

import fastmimic as fm
from fastmimic.base.files import replace_file
from fastmimic.control.config import ControllerConfig, default_config
from fastmimic.control.inertia import WORK, add_standing_leg
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import episode_duration
from fastmimic.experiments.transfer import ACTUATORS, FLOOR, trial_starts
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import pack_model
from fastmimic.simulation.conditions import Conditions

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"
OTHERS: tuple[str, ...] = ("dog:trot", "dog:pace", "dog:right-turn", "anim:turn", "anim:in-place")
OTHERS += ("trot", "pace", "turn", "side-step", "walk", "bound", "spin")
DURATION_S = 10.0

NOMINAL = Conditions()
ALL = Conditions("pybullet", "sensors", 0, (*ACTUATORS, FLOOR))
STEPS = {
    "as optimised": NOMINAL,
    "floor": Conditions("mujoco", "truth", 0, (FLOOR,)),
    "sensors": Conditions("mujoco", "sensors"),
    "sensors, motors": Conditions("mujoco", "sensors", 0, ACTUATORS),
    "sensors, motors, floor": Conditions("mujoco", "sensors", 0, (*ACTUATORS, FLOOR)),
    "PyBullet": Conditions("pybullet", "truth"),
    "PyBullet, floor": Conditions("pybullet", "truth", 0, (FLOOR,)),
    "PyBullet, sensors": Conditions("pybullet", "sensors"),
    "PyBullet, sensors, motors": Conditions("pybullet", "sensors", 0, ACTUATORS),
    "all: (c)": ALL,
}


def configured(**changes: Any) -> ControllerConfig:
    """The default with some of the stance's fields changed."""
    config = default_config()
    return dataclasses.replace(config, stance=dataclasses.replace(config.stance, **changes))


OFF, BOTH = "as it is", "both"
CONFIGS = {
    OFF: configured(),
    "`standing_inertia`": configured(standing_inertia=True),
    "`friction_sides` 8": configured(friction_sides=8),
    BOTH: configured(standing_inertia=True, friction_sides=8),
}


class Results:
    """Trials that are kept in a file as they are finished."""

    def __init__(self, path: Path, robot: fm.Robot, trials: int) -> None:
        self.path, self.robot, self.trials = path, robot, trials
        self.found: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
        self.motions: dict[str, fm.Motion] = {}

    def of(self, motion: str, step: str, conditions: Conditions, config: str) -> dict[str, Any]:
        """Rewards, falls and slip of the trials."""
        key = f"{motion} | {step} | {config} | {self.trials}"
        if key not in self.found:
            if motion not in self.motions:
                self.motions[motion] = fm.load_motion(motion, self.robot)
            given = self.motions[motion]
            rollout = run_episodes(
                self.robot,
                given,
                start=trial_starts(self.trials, 0),
                duration_s=episode_duration(given, DURATION_S),
                config=CONFIGS[config],
                conditions=conditions,
            )
            slip = float(np.nanmean(rollout.slip)) if np.isfinite(rollout.slip).any() else 0.0
            self.found[key] = {"reward": rollout.reward.tolist(), "fell": int(rollout.fell.sum()), "slip": slip}
            self.path.parent.mkdir(parents=True, exist_ok=True)
            text = json.dumps(self.found, indent=1)
            replace_file(self.path, lambda file: file.write(text.encode()))
            print(f"{key}: {np.mean(rollout.reward):.3f}", file=sys.stderr, flush=True)
        return self.found[key]

    def cell(self, motion: str, step: str, conditions: Conditions, config: str, slip: bool = False) -> str:
        its = self.of(motion, step, conditions, config)
        text = f"{np.mean(its['reward']):.3f}"
        text += f", {1e3 * its['slip']:.0f} mm" if slip else ""
        return text + (f", {its['fell']} of {self.trials} fell" if its["fell"] else "")


def ablation(results: Results, motion: str) -> str:
    lines = [
        f"| `{motion}` | {' | '.join(CONFIGS)} |",
        f"| {' | '.join(['---'] * (1 + len(CONFIGS)))} |",
    ]
    for step, conditions in STEPS.items():
        cells = [results.cell(motion, step, conditions, config, slip=True) for config in CONFIGS]
        lines.append(f"| {step} | {' | '.join(cells)} |")
    return "\n".join(lines)


def other_motions(results: Results, motions: list[str]) -> str:
    lines = ["| motion | as optimised | with both | (c) | with both | change to (c) | with both |"]
    lines.append("| --- | --- | --- | --- | --- | --- | --- |")
    last = list(STEPS)[-1]
    for motion in motions:
        cells, changes = [], []
        for step, conditions in (("as optimised", NOMINAL), (last, ALL)):
            cells += [results.cell(motion, step, conditions, config) for config in (OFF, BOTH)]
        for config in (OFF, BOTH):
            before, after = (
                np.mean(results.of(motion, *of, config)["reward"]) for of in (("as optimised", NOMINAL), (last, ALL))
            )
            changes.append(f"{round(100 * (after / before - 1)):+d} %")
        lines.append(f"| `{motion}` | {' | '.join(cells + changes)} |")
    return "\n".join(lines)


def inertias(robot: fm.Robot, names: tuple[str, ...] = ("roll", "pitch", "yaw")) -> str:
    """By how much the rigid body has more inertia than the trunk over its standing feet, home pose."""
    joints = robot.home_joint_pos
    feet = foot_positions(robot, joints)
    lines = [f"| feet that stand | {' | '.join(names)} | without rotors |", "| --- | --- | --- | --- | --- |"]
    for label, legs in (("four", (0, 1, 2, 3)), ("three", (0, 1, 2)), ("two, diagonal", (0, 3)), ("two, left", (1, 3))):
        values = []
        for rotors in (True, False):
            model, held = pack_model(robot), robot.inertia_b.copy()
            if not rotors:
                model["armature"] = 0.0
            for leg in legs:
                q = joints[3 * leg : 3 * leg + 3].copy()
                add_standing_leg(model[0], leg, q, feet[leg], robot.com_b, np.zeros(1, WORK)[0], held)
            values.append([f"{x:.2f}" for x in np.diag(robot.inertia_b) / np.diag(held)])
        lines.append(f"| {label} | {' | '.join(values[0])} | {', '.join(values[1])} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motion", default="anim:side-steps")
    parser.add_argument("--others", nargs="*", default=list(OTHERS))
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("runs/transfer-ablation.json"))
    parser.add_argument("--write", action="store_true", help="put the tables into docs/robustness.md")
    args = parser.parse_args()
    robot = fm.load_robot("a1")
    results = Results(args.out, robot, args.trials)
    text = "\n".join(
        [
            ablation(results, args.motion),
            "",
            "Mean reward, slip in a stance and falls.",
            "",
            other_motions(results, [args.motion, *args.others]),
            "",
            f"Mean reward over {args.trials} trials of {DURATION_S:g} s on a1, the same starts everywhere; retargeted"
            " motions, not optimised.",
            "",
            inertias(robot),
            "",
            "Inertia of the A1 as a rigid body over that of its trunk with the feet held, home pose.",
        ]
    )
    print(text)
    if args.write:
        put(PAGE, "transfer-ablation", text)


if __name__ == "__main__":
    main()
