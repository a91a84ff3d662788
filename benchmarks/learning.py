"""How much of the bare physics' throughput the episodes for learning keep, observation, reward and reset included.

    python benchmarks/learning.py [--json] [--motion side-step] [--robots 256] [--steps 40] [--threads N]

Each policy step is taken by the environment, then the same robots are put back and `Batch.step` alone is timed over the
same motor commands, so that both step the same robots through the same contacts at almost the same time. On a busy
machine the ratio by processor time is the one to look at.
"""

import argparse
import json
import os
import platform
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

import fastmimic as fm
from fastmimic.base.machine import available_cores
from fastmimic.learning.config import FRAME_SIZE, HISTORY, IMU_SIZE
from fastmimic.learning.episodes import Episodes, Shard

WARM_UP = 3


class Replay:
    """Physics alone, of some of the robots: the last policy step's motor commands again."""

    def __init__(self, shard: Shard) -> None:
        self.simulation = shard.simulation
        self.course: list[tuple[np.ndarray, np.ndarray]] = []
        self.before = self.simulation.batch.state.copy()
        step = self.simulation.step

        def recording(commands: Any) -> Any:
            observation = step(commands)
            self.course.append((self.simulation._ctrl.copy(), self.simulation._bias.copy()))
            return observation

        self.simulation.step = recording  # type: ignore[method-assign]

    def remember(self) -> None:
        """Where the robots are before the policy step."""
        self.before[...] = self.simulation.batch.state
        self.course.clear()

    def run(self) -> tuple[float, float]:
        """Wall and processor seconds in `Batch.step` over that step; the robots are then where they were."""
        simulation, after = self.simulation, self.simulation.batch.state.copy()
        simulation.batch.state[...] = self.before
        wall = busy = 0.0
        for ctrl, bias in self.course:
            simulation._ctrl[:], simulation._bias[:] = ctrl, bias
            began, began_busy = time.perf_counter(), time.thread_time()
            simulation.batch.step(nstep=simulation.substeps)
            wall += time.perf_counter() - began
            busy += time.thread_time() - began_busy
        simulation.batch.state[...] = after
        return wall, busy


def measure(robot: fm.Robot, motion: fm.Motion, n: int, steps: int, threads: int) -> dict[str, Any]:
    """Throughput of `steps` policy steps of n robots, and of the physics in them alone."""
    episodes = Episodes(robot, motion, n, threads=threads, seed=0)
    replays = [Replay(shard) for shard in episodes._shards]
    rng = np.random.default_rng(0)
    seen = episodes.reset()
    wall = busy = bare_wall = bare_busy = 0.0
    done = 0
    with ThreadPoolExecutor(threads) as pool:
        for step in range(WARM_UP + steps):
            actions = follow(robot, episodes, seen) + rng.normal(0, 0.3, (n, 12))
            for replay in replays:
                replay.remember()
            began, began_busy = time.perf_counter(), time.process_time()
            outcome = episodes.step(actions)
            took, took_busy = time.perf_counter() - began, time.process_time() - began_busy
            # an episode that ended has moved its robot: the replay leaves it there
            alone = list(pool.map(lambda replay: replay.run(), replays))
            seen = outcome.seen
            if step >= WARM_UP:
                wall, busy, done = wall + took, busy + took_busy, done + int(outcome.done.sum())
                bare_wall += max(a[0] for a in alone)
                bare_busy += sum(a[1] for a in alone)
    episodes.close()
    decimation = episodes.config.decimation
    return {
        "robots": n,
        "threads": threads,
        "share_of_physics_wall": bare_wall / wall,
        "share_of_physics_processor": bare_busy / busy,
        "policy_steps_per_s": n * steps / wall,
        "physics_us_per_robot_substep": bare_busy / (n * steps * decimation * replays[0].simulation.substeps) * 1e6,
        "episodes_ended": done,
    }


def follow(robot: fm.Robot, episodes: Episodes, seen: np.ndarray) -> np.ndarray:
    """Actions (n, 12) that extrapolate the reference's joints from the next two frames."""
    first = HISTORY * (IMU_SIZE + 24) + 7
    one, two = (seen[:, at : at + 12] for at in (first, first + FRAME_SIZE))
    return np.asarray((2.0 * two - one - robot.home_joint_pos) / episodes.config.action_scale)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--motion", default="side-step")
    parser.add_argument("--robots", type=int, default=256)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--threads", type=int, default=available_cores())
    arguments = parser.parse_args()
    robot = fm.load_robot("a1")
    motion = fm.load_motion(arguments.motion, robot)
    counts = dict.fromkeys((1, arguments.threads))
    found = {
        "motion": arguments.motion,
        "machine": {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()},
        "results": [measure(robot, motion, arguments.robots, arguments.steps, threads) for threads in counts],
    }
    if arguments.json:
        print(json.dumps(found))
        return
    for r in found["results"]:
        print(
            f"{arguments.motion}, {r['robots']} robots, {r['threads']} thread{'s' if r['threads'] > 1 else ''}:"
            f" {100 * r['share_of_physics_wall']:.0f} % of the bare physics' throughput"
            f" ({100 * r['share_of_physics_processor']:.0f} % by processor time),"
            f" {r['policy_steps_per_s']:.0f} policy steps/s, physics {r['physics_us_per_robot_substep']:.1f} us a"
            f" robot-substep, {r['episodes_ended']} episodes ended"
        )


if __name__ == "__main__":
    main()
