"""A library is built once, whatever happens meanwhile, and says what it is made of."""

import errno
import importlib
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dataset.conftest import RECIPE, contents, of
from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import LibraryError, OutputError, WorkerError
from fastmimic.dataset import BuildRequest, DatasetSource, MotionDataset, build_dataset, find_sources
from fastmimic.dataset.build import Built
from fastmimic.dataset.excerpts import survey
from fastmimic.dataset.index import COLUMNS, load_record, read_record
from fastmimic.dataset.jobs import Job, give_up, perform
from fastmimic.dataset.repair import check, repair, rerun
from fastmimic.executors import make_executor
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.export import export_motion
from fastmimic.motion.motion import Motion
from fastmimic.robot import load_robot
from fastmimic.runs.loading import load_motion

HERE = make_executor("local", workers=1)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two motions; not to be changed."""
    pytest.importorskip("pyarrow")
    folder = tmp_path_factory.mktemp("library")
    build_dataset(of("trot", "pace"), folder, HERE)
    return folder


@pytest.fixture
def mine(built: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copytree(built, tmp_path / "mine"))


def test_a_record_says_all(built: Path) -> None:
    rows = MotionDataset.open(built).index()
    assert [(row["name"], row["robot"], row["grade"]) for row in rows] == [("pace", "a1", "A"), ("trot", "a1", "A")]
    for row in rows:
        assert row["kept"]
        assert row["best"]
        assert row["gait"] == row["footfall"] == row["name"]
        assert row["licence"].startswith("no recording")
        assert row["reward_mean_second_simulator"] is None
        motion = MotionDataset.open(built).motion(row)
        again = evaluate(motion, "a1", duration_s=RECIPE.evaluation_s)
        assert again.rollout.reward[0] == row["reward_mean"]
        assert row["iterations"] == 3
        assert row["speed_m_per_s"] == pytest.approx(1.25, abs=0.45)


def test_pandas_reads_the_index(built: Path) -> None:
    pandas = pytest.importorskip("pandas")
    index = pandas.read_parquet(built / "index.parquet")
    assert set(COLUMNS) < set(index.columns)
    motion = np.load(built / index.query("name == 'trot'").iloc[0]["motion_file"])
    assert motion["joint_pos"].shape[1] == 12


def test_a_second_build_does_nothing(mine: Path) -> None:
    before = contents(mine)
    again = build_dataset(of("trot", "pace"), mine, HERE)
    assert (again.jobs, again.done) == (2, 0)
    assert contents(mine) == before


@pytest.mark.slow
def test_more_seeds_and_robots_are_added(mine: Path) -> None:
    more = BuildRequest([DatasetSource("trot")], RECIPE, ("a1", "go2"), seeds=2)
    again = build_dataset(more, mine, HERE)
    assert (again.jobs, again.done) == (4, 3)
    rows = [row for row in again.table.to_pylist() if row["name"] == "trot"]
    assert [(row["robot"], row["seed"]) for row in rows] == [("a1", 0), ("a1", 1), ("go2", 0), ("go2", 1)]
    assert sum(row["best"] for row in rows) == 2
    assert len(again.table.to_pylist()) == 5  # with the pace


@pytest.mark.parametrize("harm", ["torn motion", "changed motion", "lost motion", "torn record", "other record"])
def test_what_is_torn_is_noticed_and_done_again(harm: str, mine: Path) -> None:
    before, rows = contents(mine), MotionDataset.open(mine).index()
    motion, record = mine / rows[0]["motion_file"], mine / "records" / f"{rows[0]['id']}.json"
    if harm == "torn motion":
        motion.write_bytes(motion.read_bytes()[:1000])
    elif harm == "changed motion":
        motion.write_bytes(motion.read_bytes()[:-1] + b"x")
    elif harm == "lost motion":
        motion.unlink()
    elif harm == "torn record":
        record.write_bytes(record.read_bytes()[:200])
    else:
        record.write_text("[]")
    health = check(MotionDataset.open(mine))
    assert len(health.damaged) == 1
    again = build_dataset(of("trot", "pace"), mine, HERE)
    assert again.done == 1
    assert contents(mine) == before
    assert check(MotionDataset.open(mine)).sound


@pytest.mark.slow
def test_a_build_makes_what_was_lost_without_a_trace(mine: Path) -> None:
    motion = next((mine / "motions").glob("trot*"))
    whole, then = motion.read_bytes(), motion.stat()
    motion.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    os.utime(motion, ns=(then.st_atime_ns, then.st_mtime_ns))
    assert len(check(MotionDataset.open(mine)).damaged) == 1
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 1
    assert motion.read_bytes() == whole
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 0


@pytest.mark.slow
def test_a_build_looks_through_no_source_that_is_as_it_was(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module("fastmimic.dataset.build")
    shutil.copytree(clips, tmp_path / "clips")
    looked: list[str] = []
    whole = module.survey
    monkeypatch.setattr(module, "survey", lambda source, *a: looked.append(source.name) or whole(source, *a))

    def again(confidence: float = 0.5, update: bool = False) -> list[str]:
        looked.clear()
        sources = find_sources(tmp_path / "clips")
        build_dataset(
            BuildRequest(sources, RECIPE, ("a1",), confidence=confidence), tmp_path / "lib", HERE, update=update
        )
        return looked

    assert again() == ["pace", "torn", "trot"]
    assert again() == ["torn"]  # what failed is tried again
    assert again(confidence=0.4) == ["pace", "torn", "trot"]
    (tmp_path / "clips" / "trot.txt").touch()
    assert again(confidence=0.4) == ["torn", "trot"]
    assert again(confidence=0.4, update=True) == ["pace", "torn", "trot"]


@pytest.mark.slow
def test_what_is_gone_from_a_folder_leaves_the_index(clips: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(clips, tmp_path / "clips").resolve()

    def built(place: Path) -> list[str]:
        sources = find_sources(place, exclude=["torn*"] if len(made) else [])
        folders = [place] if place.is_dir() else []
        library = build_dataset(BuildRequest(sources, RECIPE, ("a1",), folders=folders), tmp_path / "lib", HERE).library
        problems = [survey.source.name for survey in library.surveys()[0] if survey.problem]
        return [row["name"] for row in library.index()] + problems

    made: list[str] = []
    made = built(folder)
    assert made == ["pace", "trot", "torn"]
    (folder / "trot.txt").unlink()
    assert built(folder / "below") == ["pace", "trot", "torn"]  # nothing is said of other folders
    assert built(folder) == ["pace"]
    (old,) = MotionDataset.open(tmp_path / "lib").gathered().superseded
    assert (old.name, old.why) == ("trot", "its source has changed or is gone")


@pytest.mark.parametrize("text", ["", "[]", '{"pieces": [1]}'])
def test_a_damaged_file_about_a_source_or_robot_takes_nothing_else_with_it(text: str, mine: Path) -> None:
    library, before = MotionDataset.open(mine), contents(mine)
    rows = library.index()
    for kind in ("sources", "robots"):
        next((mine / kind).iterdir()).write_text(text)
    assert MotionDataset.open(mine).find("trot") == [row for row in rows if row["name"] == "trot"]
    assert len(library.surveys()[0]) == 1
    health = check(library)
    assert [line.split("/")[0] for line in health.damaged] == ["robots", "sources"]
    assert all("the next build" in line for line in health.damaged)
    assert health.foreign == ()
    assert repair(library)[1] == 0
    assert [row["id"] for row in library.index()] == [row["id"] for row in rows]
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 0
    assert check(library).sound
    assert library.index() == rows
    assert contents(mine) == before


@pytest.mark.parametrize("text", ["", "{}", '{"format_version": 1, "recipe": {}, "digest": "0"}'])
def test_a_damaged_recipe_is_written_anew_by_the_next_build_like_it(text: str, mine: Path) -> None:
    rows = MotionDataset.open(mine).index()
    (mine / "library.json").write_text(text)
    library = MotionDataset.open(mine)
    assert library.index() == rows
    assert len(check(library).damaged) == 1
    with pytest.raises(LibraryError, match="cannot be read"):
        build_dataset(replace(of("trot"), recipe=replace(RECIPE, iterations=5)), mine, HERE)
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 0
    assert check(MotionDataset.open(mine)).sound


def test_a_record_of_other_columns_is_none(mine: Path) -> None:
    path = next((mine / "records").iterdir())
    record = json.loads(path.read_text())
    for other in ({**record, "of_another_version": 1}, {name: record[name] for name in record if name != "success"}):
        path.write_text(json.dumps(other))
        assert read_record(path) is None
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 1


def test_a_record_of_another_kind_is_none(mine: Path) -> None:
    path = next((mine / "records").iterdir())
    path.write_text(json.dumps({**json.loads(path.read_text()), "reward_mean": "high"}))
    assert check(MotionDataset.open(mine)).damaged == (f"records/{path.name}: not a whole record",)
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 1


def test_what_a_killed_builder_has_left_is_removed(mine: Path) -> None:
    left = [".index.parquet.x", "records/.a.json.x", "sources/.a.json.x", "motions/.a.npz.x"]
    for name in left:
        (mine / name).write_text("half")
    (mine / ".gitignore").write_text("work/")
    health, removed = repair(MotionDataset.open(mine))
    assert (sorted(health.foreign), removed) == (sorted(left), 4)
    assert (mine / ".gitignore").exists()


@pytest.mark.slow
def test_a_torn_checkpoint_is_begun_anew(mine: Path) -> None:
    before = contents(mine)
    for path in mine.glob("records/*.json"):
        path.unlink()
    for path in mine.glob("work/*/checkpoint.npz"):
        path.write_bytes(path.read_bytes()[:500])
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 2
    assert contents(mine) == before


def test_a_longer_search_goes_on_from_the_shorter_one(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    longer = replace(of("trot"), recipe=replace(RECIPE, iterations=5))
    with pytest.raises(LibraryError, match="iterations was 3"):
        build_dataset(longer, mine, HERE)
    begun = []
    from fastmimic.experiments import measurement

    whole = measurement.imitate
    monkeypatch.setattr(measurement, "imitate", lambda *a, **k: begun.append(k["resume"]) or whole(*a, **k))
    again = build_dataset(longer, mine, HERE, update=True)
    assert begun == [True]
    assert [row["iterations"] for row in again.table.to_pylist()] == [5]  # the pace is of the old recipe
    health = check(MotionDataset.open(mine))
    assert len(health.foreign) == 4  # the old records, and their motions
    assert repair(MotionDataset.open(mine)) == (health, 4)
    assert check(MotionDataset.open(mine)).foreign == ()


@pytest.mark.slow
def test_a_full_disk_loses_nothing(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(mine)
    full = True
    through = os.fsync

    def fsync(handle: int) -> None:
        if full and "walk" in os.readlink(f"/proc/self/fd/{handle}"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        through(handle)

    monkeypatch.setattr("fastmimic.base.files.os.fsync", fsync)
    with pytest.raises(OutputError, match="No space left"):
        build_dataset(of("trot", "pace", "walk"), mine, HERE)
    assert contents(mine) == before
    assert len(MotionDataset.open(mine).index()) == 2
    full = False
    assert build_dataset(of("trot", "pace", "walk"), mine, HERE).done == 1


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with clips: a trot, a pace further down, a file that is torn, and others that are none."""
    folder = tmp_path_factory.mktemp("clips")
    robot = load_robot("a1")
    for name, path in (("trot", "trot.txt"), ("pace", "below/pace.txt")):
        (folder / path).parent.mkdir(exist_ok=True)
        export_motion(load_motion(name), robot, folder / path, "deepmimic")
    text = (folder / "trot.txt").read_text()
    (folder / "torn.txt").write_text(text[: len(text) // 2])
    (folder / "LICENSE.txt").write_text("\nMade for a test\nand nothing else\n")
    (folder / "README.md").write_text("Read me")
    (folder / "picture.png").write_bytes(b"\x89PNG")
    return folder


@pytest.mark.slow
def test_a_folder_with_one_clip_that_is_torn(clips: Path, tmp_path: Path) -> None:
    sources = find_sources(clips)
    assert [Path(source.place).name for source in sources] == ["pace.txt", "torn.txt", "trot.txt"]
    done = build_dataset(BuildRequest(sources, RECIPE, ("a1",)), tmp_path, HERE)
    assert [(row["name"], row["status"]) for row in done.table.to_pylist()] == [("pace", "done"), ("trot", "done")]
    assert {row["licence"] for row in done.table.to_pylist()} == {"Made for a test"}
    failed = [survey for survey in done.surveys if survey.failed is not None]
    assert len(failed) == 1
    assert "torn.txt" in (failed[0].failed or "")


def test_a_source_that_changes_is_done_again(clips: Path, tmp_path: Path) -> None:
    file = tmp_path / "trot.txt"
    file.write_text((clips / "trot.txt").read_text())
    folder = tmp_path / "library"
    building = BuildRequest(find_sources(file), RECIPE, ("a1",))
    first = build_dataset(building, folder, HERE)
    file.write_text((clips / "below/pace.txt").read_text())
    second = build_dataset(building, folder, HERE)
    assert second.done == 1
    assert [row["id"] for row in second.table.to_pylist()] != [row["id"] for row in first.table.to_pylist()]
    assert len(second.table.to_pylist()) == 1


def test_equal_clips_are_one_motion_with_a_source_and_its_licence(clips: Path, tmp_path: Path) -> None:
    one, other = tmp_path / "clips" / "one.txt", tmp_path / "clips" / "other.txt"
    one.parent.mkdir()
    for path in (one, other):
        path.write_text((clips / "trot.txt").read_text())

    def made(licence: str | None = None) -> Built:
        sources = find_sources(tmp_path / "clips", licence=licence)
        return build_dataset(BuildRequest(sources, RECIPE, ("a1",)), tmp_path / "library", HERE)

    first = made()
    assert (first.jobs, first.done) == (1, 1)
    again = made(licence="mine")
    assert again.done == 0
    assert [row["licence"] for row in again.table.to_pylist()] == ["mine"]
    assert len(list((tmp_path / "library" / "sources").iterdir())) == 2
    for torn, whole in ((other, one), (one, other)):
        text = torn.read_text()
        torn.write_text("1 2 3")
        harmed = made()
        assert harmed.done == 0
        assert [(row["source"], row["name"]) for row in harmed.table.to_pylist()] == [(str(whole), whole.stem)]
        assert len(harmed.failures) == 1
        assert harmed.failures[0].count(str(torn)) == 1
        torn.write_text(text)
    one.write_text("1 2 3")
    made()
    one.unlink()
    assert made().failures == []


def test_a_defect_met_in_a_source_is_that_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    def open_clip(*_: object, **__: object) -> None:
        raise IndexError("a defect")

    monkeypatch.setattr("fastmimic.dataset.excerpts.open_clip", open_clip)
    found = survey(DatasetSource("trot"), 0.5)
    assert (found.failed or "").startswith("unexpected IndexError in test_build.py")
    assert found.problem == f"trot: {found.failed}"


def test_a_controllers_file_is_told_by_its_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(path: Path, friction: float) -> None:
        path.parent.mkdir(exist_ok=True)
        said = {"format": "fastmimic controller", "version": 1, "stance": {"friction": friction}}
        path.write_text(json.dumps(said))

    write(tmp_path / "mine.json", 0.4)
    write(tmp_path / "below" / "mine.json", 0.4)
    monkeypatch.chdir(tmp_path)
    recipe = replace(RECIPE, config="mine.json")
    assert recipe.digest == replace(RECIPE, config="below/mine.json").digest
    library = MotionDataset(tmp_path / "library")
    library.save_recipe(recipe)
    write(tmp_path / "mine.json", 0.5)
    with pytest.raises(LibraryError, match="made otherwise"):
        build_dataset(replace(of("trot"), recipe=replace(RECIPE, config="mine.json")), library.path, HERE)
    monkeypatch.chdir("/")
    assert library.recipe() == recipe
    (tmp_path / "mine.json").unlink()
    assert MotionDataset.open(library.path).recipe_digest() == recipe.digest


def test_what_is_of_another_robot_leaves_the_index(mine: Path) -> None:
    library = MotionDataset.open(mine)
    assert library.write_index().table.num_rows == 2
    library.save_robot("a1", "another")
    assert library.write_index().table.num_rows == 0
    assert {old.why for old in library.gathered().superseded} == {"its robot has changed"}
    assert len(check(library).foreign) == 4
    assert build_dataset(of("trot", "pace"), mine, HERE).done == 0
    assert len(library.index()) == 2


def test_the_index_of_a_running_build_is_written_once(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    others = iter(range(5))
    monkeypatch.setattr(MotionDataset, "_state", lambda self: {next(others)})
    assert MotionDataset.open(mine).write_index(settled=False).table.num_rows == 2
    assert next(others) == 1


def job_of(name: str, folder: Path) -> Job:
    """As `build` makes it."""
    (piece,) = survey(DatasetSource(name), 0.5).pieces
    return Job(piece, "a1", fingerprint(load_robot("a1").content), 0, RECIPE, folder)


def test_a_failure_does_not_replace_what_another_builder_has_done(mine: Path) -> None:
    job = job_of("trot", mine)
    done = load_record(mine, job.id)
    assert done is not None
    assert give_up(job, WorkerError("died")) == done == load_record(mine, job.id)


def test_a_machine_that_does_not_see_the_library_says_so(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="no library there as seen from"):
        perform(job_of("trot", tmp_path / "elsewhere"), print)
    assert not (tmp_path / "elsewhere").exists()


def test_names_are_as_long_as_file_systems_allow(tmp_path: Path) -> None:
    job = job_of("trot", tmp_path)
    long = replace(job, piece=replace(job.piece, name="犬" * 200))
    assert len(Path(long.motion_file).name.encode()) < 200
    assert long.motion_file.startswith("motions/犬犬")


def test_a_motion_that_cannot_be_made_is_said_with_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fastmimic.experiments import measurement

    whole = measurement.imitate

    def sometimes(motion, *a, **k):  # type: ignore[no-untyped-def]
        if motion.name == "pace":
            raise ZeroDivisionError("a defect")
        return whole(motion, *a, **k)

    monkeypatch.setattr(measurement, "imitate", sometimes)
    rows = build_dataset(of("trot", "pace"), tmp_path, HERE).table.to_pylist()
    assert [(row["name"], row["grade"]) for row in rows] == [("pace", "failed"), ("trot", "A")]
    assert "unexpected ZeroDivisionError" in rows[0]["lacks"]
    monkeypatch.undo()
    assert build_dataset(of("trot", "pace"), tmp_path, HERE).done == 1  # what failed is tried again


@pytest.mark.slow
def test_long_takes_are_cut(data_folder: Path, tmp_path: Path) -> None:
    take = data_folder / "dog_keypoints" / "dog_walk09_joint_pos.txt"
    building = BuildRequest(find_sources(take), replace(RECIPE, iterations=1), ("a1",), confidence=0.85)
    done = build_dataset(building, tmp_path, HERE)
    assert done.jobs >= 2
    assert all(row["first_frame"] < row["end_frame"] for row in done.table.to_pylist())
    assert all("CC BY-NC" in row["licence"] for row in done.table.to_pylist())


def test_movement_that_does_not_repeat_is_asked_for(data_folder: Path, tmp_path: Path) -> None:
    take = find_sources(data_folder / "dog_keypoints" / "dog_walk00_joint_pos.txt")
    cycles, all_of_it = survey(take[0], 0.5), survey(take[0], 0.5, "segments")
    once = [piece for piece in all_of_it.pieces if not piece.repeats]
    assert set(cycles.pieces) < set(all_of_it.pieces)
    assert {piece.gait for piece in once} == {"discrete"}
    shortest = min(once, key=lambda piece: piece.period_s)
    job = Job(shortest, "a1", "", 0, replace(RECIPE, iterations=1), tmp_path)
    (tmp_path / "library.json").write_text("{}")
    record = perform(job, lambda share: None)
    assert record["reason"] is None
    assert record["repeats"] is False
    assert Motion.load(tmp_path / record["motion_file"]).cycle is None


def test_takes_are_run_whole_when_asked(data_folder: Path) -> None:
    """Whether they repeat or not; of one with a gap each part, in the frames of the file."""
    (take,) = find_sources(data_folder / "dog_keypoints" / "dog_walk00_joint_pos.txt")
    (piece,) = survey(take, 0.5, "whole").pieces
    assert (piece.name, piece.frames, piece.repeats) == ("dog_walk00_joint_pos", None, False)
    (passage,) = survey(replace(take, frames=(101, 580)), 0.5, "whole").pieces
    assert (passage.frames, passage.repeats) == ((101, 580), False)
    (cycle,) = survey(replace(take, frames=(162, 201)), 0.5, "whole").pieces
    assert (cycle.frames, cycle.repeats) == ((162, 201), True)
    (gait,) = survey(DatasetSource("trot"), 0.5, "whole").pieces
    assert gait.repeats


def test_a_rerun_notices_another_reward(mine: Path) -> None:
    library = MotionDataset.open(mine)
    assert rerun(library, 5) == ([], 2)
    path = next(mine.glob("records/*.json"))
    record = json.loads(path.read_text())
    path.write_text(json.dumps({**record, "reward_mean": 0.5}))
    library.write_index()
    differing, _ = rerun(library, 5)
    assert len(differing) == 1
    assert record["id"] in differing[0]


@pytest.mark.slow
def test_processes_make_the_same(built: Path, tmp_path: Path) -> None:
    done = build_dataset(of("trot", "pace"), tmp_path, make_executor("local", workers=2))
    assert {row["name"]: row["status"] for row in done.table.to_pylist()} == {"trot": "done", "pace": "done"}
    assert [row["evaluations"] for row in done.table.to_pylist()] != [0, 0]


def test_lists(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("")
    (tmp_path / "clips.list").write_text("# what\ntrot\n\na.txt  # a file\n")
    assert [source.place for source in find_sources(tmp_path / "clips.list")] == ["trot", str(tmp_path / "a.txt")]
    (tmp_path / "clips.csv").write_text("source,frames,licence\na.txt,10:20,mine\ntrot,,\n")
    (tmp_path / "sheet.csv").write_text("\ufeffsource\ntrot\n", encoding="utf-8")
    assert [source.place for source in find_sources(tmp_path / "sheet.csv")] == ["trot"]
    found = find_sources(tmp_path / "clips.csv", licence="given")
    assert [(s.frames, s.licence) for s in found] == [((10, 20), "mine"), (None, "given")]
    (tmp_path / "wrong.list").write_text("tort\n")
    assert find_sources(tmp_path / "wrong.list")[0].place == "tort"  # said by the build, which does the others
    assert find_sources("trot")[0].place == "trot"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("x.csv", "source,fames\na,1:2\n", "unknown column 'fames'"),
        ("x.csv", "source,frames\na,1-2\n", "line 2: frames takes FIRST:END"),
        ("x.csv", "source,fps\na,fast\n", "line 2"),
        ("x.list", "# nothing\n", "the list is empty"),
        ("none.csv", None, "no such list"),
    ],
)
def test_lists_that_cannot_be_read(name: str, text: str | None, said: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(LibraryError, match=said):
        find_sources(tmp_path / name)


def test_folders_without_clips(tmp_path: Path) -> None:
    with pytest.raises(LibraryError, match="no clips"):
        find_sources(tmp_path)
    with pytest.raises(LibraryError, match="no library there"):
        MotionDataset.open(tmp_path)


def test_a_library_of_another_format(mine: Path) -> None:
    (mine / "library.json").write_text('{"format_version": 9, "recipe": {}}')
    with pytest.raises(LibraryError, match=r"library\.json"):
        MotionDataset.open(mine)


@pytest.mark.parametrize("harm", ["lost", "torn"])
def test_an_index_that_is_damaged_is_made_anew(harm: str, mine: Path) -> None:
    index = mine / "index.parquet"
    rows = MotionDataset.open(mine).index()
    index.unlink() if harm == "lost" else index.write_bytes(index.read_bytes()[:300])
    with pytest.raises(LibraryError, match=r"index\.parquet"):
        MotionDataset.open(mine).index()
    health = check(MotionDataset.open(mine))
    assert health.outdated
    repair(MotionDataset.open(mine))
    assert MotionDataset.open(mine).index() == rows
