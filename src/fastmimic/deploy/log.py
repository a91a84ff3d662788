"""The files of a deployment: its log, a row per period, a simulated robot's true states, and the thread that writes.

Its folder holds `log.mcap`, which grows while it runs, and in the end `motion.npz` and `deployment.json`.
"""

import io
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Thread
from typing import Annotated, Any, Final, Self

import msgspec
import numpy as np

from fastmimic.base.arrays import Records
from fastmimic.base.conventions import RATE_RANGE_HZ
from fastmimic.base.errors import LogError, MotionError, OutputError
from fastmimic.base.files import read_json
from fastmimic.base.jit import floats, integers
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.log_file import LogFile, read_log_file
from fastmimic.motion.motion import Motion
from fastmimic.robot.state import COMMAND, OBSERVATION, READING, RunLog
from fastmimic.runs.work_folder import MOTION, created

ENDING: Final = ".mcap"
LOG: Final = f"log{ENDING}"
RESULT: Final = "deployment.json"
PERIODS: Final = "/fastmimic/period"  # topic of `ROW`
TRUTH: Final = "/fastmimic/truth"  # topic of a simulated robot's true states, (t,) of `OBSERVATION`, at the states used
ROBOT_SIM: Final = "/fastmimic/robot_sim"  # topic of `GROUND_TRUTH`


class _Ended(msgspec.Struct):
    stopped_by: str
    log_ends: str | None = None


class RunFacts(msgspec.Struct, frozen=True, kw_only=True):
    """What a log says of its run. `config` is the controller's, `method` its method; `limits` are the `SafetyLimits`,
    `torque_limit` (12,), N·m, and `joint_speed_limit` (12,), rad/s, the robot's; `arguments` and `versions` are those
    of the command; `result` has the figures; none if the log was cut off."""

    robot: str
    motion: str
    driver: str
    method: str
    foot_force: str
    config: dict[str, Any]
    latency_s: Annotated[float, msgspec.Meta(ge=0, le=1)]
    rate_hz: Annotated[float, msgspec.Meta(ge=RATE_RANGE_HZ[0], le=RATE_RANGE_HZ[1])]
    steered: bool = False
    dry_run: bool = False
    limits: dict[str, Any] = {}
    torque_limit: list[float] = []
    joint_speed_limit: list[float] = []
    arguments: dict[str, Any] = {}
    versions: dict[str, str] = {}
    result: dict[str, Any] = {}

    @property
    def controller(self) -> ControllerConfig:
        """The controller's parameters; raises `ConfigError` for others."""
        return ControllerConfig.from_dict(self.config)

    def as_dict(self) -> dict[str, Any]:
        """JSON types."""
        return dict(msgspec.to_builtins(self))


EVERY_S: Final = 0.25  # what a kill may lose; a slow disk sets its own pace
_MOST: Final = 512  # rows at once
_BEHIND: Final = 15_000  # rows, 30 s, that a disk may be behind

ROW: Final = np.dtype(
    [
        *floats(time_s=(), late_s=(), read_s=(), control_s=(), write_s=(), round_trip_s=(), age_s=()),
        *integers(sequence=(), received=(), lost=(), rejected=(), foreign=(), missed=(), skipped=(), sample=()),
        *floats(origin=3, haste=(), wanted=3),
        *[("reading", READING), ("estimate", OBSERVATION), ("command", COMMAND)],
        *floats(force=(4, 3), solve_s=()),
        *integers(early_touchdowns=(), qp_failures=()),
        *[("cut", "i4"), ("phase", "i1"), ("fresh", "?"), ("in_motion", "?"), ("sent", "?"), ("stance", "?", (4,))],
    ]
)
"""One period: its start since the run's start, and its delay; durations of reading, control and writing, and from the
state's arrival to the command's departure; the state's age and sequence number; packets received, lost, rejected and
foreign, and periods missed and skipped, since the run's start; the reference's sample, origin and haste, and the
velocity wanted of it, if it is steered; state, estimate, command; commanded ground reaction forces (heading frame, N),
planning time and counts; how many numbers of the command were cut; the `DeploymentPhase`; whether the state was new,
the robot in the motion itself, and the command sent; stance legs."""

