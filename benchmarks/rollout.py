"""How fast the closed loop is: controller step, control over bare physics, throughput by batch size.

    python benchmarks/rollout.py [--json] [--motion trot] [--steps 1000]

All ratios are measured in one run, in turn, on the same trajectories: physics alone replays the recorded actuator
commands of the closed loop, so that both step the same robots through the same contacts.
"""

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

import fastmimic as fm
from fastmimic.base.machine import available_cores
from fastmimic.episode.loop import ClosedLoop
from fastmimic.episode.plan import nominal_start
from fastmimic.simulation.mujoco_sim import MujocoSimulation

REPEATS = 7


def simulation_of(loop: ClosedLoop) -> MujocoSimulation:
    assert isinstance(loop.simulation, MujocoSimulation)
    return loop.simulation


class Replay:
    """Physics alone: steps a recorded closed loop's commands."""

    def __init__(self, loop: ClosedLoop, steps: int) -> None:
        self.simulation, self.steps, self.loop = simulation_of(loop), steps, loop
        self.course: list[tuple[np.ndarray, np.ndarray]] = []
        step = self.simulation.step

        def recording(commands: Any) -> Any:
            observation = step(commands)
            self.course.append((self.simulation._ctrl.copy(), self.simulation._bias.copy()))
            return observation

        self.simulation.step = recording  # type: ignore[method-assign]
        loop.run(None, nominal_start(loop.n), steps)
        self.simulation.step = step  # type: ignore[method-assign]

    def run(self) -> float:
        """Seconds in `Batch.step` over the recorded course."""
        simulation, loop = self.simulation, self.loop
        loop.place(nominal_start(loop.n))
        spent = 0.0
        for ctrl, bias in self.course:
            simulation._ctrl[:] = ctrl
            simulation._bias[:] = bias
            began = time.perf_counter()
            simulation.batch.step(nstep=simulation.substeps)
            spent += time.perf_counter() - began
        return spent


def closed_over_physics(robot: fm.Robot, motion: fm.Motion, n: int, steps: int, threads: int) -> dict[str, Any]:
    """Time under control over `Batch.step` alone, n robots on `threads` threads, in turn."""
    parts = split(n, threads)
    loops = [ClosedLoop(robot, motion, k) for k in parts]
    replays = [Replay(loop, steps) for loop in loops]

    def control(i: int) -> None:
        loops[i].run(None, nominal_start(parts[i]), steps)

    closed, bare = [], []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(REPEATS):
            bare.append(max(pool.map(lambda r: r.run(), replays)))
            closed.append(timed(lambda: list(pool.map(control, range(threads)))))
    ratios = [c / b for c, b in zip(closed, bare, strict=True)]
    return {
        "robots": n,
        "threads": threads,
        "ratio_median": statistics.median(ratios),
        "ratio_min": min(ratios),
        "ratio_max": max(ratios),
        "physics_us_per_robot_substep": min(bare) / (n * steps * simulation_of(loops[0]).substeps) * 1e6,
    }


def control_step(robot: fm.Robot, motion: fm.Motion, steps: int) -> dict[str, float]:
    """Times of single calls of the controller for one robot along a rollout, µs."""
    loop = ClosedLoop(robot, motion, 1)
    times: list[float] = []
    step = loop.controller.step

    def timing(observation: Any, clocks: Any) -> Any:
        began = time.perf_counter_ns()
        commands = step(observation, clocks)
        times.append((time.perf_counter_ns() - began) / 1e3)
        return commands

    loop.run(None, nominal_start(1), 100)
    loop.controller.step = timing  # type: ignore[method-assign]
    for _ in range(REPEATS):
        loop.run(None, nominal_start(1), steps)
    median, p99, p999 = np.percentile(times, [50, 99, 99.9])
    return {"median": float(median), "p99": float(p99), "p999": float(p999)}


def throughput(robot: fm.Robot, motion: fm.Motion, n: int, steps: int, threads: int) -> float:
    """Robot control steps a second of the whole closed loop."""
    parts = split(n, threads)
    loops = [ClosedLoop(robot, motion, k) for k in parts]

    def run(i: int) -> None:
        loops[i].run(None, nominal_start(parts[i]), steps)

    with ThreadPoolExecutor(len(parts)) as pool:
        best = min(timed(lambda: list(pool.map(run, range(len(parts))))) for _ in range(3))
    return n * steps / best


def split(n: int, parts: int) -> list[int]:
    """n in nearly equal parts, none empty."""
    bounds = np.linspace(0, n, min(parts, n) + 1).astype(int)
    return [int(k) for k in np.diff(bounds)]


def timed(work: Callable[[], Any]) -> float:
    """Seconds that `work` takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def environment() -> dict[str, Any]:
    """What the figures were measured on and with."""
    from fastmimic.base.machine import versions

    return {"machine": platform.machine(), "cores": available_cores(), "load_1min": os.getloadavg()[0], **versions()}


def measure(motion_name: str, steps: int) -> dict[str, Any]:
    """All figures of this benchmark."""
    robot = fm.load_robot("a1")
    motion = fm.load_motion(motion_name, robot)
    threads = available_cores()
    ratio = closed_over_physics(robot, motion, 16, steps, threads)
    return {
        "motion": motion.name,
        "closed_loop_over_physics": ratio["ratio_median"],
        "closed_loop_over_physics_detail": ratio,
        "control_step_us": control_step(robot, motion, steps),
        "robot_steps_per_s": {str(n): throughput(robot, motion, n, steps, threads) for n in (1, 2, 4, 8, 16, 32, 64)},
        "environment": environment(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--motion", default="trot")
    parser.add_argument("--steps", type=int, default=1000)
    args = parser.parse_args()
    figures = measure(args.motion, args.steps)
    if args.json:
        print(json.dumps(figures))
        return
    step = figures["control_step_us"]
    print(f"closed loop over bare physics, 16 robots: {figures['closed_loop_over_physics']:.2f}")
    print(
        f"controller step, one robot: median {step['median']:.1f} µs, p99 {step['p99']:.1f}, p99.9 {step['p999']:.1f}"
    )
    for n, rate in figures["robot_steps_per_s"].items():
        print(f"{n:>4} robots: {rate:,.0f} control steps/s, {rate / 500:.0f} × real time in all")


if __name__ == "__main__":
    main()
