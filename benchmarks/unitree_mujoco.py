"""Deployments on Unitree's own public simulator: does the Go2 stand up, walk, and sit down.

    python benchmarks/unitree_mujoco.py --simulator unitree_mujoco --sdk unitree_sdk2_python
                                        [--steps-ms 1 2 5] [--runs 10] [--at-once 1] [--seconds 60]
                                        [--motion trot] [--motion steer --commands way.csv]
                                        [--out runs/unitree_mujoco] [--json]

`--simulator` and `--sdk` are clones of github.com/unitreerobotics/unitree_mujoco and unitree_sdk2_python. Their Python
simulator runs unchanged, with the time step that `--steps-ms` names, on a flat floor, without its window and gamepad.
It never fills in the forces of the feet, the checksum and the tick. `real time` is its own time over the clock's: well
below 1, the machine was too slow for it. Finished runs are kept in `--out`.
"""

import argparse
import json
import os
import runpy
import signal
import subprocess
import sys
import time
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}
FIRST_DOMAIN = 20
FLOOR = """<mujoco model="flat">
  <include file="go2.xml"/>
  <worldbody><geom name="floor" size="0 0 0.05" type="plane"/></worldbody>
</mujoco>
"""


class NoWindow:
    """In place of the simulator's window: it runs until a signal, then writes what became of the robot."""

    def __init__(self, model: Any, data: Any, out: Path) -> None:
        self._data, self._out, self._running, self._begun, self._told = data, out, True, 0.0, False
        signal.signal(signal.SIGTERM, self._stop)

    def _stop(self, *_: Any) -> None:
        self._running = False

    def is_running(self) -> bool:
        self._begun = self._begun or time.perf_counter()
        if not self._running and not self._told:
            self._told = True
            x, y = self._data.qpos[4:6]
            found = {
                "realtime_factor": self._data.time / (time.perf_counter() - self._begun),
                "travelled_m": float(np.hypot(*self._data.qpos[:2])),
                "tilt_rad": float(np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1))),
            }
            self._out.write_text(json.dumps(found))
        return self._running

    def sync(self) -> None:
        """Nothing to draw."""


def simulate(simulator: Path, sdk: Path, step_ms: float, domain: int, out: Path) -> None:
    """Unitree's simulator, in this process, until SIGTERM."""
    import mujoco

    viewer: Any = types.ModuleType("mujoco.viewer")
    viewer.launch_passive = lambda model, data, **_: NoWindow(model, data, out)
    mujoco.viewer = viewer
    sys.modules["mujoco.viewer"] = viewer
    sys.modules.setdefault("pygame", types.ModuleType("pygame"))  # for gamepads only
    sys.path[:0] = [str(simulator / "simulate_python"), str(sdk)]
    os.chdir(simulator / "simulate_python")
    import config  # type: ignore[import-not-found]

    config.SIMULATE_DT, config.DOMAIN_ID = step_ms / 1000, domain
    config.USE_JOYSTICK, config.PRINT_SCENE_INFORMATION = 0, False
    config.ROBOT_SCENE = str(simulator / "unitree_robots/go2/flat.xml")
    runpy.run_path("unitree_mujoco.py", run_name="__main__")


def run(given: argparse.Namespace, step_ms: float, number: int, domain: int) -> dict[str, Any]:
    """One deployment on a simulator of its own."""
    folder = given.out / f"{given.motion.replace(':', '_')}-{step_ms:g}ms-{number}"
    file, truth = folder / "result.json", folder / "simulator.json"
    if file.exists():
        return dict(json.loads(file.read_text()))
    folder.mkdir(parents=True, exist_ok=True)
    own = [sys.executable, __file__, "--simulator", str(given.simulator), "--sdk", str(given.sdk)]
    own += ["--serve", f"{step_ms:g}", str(domain), str(truth)]
    with (folder / "simulator.log").open("w") as log:
        simulator = subprocess.Popen(own, stdout=log, stderr=log, env=ENVIRONMENT)
        try:
            time.sleep(8.0)  # loading, and falling to the floor
            deploy = [sys.executable, "-m", "fastmimic", "deploy", given.motion, "--robot", "go2", "--driver", "go2"]
            deploy += ["--domain", str(domain), "--duration", str(given.seconds), "--yes", "--json"]
            deploy += ["--commands", str(given.commands)] if given.commands else []
            deploy += ["--out", str(folder / f"deploy-{time.time():.0f}")]
            done = subprocess.run(deploy, capture_output=True, text=True, env=ENVIRONMENT, check=False)
        finally:
            simulator.terminate()
            try:
                simulator.wait(20)
            except subprocess.TimeoutExpired:
                simulator.kill()
    account = json.loads(done.stdout) if done.stdout else {"error": done.stderr.strip().splitlines()[-1:]}
    kept = ("stopped_by", "why", "fell", "duration_s", "travelled_m", "velocity_error_m_s", "error")
    found: dict[str, Any] = {"step_ms": step_ms, "run": number, "rc": done.returncode}
    found |= {key: account[key] for key in kept if key in account}
    found["simulator"] = json.loads(truth.read_text()) if truth.exists() else None
    file.write_text(json.dumps(found, indent=1))
    (folder / "account.json").write_text(json.dumps(account, indent=1))
    return found


def table(rows: list[dict[str, Any]]) -> str:
    """The runs by time step, as Markdown."""
    lines = ["| time step | sat down at the end | real time | what ended the others |", "| --- | --- | --- | --- |"]
    for step in sorted({row["step_ms"] for row in rows}):
        of = [row for row in rows if row["step_ms"] == step]
        held = [row for row in of if row["rc"] == 0 and not row.get("fell")]
        factors = [row["simulator"]["realtime_factor"] for row in of if row["simulator"]] or [float("nan")]
        others = sorted({str(row.get("stopped_by", row.get("error"))) for row in of if row not in held})
        lines.append(
            f"| {step:g} ms | {len(held)} of {len(of)} | {min(factors):.2f}–{max(factors):.2f}"
            f" | {', '.join(others) or '–'} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulator", type=Path, required=True)
    parser.add_argument("--sdk", type=Path, required=True)
    parser.add_argument("--steps-ms", type=float, nargs="*", default=[1.0, 2.0, 5.0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--at-once", type=int, default=1, help="each takes two to three cores")
    parser.add_argument("--seconds", type=float, default=60.0, help="in the motion itself")
    parser.add_argument("--motion", default="trot")
    parser.add_argument("--commands", type=Path, help="velocities, for the motion 'steer'")
    parser.add_argument("--out", type=Path, default=Path("runs/unitree_mujoco"))
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--serve", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    given.simulator, given.sdk, given.out = given.simulator.resolve(), given.sdk.resolve(), given.out.resolve()
    given.commands = given.commands and given.commands.resolve()
    if given.serve:
        simulate(given.simulator, given.sdk, float(given.serve[0]), int(given.serve[1]), Path(given.serve[2]))
        return
    (given.simulator / "unitree_robots/go2/flat.xml").write_text(FLOOR)
    cases = [(step, number) for step in given.steps_ms for number in range(given.runs)]
    with ThreadPoolExecutor(given.at_once) as pool:
        asked = [pool.submit(run, given, *case, FIRST_DOMAIN + k % 200) for k, case in enumerate(cases)]
        rows = [future.result() for future in asked]
    if given.json:
        print(json.dumps({"rows": rows}, indent=1))
    else:
        print(table(rows))


if __name__ == "__main__":
    main()
