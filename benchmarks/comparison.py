"""The comparisons of docs/comparison.md: the paper's methods on the paper's motions.

    python benchmarks/comparison.py [full|printed] [--out FOLDER] [--write] [-- OPTIONS OF compare]
    python benchmarks/comparison.py --scaling

`full` is `fastmimic compare` with two seeds; `printed` is a shorter one under the controller as the paper prints
it. Each goes on where it was interrupted. With `--write` its table goes between its markers in docs/comparison.md.
Motions of the dog need `fastmimic data fetch`, or FASTMIMIC_DATA. `--scaling` measures instead what made us choose
processes: the same searches by threads of one process, and by a process for each core.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from docs_table import put

import fastmimic as fm
from fastmimic.base.machine import available_cores
from fastmimic.cli import main as fastmimic
from fastmimic.experiments.compare import ComparisonPlan, prepare
from fastmimic.experiments.comparison_run import ComparisonSettings
from fastmimic.runs.work_folder import ENVIRONMENT

PAGE = Path(__file__).resolve().parent.parent / "docs" / "comparison.md"
MARKS = {"full": "comparison", "printed": "printed"}
OPTIONS = {
    "full": ("--seeds", "2"),
    "printed": ("--config", "paper", "--seeds", "2", "--iterations", "60"),
}
SEARCH: dict[str, Any] = {"iterations": 10, "population": 10, "duration_s": 5.0}


def scaling() -> None:
    """Two searches at once: by threads one after the other, and by processes side by side."""
    cores = available_cores()
    plan = ComparisonPlan(
        ComparisonSettings(**SEARCH, perturbed_episodes=1, evaluation_s=1.0),
        ("trot",),
        ("mbc-dmp",),
        seeds=cores,
        ablations=False,
    )
    fm.imitate("trot", iterations=1, duration_s=1.0)  # compiled
    began = time.perf_counter()
    for seed in range(cores):
        fm.imitate("trot", seed=seed, **SEARCH)
    threads = time.perf_counter() - began
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        prepared = prepare(plan, Path(folder), keep=True, prepared=lambda name: None)
        prepared.perform(cores, lambda effort, row: None)
        processes = time.perf_counter() - began
    print(f"{cores} searches of {SEARCH['iterations']} iterations on {cores} cores")
    print(f"  one after the other, {cores} threads each: {threads:.1f} s")
    print(f"  side by side, a process each:       {processes:.1f} s, starting the processes included")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("which", nargs="?", choices=OPTIONS, default="full")
    parser.add_argument("--out", type=Path, help="by default runs/comparison-WHICH")
    parser.add_argument("--write", action="store_true", help="put the table into docs/comparison.md")
    parser.add_argument("--scaling", action="store_true", help="measure threads against processes instead")
    given = sys.argv[1:]
    end = given.index("--") if "--" in given else len(given)
    args = parser.parse_args(given[:end])
    if args.scaling:
        scaling()
        return
    out = args.out if args.out is not None else Path("runs") / f"comparison-{args.which}"
    options = ["--out", str(out), *OPTIONS[args.which], *given[end + 1 :]]
    options += ["--resume"] if (out / ENVIRONMENT).is_file() else []
    status = fastmimic(["compare", *options])
    if status == 0 and args.write:
        put(PAGE, MARKS[args.which], (out / "table.md").read_text(encoding="utf-8").strip())
    sys.exit(status)


if __name__ == "__main__":
    main()
