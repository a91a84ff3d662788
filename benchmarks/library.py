"""What a library costs: time, memory and disk a motion, and what several processes make of it.

    python benchmarks/library.py cost [--json] [--write]        # about 5 minutes on two idle cores
    python benchmarks/library.py takes [--write] [--out LIBRARY]  # a library of all of the dog's recordings
    python benchmarks/library.py index [--write] [--records N]  # what many records cost; 100,000 take minutes

`--write` puts the tables into docs/library.md. `cost` wants a machine that does nothing else: it compares wall times.
"""

import argparse
import hashlib
import json
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from docs_table import put

from fastmimic.base.arrays import fingerprint
from fastmimic.base.machine import versions
from fastmimic.clips.data import data_folder
from fastmimic.dataset import BuildRequest, BuildSettings, DatasetSource, MotionDataset, build_dataset, find_sources
from fastmimic.dataset.build import BuildStep
from fastmimic.dataset.excerpts import Survey, look_of, survey
from fastmimic.dataset.index import DONE, FIGURES, record_file, sha256
from fastmimic.dataset.jobs import Job, perform
from fastmimic.executors import Executor, Report, make_executor
from fastmimic.executors.local import LocalExecutor
from fastmimic.optimize.cma_es import MOST_ITERATIONS
from fastmimic.robot import load_robot

PAGE = Path(__file__).parents[1] / "docs" / "library.md"
MOTIONS = ("trot", "pace", "turn", "side-step")
SHORT, LONG = 5, 25
CLIPS = 100_000
CORES = 1000


def measured(job: Job, report: Report) -> tuple[dict[str, Any], float]:
    """The record of a job, and the greatest memory of its process so far, MB."""
    record = perform(job, report)
    return record, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def jobs_of(folder: Path, iterations: int) -> list[Job]:
    """The built-in motions on the A1."""
    robot = load_robot("a1")
    recipe = BuildSettings(iterations=iterations)
    pieces = [piece for name in MOTIONS for piece in survey(DatasetSource(name), 0.5).pieces]
    return [Job(piece, "a1", fingerprint(robot.content), 0, recipe, folder) for piece in pieces]


