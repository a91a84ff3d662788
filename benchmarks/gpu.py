"""What MuJoCo Warp on a GPU makes of the A1 in contact, against `mujoco.batch.Batch` on the cores beside it.

    python benchmarks/gpu.py [--json] [--motion trot] [--robots 64 256 ... 16384] [--threads N] [--device cuda:0]

Needs `pip install mujoco-warp`. The closed loop is run once, and the motors' commands of many robots are kept. Both
simulators then repeat a tenth of a second of it: the same states at the beginning, the same commands at every control
step, handed over as a controller would hand them over. So both step the same robots through the same contacts; how far
they end up from each other is printed. Compiling is left out.
"""

import argparse
import copy
import json
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

import fastmimic as fm
from fastmimic.base.machine import available_cores
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import perturbed_start
from fastmimic.simulation.mujoco_sim import MujocoSimulation

RECORDED = 64
RECORDED_S = 1.2
SETTLING = 100  # control steps
WINDOW = 50
REPEATS = 5
CONTACTS, CONSTRAINTS = 24, 96  # room for each robot; what does not fit would be reported


@dataclass
class Course:
    """What n robots begin with, and what their motors are told at each control step."""

    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    ctrl: NDArray[np.float64]
    bias: NDArray[np.float64]

    def of(self, n: int) -> "Course":
        """A window for each of n robots, beginning at different times."""
        starts = self.ctrl.shape[0] - WINDOW
        robot, at = np.arange(n) % RECORDED, (np.arange(n) // RECORDED * 7) % starts
        steps = at + np.arange(WINDOW)[:, None]
        return Course(self.qpos[at, robot], self.qvel[at, robot], self.ctrl[steps, robot], self.bias[steps, robot])


def record(robot: fm.Robot, motion: fm.Motion) -> tuple[Course, mujoco.MjModel]:
    """The closed loop from perturbed starts; and the model."""
    states, commands, models = [], [], []
    whole = MujocoSimulation.step

    def recording(simulation: MujocoSimulation, given: Any) -> Any:
        states.append((simulation._qpos.copy(), simulation._qvel.copy()))
        observation = whole(simulation, given)
        commands.append((simulation._ctrl.copy(), np.array(simulation._bias)))
        models.append(simulation.model)
        return observation

    MujocoSimulation.step = recording  # type: ignore[method-assign, assignment]
    try:
        start = perturbed_start(RECORDED, motion.joint_pos.shape[0], np.random.default_rng(0))
        run_episodes(robot, motion, start=start, duration_s=RECORDED_S)
    finally:
        MujocoSimulation.step = whole  # type: ignore[method-assign]
    qpos, qvel = (np.array([state[i] for state in states[SETTLING:]]) for i in (0, 1))
    ctrl, bias = (np.array([command[i] for command in commands[SETTLING:]]) for i in (0, 1))
    return Course(qpos, qvel, ctrl, bias), models[0]


def timed(reset: Callable[[], None], run: Callable[[], None]) -> float:
    """Median of the seconds that it takes, once it is warm."""
    found = []
    for _ in range(1 + REPEATS):
        reset()
        began = time.perf_counter()
        run()
        found.append(time.perf_counter() - began)
    return statistics.median(found[1:])


def on_cores(model: mujoco.MjModel, course: Course, substeps: int, threads: int) -> tuple[float, NDArray[np.float64]]:
    """Seconds of a window, and where the robots are after it."""
    batch = Batch(model, course.qpos.shape[0], nthread=threads)
    qpos, qvel, ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
    bias = batch.expand("actuator_biasprm")

    def reset() -> None:
        batch.reset()
        qpos[:], qvel[:] = course.qpos, course.qvel

    def run() -> None:
        for step in range(WINDOW):
            ctrl[:], bias[:] = course.ctrl[step], course.bias[step]
            batch.step(nstep=substeps)

    return timed(reset, run), qpos.copy()


def on_gpu(model: mujoco.MjModel, course: Course, substeps: int, device: str) -> tuple[float, NDArray[np.float64], str]:
    """Likewise, and what did not fit, if anything did not."""
    import mujoco_warp as mjw
    import warp as wp

    n = course.qpos.shape[0]
    model = copy.copy(model)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # Warp knows no such thing
    with wp.ScopedDevice(device):
        m = mjw.put_model(model, batch_sizes={"actuator_biasprm": n})
        d = mjw.make_data(model, nworld=n, nconmax=CONTACTS, njmax=CONSTRAINTS)
        qpos, qvel = (wp.array(a, dtype=kept.dtype) for a, kept in ((course.qpos, d.qpos), (course.qvel, d.qvel)))
        ctrl = [wp.array(a, dtype=d.ctrl.dtype) for a in course.ctrl]
        bias = [wp.array(a, dtype=m.actuator_biasprm.dtype) for a in course.bias]

        def step() -> None:
            for _ in range(substeps):
                mjw.step(m, d)

        step()  # compiles
        launch = step
        if wp.get_device(device).is_cuda:
            with wp.ScopedCapture() as capture:
                step()

            def launch() -> None:
                wp.capture_launch(capture.graph)

        def reset() -> None:
            mjw.reset_data(m, d)
            wp.copy(d.qpos, qpos)
            wp.copy(d.qvel, qvel)
            wp.synchronize()

        def run() -> None:
            for at in range(WINDOW):
                wp.copy(d.ctrl, ctrl[at])
                wp.copy(m.actuator_biasprm, bias[at])
                launch()
            wp.synchronize()

        seconds = timed(reset, run)
        overflow = int(np.bitwise_or.reduce(d.overflow.numpy(), axis=None))
        return seconds, d.qpos.numpy().astype(np.float64), mjw.OverflowType(overflow).name or "" if overflow else ""


def compare(course: Course, model: mujoco.MjModel, rate_hz: float, n: int, threads: int, device: str) -> dict[str, Any]:
    """Both, with n robots."""
    part, substeps = course.of(n), round(1.0 / (rate_hz * model.opt.timestep))
    cores_s, there = on_cores(model, part, substeps, threads)
    gpu_s, here, lacking = on_gpu(model, part, substeps, device)
    if lacking:
        raise SystemExit(f"{n} robots: no room for {lacking}; raise CONTACTS and CONSTRAINTS")
    apart = np.abs(here[:, 7:] - there[:, 7:]).max(axis=1)
    return {
        "robots": n,
        "cores_steps_per_s": n * WINDOW * substeps / cores_s,
        "gpu_steps_per_s": n * WINDOW * substeps / gpu_s,
        "times_faster": cores_s / gpu_s,
        "apart_rad_median": float(np.median(apart)),
        "apart_rad_99": float(np.quantile(apart, 0.99)),
    }


def table(rows: Sequence[dict[str, Any]], threads: int) -> str:
    """As Markdown."""
    lines = [
        f"| robots | `Batch`, {threads} threads, robot-steps/s | MuJoCo Warp, robot-steps/s | times faster"
        " | joints apart after 0.1 s, rad: median, 99 % |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {row['robots']:,} | {row['cores_steps_per_s']:,.0f} | {row['gpu_steps_per_s']:,.0f}"
        f" | {row['times_faster']:.2f} | {row['apart_rad_median']:.1e}, {row['apart_rad_99']:.1e} |"
        for row in rows
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--motion", default="trot")
    parser.add_argument("--robots", type=int, nargs="+", default=[64, 256, 1024, 4096, 16384])
    parser.add_argument("--threads", type=int, default=available_cores())
    parser.add_argument("--device", default="cuda:0", help="of Warp; cpu to try the script")
    arguments = parser.parse_args()
    robot = fm.load_robot("a1")
    motion = fm.load_motion(arguments.motion, robot)
    course, model = record(robot, motion)
    rows = []
    for n in arguments.robots:
        rows.append(compare(course, model, motion.rate_hz, n, arguments.threads, arguments.device))
        print(json.dumps(rows[-1]), flush=True)
    if not arguments.json:
        print(table(rows, arguments.threads))
        print(f"{platform.processor() or platform.machine()}, {arguments.device}, {arguments.motion}")


if __name__ == "__main__":
    main()
