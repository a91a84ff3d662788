"""The log on the disk: read by others, cut off anywhere, damaged, and on a disk that is full or slow."""

import contextlib
import json
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from deploy.rig import Rig
from fastmimic.base.errors import LogError, OutputError
from fastmimic.cli import main
from fastmimic.deploy import log_file
from fastmimic.deploy.log import (
    GROUND_TRUTH,
    PERIODS,
    ROBOT_SIM,
    ROW,
    TRUTH,
    DeploymentLog,
    LogWriter,
    Recorder,
    load_ground_truth,
)
from fastmimic.deploy.log_file import LogFile, read_log_file, schema_of
from fastmimic.deploy.summary import robot_of, with_result
from fastmimic.robot.state import OBSERVATION

KINDS = {PERIODS: ROW, TRUTH: OBSERVATION}


def random_rows(kind: np.dtype[Any], n: int) -> NDArray[Any]:
    """Rows of small numbers, each value of each field another one."""
    rng, rows = np.random.default_rng(0), np.zeros(n, kind)
    for name in kind.names or ():
        part = kind[name]
        if part.names:
            rows[name] = random_rows(part, n)
        else:
            rows[name] = rng.integers(0, 2 if part.base.kind == "b" else 100, (n, *part.shape))
    return rows


def write(path: Path, chunks: int = 6, each: int = 20) -> dict[str, NDArray[Any]]:
    """A file of two topics; returns their rows."""
    rows = {topic: random_rows(kind, chunks * each) for topic, kind in KINDS.items()}
    file = LogFile(path, KINDS, chunks * each, {"motion.npz": bytes(range(256))}, {"rate_hz": 500.0})
    for first in range(0, chunks * each, each):
        part = slice(first, first + each)
        file.add_rows(np.arange(first, first + each) * 2_000_000, {topic: rows[topic][part] for topic in KINDS})
    file.end({"result": {"fell": False}})
    return rows


@pytest.mark.parametrize("kind", [ROW, OBSERVATION, GROUND_TRUTH])
def test_a_row_is_its_own_message_in_cdr(kind: np.dtype[Any]) -> None:
    """The fields lie side by side, each number at a multiple of its size."""

    def fields(kind: np.dtype[Any], at: int) -> Iterator[tuple[int, np.dtype[Any]]]:
        for part, offset, *_ in (kind.fields or {}).values():
            if part.names:
                yield from fields(part, at + offset)
            else:
                yield at + offset, part

    end = 0
    for offset, part in fields(kind, 0):
        assert offset == end
        assert offset % part.base.itemsize == 0
        end = offset + part.itemsize
    assert kind.itemsize == end


