"""How long planning ahead takes, and the same problems in other solvers.

    python benchmarks/mpc.py [--json] [--seconds 5] [--problems 60]

`solve_us` is what the controller itself logs: foresight, assembly, solution, for every plan of one robot in closed loop
on several motions; with FASTMIMIC_DATA real recordings among them. The other solvers get the assembled problems, each
anew, because the matrices change with the feet; `pip install fastmimic[bench]` brings them. Their times contain setup
and solution, not assembly; `daqp` is ours on the same terms, called from Python.
"""

import argparse
import dataclasses
import json
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rollout import environment

import fastmimic as fm
from fastmimic.control.config import ControllerConfig, HorizonConfig
from fastmimic.control.controller import Controller
from fastmimic.control.native import OPTIMAL, solve_qp
from fastmimic.episode.loop import ClosedLoop
from fastmimic.episode.plan import perturbed_start

BUILT_IN = ("trot", "pace", "turn", "side-step", "walk")
RECORDED = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps")
REPEATS = 3  # of each solution; the fastest counts, for all solvers alike


@dataclasses.dataclass(frozen=True)
class Problem:
    """min ½ xᵀHx + gᵀx, lower ≤ C x ≤ upper, x in multiples of the weight; and our solution."""

    hessian: np.ndarray
    gradient: np.ndarray
    rows: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    simple: int
    x: np.ndarray

    @classmethod
    def of(cls, workspace: Any, k: int) -> "Problem":
        n, m = 3 * k, 5 * k
        return cls(
            workspace["hessian"][: n * n].reshape(n, n).copy(),
            workspace["gradient"][:n].copy(),
            np.vstack([np.eye(n)[:k], workspace["rows"][: 4 * k * n].reshape(4 * k, n)]),
            workspace["lower"][:m].copy(),
            workspace["upper"][:m].copy(),
            k,
            workspace["x"][:n].copy(),
        )

    def cost(self, x: np.ndarray) -> float:
        return float(0.5 * x @ self.hessian @ x + self.gradient @ x)


def configured(rate_hz: float) -> ControllerConfig:
    """The default controller with forces planned ahead that often."""
    config = ControllerConfig()
    return dataclasses.replace(
        config,
        stance=dataclasses.replace(config.stance, forces="horizon"),
        horizon=dataclasses.replace(config.horizon, solve_rate_hz=rate_hz),
    )


def closed_loop(
    robot: fm.Robot, motion: fm.Motion, config: ControllerConfig, seconds: float
) -> tuple[list[float], list[Problem], dict[str, Any]]:
    """Times of all plans (s), the problems, and how the robot did."""
    loop = ClosedLoop(robot, motion, 1, config)
    steps = round(seconds * config.rate_hz)
    start = perturbed_start(2, motion.n_samples, np.random.default_rng(1)).part(slice(1, 2))
    if motion.cycle is None:
        steps = min(steps, motion.n_samples - 1 - int(start.sample[0]))
    loop.run(None, start, 60)  # compiles, and warms the caches up
    times: list[float] = []
    problems: list[Problem] = []
    step, controller = loop.controller.step, loop.controller
    assert isinstance(controller, Controller)

    def recording(observation: Any, clocks: Any) -> Any:
        commands = step(observation, clocks)
        if controller.memory["solve_time"][0] > 0:
            times.append(float(controller.memory["solve_time"][0]))
            k = int(controller._work.foresight["slot"][0, : config.horizon.steps].max()) + 1
            if k > 0:
                problems.append(Problem.of(controller._work.plan_qp[0], k))
        return commands

    controller.step = recording  # type: ignore[method-assign]
    rollout = loop.run(None, start, steps)
    how = {"reward": float(rollout.reward[0]), "fell": bool(rollout.fell[0]), "failures": int(rollout.qp_failures[0])}
    return times, problems, how


def daqp_solver(workspace: Any, p: Problem) -> Callable[[], np.ndarray]:
    n, m, k = len(p.gradient), len(p.upper), p.simple
    workspace["hessian"][: n * n] = p.hessian.ravel()
    workspace["gradient"][:n] = p.gradient
    workspace["rows"][: 4 * k * n] = p.rows[k:].ravel()
    workspace["lower"][:m], workspace["upper"][:m] = p.lower, p.upper

    def solve() -> np.ndarray:
        assert solve_qp(workspace, n, m, k) == OPTIMAL
        return workspace["x"][:n]

    return solve


def osqp_solver(p: Problem) -> Callable[[], np.ndarray]:
    import osqp
    from scipy import sparse

    hessian, rows = sparse.csc_matrix(np.triu(p.hessian)), sparse.csc_matrix(p.rows)

    def solve() -> np.ndarray:
        solver = osqp.OSQP()
        solver.setup(
            hessian, p.gradient, rows, p.lower, p.upper, verbose=False, eps_abs=1e-6, eps_rel=1e-6, max_iter=20_000
        )
        result = solver.solve()
        return np.asarray(result.x) if result.info.status == "solved" else np.full(len(p.gradient), np.nan)

    return solve


