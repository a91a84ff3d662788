"""`fastmimic library` as its users meet it."""

import json
import shutil
import signal
import subprocess
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from cli.running import Run
from dataset.conftest import reproducible, same
from fastmimic.dataset import MotionDataset
from fastmimic.dataset.repair import check
from fastmimic.episode.metrics import TRACKED
from fastmimic.simulation.simulators import FIRST_SIMULATOR, SECOND_SIMULATOR, SIMULATORS
from searches import quick_main

pytest.importorskip("pyarrow")

QUICK = [
    *("--iterations", "3", "--population", "4", "--duration", "0.6", "--trial", "0.6", "--perturbed", "1"),
    *("--others", "2", "--no-second-simulator"),
]
HERE = [*QUICK, "--workers", "1"]
RAY = "no Ray cluster at" if find_spec("ray") else "pip install 'fastmimic[ray]'"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a trot and a pace; not to be changed."""

    folder = tmp_path_factory.mktemp("command") / "motions"
    assert quick_main(["library", "build", "trot", "pace", "--out", str(folder), *HERE]) == 0
    return folder


def test_build_says_what_it_does(run: Run) -> None:
    done = run("library", "build", "trot", "--out", "lib", *HERE)
    assert done.status == 0
    assert done.out.splitlines() == ["1 motions, 1 of them new", "1 records: 1 A", "library in lib"]
    assert "1/1 trot on a1 seed 0: reward 0.9" in done.err
    again = run("library", "build", "trot", "--out", "lib", *HERE)
    assert again.out.startswith("1 motions, 0 of them new")


def test_one_corrupt_clip_does_not_stop_the_others(run: Run, in_folder: Path) -> None:
    (in_folder / "clips.list").write_text("trot\nbroken.txt\n")
    (in_folder / "broken.txt").write_text("1 2 3\n4 5\n")
    done = run("library", "build", "clips.list", "--out", "lib", *HERE)
    assert done.status == 3
    assert "1 records: 1 A" in done.out
    failed = [line for line in (done.err + done.out).splitlines() if "broken.txt" in line]
    assert len(failed) == 1
    assert failed[0].startswith("failed: ")
    assert failed[0].count("broken.txt") == 1
    assert "1 failed: 'fastmimic library list lib --grade failed' lists them with the reason" in done.out
    assert "broken.txt" in run("library", "list", "lib").out


def test_list_and_show(library: Path, run: Run) -> None:
    listed = run("library", "list", library).out.splitlines()
    assert listed[0].split()[:3] == ["id", "name", "robot"]
    assert "success  mpjpe, mm" in listed[0]
    assert [line.split()[1] for line in listed[1:3]] == ["pace", "trot"]
    rows = json.loads(run("library", "list", library, "--json", "--gait", "trot").out)["motions"]
    assert [row["name"] for row in rows] == ["trot"]
    assert all(rows[0][name] > 0 for name in TRACKED)
    assert f"{rows[0]['success_perturbed']:.0%}" in listed[2]
    shown = json.loads(run("library", "show", library, rows[0]["id"][:6], "--json").out)["motions"]
    assert shown == rows
    assert f"id {'':20} {rows[0]['id']}".split() == run("library", "show", library, "trot").out.splitlines()[0].split()


def test_records_that_are_superseded_or_of_another_version_are_told_of(library: Path, run: Run, tmp_path: Path) -> None:
    mine = Path(shutil.copytree(library, tmp_path / "mine"))
    rows = {row["name"]: row for row in MotionDataset.open(mine).index()}
    path = mine / "records" / f"{rows['trot']['id']}.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "fastmimic_version": "0.0.1"}))
    other = {**json.loads(path.read_text()), "id": "0" * 16, "recipe": "another"}
    (mine / "records" / f"{other['id']}.json").write_text(json.dumps(other))
    MotionDataset.open(mine).write_index()
    listed = run("library", "list", mine).out
    assert "made by several versions of FastMimic (1 by 0.0.1, 1 by " in listed
    assert "1 more records are not in the index: 'list --superseded' lists the reasons" in listed
    assert "00000000  trot  a1     0     made otherwise" in run("library", "list", mine, "--superseded").out
    (said,) = json.loads(run("library", "list", mine, "--superseded", "--json").out)["superseded"]
    assert said == {
        "id": other["id"],
        "name": "trot",
        "robot": "a1",
        "seed": 0,
        "why": "made otherwise",
    }
    assert run("library", "verify", mine, "--mend").status == 0
    assert "more records" not in run("library", "list", mine).out


def test_list_and_show_say_what_is_damaged_and_go_on(library: Path, run: Run, tmp_path: Path) -> None:
    mine = Path(shutil.copytree(library, tmp_path / "mine"))
    (mine / "library.json").write_text("{")
    torn = next((mine / "sources").iterdir())
    torn.write_text("{")
    listed = run("library", "list", mine)
    assert listed.status == 0
    assert listed.out == run("library", "list", library).out
    damaged = [line.split(": ")[:2] for line in listed.err.splitlines()]
    assert damaged == [["damaged", "library.json"], ["damaged", f"sources/{torn.name}"]]
    assert run("library", "show", mine, "trot").status == 0
    verified = run("library", "verify", mine)
    assert verified.status == 3
    assert f"damaged: sources/{torn.name}: cannot be read" in verified.out
    assert run("library", "verify", mine, "--mend").status == 3
    assert run("library", "build", "trot", "pace", "--out", mine, *HERE).out.startswith("2 motions, 0 of them new")
    assert run("library", "verify", mine).status == 0


def test_export(library: Path, run: Run, in_folder: Path) -> None:
    done = run("library", "export", library, "--to", "for-mjlab", "--grade", "A")
    assert done.out.startswith("2 motions in for-mjlab, listed in motions.csv")
    names = sorted(path.name.split("-")[0] for path in (in_folder / "for-mjlab").glob("*.npz"))
    assert names == ["pace", "trot"]
    assert run("export", next((library / "motions").glob("trot*")), "--format", "csv", "--out", "one.csv").status == 0
    assert run("library", "export", library, "--to", "csv", "--format", "csv", "--gait", "trot").status == 0
    written = next((in_folder / "csv").glob("trot*.csv")).read_text()
    assert written == (in_folder / "one.csv").read_text()


def test_verify(library: Path, run: Run, tmp_path: Path) -> None:
    done = run("library", "verify", library, "--rerun", "1")
    assert done.status == 0
    assert done.out.splitlines() == [
        "2 records, 0 damaged, 0 orphaned files",
        "1 motions run again, 0 with a different reward",
    ]
    mine = Path(shutil.copytree(library, tmp_path / "mine"))
    motion = next((mine / "motions").glob("trot*"))
    motion.write_bytes(motion.read_bytes()[:-10])
    done = run("library", "verify", mine)
    assert done.status == 3
    assert "is not what was written" in done.out
    assert run("library", "verify", mine, "--mend").status == 0
    assert [row["name"] for row in MotionDataset.open(mine).index()] == ["pace"]
    assert run("library", "build", "trot", "pace", "--out", mine, *HERE).out.startswith("2 motions, 1 of them new")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["build", "--out", "x"], "name folders, lists, clips or motions"),
        (["build", "trot"], "--out"),
        (
            ["build", "trot", "tort", "--out", "x"],
            "'tort' is neither the name of a motion nor a file; did you mean 'trot'",
        ),
        (["build", "trot", "dog:trto", "--out", "x"], "did you mean 'dog:trot'"),
        (["build", "trot", "dog:trot", "--out", "x"], "run 'fastmimic data fetch'"),
        (["build", "trot", "none.list", "--out", "x"], "no such list"),
        (["build", "trot", "--out", "x", "--robots", "a1", "none.xml"], "none.xml"),
        (["build", "trot", "--out", "x", "--executor", "ray", "--address", "127.0.0.1:9"], RAY),
        (["build", "trot", "--out", "x", "--seeds", "0"], "seeds must be at least 1"),
        (["build", "trot", "--out", "x", "--iterations", "0"], "iterations must be at least 1"),
        (["build", "trot", "--out", "x", "--robots", "a2"], "unknown robot 'a2'"),
        (["build", "trot", "--out", "x", "--method", "rl"], "model-based"),
        (["build", "trot", "--out", "x", "--executor", "slurm"], "unknown executor 'slurm'"),
        (["build", "trot", "--out", "x", "--confidence", "2"], "confidence"),
        (["build", "none.csv", "--out", "x"], "no such list"),
        (["list", "nothing"], "no library there"),
        (["show", "LIBRARY", "tort"], "did you mean 'trot'?"),
        (["list", "LIBRARY", "--grade", "D"], "unknown grade 'D'"),
        (["list", "LIBRARY", "--gait", "canter"], "there are pace, trot"),
        (["export", "LIBRARY", "--to", "y", "--grade", "rejected"], "no motion of it fits"),
        (["export", "LIBRARY", "--to", "y", "--format", "bvh"], "unknown format 'bvh'"),
        (["export", "LIBRARY", "--to", "LIBRARY"], "is in the library"),
        (["build", "none/below/", "--out", "x"], "no such file or folder"),
        (["build", "none.txt", "--out", "x"], "no such file or folder"),
        (["verify", "LIBRARY", "--rerun", "-1"], "--rerun must not be negative"),
    ],
)
def test_bad_input(arguments: list[str], said: str, library: Path, run: Run, in_folder: Path) -> None:
    assert said in run("library", *(str(library) if a == "LIBRARY" else a for a in arguments)).error
    assert not (in_folder / "x").exists()


def test_another_recipe_is_refused(library: Path, run: Run) -> None:
    changed = [*HERE, "--duration", "0.8"]
    assert "duration_s was 0.6" in run("library", "build", "trot", "--out", library, *changed).error


@pytest.mark.parametrize(("robot", "told"), [("a1", True), ("A1", True), ("go2", False)])
def test_a_second_simulator_that_is_missing_is_noted_for_a_robot_that_it_knows(
    robot: str, told: bool, run: Run, in_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (in_folder / "x").touch()  # so that nothing is made
    missing = replace(SIMULATORS[SECOND_SIMULATOR], needs=("no_such_module",))
    monkeypatch.setitem(SIMULATORS, SECOND_SIMULATOR, missing)
    done = run("library", "build", "trot", "--out", "x", "--robots", robot)
    assert done.status == 2
    assert ("motions are not tested in a second simulator" in done.err) == told


def test_whether_there_is_a_second_simulator_is_the_same_for_all_robots() -> None:
    second = SIMULATORS[SECOND_SIMULATOR]
    assert second.installed == (find_spec("pybullet") is not None)
    assert (second.knows("a1"), second.knows("go2"), SIMULATORS[FIRST_SIMULATOR].knows("go2")) == (True, False, True)


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_interrupted_and_gone_on(
    workers: str, library: Path, start: Callable[..., subprocess.Popen[str]], run: Run, in_folder: Path
) -> None:
    names = ["trot", "pace", "walk"]
    process = start("library", "build", *names, "--out", "lib", *QUICK, "--workers", workers)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("1/3 "):
            break
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "the same command continues" in err
    done = len(MotionDataset.open(in_folder / "lib").index())
    assert 1 <= done < 3
    rest = run("library", "build", *names, "--out", "lib", *HERE)
    assert rest.out.startswith(f"3 motions, {3 - done} of them new")
    assert check(MotionDataset.open(in_folder / "lib")).sound
    if workers == "1":  # others choose among the best candidates by longer episodes than these tests
        rows = {row["name"]: reproducible(row) for row in MotionDataset.open(in_folder / "lib").index()}
        assert all(rows[row["name"]] == reproducible(row) for row in MotionDataset.open(library).index())


@pytest.mark.slow
def test_two_builders_in_one_folder(
    library: Path, start: Callable[..., subprocess.Popen[str]], in_folder: Path
) -> None:
    builders = [start("library", "build", "trot", "pace", "--out", "lib", *HERE) for _ in range(2)]
    for process in builders:
        assert process.communicate(timeout=240)
        assert process.returncode == 0
    assert check(MotionDataset.open(in_folder / "lib")).sound
    same(in_folder / "lib", library)
