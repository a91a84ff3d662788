"""The guard of changes that are meant to move no bits: hashes of motions, rewards, searches, comparisons, observations.

    python benchmarks/hashes.py --against HEAD~1     hashes that commit, too; says what moved, exit status 1 if anything
    python benchmarks/hashes.py --only rewards       some groups of cases; without --against they are printed

Runs the product through its public face alone (`import fastmimic`, the command line), so that it outlives any change
inside. Numbers are hashed as bytes: a single bit that moves is told. Times, versions and paths are left out. Another
processor rounds differently, so both states are hashed on the same machine; recordings need FASTMIMIC_DATA.
"""

import argparse
import csv
import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import fastmimic as fm

GAITS = ("trot", "pace", "turn", "side-step", "walk", "bound", "backward-trot", "spin")
RECORDED = (
    "dog:pace",
    "dog:trot",
    "dog:right-turn",
    "dog:left-turn",
    "dog:spin",
    "dog:canter",
    "anim:side-steps",
    "anim:turn",
    "anim:in-place",
)
NAMED = (*GAITS, *RECORDED) if os.environ.get("FASTMIMIC_DATA") else GAITS
MOTION_ARRAYS = (
    "root_pos_w",
    "root_quat_wxyz",
    "joint_pos",
    "foot_pos_b",
    "contact",
    "root_lin_vel_w",
    "root_ang_vel_w",
    "joint_vel",
)
ROLLOUT_ARRAYS = ("reward", "terms", "fell", "steps", "drift", "clearance", "slip", "early_contacts", "foot_rmse")
FIGURES: tuple[str, ...] = (
    "reward_mean",
    "reward_std",
    "components",
    "fell",
    "drift_m_per_s",
    "swing_clearance_m",
    "early_contacts_per_s",
)
FIGURES += (
    "stance_slip_m",
    "foot_z_rmse_m",
    "foot_x_rmse_m",
    "estimate_velocity_rmse_m_per_s",
    "estimate_height_rmse_m",
)
"""Of `evaluate --json`, where they are there."""
COLUMNS: tuple[tuple[str, ...], ...] = (
    ("reward_mean", "reward"),
    ("reward_std_perturbed", "reward_std"),
    ("reward_mean_perturbed", "reward_perturbed"),
    ("reward_mean_before", "reward_before"),
    ("fell",),
    ("fell_perturbed",),
    ("drift_m_per_s",),
    ("mean_clearance_m", "swing_clearance_m"),
    ("swing_clearance_least_share",),
    ("stance_slip_m",),
    ("style_distance",),
    ("components_root_pose", "reward_root_pose"),
    ("style_distance_realised",),
    ("foot_z_rmse_m", "foot_z_rmse_after_m"),
    ("foot_x_rmse_m", "foot_x_rmse_after_m"),
    ("evaluations",),
    ("simulated_s",),
)
"""Of a comparison's `results.csv`; later and earlier names."""

Case = tuple[str, str]


