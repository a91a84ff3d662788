"""What the main job costs as a user runs it: whole processes, timed from outside.

    python benchmarks/imitate.py [--json] [--motion trot] [--iterations 200] [--population 10] [--duration 5]

`wall_s` is the optimisation's own figure (video excluded), `process_s` the whole command, and `peak_rss_mb` its memory;
`import_s` and `help_s` are medians of several fresh interpreters.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def timed(command: list[str], repeats: int) -> float:
    """Median seconds of a command."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def fastmimic(*args: str) -> list[str]:
    """The command line as this interpreter runs it."""
    return [sys.executable, "-m", "fastmimic", *args]


def measure(motion: str, iterations: int, population: int, duration: float) -> dict[str, Any]:
    """All figures of this benchmark."""
    with tempfile.TemporaryDirectory() as folder:
        # once with the smallest settings, so that compilation is not part of what is measured
        small = ["--iterations", "1", "--population", "4", "--duration", "0.1", "--no-video"]
        subprocess.run(fastmimic("imitate", motion, "--out", f"{folder}/warm", *small), check=True, capture_output=True)
        out = Path(folder) / "run"
        settings = ["--iterations", str(iterations), "--population", str(population), "--duration", str(duration)]
        began = time.perf_counter()
        subprocess.run(fastmimic("imitate", motion, "--out", str(out), *settings), check=True, capture_output=True)
        process = time.perf_counter() - began
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        metrics = json.loads((out / "metrics.json").read_text())
    return {
        "motion": motion,
        "wall_s": metrics["wall_s"],
        "video_s": metrics["video_s"],
        "process_s": process,
        "evaluations_per_s": metrics["evaluations"] / metrics["wall_s"],
        "realtime_factor": metrics["realtime_factor"],
        "peak_rss_mb": peak,
        "import_s": timed([sys.executable, "-c", "import fastmimic"], 5),
        "help_s": timed(fastmimic("--help"), 5),
        "load_1min": os.getloadavg()[0],
        "versions": metrics["versions"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--motion", default="trot")
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--population", type=int, default=10)
    parser.add_argument("--duration", type=float, default=5.0)
    args = parser.parse_args()
    figures = measure(args.motion, args.iterations, args.population, args.duration)
    if args.json:
        print(json.dumps(figures))
        return
    for name in ("wall_s", "video_s", "process_s", "evaluations_per_s", "realtime_factor", "peak_rss_mb"):
        print(f"{name:20} {figures[name]:.1f}")
    for name in ("import_s", "help_s"):
        print(f"{name:20} {figures[name]:.3f}")


if __name__ == "__main__":
    main()
