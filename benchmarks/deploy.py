"""Deployments on a robot in another process, over DDS: does it fall, what is it worth, and is the computer fast enough.

    python benchmarks/deploy.py trot.npz turn.npz --seconds 60          # a table
    python benchmarks/deploy.py trot.npz --seconds 60 --faults --lh     # also a bad wire, and planning at 500 Hz
    python benchmarks/deploy.py trot.npz --json                         # one JSON object for each case, one a line

Each case starts 'fastmimic robot-sim', deploys the motion on it, and scores what the robot really did; beside it is the
closed loop of 'fastmimic evaluate --observe sensors' for as long. Motions are those of a Go2.
With --real-time both processes ask for real-time scheduling, as on a robot's own computer; without, other work on this
one shows in the figures.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}
BAD_WIRE = ("--loss", "0.05", "--command-loss", "0.05", "--latency-ms", "4")


@dataclass(frozen=True)
class Case:
    """One deployment: of which motion, on which wire, and with which options."""

    name: str
    motion: str
    wire: tuple[str, ...] = ()
    options: tuple[str, ...] = ()


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "fastmimic", *arguments]


@contextmanager
def robot(case: Case, truth: Path, domain: int, *, real_time: bool) -> Iterator[None]:
    """A simulated robot in a process of its own, that has begun to send states."""
    sim = command("robot-sim", "--domain", str(domain), "--log", str(truth), *case.wire)
    if real_time and shutil.which("chrt"):
        sim = ["chrt", "-f", "40", *sim]
    process = subprocess.Popen(sim, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=ENVIRONMENT)
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if "states" in line:
                break
        else:
            raise SystemExit(f"robot-sim ended with {process.wait()}")
        os.set_blocking(process.stderr.fileno(), False)
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)


def run(case: Case, seconds: float, domain: int, *, real_time: bool) -> dict[str, Any]:
    """Deploys, and scores by what the robot did."""
    with tempfile.TemporaryDirectory() as folder:
        truth, out = Path(folder) / "truth.mcap", Path(folder) / "out"
        with robot(case, truth, domain, real_time=real_time):
            options = [*case.options, "--real-time", "on" if real_time else "off"]
            deploy = command("deploy", case.motion, "--driver", "go2", "--domain", str(domain), "--yes", "--json")
            deploy += ["--duration", str(seconds), "--out", str(out), *options]
            done = subprocess.run(deploy, capture_output=True, text=True, env=ENVIRONMENT, check=False)
        if not done.stdout:
            raise SystemExit(f"{case.name}: {done.stderr.strip().splitlines()[-1]}")
        result = json.loads(done.stdout)
        result["case"] = case.name
        result["reward_robot_side"] = None
        scored = called("evaluate", str(out / "log.mcap"), "--truth", str(truth), "--json")
        if scored is not None:
            result["reward_robot_side"] = scored["reward_mean"]
            result["swing_clearance_robot_side_m"] = scored["swing_clearance_m"]
            result["fell"] = bool(result["fell"] or scored["fell"])
    method = [option for option in case.options if option in ("--method", "lh")]
    loop = called("evaluate", case.motion, "--observe", "sensors", "--duration", str(seconds), "--json", *method)
    result["reward_closed_loop"] = None if loop is None else loop["reward_mean"]
    result["swing_clearance_closed_loop_m"] = None if loop is None else loop["swing_clearance_m"]
    return result


def called(*arguments: str) -> dict[str, Any] | None:
    """What a verb prints as JSON; None if it fails."""
    done = subprocess.run(command(*arguments), capture_output=True, text=True, env=ENVIRONMENT, check=False)
    return dict(json.loads(done.stdout)) if done.returncode == 0 else None


HEADER = (
    "| case | stopped by | fell | reward, robot's side | closed loop | period error, µs: median, 99 % |"
    " control, µs: median, 99 % | planning, µs: median, 99 % | writing, µs | misses | lost |\n" + "| --- " * 11 + "|"
)


def row(r: dict[str, Any]) -> str:
    """A line of the table."""

    def pair(found: dict[str, Any]) -> str:
        return "–" if found["median"] is None else f"{found['median']:.0f}, {found['p99']:.0f}"

    def number(value: float | None) -> str:
        return "–" if value is None else f"{value:.3f}"

    return (
        f"| {r['case']} | {r['stopped_by']} | {'yes' if r['fell'] else 'no'} | {number(r['reward_robot_side'])}"
        f" | {number(r['reward_closed_loop'])} | {pair(r['period_error_us'])} | {pair(r['control_us'])}"
        f" | {pair(r['solve_us'])} | {r['write_us']['median']:.0f}"
        f" | {r['deadline_misses']} of {r['periods']}, {r['periods_skipped']} left out | {r['packets']['lost']} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("motions", nargs="*", default=["trot", "turn"])
    parser.add_argument("--seconds", type=float, default=60.0, help="in the motion itself")
    parser.add_argument("--faults", action="store_true", help="also 5 %% loss each way and 4 ms more latency")
    parser.add_argument("--lh", action="store_true", help="also with planning ahead in every period")
    parser.add_argument("--only", help="the case of this name alone")
    parser.add_argument("--real-time", action="store_true", help="real-time scheduling for both processes")
    parser.add_argument("--domain", type=int, default=90)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    cases = []
    for motion in given.motions:
        name = Path(motion).stem if Path(motion).stem != "motion" else Path(motion).parent.name
        cases.append(Case(name, motion))
        if given.faults:
            cases.append(Case(f"{name}, 5 % lost, 4 ms later", motion, BAD_WIRE))
        if given.lh:
            cases.append(Case(f"{name}, lh at 500 Hz", motion, (), ("--method", "lh")))
    if not given.json:
        print(HEADER)
    for case in cases:
        if given.only is None or given.only == case.name:
            found = run(case, given.seconds, given.domain, real_time=given.real_time)
            print(json.dumps(found) if given.json else row(found), flush=True)
            time.sleep(1.0)  # for the domain to empty


if __name__ == "__main__":
    main()