def digest(*values: Any) -> str:
    """Of arrays, texts and numbers, with the arrays' types and shapes."""
    found = hashlib.sha256()
    for value in values:
        array = np.ascontiguousarray(value)
        found.update(f"{array.dtype.str}{array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()[:16]


def of_motion(motion: fm.Motion) -> str:
    cycle = np.array([] if motion.cycle is None else motion.cycle, float)
    return digest(*(getattr(motion, name) for name in MOTION_ARRAYS), cycle, motion.rate_hz)


def of_evaluation(evaluation: fm.Evaluation) -> str:
    rollout = evaluation.rollout
    found = [np.asarray(getattr(rollout, name), float) for name in ROLLOUT_ARRAYS]
    return f"{digest(*found)} reward {rollout.reward.mean():.6f}"


def motions() -> Iterator[Case]:
    for robot in ("a1", "go2"):
        for name in NAMED:
            motion, _ = fm.retarget(fm.open_clip(name, robot=fm.load_robot(robot)), fm.load_robot(robot))
            yield f"{robot} {name}", of_motion(motion)


def rewards() -> Iterator[Case]:
    for robot in ("a1", "go2"):
        for name in NAMED:
            yield f"{robot} {name}", of_evaluation(fm.evaluate(name, robot, episodes=3, duration_s=2.0))
    for method in ("raibert", "lh"):
        for name in ("trot", "turn"):
            evaluation = fm.evaluate(name, "a1", episodes=3, duration_s=2.0, method=method)
            yield f"{method} {name}", of_evaluation(evaluation)
    yield "paper trot", of_evaluation(fm.evaluate("trot", "a1", episodes=3, duration_s=2.0, config="paper"))
    for options in (
        ["--observe", "sensors"],
        ["--simulator", "pybullet"],
        ["--simulator", "pybullet", "--observe", "sensors", "--disturb", "friction=0.6", "--config", "paper"],
        ["--disturb", "payload=2", "--disturb", "push=5", "--disturb", "delay=0.004"],
    ):
        figures = command("evaluate", "trot", "--episodes", "3", "--duration", "2", "--json", *options)
        yield "evaluate trot " + " ".join(options), digest(json.dumps([figures.get(name) for name in FIGURES]))


def searches() -> Iterator[Case]:
    options: dict[str, Any] = {"iterations": 3, "population": 4, "duration_s": 0.8}
    with tempfile.TemporaryDirectory() as scratch:
        methods: dict[str, dict[str, Any]] = {
            "trot": {},
            "pace, mbc-dmp-path": {"method": "mbc-dmp-path"},
            "side-step, mbc-dmp-body": {"method": "mbc-dmp-body"},
            "trot, lh-dmp": {"method": "lh-dmp"},
        }
        for name, more in methods.items():
            file = Path(scratch) / "checkpoint.npz"
            file.unlink(missing_ok=True)
            result = fm.imitate(name.split(",")[0], "a1", checkpoint=file, **options, **more)
            yield f"motion of {name}", of_motion(result.motion)
            yield f"checkpoint of {name}", of_checkpoint(file)
        joined = fm.stitch(["pace", "trot"], "a1", cycles=2, iterations=1, part_iterations=1, population=4)
        yield "stitched pace + trot", of_motion(joined.motion)


def of_checkpoint(file: Path) -> str:
    with np.load(file) as data:
        kept = sorted(name for name in data.files if name != "elapsed_s" and data[name].dtype.kind in "fiub")
        return digest(*(data[name] for name in kept))


def comparisons() -> Iterator[Case]:
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "comparison"
        options = ["--methods", "raibert", "mbc", "mbc-dmp", "--seeds", "1", "--iterations", "2", "--population", "4"]
        command("compare", "--motions", "trot", "turn", *options, "--duration", "0.8", "--out", str(out))
        for row in csv.DictReader(io.StringIO((out / "results.csv").read_text())):
            yield f"compare {row['motion']} {row['method']}", digest(*(number(row, names) for names in COLUMNS))


def number(row: dict[str, str], names: tuple[str, ...]) -> float:
    """The first of these columns that the row has; a truth value is 0 or 1."""
    text = next(row[name] for name in names if name in row)
    return float(text == "True") if text in ("True", "False") else float(text or "nan")


def policies() -> Iterator[Case]:
    import gymnasium

    import fastmimic.learning  # noqa: F401

    for vectorised in (False, True):
        make: Callable[..., Any] = gymnasium.make_vec if vectorised else gymnasium.make
        options: dict[str, Any] = {"num_envs": 4} if vectorised else {}
        environment = make(
            "fastmimic/Imitation-v0",
            motion="trot",
            robot="a1",
            randomize=["friction=0.4:1.2", "payload=0:3"],
            **options,
        )
        seen, _ = environment.reset(seed=3)
        rng, course = np.random.default_rng(0), [seen]
        for _ in range(60):
            action = rng.normal(0.0, 0.3, environment.action_space.shape).astype(np.float32)
            seen, reward, terminated, truncated, _ = environment.step(action)
            course += [seen, reward, terminated, truncated]
            if not vectorised and (terminated or truncated):
                seen, _ = environment.reset()
                course.append(seen)
        yield "vectorised environment" if vectorised else "environment", digest(*map(np.asarray, course))
        environment.close()


def deployments() -> Iterator[Case]:
    with tempfile.TemporaryDirectory() as scratch:
        for name, options in {
            "trot": ["--cycles", "3"],
            "turn, horizon": ["--duration", "1.5", "--method", "lh"],
            "pace, bad link": ["--duration", "2", "--loss", "0.05", "--latency-ms", "4", "--robot", "go2"],
        }.items():
            out = Path(scratch) / name.split(",")[0]
            command(
                "deploy", name.split(",")[0], "--driver", "sim", "--yes", "--lock-step", "--out", str(out), *options
            )
            found = of_log(out)
            yield f"deploy {name}", digest(*(found[k] for k in sorted(found.keys() - NOT_HASHED)))


NOT_HASHED = {"solve_s", "meta_json", "motion_npz", "deployment_version"}
NOT_HASHED |= {"received", "lost", "rejected", "foreign", "missed", "skipped"}
"""Of a deployment's log: what takes time, and what not every version of it has."""


def of_log(folder: Path) -> dict[str, Any]:
    """The columns of a deployment's log, of the present kind or an earlier one's `.npz`."""
    if (folder / "log.npz").is_file():
        with np.load(folder / "log.npz") as data:
            return dict(data)
    from fastmimic.deploy.log import DeploymentLog

    log = DeploymentLog.load(folder)
    return columns("", log.rows) | columns("truth_", log.truth)


def columns(prefix: str, rows: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in rows.dtype.names:
        nested = rows.dtype[name].names
        found |= columns(f"{prefix}{name}_", rows[name]) if nested else {f"{prefix}{name}": rows[name]}
    return found


GROUPS: dict[str, Callable[[], Iterator[Case]]] = {
    "motions": motions,
    "rewards": rewards,
    "searches": searches,
    "comparisons": comparisons,
    "policies": policies,
    "deployments": deployments,
}


def command(*arguments: str) -> Any:
    """What a command of the product prints, read as JSON where it is."""
    run = subprocess.run([sys.executable, "-m", "fastmimic", *arguments], capture_output=True, text=True, check=False)
    if run.returncode != 0:
        raise SystemExit(f"fastmimic {' '.join(arguments)} ended with {run.returncode}:\n{run.stdout}{run.stderr}")
    return json.loads(run.stdout) if "--json" in arguments else run.stdout


def hashes_of(commit: str, groups: list[str]) -> dict[str, str]:
    """What this script finds on the code of a commit."""
    here = Path(__file__).resolve()
    with tempfile.TemporaryDirectory() as scratch:
        tree, file = Path(scratch) / "tree", Path(scratch) / "hashes.json"
        subprocess.run(["git", "worktree", "add", "--detach", tree, commit], cwd=here.parent, check=True)
        try:
            source = {"PYTHONPATH": str(tree / "src")}
            words = [sys.executable, str(here), "--only", *groups, "--write", str(file)]
            subprocess.run(words, cwd=scratch, env=os.environ | source, check=True)
            return dict(json.loads(file.read_text()))
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", tree], cwd=here.parent, check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    parser.add_argument("--against", metavar="COMMIT")
    parser.add_argument("--write", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    known = hashes_of(arguments.against, arguments.only) if arguments.against else {}
    print(f"the code in {Path(fm.__file__).parent}", flush=True)
    found: dict[str, str] = {}
    moved = 0
    for group in arguments.only:
        for case, value in GROUPS[group]():
            name = f"{group}: {case}"
            found[name] = value
            same = known.get(name, value) == value
            moved += not same
            print(f"{value}  {name}" if same else f"{value}  {name}  MOVED, was {known[name]}", flush=True)
    missing = [name for name in known if name not in found]
    for name in missing:
        print(f"MISSING  {name}")
    if arguments.write:
        arguments.write.write_text(json.dumps(found, indent=1) + "\n")
    if arguments.against:
        print(f"{len(found)} cases, {moved} moved, {len(missing)} missing")
        sys.exit(1 if moved or missing else 0)


if __name__ == "__main__":
    main()
