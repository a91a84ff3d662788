"""What a controller loses that sees sensors in place of the truth, and how far its estimate is off.

    python benchmarks/estimation.py [--motions trot pace …] [--episodes 32] [--duration 10] [--write]
    python benchmarks/estimation.py --errors dog:trot [--write]
    python benchmarks/estimation.py --contact a1 go2 --motions dog:trot dog:pace … [--write]
    python benchmarks/estimation.py --figure dog:trot estimation.png

Each motion runs with the truth and with sensors (`fastmimic evaluate --observe sensors`), from its start and from
perturbed starts; sensors, estimator and controller are the defaults. `--errors` leaves out one sort of error after the
other on one motion. `--contact` compares contacts found with and without foot sensors. `--figure` draws estimate and
truth. `--write` puts the table between its markers in docs/estimation.md. Motions of the dog need
`fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import dataclasses
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put
from numpy.typing import NDArray

import fastmimic as fm
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.observer import EstimationErrors
from fastmimic.episode.plan import nominal_start
from fastmimic.episode.rollout import Rollout
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.motion.motion import Motion
from fastmimic.render.figure_style import AFTER, DEMONSTRATION, STANCE, new_figure, save, tidy
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions, parse_disturbance
from fastmimic.simulation.config import SensorConfig, ideal_sensors

MOTIONS = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps", "trot", "pace", "turn", "side-step")
PAGE = Path(__file__).resolve().parent.parent / "docs" / "estimation.md"

BEARS = 0.02  # weights; a foot with less counts as free in the gait planner
BOUNCE = 10  # control steps; a foot that is back within 20 ms has bounced
SETTLED = 50  # control steps of the start that are left out

ERRORS = {
    "latency": ("imu_latency_s", "joint_latency_s", "foot_latency_s"),
    "tilt (accelerometer bias, attitude filter)": ("accel_bias", "accel_bias_walk", "tilt_error", "orientation_noise"),
    "gyro bias and noise": ("gyro_bias", "gyro_bias_walk", "gyro_noise"),
    "accelerometer noise": ("accel_noise",),
    "joint offsets": ("joint_offset",),
    "joint noise and quantum": ("joint_pos_noise", "joint_pos_quantum", "joint_vel_noise", "joint_vel_quantum"),
    "foot sensors": ("foot_noise", "foot_quantum", "foot_gain_error", "foot_offset", "foot_offset_walk"),
}


def nominal(motion: Motion, robot: Robot, args: argparse.Namespace, conditions: Conditions, n: int) -> Rollout:
    """n episodes from the motion's start."""
    return run_episodes(robot, motion, start=nominal_start(n), duration_s=args.duration, conditions=conditions)


def perturbed(motion: Motion, robot: Robot, args: argparse.Namespace, conditions: Conditions) -> Rollout:
    """As `fastmimic evaluate --episodes`."""
    return fm.evaluate(
        motion, robot, episodes=args.episodes, duration_s=args.duration, seed=args.seed, conditions=conditions
    ).rollout


def errors_of(rollout: Rollout) -> EstimationErrors:
    assert rollout.estimation is not None
    return rollout.estimation


def reward(rollout: Rollout) -> str:
    """Its mean, and how many fell."""
    fell = int(rollout.fell.sum())
    return f"{rollout.reward.mean():.3f}" + (f" ({fell} fell)" if fell else "")


def compare(robot: Robot, args: argparse.Namespace) -> list[str]:
    lines = [
        "| motion | truth | sensors | loss | drift, % of distance | velocity RMSE, m/s | height RMSE, mm |"
        " tilt RMSE, mrad | heading error, mrad | perturbed starts: truth | sensors |",
        "| --- |" + " --- |" * 10,
    ]
    sensors = Conditions(observe="sensors", seed=args.seed)
    for name in args.motions:
        print(f"{name} …", file=sys.stderr, flush=True)
        motion = fm.load_motion(name, robot)
        truth = nominal(motion, robot, args, Conditions(), 1)
        sensed = nominal(motion, robot, args, sensors, args.episodes)
        errors = errors_of(sensed)
        off = [perturbed(motion, robot, args, c) for c in (Conditions(), sensors)]
        lines.append(
            f"| `{name}` | {reward(truth)} | {reward(sensed)} | {truth.reward[0] - sensed.reward.mean():+.3f} |"
            f" {np.nanmean(errors.position_drift):.2f} | {errors.velocity_rmse.mean():.3f} |"
            f" {1e3 * errors.height_rmse.mean():.1f} | {1e3 * errors.tilt_rmse.mean():.1f} |"
            f" {1e3 * np.abs(errors.heading_error).mean():.1f} | {reward(off[0])} | {reward(off[1])} |"
        )
    return lines