def timed(executor: Executor, iterations: int) -> dict[str, Any]:
    """Wall and processor time of the jobs, memory, and disk."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        MotionDataset(folder).save_recipe(BuildSettings(iterations=iterations))
        began = time.perf_counter()
        done = [outcome.result for outcome in executor.run(measured, jobs_of(folder, iterations))]
        wall = time.perf_counter() - began
        assert all(record["status"] == "done" for record, _ in done), done
        sizes = {
            kind: statistics.mean(path.stat().st_size for path in folder.glob(pattern)) / 1e3
            for kind, pattern in (("motion", "motions/*"), ("record", "records/*"), ("checkpoint", "work/*/*"))
        }
    return {
        "wall_s": wall,
        "cpu_s": statistics.mean(record["cpu_s"] for record, _ in done),
        "simulated_s": statistics.mean(record["simulated_s"] for record, _ in done),
        "memory_mb": max(memory for _, memory in done),
        "kb": sizes,
    }


def cost() -> dict[str, Any]:
    """All of it, measured in one run."""
    one, two = LocalExecutor(1, in_process=False), LocalExecutor(2)
    timed(two, 1)  # compiles, and loads from the disk
    short = {"one": timed(one, SHORT), "two": timed(two, SHORT)}
    long = timed(two, LONG)
    each = (long["cpu_s"] - short["two"]["cpu_s"]) / (LONG - SHORT)
    trials = short["two"]["cpu_s"] - SHORT * each
    whole = trials + MOST_ITERATIONS * each
    sizes = [figures["kb"]["checkpoint"] for figures in (short["two"], long)]
    checkpoint = sizes[1] + (sizes[1] - sizes[0]) / (LONG - SHORT) * (MOST_ITERATIONS - LONG)  # it grows with each
    takes = _surveying()
    return {
        "iteration_cpu_s": each,
        "trials_cpu_s": trials,
        "motion_cpu_s": whole,
        "per_core_hour": 3600 / whole,
        "simulated_per_cpu_s": (long["simulated_s"] - short["two"]["simulated_s"]) / (LONG - SHORT) / each,
        "efficiency_two": short["one"]["wall_s"] / (2 * short["two"]["wall_s"]),
        "memory_mb": long["memory_mb"],
        "kb": {**long["kb"], "checkpoint": checkpoint},
        **takes,
        "core_hours": CLIPS * whole / 3600,
    }


def _surveying() -> dict[str, Any]:
    folder = data_folder() / "dog_keypoints"
    files = sorted(folder.glob("*_joint_pos.txt"))
    if not files:
        return {}
    began, busy = time.perf_counter(), time.process_time()
    found = [survey(source, 0.5) for source in find_sources(folder)]
    seconds = sum(len(path.read_text().splitlines()) for path in files) / 60
    return {
        "survey_cpu_s_per_minute": 60 * (time.process_time() - busy) / seconds,
        "survey_wall_s": time.perf_counter() - began,
        "pieces_per_minute": 60 * sum(len(s.pieces) for s in found) / seconds,
    }


def cost_table(c: dict[str, Any]) -> str:
    """As Markdown, with the arithmetic."""
    kb = sum(c["kb"].values())
    rows = [
        ("a generation of ten candidates, 5 s each", f"{c['iteration_cpu_s']:.2f} s of a core"),
        ("simulated, with its controller", f"{c['simulated_per_cpu_s']:.0f} s a second of a core"),
        ("choosing among the best, and all trials", f"{c['trials_cpu_s']:.0f} s of a core"),
        ("one motion, 200 generations", f"{c['motion_cpu_s']:.0f} s of a core"),
        ("motions a core-hour", f"{c['per_core_hour']:.0f}"),
        ("two processes against one, share of twice as fast", f"{100 * c['efficiency_two']:.0f} %"),
        ("memory of a process, at most", f"{c['memory_mb']:.0f} MB"),
        ("disk: motion, record, checkpoint", " + ".join(f"{c['kb'][k]:.0f}" for k in c["kb"]) + " kB"),
    ]
    if "survey_cpu_s_per_minute" in c:
        rows.append(("looking through a minute of a take", f"{c['survey_cpu_s_per_minute']:.2f} s of a core"))
    hours = c["core_hours"]
    lines = ["| what | measured |", "| --- | --- |", *(f"| {a} | {b} |" for a, b in rows), ""]
    lines += [
        f"{CLIPS:,} clips, one robot, one seed: {CLIPS:,} × {c['motion_cpu_s']:.0f} s = **{hours:,.0f} core-hours**, on"
        f" {CORES:,} cores {hours / CORES:.1f} h; {CLIPS * kb / 1e6:,.0f} GB of disk, of which the checkpoints"
        f" ({CLIPS * c['kb']['checkpoint'] / 1e6:,.0f} GB) may be removed. The {CORES:,} processes need"
        f" {CORES * c['memory_mb'] / 1e6:.1f} TB of memory in all."
    ]
    return "\n".join(lines)


def takes(out: Path, iterations: int, say: Callable[[str], None]) -> str:
    """A library of all recordings of the dog; its table as Markdown."""

    def progress(step: BuildStep) -> None:
        if step.record is not None:
            say(f"{step.done}/{step.total} {step.record['name']}: {step.record['reward_mean']}")

    sources = find_sources(data_folder())
    recipe = replace(BuildSettings(), iterations=iterations)
    built = build_dataset(BuildRequest(sources, recipe, ("a1",)), out, make_executor("local"), progress=progress)
    rows = built.table.to_pylist()
    by_gait: dict[str, Counter[str]] = {}
    for row in rows:
        by_gait.setdefault(row["footfall"] if row["gait"] != "turn" else "turn", Counter())[row["grade"]] += 1
    grades = ["A", "B", "C", "rejected", "failed"]
    lines = [f"| gait | {' | '.join(grades)} |", f"| {' | '.join(['---'] * (len(grades) + 1))} |"]
    for gait, counted in sorted(by_gait.items()):
        lines.append(f"| {gait} | {' | '.join(str(counted[g] or '') for g in grades)} |")
    lost = Counter(
        re.sub(
            r",? (above |below )?[\d.]+( mm)?",
            "",
            (row["limits_exceeded"] or row["lacks"]).split(";")[0].split(" (")[0],
        )
        for row in rows
        if not row["kept"]
    )
    lines += [
        "",
        f"{len(sources)} files, {len(rows)} motions for the A1, {iterations} generations each,"
        f" {sum(row['cpu_s'] for row in rows) / 60:.0f} minutes of a core in all;"
        f" kept {sum(row['kept'] for row in rows)}."
        + (f" What is rejected lacks: {', '.join(f'{why} ({n})' for why, n in lost.most_common())}." if lost else ""),
    ]
    return "\n".join(lines)


def copied(count: int, library: Path, clips: Path) -> None:
    """A library of one record, copied with other names and figures; its clips and motions are a few bytes each."""
    recipe, digest = BuildSettings(), fingerprint(load_robot("a1").content)
    made = MotionDataset(library)
    made.save_recipe(recipe)
    made.save_robot("a1", digest)
    for folder in (clips, library / "motions", library / "records", library / "sources"):
        folder.mkdir()
    (trot,) = survey(DatasetSource("trot"), 0.5).pieces
    versions_at = {f"{name}_version": version for name, version in versions().items()}
    for i in range(count):
        clip = clips / f"clip{i:06}.txt"
        clip.write_text(f"{i}")
        source = DatasetSource(str(clip.resolve()))
        piece = replace(trot, name=source.name, source=source, digest=hashlib.sha256(str(i).encode()).hexdigest()[:16])
        looked = asdict(Survey(source, (piece,), looked=look_of(source, 0.5, "cycles")))
        (library / "sources" / f"{source.key}.json").write_text(json.dumps(looked))
        job = Job(piece, "a1", digest, 0, recipe, library)
        (library / job.motion_file).write_text(f"{i}")
        figures = {name: (i % 997) / 1009 for name, kind in FIGURES.items() if kind is float}
        known = {"status": DONE, "motion_file": job.motion_file, "motion_sha256": sha256(library / job.motion_file)}
        record = job.record | figures | versions_at | known | {"parameters": "0.01, " * 30, "finished": "2026"}
        record_file(library, job.id).write_text(json.dumps(record))


def index(count: int, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """What commands take, each in a process of its own, in a library of so many records."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        library, clips = Path(name) / "library", Path(name) / "clips"
        copied(count, library, clips)
        build_again = ["build", str(clips), "--out", str(library), "--workers", "1"]
        for what, arguments in (
            ("build, nothing to do, all files new", build_again),
            ("build, nothing to do", build_again),
            ("list", ["list", str(library)]),
            ("verify", ["verify", str(library)]),
        ):
            began = time.perf_counter()
            with subprocess.Popen(
                [sys.executable, "-m", "fastmimic", "library", *arguments],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            ) as process:
                assert process.stdout is not None
                said = process.stdout.read().decode()
                _, status, used = os.wait4(process.pid, 0)
                process.returncode = os.waitstatus_to_exitcode(status)
            assert process.returncode == 0, said
            rows.append(
                {
                    "what": what,
                    "records": count,
                    "wall_s": time.perf_counter() - began,
                    "cpu_s": used.ru_utime + used.ru_stime,
                    "memory_mb": used.ru_maxrss / 1024,
                }
            )
            say(f"{what}: {rows[-1]['cpu_s']:.0f} s of a core")
    return rows


def index_table(rows: Sequence[dict[str, Any]]) -> str:
    """As Markdown."""
    lines = [f"| {rows[0]['records']:,} records | s of a core | memory, MB |", "| --- | --- | --- |"]
    return "\n".join([*lines, *(f"| {row['what']} | {row['cpu_s']:.0f} | {row['memory_mb']:.0f} |" for row in rows)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["cost", "takes", "index"])
    parser.add_argument("--json", action="store_true", help="print figures instead of a table")
    parser.add_argument("--write", action="store_true", help="into docs/library.md")
    parser.add_argument("--out", type=Path, default=Path("runs/takes"), help="the library of `takes`")
    parser.add_argument("--iterations", type=int, default=20, help="generations of `takes`")
    parser.add_argument("--records", type=int, default=CLIPS, help="of `index`")
    given = parser.parse_args()

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    if given.what == "cost":
        figures: Any = cost()
        text = cost_table(figures)
    elif given.what == "index":
        figures = index(given.records, say)
        text = index_table(figures)
    else:
        text = takes(given.out, given.iterations, say)
        figures = MotionDataset.open(given.out).index()
    print(json.dumps(figures) if given.json else text)
    if given.write:
        put(PAGE, given.what, text)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