def proxqp_solver(p: Problem) -> Callable[[], np.ndarray]:
    import proxsuite

    n, k = len(p.gradient), p.simple
    lower = np.maximum(p.lower, -1e20)  # its infinity

    def solve() -> np.ndarray:
        qp = proxsuite.proxqp.dense.QP(n, 0, 5 * k)
        qp.settings.eps_abs = 1e-6
        qp.init(p.hessian, p.gradient, None, None, p.rows, lower, p.upper)
        qp.solve()
        solved = qp.results.info.status == proxsuite.proxqp.QPSolverOutput.PROXQP_SOLVED
        return np.asarray(qp.results.x) if solved else np.full(n, np.nan)

    return solve


def quadprog_solver(p: Problem) -> Callable[[], np.ndarray]:
    import quadprog

    k = p.simple
    rows = np.vstack([p.rows[:k], -p.rows]).T.copy()
    bounds = np.concatenate([p.lower[:k], -p.upper])

    def solve() -> np.ndarray:
        return np.asarray(quadprog.solve_qp(p.hessian, -p.gradient, rows, bounds)[0])

    return solve


def compare(problems: list[Problem], weight: float, workspace: Any) -> dict[str, Any]:
    """Times and agreement of the solvers that are installed."""
    makers: dict[str, Callable[[Problem], Callable[[], np.ndarray]]] = {
        "daqp": lambda p: daqp_solver(workspace, p),
        "quadprog": quadprog_solver,
        "proxqp": proxqp_solver,
        "osqp": osqp_solver,
    }
    out: dict[str, Any] = {}
    for name, make in makers.items():
        try:
            make(problems[0])()
        except ImportError as e:
            out[name] = {"missing": str(e)}
            continue
        times, forces, costs, failed = [], [], [], 0
        for p in problems:
            solve = make(p)
            best, x = np.inf, p.x
            for _ in range(REPEATS):
                began = time.perf_counter()
                x = solve()
                best = min(best, time.perf_counter() - began)
            times.append(best)
            if not np.isfinite(x).all():
                failed += 1
                continue
            forces.append(float(np.abs(x - p.x).max()) * weight)
            costs.append((p.cost(x) - p.cost(p.x)) / abs(p.cost(p.x)))
        out[name] = {
            "us": percentiles(times),
            "failed": failed,
            "largest_force_difference_n": max(forces, default=None),
            "largest_relative_cost_difference": max(costs, key=abs, default=None),
        }
    return out


def percentiles(seconds: list[float]) -> dict[str, float]:
    """Median and the tail, µs."""
    median, p99, p999 = 1e6 * np.percentile(seconds, [50, 99, 99.9])
    return {"median": float(median), "p99": float(p99), "p999": float(p999)}


def measure(seconds: float, per_motion: int, rate_hz: float) -> dict[str, Any]:
    """All figures of this benchmark."""
    robot, config = fm.load_robot("a1"), configured(rate_hz)
    names = BUILT_IN + (RECORDED if os.environ.get("FASTMIMIC_DATA") else ())
    everything: list[float] = []
    chosen: list[Problem] = []
    motions = {}
    for name in names:
        times, problems, how = closed_loop(robot, fm.load_motion(name, robot), config, seconds)
        everything += times
        chosen += problems[:: max(1, len(problems) // per_motion)]
        variables = [len(p.gradient) for p in problems]
        motions[name] = {
            "solve_us": percentiles(times),
            "plans": len(times),
            "variables": {"median": float(np.median(variables)), "max": max(variables)},
            **how,
        }
    from fastmimic.base.conventions import GRAVITY
    from fastmimic.control.horizon import HORIZON_CONSTRAINTS, HORIZON_VARIABLES
    from fastmimic.control.native import make_workspace

    workspace = make_workspace(HORIZON_VARIABLES, HORIZON_CONSTRAINTS)[0]
    return {
        "solve_us": percentiles(everything),
        "plans": len(everything),
        "motions": motions,
        "solvers": compare(chosen, robot.mass * GRAVITY, workspace),
        "problems_compared": len(chosen),
        "horizon": dataclasses.asdict(config.horizon),
        "environment": environment(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each episode, s")
    parser.add_argument("--problems", type=int, default=60, help="problems of each motion for the other solvers")
    parser.add_argument("--rate", type=float, default=HorizonConfig().solve_rate_hz, help="plans a second, Hz")
    args = parser.parse_args()
    figures = measure(args.seconds, args.problems, args.rate)
    if args.json:
        print(json.dumps(figures))
        return
    for name, f in figures["motions"].items():
        u, v = f["solve_us"], f["variables"]
        print(
            f"{name:18} {f['plans']:5} plans  median {u['median']:6.0f} µs  p99 {u['p99']:6.0f}  p99.9 {u['p999']:6.0f}"
            f"  variables {v['median']:.0f} to {v['max']}  reward {f['reward']:.3f}{'  fell' if f['fell'] else ''}"
        )
    u = figures["solve_us"]
    times = f"median {u['median']:6.0f} µs  p99 {u['p99']:6.0f}  p99.9 {u['p999']:6.0f}"
    print(f"{'all':18} {figures['plans']:5} plans  {times}")
    for name, f in figures["solvers"].items():
        if "missing" in f:
            print(f"{name:9} not installed: {f['missing']}")
            continue
        u = f["us"]
        times = f"median {u['median']:6.0f} µs  p99 {u['p99']:6.0f}  p99.9 {u['p999']:6.0f}"
        print(
            f"{name:9} {times}  failed {f['failed']} of {figures['problems_compared']}, forces differ by"
            f" {f['largest_force_difference_n']} N, relative cost by {f['largest_relative_cost_difference']}"
        )


if __name__ == "__main__":
    main()