GROUND_TRUTH: Final = np.dtype(
    [
        *[("time_s", "f8"), ("tick", "i8"), ("observation", OBSERVATION), ("command", COMMAND)],
        *[("damped", "?"), ("service", "?")],
    ]
)
"""One measured state, whether or not it arrived: time since the start, s; tick (the driver's sequence number); true
state; command of the motors; whether they damped for lack of commands; whether the motion service was active."""


@dataclass(frozen=True, eq=False)
class DeploymentLog:
    """A deployment."""

    rows: Records  # (t,) of `ROW`
    motion: Motion
    facts: RunFacts
    truth: Records | None = None  # (t,) of `OBSERVATION`, at the states used; of a simulated robot

    @property
    def rate_hz(self) -> float:
        return self.facts.rate_hz

    def with_result(self, result: dict[str, Any]) -> "DeploymentLog":
        """The log with a run's figures."""
        return replace(self, facts=msgspec.structs.replace(self.facts, result=result))

    def run_log(self) -> RunLog:
        """The part in the motion itself, to identify from; raises `LogError` if the robot did not reach it."""
        at = np.flatnonzero(self.rows["in_motion"])
        if len(at) < 2:
            raise LogError("the robot did not reach the motion, so there is nothing to identify")
        step, after = self.rows[at[:-1]], self.rows[at[1:]]
        about, seen = self.facts, (after["reading"], step["command"], after["estimate"], step["stance"])
        return RunLog(about.robot, about.motion, about.rate_hz, about.latency_s, *map(np.ascontiguousarray, seen))

    @classmethod
    def load(cls, path: str | Path) -> "DeploymentLog":
        """Reads a log, or that in a deployment's folder. One that was cut off is read as far as it goes. Raises
        `LogError` for any other or a damaged file."""
        path = log_path(path)
        found = read_log_file(path, {PERIODS: ROW, TRUTH: OBSERVATION})
        rows, truth = found.rows[PERIODS], found.rows[TRUTH]
        if not len(rows):
            raise LogError(f"{path}: not the log of a deployment, or it ends before its first period")
        try:
            motion = Motion.load(io.BytesIO(found.attachments[MOTION]))
            facts = msgspec.convert(found.metadata, RunFacts)
            if facts.result:
                msgspec.convert(facts.result, _Ended)
        except msgspec.ValidationError as error:
            raise LogError(f"{path}: the log is damaged: {error}") from None
        except (KeyError, MotionError):
            raise LogError(f"{path}: the log is damaged: it has no readable {MOTION}") from None
        return cls(rows, motion, facts, truth if len(truth) == len(rows) else None)


def new_log_file(path: Path, motion: Motion, facts: Mapping[str, Any], rows: int, *, with_truth: bool) -> LogFile:
    """A log to be written, of about so many rows; raises `OutputError` if it cannot be, or the disk has no room."""
    content = io.BytesIO()
    motion.save(content)
    kinds = {PERIODS: ROW, **({TRUTH: OBSERVATION} if with_truth else {})}
    return LogFile(path, kinds, rows, {MOTION: content.getvalue()}, facts)


def log_path(path: str | Path) -> Path:
    """The log in the folder of a deployment; another path as it is. Raises `LogError` if there is none."""
    path = Path(path)
    if not path.is_dir():
        return path
    if (path / LOG).is_file():
        return path / LOG
    with suppress(LogError, KeyError, TypeError):
        if given := read_json(path / RESULT, LogError)["arguments"]["log"]:
            return Path(given)
    raise LogError(f"{path}: a folder without {LOG}")


def is_deployment_log(path: str | Path) -> bool:
    """Whether a path is that of a log or of a deployment's folder, whole or damaged."""
    path = Path(path)
    return path.suffix == ENDING or (path / LOG).is_file() or (path / RESULT).is_file()


