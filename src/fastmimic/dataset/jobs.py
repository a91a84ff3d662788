"""One job of a library: from an excerpt, a robot and a seed to an evaluated motion and its record.

A job reads its source, resumes from its checkpoint if there is one, and writes its motion and then its record. Jobs
share nothing else, so they can run anywhere, at any time and repeatedly.
"""

import re
import socket
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import Final

import numpy as np

from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import CheckpointError, FastMimicError, OutputError
from fastmimic.base.machine import versions
from fastmimic.base.text import plain
from fastmimic.dataset.excerpts import Excerpt, reason_of
from fastmimic.dataset.folder import SETTINGS, BuildSettings
from fastmimic.dataset.index import COLUMNS, DONE, FAILED, MOTIONS, Record, load_record, save_record, sha256
from fastmimic.episode.feasibility import demands, describe_fall, reasons
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.plan import nominal_start, perturbed_start
from fastmimic.executors import Report
from fastmimic.experiments.measurement import measure, named_values, searched
from fastmimic.imitation.imitate import Imitation
from fastmimic.optimize.cma_es import Progress
from fastmimic.robot import load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.runs.work_folder import CHECKPOINT
from fastmimic.simulation.conditions import Conditions, other_robots
from fastmimic.simulation.simulators import SECOND_SIMULATOR, SIMULATORS

WORK: Final = "work"
_SEARCH: Final = 0.85  # approximate share of a job's time in the search
_TRIALS_SEED: Final = 20230618
_SECOND_SIMULATOR_EPISODES: Final = 3


@dataclass(frozen=True)
class Job:
    piece: Excerpt
    robot: str  # a built-in robot's name, or the path of an MJCF
    robot_digest: str
    seed: int
    recipe: BuildSettings
    folder: Path
    began: str = "~"  # start of its build: a motion that failed since then is not tried again

    @cached_property
    def id(self) -> str:
        """Id of its record: 16 hexadecimal digits of everything that determines the motion and its figures."""
        return fingerprint(self._content(self.recipe.digest))

    @property
    def checkpoint(self) -> Path:
        """Checkpoint of its search; kept after the job for longer searches or other evaluations."""
        return self.folder / WORK / fingerprint(self._content(self.recipe.search_digest)) / CHECKPOINT

    @property
    def motion_file(self) -> str:
        """Its motion's file, relative to the library."""
        robot = Path(self.robot).stem
        name = re.sub(r"[^\w.-]+", "_", f"{self.piece.name}-{robot}-{self.seed}")
        short = name.encode()[:100].decode(errors="ignore")  # file systems limit bytes
        return f"{MOTIONS}/{short}-{self.id}.npz"

    @property
    def record(self) -> Record:
        """The part of its record that is known in advance."""
        return {
            **dict.fromkeys(COLUMNS),
            **self.piece.described,
            "id": self.id,
            "robot": Path(self.robot).stem,
            "robot_file": self.robot if Path(self.robot).is_absolute() else None,
            "robot_digest": self.robot_digest,
            "method": self.recipe.method,
            "seed": self.seed,
            "recipe": self.recipe.digest,
        }

    def _content(self, recipe: str) -> bytes:
        return repr((self.piece.digest, self.robot_digest, self.seed, recipe)).encode()


