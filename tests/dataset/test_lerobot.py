"""Executed runs for LeRobot, read back by the steps of its own `LeRobotDataset` (version 3.0) without installing it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError, LibraryError, OutputError
from fastmimic.cli import main
from fastmimic.dataset import lerobot
from fastmimic.dataset.lerobot import check_lerobot, write_lerobot
from fastmimic.imitation.evaluate import evaluate
from fastmimic.imitation.imitate import Rollout
from fastmimic.robot import Robot, load_robot

pytest.importorskip("pyarrow")
import pyarrow.parquet as pq


@pytest.fixture(scope="module")
def a1() -> Robot:
    return load_robot("a1")


@pytest.fixture(scope="module")
def rollout(a1: Robot) -> Rollout:
    return evaluate("trot", a1, episodes=2, duration_s=0.5, log=True).rollout


class Reader:
    """The contract: `load_info`, `load_tasks`, `load_episodes`, `load_stats`, features and `data/*/*.parquet`."""

    DEFAULT_FEATURES = ("timestamp", "frame_index", "episode_index", "index", "task_index")

    def __init__(self, root: Path) -> None:
        self.root = root
        self.info = json.loads((root / "meta/info.json").read_text())
        self.stats = json.loads((root / "meta/stats.json").read_text())
        self.tasks = pq.read_table(root / "meta/tasks.parquet")
        self.episodes = pq.read_table(sorted((root / "meta/episodes").glob("*/*.parquet"))[0]).to_pylist()
        self.table = pq.read_table(sorted((root / "data").glob("*/*.parquet"))[0])

    def column(self, name: str) -> np.ndarray:
        return np.array(self.table[name].to_pylist())


@pytest.fixture(scope="module")
def written(rollout: Rollout, a1: Robot, tmp_path_factory: pytest.TempPathFactory) -> Reader:
    folder = tmp_path_factory.mktemp("lerobot") / "set"
    assert write_lerobot(folder, rollout, a1, "trot on a1", 50) == 50
    return Reader(folder)


def test_the_folder_is_what_lerobot_loads(written: Reader) -> None:
    info = written.info
    assert info["codebase_version"] == "v3.0"
    assert (info["fps"], info["total_episodes"], info["total_frames"], info["total_tasks"]) == (50, 2, 50, 1)
    assert info["splits"] == {"train": "0:2"}
    assert info["data_path"] == "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    assert info["video_path"] is None
    for k, row in enumerate(written.episodes):
        assert (row["episode_index"], row["length"], row["tasks"]) == (k, 25, ["trot on a1"])
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (25 * k, 25 * (k + 1))
        places = {name: row[name] for name in row if name.endswith(("chunk_index", "file_index"))}
        assert set(places) == {f"{of}/{kind}_index" for of in ("data", "meta/episodes") for kind in ("chunk", "file")}
        path = info["data_path"].format(chunk_index=places["data/chunk_index"], file_index=places["data/file_index"])
        assert (written.root / path).is_file()


def test_features_are_the_columns(written: Reader) -> None:
    features: dict[str, dict[str, Any]] = written.info["features"]
    assert list(features) == written.table.column_names
    assert set(features) >= {"observation.state", "action", *written.DEFAULT_FEATURES}
    assert not [name for name in features if "/" in name]
    for name, feature in features.items():
        kind, (size, *rest) = written.table.schema.field(name).type, feature["shape"]
        assert rest == []
        if size > 1:  # `datasets.Sequence(length)`
            assert (kind.list_size, str(kind.value_type)) == (size, "float")
            assert len(feature["names"]) == size == len(set(feature["names"]))
        else:
            assert str(kind) == {"float32": "float"}.get(feature["dtype"], feature["dtype"])
        found = written.stats[name]
        assert {len(found[key]) for key in ("min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99")} == {size}
        assert found["count"] == [50]
    assert written.stats["action"]["mean"] == pytest.approx(written.column("action").mean(axis=0), abs=1e-5)


def test_the_task_is_the_index_of_its_table(written: Reader) -> None:
    pandas = pytest.importorskip("pandas")
    tasks = pandas.read_parquet(written.root / "meta/tasks.parquet")
    assert tasks.index.name == "task"
    assert tasks.iloc[0].name == "trot on a1"
    assert int(tasks.loc["trot on a1"].task_index) == 0


def test_frames_are_states_and_what_was_commanded_in_them(written: Reader, rollout: Rollout, a1: Robot) -> None:
    assert written.column("episode_index").tolist() == [0] * 25 + [1] * 25
    assert written.column("frame_index").tolist() == [*range(25), *range(25)]
    assert written.column("index").tolist() == list(range(50))
    assert written.column("timestamp") == pytest.approx(np.tile(np.arange(25) / 50, 2), abs=1e-6)
    assert np.flatnonzero(written.column("next.done")).tolist() == [24, 49]
    log, frame = rollout.course, 30  # sixth of the second episode
    state, command = log.observation[1, 50], log.command[1, 51]
    seen, action = written.column("observation.state")[frame], written.column("action")[frame]
    names = {name: written.info["features"][name]["names"] for name in ("observation.state", "action")}
    assert seen[names["observation.state"].index(f"{a1.joint_names[5]}.vel")] == pytest.approx(
        state["joint_vel"][5], rel=1e-6
    )
    assert seen[24:28] == pytest.approx(state["root_quat"], abs=1e-6)
    assert action[:12] == pytest.approx(command["joint_pos"], rel=1e-6)
    torque = command["torque"] + command["stiffness"] * (command["joint_pos"] - state["joint_pos"])
    torque += command["damping"] * (command["joint_vel"] - state["joint_vel"])
    assert action[12:] == pytest.approx(np.clip(torque, -a1.torque_limit, a1.torque_limit), rel=1e-5, abs=1e-5)
    assert names["action"][17] == f"{a1.joint_names[5]}.torque"
    assert written.column("next.reward")[frame] == pytest.approx(log.reward[1, 51], rel=1e-6)


def test_an_episode_ends_where_the_robot_fell(rollout: Rollout, a1: Robot, tmp_path: Path) -> None:
    from dataclasses import replace

    fell = replace(rollout, steps=np.array([250, 101]), fell=np.array([False, True]))
    assert write_lerobot(tmp_path / "set", fell, a1, "trot", 50) == 25 + 10
    at_once = replace(rollout, steps=np.array([250, 1]))
    with pytest.raises(ConfigError, match="the robot fell at once"):
        write_lerobot(tmp_path / "other", at_once, a1, "trot", 50)


def test_nothing_is_written_half(rollout: Rollout, a1: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OutputError("no space left")

    monkeypatch.setattr(lerobot, "write_json", full)
    with pytest.raises(OutputError, match="no space"):
        write_lerobot(tmp_path / "set", rollout, a1, "trot", 50)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("fps", [30.0, 0.0, 12.5, np.nan])
def test_rates_that_do_not_divide_are_refused(fps: float, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a whole number that divides 500"):
        check_lerobot(tmp_path / "set", 500.0, fps)


def test_without_arrow_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow.parquet", None)
    with pytest.raises(LibraryError, match=r"pip install 'fastmimic\[library\]'"):
        check_lerobot(tmp_path / "set", 500.0, 50.0)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "set"
    options = ["--format", "lerobot", "--out", str(out), "--duration", "0.2"]
    assert main(["export", "trot", *options, "--episodes", "2"]) == 0
    assert f"2 runs, 0 with a fall, 20 frames at 50 per second in {out}" in capsys.readouterr().out
    assert main(["export", "trot", *options]) == 2
    assert "exists; name a new folder" in capsys.readouterr().err
    assert main(["export", "trot", "--format", "csv", "--out", str(tmp_path / "x.csv"), "--episodes", "2"]) == 2
    assert "--episodes is for the format lerobot" in capsys.readouterr().err
