"""Executed runs as a dataset of LeRobot, version 3.0: states, and the motors' targets and torques as actions."""

import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.files import check_folder, write_json
from fastmimic.base.rotations import quat_rotate_inverse
from fastmimic.dataset.index import require_pyarrow
from fastmimic.episode.rollout import Rollout
from fastmimic.robot import Robot
from fastmimic.robot.state import commanded_torque

_PATH: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FIRST: Final = _PATH.format(chunk_index=0, file_index=0)
_QUANTILES: Final = (1, 10, 50, 90, 99)  # percent
_INDEXED: Final = (
    b'{"index_columns": ["task"], "column_indexes": [], "columns": [{"name": "task", "field_name": "task",'
    b' "pandas_type": "unicode", "numpy_type": "object", "metadata": null}]}'
)  # that the task is the index, for pandas, as LeRobot reads it

Columns = dict[str, NDArray[Any]]


def write_lerobot(folder: str | Path, rollout: Rollout, robot: Robot, task: str, fps: float) -> int:
    """Writes a rollout with its log as a new folder for `lerobot.datasets.LeRobotDataset`; returns the number of
    frames. A frame has the state before a control step and what this step commands: target angles, and torques by the
    motor law at this state, about the joints' axes in the robot's file. An episode ends where the robot fell. `task`
    says in words what the robot does; `fps`, frames a second, divides the control rate. Raises `ConfigError` for
    another rate, `OutputError` if the folder exists or cannot be written, `LibraryError` without Arrow."""
    folder, rate = Path(folder), rollout.course.rate_hz
    check_lerobot(folder, rate, fps)
    episodes = [_episode(rollout, i, robot, int(rate // fps)) for i in range(len(rollout.reward))]
    lengths = [len(found["action"]) for found in episodes]
    if not all(lengths):
        raise ConfigError("an episode has no frame: the robot fell at once")
    columns = {name: np.concatenate([found[name] for found in episodes]) for name in episodes[0]}
    frame = np.concatenate([np.arange(n) for n in lengths])  # from here on the columns that every dataset has
    columns |= {"timestamp": (frame / fps).astype(np.float32), "frame_index": frame}
    columns |= {"episode_index": np.repeat(np.arange(len(lengths)), lengths), "index": np.arange(len(frame))}
    columns |= {"task_index": np.zeros_like(frame)}
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as scratch:
        whole = Path(scratch) / "whole"
        _write_tables(whole, columns, lengths, task)
        write_json(whole / "meta" / "info.json", _info(columns, len(lengths), robot, int(fps)))
        write_json(whole / "meta" / "stats.json", {name: _statistics(values) for name, values in columns.items()})
        whole.rename(folder)
    return sum(lengths)


def check_lerobot(folder: Path, rate_hz: float, fps: float) -> None:
    """Whether runs at `rate_hz` can be written, before the work; raises as `write_lerobot`."""
    require_pyarrow()
    if not (fps >= 1 and fps == round(fps) and rate_hz % fps == 0):
        raise ConfigError(f"frames a second of a LeRobot dataset: a whole number that divides {rate_hz:g}, not {fps:g}")
    if folder.exists():
        raise OutputError(f"{folder}: exists; name a new folder")
    check_folder(folder.parent)


def _episode(rollout: Rollout, i: int, robot: Robot, every: int) -> Columns:
    log, lived, sign = rollout.course, int(rollout.steps[i]), robot.joint_sign
    state, command = log.observation[i, : max(lived - 1, 0) : every], log.command[i, 1:lived:every]
    torque = commanded_torque(command, state["joint_pos"], state["joint_vel"])
    torque = np.clip(torque, -robot.torque_limit, robot.torque_limit)
    gyro = quat_rotate_inverse(state["root_quat"], state["ang_vel"])
    seen = np.hstack([sign * state["joint_pos"], sign * state["joint_vel"], state["root_quat"], gyro])
    surroundings = np.hstack([state["root_pos"], state["lin_vel"], state["foot_force"][..., 2]])
    return {
        "observation.state": seen.astype(np.float32),
        "observation.environment_state": surroundings.astype(np.float32),
        "action": np.hstack([sign * command["joint_pos"], sign * torque]).astype(np.float32),
        "next.reward": log.reward[i, 1:lived:every].astype(np.float32),
        "next.done": np.arange(len(state)) == len(state) - 1,
    }


def _names(robot: Robot) -> dict[str, list[str]]:
    """What the components of each vector are; SI units."""
    state = [f"{name}.{kind}" for kind in ("pos", "vel") for name in robot.joint_names]
    root = [f"root.{kind}_{axis}" for kind in ("pos", "vel") for axis in "xyz"]
    return {
        "observation.state": [*state, *(f"imu.q{axis}" for axis in "wxyz"), *(f"imu.gyro_{axis}" for axis in "xyz")],
        "observation.environment_state": [*root, *(f"{leg}.force_z" for leg in LEGS)],
        "action": [f"{name}.{kind}" for kind in ("pos", "torque") for name in robot.joint_names],
    }


def _info(columns: Columns, episodes: int, robot: Robot, fps: int) -> dict[str, Any]:
    names = _names(robot)
    info = {"codebase_version": "v3.0", "robot_type": robot.name, "fps": fps, "total_episodes": episodes}
    info |= {"total_frames": len(columns["index"]), "total_tasks": 1, "splits": {"train": f"0:{episodes}"}}
    info |= {"chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 500}
    info |= {"data_path": f"data/{_PATH}", "video_path": None}
    shapes = {name: list(values.shape[1:]) or [1] for name, values in columns.items()}
    kinds = {name: values.dtype.name for name, values in columns.items()}
    features = {name: {"dtype": kinds[name], "shape": shapes[name], "names": names.get(name)} for name in columns}
    return info | {"features": features}


def _write_tables(folder: Path, columns: Columns, lengths: list[int], task: str) -> None:
    import pyarrow

    rows: list[dict[str, Any]] = []
    for k, (end, length) in enumerate(zip(np.cumsum(lengths).tolist(), lengths, strict=True)):
        row = {"episode_index": k, "tasks": [task], "length": length}
        row |= {"dataset_from_index": end - length, "dataset_to_index": end}
        rows.append(row | {f"{of}/{kind}_index": 0 for of in ("data", "meta/episodes") for kind in ("chunk", "file")})
    tasks = pyarrow.table({"task_index": [0], "task": [task]}).replace_schema_metadata({b"pandas": _INDEXED})
    data = {name: _arrow(values) for name, values in columns.items()}
    files = {"meta/tasks.parquet": tasks, f"meta/episodes/{_FIRST}": pyarrow.Table.from_pylist(rows)}
    for name, table in (files | {f"data/{_FIRST}": pyarrow.table(data)}).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        require_pyarrow().write_table(table, folder / name)


def _statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Of each component over the frames."""
    rows = values.reshape(len(values), -1).astype(np.float64)
    found = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    found |= {f"q{q:02d}": np.percentile(rows, q, axis=0) for q in _QUANTILES}
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(rows)]}


def _arrow(values: NDArray[Any]) -> Any:
    """A column: numbers, or vectors of a fixed length."""
    import pyarrow

    if values.ndim == 1:
        return pyarrow.array(values)
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.ravel()), values.shape[1])