def leave_out(robot: Robot, args: argparse.Namespace) -> list[str]:
    motion = fm.load_motion(args.errors, robot)
    sensors, current = SensorConfig(), EstimatorConfig()
    variants = {"all of them": (sensors, current)}
    for name, fields in ERRORS.items():
        estimator = dataclasses.replace(current, latency_s=0.0) if name == "latency" else current
        variants[f"without {name}"] = dataclasses.replace(sensors, **dict.fromkeys(fields, 0.0)), estimator
    variants["none"] = ideal_sensors(), dataclasses.replace(current, latency_s=0.0)
    lines = ["| errors | reward | velocity RMSE, m/s |", "| --- | --- | --- |"]
    for name, (its, estimator) in variants.items():
        print(f"{name} …", file=sys.stderr, flush=True)
        conditions = Conditions(observe="sensors", seed=args.seed, sensors=its, estimator=estimator)
        found = nominal(motion, robot, args, conditions, args.episodes)
        lines.append(f"| {name} | {reward(found)} | {errors_of(found).velocity_rmse.mean():.3f} |")
    lines.append(f"| the truth in place of sensors | {reward(nominal(motion, robot, args, Conditions(), 1))} | – |")
    return lines


def without_gaps(contact: NDArray[np.bool_], longest: int) -> NDArray[np.bool_]:
    """(t, 4) contacts, with gaps of at most so many control steps closed: a foot that bounces has touched down."""
    closed = contact.copy()
    for leg in range(4):
        at = np.flatnonzero(contact[:, leg])
        for before, after in pairwise(at):
            if after - before <= longest + 1:
                closed[before:after, leg] = True
    return closed


def found_after(true: NDArray[np.bool_], told: NDArray[np.bool_]) -> list[int]:
    """Control steps from each touch-down after 40 ms in the air until it is told, 50 at most; negative if before."""
    delays = []
    for leg in range(4):
        began = np.flatnonzero(true[1:, leg] & ~true[:-1, leg]) + 1
        for k in began[(began >= SETTLED) & (began < len(true) - 50)]:
            if not true[k - 20 : k, leg].any():
                near = told[k - 20 : k + 50, leg]
                starts = np.flatnonzero(near[1:] & ~near[:-1]) + 1 - 20
                delays.append(int(starts[np.argmin(np.abs(starts))]) if len(starts) else 50)
    return delays


def contacts(motion: Motion, robot: Robot, args: argparse.Namespace, foot_force: Any) -> tuple[Rollout, list[str]]:
    """Episodes with sensors, and in words: median delay of touch-downs, ms; share of wrong samples; the same against
    whatever touches at all."""
    conditions = Conditions(observe="sensors", seed=args.seed, estimator=EstimatorConfig(foot_force=foot_force))
    rollout = run_episodes(
        robot, motion, start=nominal_start(args.episodes), duration_s=args.duration, log=True, conditions=conditions
    )
    log = rollout.course
    assert log.estimate is not None
    delays, wrong, touching = [], [], []
    for truth, estimate in zip(log.observation, log.estimate, strict=True):
        force, told = truth["foot_force"][:, :, 2], estimate["foot_force"][:, :, 2] > 0
        true = without_gaps(force > BEARS * robot.mass * GRAVITY, BOUNCE)
        delays += found_after(true, told)
        wrong.append((true != told)[SETTLED:].mean())
        touching.append(((force > 0) != told)[SETTLED:].mean())
    said = f"{1e3 * np.median(delays) / log.rate_hz:.0f} ms", f"{np.mean(wrong):.1%}", f"{np.mean(touching):.1%}"
    return rollout, list(said)