def test_another_reader_reads_the_same_numbers(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
    rows = write(tmp_path / "log.mcap")
    with open(tmp_path / "log.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()])
        seen = dict.fromkeys(KINDS, 0)
        for _, channel, message, decoded in reader.iter_decoded_messages():
            assert message.log_time == 2_000_000 * message.sequence
            assert message.sequence == seen[channel.topic]
            assert_same(decoded, rows[channel.topic][message.sequence])
            seen[channel.topic] += 1
        assert set(seen.values()) == {120}
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 240
        assert len(summary.chunk_indexes) == 6
        assert [a.data for a in reader.iter_attachments()] == [bytes(range(256))]
        assert [m.metadata for m in reader.iter_metadata()] == [{"rate_hz": "500.0"}, {"result": '{"fell": false}'}]


def assert_same(decoded: Any, row: Any) -> None:
    for name in row.dtype.names:
        value = getattr(decoded, name)
        if row.dtype[name].names:
            assert_same(value, row[name])
        else:
            np.testing.assert_array_equal(np.ravel(value), np.ravel(row[name]))


def test_a_second_takes_a_megabyte_and_no_more_than_was_reckoned_with(tmp_path: Path) -> None:
    write(tmp_path / "log.mcap", chunks=4, each=125)
    size = (tmp_path / "log.mcap").stat().st_size
    assert size == pytest.approx(1.04e6, rel=0.02)
    assert size < 500 * sum(kind.itemsize + log_file._PER_ROW for kind in KINDS.values())


def test_cut_off_anywhere_it_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    rows = write(tmp_path / "log.mcap")
    content = (tmp_path / "log.mcap").read_bytes()
    assert read_log_file(tmp_path / "log.mcap", KINDS).metadata["result"] == {"fell": False}
    cut = tmp_path / "cut.mcap"
    lengths = set()
    for length in np.random.default_rng(1).integers(9, len(content), 50):
        cut.write_bytes(content[:length])
        found = read_log_file(cut, KINDS)
        assert "result" not in found.metadata or length > 0.9 * len(content)
        n = len(found.rows[PERIODS])
        lengths.add(n)
        assert n >= 20 * (6 * int(length) // len(content) - 1)
        for topic in KINDS:
            assert found.rows[topic].tobytes() == rows[topic][:n].tobytes()
    assert len(lengths) > 4


def test_a_power_cut_leaves_zeros(tmp_path: Path) -> None:
    rows = write(tmp_path / "log.mcap")
    content = (tmp_path / "log.mcap").read_bytes()
    half = len(content) // 2
    (tmp_path / "log.mcap").write_bytes(content[:half] + bytes(len(content) // 3))
    found = read_log_file(tmp_path / "log.mcap", KINDS)
    assert 20 <= len(found.rows[PERIODS]) < 120
    assert found.rows[PERIODS].tobytes() == rows[PERIODS][: len(found.rows[PERIODS])].tobytes()


def test_a_flipped_bit_is_one_line(tmp_path: Path) -> None:
    write(tmp_path / "log.mcap", chunks=2)
    content = (tmp_path / "log.mcap").read_bytes()
    damaged = tmp_path / "damaged.mcap"
    told = 0
    for at in np.random.default_rng(2).integers(0, len(content), 200):
        wrong = bytearray(content)
        wrong[at] ^= 1 << int(at) % 8
        damaged.write_bytes(wrong)
        with contextlib.suppress(LogError):
            read_log_file(damaged, KINDS)
            continue
        told += 1
    assert told > 190, "only the summary and the magic numbers have no checksum"


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "no such file"), (b"", "the log is damaged"), (b"PK\x03\x04" * 9, "not the log of a deployment")],
)
def test_another_file_is_no_log(content: bytes | None, said: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "log.mcap").write_bytes(content)
    with pytest.raises(LogError, match=said):
        DeploymentLog.load(tmp_path / "log.mcap")
    write(tmp_path / "other.mcap")
    with pytest.raises(LogError, match=r"it has no readable motion\.npz"):
        DeploymentLog.load(tmp_path / "other.mcap")
    with pytest.raises(LogError, match="not a log of 'fastmimic robot-sim'"):
        load_ground_truth(tmp_path / "other.mcap")


def test_rows_of_another_version_are_refused(tmp_path: Path) -> None:
    older = np.dtype([("time_s", "f8")])
    file = LogFile(tmp_path / "log.mcap", {PERIODS: older}, 1)
    file.add_rows(np.arange(1), {PERIODS: np.zeros(1, older)})
    file.end({})
    with pytest.raises(LogError, match="another version of FastMimic"):
        read_log_file(file.path, KINDS)
    assert schema_of(older) == "float64 time_s"


def test_no_log_is_overwritten(tmp_path: Path) -> None:
    write(tmp_path / "log.mcap")
    before = (tmp_path / "log.mcap").read_bytes()
    with pytest.raises(OutputError, match=r"log.mcap: cannot be written \(File exists\)"):
        LogFile(tmp_path / "log.mcap", KINDS, 10)
    assert (tmp_path / "log.mcap").read_bytes() == before


class Slow(LogFile):
    """A disk that takes its time."""

    def add_rows(self, time_ns: Any, rows: Any) -> None:
        time.sleep(0.05)
        super().add_rows(time_ns, rows)


def filled(recorder: Recorder, n: int) -> None:
    for _ in range(n):
        recorder.next_row()["time_s"] = recorder.periods / 500


def test_rows_are_written_while_they_come(tmp_path: Path) -> None:
    recorder = Recorder(GROUND_TRUTH, 100)
    file = LogFile(tmp_path / "truth.mcap", {ROBOT_SIM: GROUND_TRUTH}, 100)
    with LogWriter(recorder, file, lambda rows: {ROBOT_SIM: rows}) as writer:
        recorder.start()
        filled(recorder, 60)
        end = time.monotonic() + 20
        while not len(read_log_file(file.path, {ROBOT_SIM: GROUND_TRUTH}).rows[ROBOT_SIM]):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert len(load_ground_truth(file.path)) == 59, "all but the last one, which may not be complete"
        filled(recorder, 60)
    writer.end({})
    assert writer.ends is None
    np.testing.assert_allclose(load_ground_truth(file.path)["time_s"], np.arange(120) / 500)


def test_a_disk_that_is_too_slow_ends_the_log_and_nothing_else(tmp_path: Path) -> None:
    recorder = Recorder(GROUND_TRUTH, 100)
    file = Slow(tmp_path / "truth.mcap", {ROBOT_SIM: GROUND_TRUTH}, 100)
    with LogWriter(recorder, file, lambda rows: {ROBOT_SIM: rows}) as writer:
        recorder.start()
        filled(recorder, 50)
        while not len(read_log_file(file.path, {ROBOT_SIM: GROUND_TRUTH}).rows[ROBOT_SIM]):
            time.sleep(0.01)
        filled(recorder, 200)
    writer.end({})
    assert writer.ends == "at 0.1 s: the disk is too slow"
    assert load_ground_truth(file.path)["time_s"][-1] == pytest.approx(48 / 500)


@contextlib.contextmanager
def no_file_above(size: int) -> Iterator[None]:
    """As on a disk that is full then: writing more fails."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
def test_a_full_disk_does_not_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with no_file_above(3_000_000):
        status = main(["deploy", "stand", "--driver", "sim", "--lock-step", "--duration", "0.2", "--out", "there"])
    out, err = capsys.readouterr()
    assert status == 4
    assert re.search(r"^fastmimic: the log ends at \d\.\d s: File too large$", err, re.MULTILINE)
    assert "Traceback" not in err
    assert json.loads(Path("there/deployment.json").read_text())["result"]["stopped_by"] == "duration"
    log = DeploymentLog.load("there")
    assert 500 < len(log.rows) < 2000
    assert not log.facts.result
    assert "log" in {line.split()[0] for line in out.splitlines()}


def test_a_disk_that_is_full_before_is_found_before_anything_is_sent(
    stands: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(log_file.shutil, "disk_usage", lambda path: usage._replace(free=5_000_000))
    with pytest.raises(OutputError, match="the disk has 5 MB free, and the log needs "):
        stands.run(log=tmp_path / "log.mcap")
    assert stands.driver.opened == 0
    with no_file_above(1000), pytest.raises(OutputError, match=r"cannot be written \(File too large\)"):
        LogFile(tmp_path / "log.mcap", KINDS, 0, {"motion.npz": bytes(5000)})
    assert list(tmp_path.iterdir()) == []


def test_a_robot_that_does_not_begin_leaves_no_log(stands: Rig, tmp_path: Path) -> None:
    stands.switch.signals = 1
    with contextlib.suppress(Exception):
        stands.run(log=tmp_path / "log.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_log_that_was_cut_off_is_scored_by_its_rows(stands: Rig, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    done = stands.run(log=path, duration_s=1.0)
    with open(path, "rb+") as file:
        file.truncate(path.stat().st_size - 100_000)
    log = DeploymentLog.load(path)
    assert not log.facts.result
    result = with_result(robot_of(log), log).facts.result
    assert result["stopped_by"] == "unknown"
    assert "killed" in result["stopped_because"]
    assert result["log_ends"].startswith(f"at {log.rows['time_s'][-1]:.1f} s: the program was killed")
    for name in ("reward_mean", "reward_truth_mean", "fell", "deadline_misses"):
        assert result[name] == done.result[name]
    lost = len(done.log.rows) - len(log.rows)
    assert 0 < lost < 1100
    assert result["packets"] == done.result["packets"] | {
        "sent": done.result["packets"]["sent"] - lost,
        "received": done.result["packets"]["received"] - lost,
    }


@pytest.mark.slow
@pytest.mark.real_time
def test_killed_at_once_it_has_lost_less_than_a_second(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    patient = ("--limit", "stale_s=2", "--limit", "overrun_s=2", "--limit", "lean=0")
    command = [sys.executable, "-m", "fastmimic", "deploy", "stand", "--driver", "sim", "--endless", "--out", "there"]
    process = subprocess.Popen([*command, *patient], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("blending into stand"):
            break
    time.sleep(2.0)
    process.kill()
    killed = time.time()
    process.communicate()
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["log.mcap"]
    last = 0
    with open(tmp_path / "there" / "log.mcap", "rb") as file, contextlib.suppress(Exception):
        for record in StreamReader(file).records:
            last = record.log_time if isinstance(record, Message) else last
    assert killed - 1e-9 * last < 1.2
    rows = DeploymentLog.load(tmp_path / "there").rows
    assert rows["time_s"][-1] > 5.0
    assert (np.diff(rows["time_s"]) > 0).all()
    assert main(["evaluate", str(tmp_path / "there"), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["result"]["stopped_by"] == "unknown"
    assert "the log ends at" in err
