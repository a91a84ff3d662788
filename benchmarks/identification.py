"""What one logged run says of friction and payload, and what knowing it is worth: tables of docs/robustness.md.

    python benchmarks/identification.py [--motions dog:trot …] [--trials 4] [--write]

Every run has sensors. Motions of the dog need `fastmimic data fetch`, or FASTMIMIC_DATA. `--write` puts the tables
between the markers in docs/robustness.md.
"""

import argparse
from pathlib import Path

from docs_table import put

from fastmimic.base.errors import LogError
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.rollout import Rollout, run_log
from fastmimic.experiments.compare import PAPER_MOTIONS
from fastmimic.experiments.transfer import STAGES, trial_starts
from fastmimic.identification.identify import Identification, identify
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.state import RunLog
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, Disturbance

DOCS = Path(__file__).resolve().parent.parent / "docs"
FLOORS = (0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
PAYLOADS = (0.0, 1.0, 2.0, 3.0, 5.0)
SLIPPERY = (0.4, 0.5, 0.6)
RUN_S = 5.0
SIDE_STEPS = "anim:side-steps"
MOTORS = tuple(d for d in STAGES[-1].disturbances if d.name != "friction")


def conditions(simulator: str, **disturbances: float) -> Conditions:
    """With sensors; PyBullet with the motors of the transfer's last stage."""
    own = tuple(Disturbance(name, (value,)) for name, value in disturbances.items())
    return Conditions(simulator, "sensors", 0, (*MOTORS, *own) if simulator == "pybullet" else own)


def logged(robot: Robot, motion: Motion, where: Conditions) -> RunLog:
    """The log of one run from the motion's start."""
    rollout = run_episodes(robot, motion, duration_s=RUN_S, log=True, conditions=where)
    assert rollout.log is not None
    return run_log(rollout.log, 0, robot=robot.name, motion=motion.name, latency_s=where.estimator.latency_s)


def shown(found: Identification | None) -> str:
    """Friction in a cell."""
    if found is None:
        return "fell"
    f = found.friction
    if f.value is None or f.upper is None:
        return f"≥ {f.lower:.2f}"
    return f"{f.value:.2f} ({f.lower:.2f} … {f.upper:.2f})"


def try_identify(log: RunLog, robot: Robot, unloaded: RunLog | None = None) -> Identification | None:
    """None where the robot did not stand long enough."""
    try:
        return identify(log, robot, unloaded)
    except LogError:
        return None


def friction_table(robot: Robot, motions: list[Motion]) -> list[str]:
    """Identified friction over floors and motions."""
    lines = [f"| true friction | {' | '.join(f'`{m.name}`' for m in motions)} |", "| --- " * (1 + len(motions)) + "|"]
    for floor in FLOORS:
        where = conditions("mujoco", friction=floor)
        cells = [shown(try_identify(logged(robot, motion, where), robot)) for motion in motions]
        lines.append(f"| {floor:g} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return lines


def payload_table(robot: Robot, motions: list[Motion]) -> list[str]:
    """Identified payload over masses and motions, with an unloaded run and without."""
    lines = [
        f"| true payload, kg | {' | '.join(f'`{m.name}`' for m in motions)} |",
        "| --- " * (1 + len(motions)) + "|",
    ]
    empty = {motion.name: logged(robot, motion, conditions("mujoco")) for motion in motions}
    for mass in PAYLOADS:
        cells = []
        for motion in motions:
            log = logged(robot, motion, conditions("mujoco", payload=mass)) if mass else empty[motion.name]
            alone, tared = try_identify(log, robot), try_identify(log, robot, empty[motion.name])
            a, t = (None if found is None else found.payload for found in (alone, tared))
            if a is None or t is None:
                cells.append("fell")
                continue
            cells.append(f"{t.mass:.2f} ± {t.upper - t.mass:.2f} ({a.mass:.2f} ± {a.upper - a.mass:.2f})")
        lines.append(f"| {mass:g} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return lines


def trials(robot: Robot, motion: Motion, where: Conditions, config: ControllerConfig, count: int) -> Rollout:
    """Episodes from starts that a person's hands would give."""
    return run_episodes(robot, motion, start=trial_starts(count, 1), duration_s=RUN_S, config=config, conditions=where)


def worth(rollout: Rollout) -> str:
    """Reward, slip and falls in a cell."""
    fell = f", {int(rollout.fell.sum())} of {len(rollout.fell)} fell" if rollout.fell.any() else ""
    return f"{rollout.reward.mean():.3f}, {1e3 * rollout.slip.mean():.0f} mm{fell}"


def before_and_after(robot: Robot, motions: list[Motion], count: int) -> list[str]:
    """What the floor that a side-step was identified on does to all motions, before and after."""
    lines = [
        "| floor | identified, assumed | motion | before | after |",
        "| --- | --- | --- | --- | --- |",
    ]
    side_steps = load_motion(SIDE_STEPS, robot)
    for simulator, floors, tried in (
        ("mujoco", SLIPPERY, motions),
        ("pybullet", SLIPPERY, [side_steps]),
    ):
        for floor in floors:
            where = conditions(simulator, friction=floor)
            found = try_identify(logged(robot, side_steps, where), robot)
            if found is None:
                continue
            before = ControllerConfig()
            after = found.configure(before)
            said = f"{shown(found)}, {after.stance.friction:.2f}"
            said += f", payload {after.load.mass:.1f} kg" if after.load.mass else ""
            for motion in tried:
                cells = [worth(trials(robot, motion, where, config, count)) for config in (before, after)]
                lines.append(f"| {simulator}, {floor:g} | {said} | `{motion.name}` | {' | '.join(cells)} |")
                print(lines[-1], flush=True)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=list(PAPER_MOTIONS))
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--write", action="store_true", help="put it into docs/robustness.md")
    args = parser.parse_args()
    robot = load_robot("a1")
    motions = [load_motion(name, robot) for name in args.motions]
    friction = friction_table(robot, motions)
    payload = payload_table(robot, motions)
    worth_it = before_and_after(robot, motions, args.trials)
    text = "\n".join(
        [
            *friction,
            "",
            f"Friction from one run of {RUN_S:g} s in MuJoCo with sensors, with the 95 % interval; ≥: no foot slid.",
            "",
            *payload,
            "",
            "Payload in kg with the 95 % interval, given a run without payload, and in brackets without one.",
            "",
            *worth_it,
            "",
            f"Reward, slip in a stance and falls of {args.trials} trials of {RUN_S:g} s, before and after the"
            f" controller is told what one run of `{SIDE_STEPS}` on that floor says; PyBullet with the motors of (c).",
        ]
    )
    print(text)
    if args.write:
        put(DOCS / "robustness.md", "identification", text)


if __name__ == "__main__":
    main()