def find_contacts(args: argparse.Namespace) -> list[str]:
    lines = [
        "| robot, motion | foot sensors alone: touch-down | wrong | wrong, bounces too | no foot sensors: touch-down |"
        " wrong | wrong, bounces too | both: touch-down | wrong | wrong, bounces too | reward: sensors alone | none |"
        " both | dead ones |",
        "| --- |" + " --- |" * 13,
    ]
    dead = Conditions(observe="sensors", seed=args.seed, disturbances=(parse_disturbance("foot-force-scale=0"),))
    for name, at in ((robot, at) for robot in args.contact for at in args.motions):
        print(f"{name} {at} …", file=sys.stderr, flush=True)
        robot = fm.load_robot(name)
        motion = fm.load_motion(at, robot)
        ways = [contacts(motion, robot, args, way) for way in ("on", "off", "auto")]
        rewards = [*(found for found, _ in ways), nominal(motion, robot, args, dead, args.episodes)]
        figures = [figure for _, said in ways for figure in said] + [reward(found) for found in rewards]
        lines.append(f"| {name}, `{at}` | {' | '.join(figures)} |")
    return lines


def draw(name: str, robot: Robot, path: Path) -> None:
    """Two seconds of one episode: the base's velocity in its heading frame, height, and the forces on one diagonal."""
    log = fm.evaluate(name, robot, duration_s=4.0, conditions=Conditions(observe="sensors"), log=True).rollout.log
    assert log is not None
    assert log.estimate is not None
    rows = slice(int(2.0 * log.rate_hz), int(4.0 * log.rate_hz))
    truth, estimate = log.observation[0, rows], log.estimate[0, rows]
    t = np.arange(rows.start, rows.stop) / log.rate_hz
    figure = new_figure(8.0, 7.6, f"{name} on {robot.name}: what the controller is told, and what is")
    panels = figure.subplots(4, 1, sharex=True)
    ahead = [rotate_planar(-yaw_from_quat(truth["root_quat"]), x["lin_vel"][:, :2]) for x in (truth, estimate)]
    drawn = (
        ("Forward velocity", "m/s", ahead[0][:, 0], ahead[1][:, 0]),
        ("Sideways velocity", "m/s", ahead[0][:, 1], ahead[1][:, 1]),
        ("Height", "m", truth["root_pos"][:, 2], estimate["root_pos"][:, 2]),
        ("Force on the front right foot", "N", truth["foot_force"][:, 0, 2], estimate["foot_force"][:, 0, 2]),
    )
    for axes, (title, unit, true, told) in zip(panels, drawn, strict=True):
        axes.fill_between(
            t, 0, 1, where=log.wanted[0, rows, 0], transform=axes.get_xaxis_transform(), color=STANCE, lw=0
        )
        axes.plot(t, true, **DEMONSTRATION._asdict(), label="truth")
        axes.plot(t, told, **AFTER._asdict(), label="estimate")
        tidy(axes, title, "s" if axes is panels[-1] else "", unit)
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False, ncols=2)
    save(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--motions", nargs="*", default=MOTIONS)
    parser.add_argument("--errors", metavar="MOTION", help="leave out one sort of error after the other")
    parser.add_argument("--contact", nargs="+", metavar="ROBOT", help="contacts with and without foot sensors")
    parser.add_argument("--figure", nargs=2, metavar=("MOTION", "FILE"), help="draw estimate and truth")
    parser.add_argument("--episodes", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--write", action="store_true", help="put the table into docs/estimation.md")
    args = parser.parse_args()
    robot = fm.load_robot(args.robot)
    if args.figure:
        draw(args.figure[0], robot, Path(args.figure[1]))
        return
    if args.contact:
        text = "\n".join(
            [
                *find_contacts(args),
                "",
                f"Medians and means over {args.episodes} episodes of {args.duration:g} s, each with its own errors of"
                " the sensors; method `mbc`, motions not optimised.",
            ]
        )
        print(text)
        if args.write:
            put(PAGE, "contact", text)
        return
    of = f" of `{args.errors}`" if args.errors else ""
    rest = "" if args.errors else "; on the right from that start and from perturbed ones"
    lines = [
        *(leave_out(robot, args) if args.errors else compare(robot, args)),
        "",
        f"{robot.name}, method `mbc`, motions not optimised: means over {args.episodes} episodes{of} of"
        f" {args.duration:g} s from the motion's start, each with its own errors of the sensors{rest}.",
    ]
    text = "\n".join(lines)
    print(text)
    if args.write:
        put(PAGE, "errors" if args.errors else "estimation", text)


if __name__ == "__main__":
    main()
