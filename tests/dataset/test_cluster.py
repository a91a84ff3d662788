"""Two machines of a Ray cluster, a worker and then a whole machine of which are killed while a library is built."""

import os
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dataset.conftest import of, same
from fastmimic.dataset import MotionDataset, build_dataset
from fastmimic.dataset.build import BuildStep
from fastmimic.dataset.repair import repair
from fastmimic.executors import make_executor

pytestmark = pytest.mark.cluster

MOTIONS = ("trot", "pace", "walk", "turn")


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two nodes with a core each, real processes of Ray's on this machine; and a third core for the driver's own."""
    pytest.importorskip("pyarrow")
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield made
    made.shutdown()


def working() -> list[int]:
    """The processes that do a job now."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and (entry / "cmdline").read_bytes().startswith(b"ray::attempt"):
                found.append(int(entry.name))
        except OSError:
            continue  # it has just ended
    return found


def test_a_worker_and_a_node_that_are_killed_cost_nothing_but_time(cluster: Any, tmp_path: Path) -> None:
    node = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    killed: list[str] = []
    recorded: Counter[str] = Counter()

    def progress(step: BuildStep) -> None:
        if step.record is None:
            return
        recorded[step.record["id"]] += 1
        if not killed and (pids := working()):
            os.kill(pids[0], signal.SIGKILL)
            killed.append("worker")
        elif killed == ["worker"]:
            cluster.remove_node(node, allow_graceful=False)
            killed.append("node")

    executor = make_executor("ray", address=cluster.address)
    built = build_dataset(of(*MOTIONS), tmp_path / "cluster", executor, progress=progress)
    assert killed == ["worker", "node"]
    assert (built.jobs, built.done) == (4, 4)
    assert len(recorded) == 4
    assert set(recorded.values()) == {1}
    health, _ = repair(MotionDataset.open(tmp_path / "cluster"))
    assert health.sound
    assert all(Path(name).name.startswith(".") for name in health.foreign), "more than what was cut off while written"

    build_dataset(of(*MOTIONS), tmp_path / "here", make_executor("local", workers=1))
    same(tmp_path / "cluster", tmp_path / "here")
    again = build_dataset(of(*MOTIONS), tmp_path / "cluster", make_executor("local", workers=1))
    assert again.done == 0