def now() -> str:
    """The time in the records' format."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def perform(job: Job, report: Report) -> Record:
    """Runs a job unless its record exists; returns the record. Errors of the excerpt, and defects that it reveals, go
    into the record, so that the other motions are still made. Raises `OutputError` if the library's folder is not
    visible here, or cannot be written to, such as a full disk."""
    if not (job.folder / SETTINGS).is_file():
        said = f"no library there as seen from {socket.gethostname()}"
        raise OutputError(f"{job.folder}: {said}; all machines must see it under the same path")
    found = load_record(job.folder, job.id)
    if found is not None and (found["status"] != FAILED or job.began <= found["finished"]):
        return found
    began, busy = time.perf_counter(), time.process_time()
    record = job.record
    try:
        record |= _made(job, report)
    except OutputError:
        raise
    except Exception as error:  # noqa: BLE001 - one motion's defect, of which there may be a thousand others
        record |= {"status": FAILED, "reason": reason_of(error)}
    record |= {"wall_s": time.perf_counter() - began, "cpu_s": time.process_time() - busy, "finished": now()}
    return _kept(job, record)


def give_up(job: Job, error: FastMimicError) -> Record:
    """Saves the record of a job that killed its process each time; raises `OutputError` if it cannot."""
    return _kept(job, job.record | {"status": FAILED, "reason": reason_of(error), "finished": now()})


def _kept(job: Job, record: Record) -> Record:
    """Writes the record, unless another builder has done the job meanwhile."""
    there = load_record(job.folder, job.id)
    if there is not None and there["status"] != FAILED:
        return there
    save_record(job.folder, record)
    return record


def _made(job: Job, report: Report) -> Record:
    recipe = job.recipe
    robot = load_robot(job.robot)
    demonstration = load_motion(job.piece.open(), robot).target

    def progress(step: Progress) -> None:
        report(_SEARCH * step.iteration / step.iterations)

    own = {"method": recipe.method, "seed": job.seed, "workers": 1, "progress": progress}
    try:
        result = searched(demonstration, robot, recipe, job.checkpoint, **own)
    except CheckpointError:  # damaged, or of another installation
        job.checkpoint.unlink(missing_ok=True)
        result = searched(demonstration, robot, recipe, job.checkpoint, **own)
    tried = _tried(job, result)
    path = job.folder / job.motion_file
    result.motion.save(path)
    report(1.0)
    said: Record = {
        "status": DONE,
        **tried,
        "parameters": named_values(result),
        "iterations": result.iterations,
        "evaluations": result.evaluations,
        "motion_file": job.motion_file,
        "motion_sha256": sha256(path),
        **{f"{name}_version": version for name, version in versions().items()},
    }
    return {name: plain(value) for name, value in said.items()}


def _tried(job: Job, result: Imitation) -> Record:
    recipe, robot, demonstration = job.recipe, result.robot, result.demonstration
    measured = measure(result, recipe.evaluation_s, recipe.perturbed)
    figures = {name: value for name, value in measured.figures.items() if name in COLUMNS}
    needs = demands(robot, demonstration)
    exceeded = reasons(needs, describe_fall(robot, measured.after))
    simulated_s = result.simulated_s + measured.simulated_s
    figures |= {
        "period_s": demonstration.period_s,
        "speed_m_per_s": np.linalg.norm(demonstration.root_lin_vel_w[:, :2], axis=1).mean(),
        "yaw_rate_rad_per_s": demonstration.root_ang_vel_w[:, 2].mean(),
        "duty_factor": demonstration.contact.mean(),
        "repeats": demonstration.cycle is not None,
        "joint_speed_share": needs.joint_speed,
        "torque_share": needs.torque,
        "friction_needed": needs.friction,
        "flight_share": needs.flight,
        "limits_exceeded": "; ".join(reason.text for reason in exceeded) or None,
    }

    elsewhere = partial(run_episodes, robot, result.motion, duration_s=measured.seconds, config=result.config)
    if recipe.others:
        others = Conditions(disturbances=other_robots(recipe.others))
        rollout = elsewhere(conditions=others, start=nominal_start(recipe.others))
        simulated_s += measured.seconds * recipe.others
        figures |= Metrics.of(rollout).named(("reward_mean", "reward_worst", "fell"), "robots")
    if recipe.second_simulator and SIMULATORS[SECOND_SIMULATOR].knows(job.robot):
        random = np.random.default_rng(_TRIALS_SEED)
        start = perturbed_start(_SECOND_SIMULATOR_EPISODES + 1, 1, random).part(slice(1, None))
        rollout = elsewhere(conditions=Conditions(SECOND_SIMULATOR), start=start)
        simulated_s += measured.seconds * _SECOND_SIMULATOR_EPISODES
        figures |= Metrics.of(rollout).named(("reward_mean", "fell"), "second_simulator")
    return figures | {"simulated_s": simulated_s}