def load_ground_truth(path: str | Path) -> Records:
    """(t,) of `GROUND_TRUTH` from `fastmimic robot-sim --log`, whole or cut off; `LogError` for another file."""
    rows = read_log_file(Path(path), {ROBOT_SIM: GROUND_TRUTH}).rows[ROBOT_SIM]
    if not len(rows):
        raise LogError(f"{path}: not a log of 'fastmimic robot-sim', or it ends before its first state")
    return rows


def open_deployment(folder: Path) -> AbstractContextManager[None]:
    """Prepares a new or empty folder; unchanged if the block fails before its log begins. Raises `OutputError`."""
    if folder.is_dir() and any(folder.iterdir()):
        raise OutputError(f"{folder} holds an earlier deployment or something else; choose another --out")
    return created(folder)


class Recorder:
    """Rows in preallocated memory; when it is full, the oldest are overwritten, but still counted in `periods`.
    `start_ns` is the moment of time 0, since 1970; None before there is one."""

    def __init__(self, kind: np.dtype[Any], capacity: int) -> None:
        self._rows = np.zeros(capacity, kind)
        self._rows.view(np.uint8)[:] = 0  # touches the memory now
        self.capacity, self.periods = capacity, 0
        self.start_ns: int | None = None

    def start(self, in_s: float = 0.0) -> None:
        """Begins anew, with time 0 in so many s."""
        self.periods, self.start_ns = 0, time.time_ns() + round(1e9 * in_s)

    def next_row(self) -> Records:
        """The row (1,) of this period, to be filled in before the next one is asked for."""
        at = self.periods % self.capacity
        self.periods += 1
        return self._rows[at : at + 1]

    def rows(self, first: int = 0, end: int | None = None) -> Records:
        """A copy of the rows from number `first` to `end`, all if None, that are not overwritten."""
        end = self.periods if end is None else end
        return self._rows[np.arange(max(first, self.periods - self.capacity), end) % self.capacity]


def ground_truth_writer(path: Path) -> "LogWriter":
    """Writes what a simulated robot really does; raises `OutputError`."""
    file = LogFile(path, {ROBOT_SIM: GROUND_TRUTH}, _BEHIND)
    return LogWriter(Recorder(GROUND_TRUTH, _BEHIND), file, lambda rows: {ROBOT_SIM: rows})


class LogWriter(Thread):
    """Writes a recorder's rows to a file while the block runs; the loop that records never waits for the disk. When
    that fails, or the disk is so slow that rows were overwritten, the log ends there."""

    def __init__(self, recorder: Recorder, file: LogFile, columns: Callable[[Records], Mapping[str, Any]]) -> None:
        """`columns` gives what is written of rows (t,), which have a `time_s`: by topic, (t,) of its kind."""
        super().__init__(name="log", daemon=True)
        self.recorder, self._file, self._columns = recorder, file, columns
        self._over = Event()
        self._written, self._until_s = 0, 0.0
        self.ends: str | None = None  # when and why the log ends before the rows do

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Writes the rest; a file without rows is removed."""
        self._over.set()
        self.join()
        if not self._written:
            self._file.remove()

    def run(self) -> None:
        while not self._over.wait(EVERY_S):
            self._write(self.recorder.periods - 1)  # the last one may not be complete
        self._write(self.recorder.periods)

    def end(self, metadata: Mapping[str, Any]) -> None:
        """Ends the file, after the block."""
        if self.ends is None:
            self._try(self._file.end, metadata)

    def _write(self, end: int) -> None:
        while self.recorder.start_ns is not None and self._written < end and self.ends is None:
            following = min(end, self._written + _MOST)
            rows = self.recorder.rows(self._written, following)
            if self.recorder.periods - self._written > self.recorder.capacity:
                self.ends = f"at {self._until_s:.1f} s: the disk is too slow"
                return
            times = self.recorder.start_ns + np.round(1e9 * rows["time_s"]).astype(np.int64)
            if self._try(self._file.add_rows, times, self._columns(rows)):
                self._written, self._until_s = following, float(rows["time_s"][-1])

    def _try(self, write: Callable[..., None], *arguments: Any) -> bool:
        try:
            write(*arguments)
        except OSError as error:
            self.ends = f"at {self._until_s:.1f} s: {error.strerror or error}"
            self._file.close()
        return self.ends is None
