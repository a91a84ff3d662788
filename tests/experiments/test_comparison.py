"""A whole comparison in small: every method and every ablation, its rows, tables and figures, and what is kept."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.control.config import CONFIGS, ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import perturbed_start
from fastmimic.episode.reward import TERMS, WEIGHTS
from fastmimic.experiments.ablations import ABLATIONS, ablation_named, ablations_of
from fastmimic.experiments.compare import ComparisonPlan, prepare
from fastmimic.experiments.comparison_run import ComparisonFolder, ComparisonSettings, Row, finished_row
from fastmimic.experiments.measurement import COLUMNS, ablation_table, comparison_table, summaries
from fastmimic.imitation.evaluate import evaluate
from fastmimic.imitation.methods import METHODS, PAPER_METHODS
from fastmimic.motion.motion import Motion
from fastmimic.report.experiment_figures import write_comparison
from fastmimic.robot import load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, parse_terrain
from searches import QUICK_CHOICE

TINY = ComparisonSettings(
    duration_s=0.4, iterations=2, population=4, evaluation_s=0.8, perturbed_episodes=2, choice=QUICK_CHOICE
)
SEEDS = ComparisonPlan(TINY, ("trot",), tuple(PAPER_METHODS), seeds=2, ablations=False)
PLAN = replace(SEEDS, seeds=1, ablations=True)
PNG = b"\x89PNG"


def run(plan: ComparisonPlan, out: Path, workers: int = 1) -> tuple[list[Row], list[tuple[float, Row | None]]]:
    """The rows, and what was reported on the way."""
    reported: list[tuple[float, Row | None]] = []

    def report(share: float, row: Row | None) -> None:
        reported.append((share, row))

    return prepare(plan, out, keep=True, prepared=lambda name: None).perform(workers, report), reported


def figures(row: Row) -> Row:
    """All of a row but how long it took."""
    return {k: v for k, v in row.items() if k not in ("wall_s", "cpu_s")}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Row], list[tuple[float, Row | None]]]:
    """A finished comparison of methods by two seeds, to which ablations by one were added, with its folder written, and
    what was reported of the methods. Not to be changed."""
    out = tmp_path_factory.mktemp("comparison")
    rows, reported = run(SEEDS, out)
    rows += [row for row in run(PLAN, out)[0] if row["variant"]]
    write_comparison(ComparisonFolder.at(out), PLAN, rows)
    return out, rows, reported


@pytest.fixture(scope="module")
def rows(done: tuple[Path, list[Row], list[tuple[float, Row | None]]]) -> list[Row]:
    return done[1]


@pytest.fixture(scope="module")
def out(done: tuple[Path, list[Row], list[tuple[float, Row | None]]]) -> Path:
    return done[0]


class TestPlan:
    def test_deterministic_methods_run_once_and_searches_once_a_seed(self) -> None:
        keys = [(r.method, r.seed) for r in SEEDS.runs]
        once = [("raibert", 0), ("mbc", 0), ("lh", 0)]
        assert keys == [*once, ("mbc-dmp", 0), ("lh-dmp", 0), ("mbc-dmp", 1), ("lh-dmp", 1)]

    def test_the_ablations_bring_their_method_along(self) -> None:
        runs = replace(PLAN, methods=("mbc",), seeds=1).runs
        assert [(r.method, r.variant) for r in runs[:2]] == [("mbc", ""), ("mbc-dmp", "")]
        assert {r.method for r in runs if r.variant} == {"mbc-dmp"}

    @pytest.mark.parametrize(
        ("config", "own"),
        [
            (ControllerConfig(), {"full-adaptation"}),
            (
                CONFIGS["paper"],
                {
                    "paper-adaptation",
                    "paper-controller",
                    "no-leg-momentum",
                    "no-leg-dynamics",
                    "no-reference-acceleration",
                    "constant-gains",
                    "paper-footholds",
                    "no-disturbance-estimate",
                },
            ),
        ],
    )
    def test_an_ablation_that_changes_nothing_is_left_out(self, config: object, own: set[str]) -> None:
        names = {a.name for a in ablations_of(config)}  # type: ignore[arg-type]
        assert names == set(ABLATIONS) - own

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"motions": ()}, "at least one motion"),
            ({"methods": ()}, "at least one method; there are raibert, mbc"),
            ({"methods": ("mbc-dpm",)}, "unknown method 'mbc-dpm'.*did you mean 'mbc-dmp'"),
            ({"motions": ("trot", "trot")}, "motion trot is given twice"),
            ({"seeds": 0}, "seeds must be at least 1, found 0"),
            ({"settings": replace(TINY, population=3)}, "population must be at least 4"),
            ({"settings": replace(TINY, config="papre")}, "unknown configuration 'papre'"),
        ],
    )
    def test_nonsense_is_refused(self, changes: dict[str, object], message: str) -> None:
        with pytest.raises(ConfigError, match=message):
            replace(PLAN, **changes)  # type: ignore[arg-type]


@pytest.mark.slow
class TestRows:
    def test_there_is_one_for_each_run_in_order(self, rows: list[Row]) -> None:
        assert [(r["method"], r["variant"], r["seed"]) for r in rows] == [
            (r.method, r.variant, r.seed) for r in (*SEEDS.runs, *(r for r in PLAN.runs if r.variant))
        ]

    def test_they_have_all_columns_and_nothing_else(self, rows: list[Row]) -> None:
        assert all(set(row) == set(COLUMNS) for row in rows)

    def test_the_reward_is_the_sum_of_its_terms(self, rows: list[Row]) -> None:
        for row in rows:
            terms = [row[f"components_{name}"] for name in TERMS]
            assert row["reward_mean"] == pytest.approx(np.dot(WEIGHTS, terms))
            assert 0 < row["reward_mean"] <= 1

    def test_methods_without_a_search_have_none(self, rows: list[Row]) -> None:
        for row in rows:
            assert (row["iterations"], row["parameters"] != "") == (
                (2, True) if METHODS[row["method"]].optimises else (0, False)
            )

    def test_before_is_the_unoptimised_motion_under_the_same_controller(self, rows: list[Row]) -> None:
        by = {(r["method"], r["variant"], r["seed"]): r for r in rows}
        assert by["mbc-dmp", "", 0]["reward_mean_before"] == by["mbc", "", 0]["reward_mean"]
        assert by["lh-dmp", "", 1]["reward_mean_before"] == by["lh", "", 0]["reward_mean"]
        assert by["mbc", "", 0]["reward_mean"] != by["lh", "", 0]["reward_mean"]

    def test_seeds_are_those_of_the_search(self, rows: list[Row], out: Path) -> None:
        one, other = (r for r in rows if r["method"] == "mbc-dmp" and not r["variant"])
        assert one["digest"] == other["digest"]
        tried = [np.load(out / "runs" / f"trot-mbc-dmp-seed{seed}" / "checkpoint.npz")["candidates"] for seed in (0, 1)]
        assert not np.array_equal(*tried)

    def test_the_style_is_the_references_and_a_method_with_its_own_feet_has_none(self, rows: list[Row]) -> None:
        for row in rows:
            if row["method"] == "raibert":
                assert row["style_distance"] is None
            elif not METHODS[row["method"]].optimises:
                assert row["style_distance"] == 0.0
            else:
                assert 0 < row["style_distance"] < 1
        realised = {r["method"]: r["style_distance_realised"] for r in rows if not r["variant"]}
        assert realised["raibert"] > 2 * realised["mbc"]

    def test_every_ablation_changes_something(self, rows: list[Row]) -> None:
        whole = next(r for r in rows if r["method"] == "mbc-dmp" and not r["variant"])
        assert {r["variant"] for r in rows} == {"", *PLAN.variants}
        for row in rows:
            if row["variant"]:
                assert row["digest"] != whole["digest"]
        before = {r["variant"]: r["reward_mean_before"] for r in rows if r["method"] == "mbc-dmp" and r["seed"] == 0}
        # nothing goes wrong in so short and smooth an episode, and fewer basis functions are no other controller
        same = {
            "",
            "no-state-machine",
            "no-recovery-steps",
            "no-step-timing",
            "10-basis-functions",
            "25-basis-functions",
        }
        assert {name for name, reward in before.items() if reward == before[""]} == same
        styles = {r["variant"]: r["style_distance"] for r in rows if r["seed"] == 0 and r["method"] == "mbc-dmp"}
        assert styles["10-basis-functions"] != styles["25-basis-functions"] != styles[""]

    def test_without_the_state_machine_no_touch_down_is_early(self) -> None:
        robot = load_robot("a1")
        trot = load_motion("trot", robot)
        start = perturbed_start(8, trot.n_samples, np.random.default_rng(0))
        rough, early = Conditions(terrain=parse_terrain("rough=0.05")), {}
        for name in ("", "no-state-machine"):
            config = ablation_named(name).change(ControllerConfig())
            found = run_episodes(robot, trot, start=start, duration_s=0.8, config=config, conditions=rough)
            early[name] = found.early_contacts
        assert early[""].any()
        assert not early["no-state-machine"].any()

    def test_they_do_not_depend_on_the_number_of_processes(self, rows: list[Row], tmp_path: Path) -> None:
        plan = replace(PLAN, methods=("raibert", "mbc", "mbc-dmp"), seeds=1, ablations=False)
        spread, reported = run(plan, tmp_path, workers=2)
        expected = [r for r in rows if r["method"] in plan.methods and not r["variant"] and r["seed"] == 0]
        effort = ("evaluations", "simulated_s")  # the final choice is shortened in this process only
        for row, other in zip(spread, expected, strict=True):
            assert {k: v for k, v in figures(row).items() if k not in effort} == {
                k: v for k, v in figures(other).items() if k not in effort
            }
        assert reported[-1][0] == pytest.approx(1.0)  # a sum in the order in which they end


@pytest.mark.slow
class TestKept:
    def test_progress_only_grows(self, done: tuple[Path, list[Row], list[tuple[float, Row | None]]]) -> None:
        shares = [share for share, _ in done[2]]
        assert shares == sorted(shares)
        assert shares[-1] == pytest.approx(1.0)
        assert [row for _, row in done[2] if row is not None] == [row for row in done[1] if not row["variant"]]

    def test_what_is_finished_is_not_done_again(self, out: Path, rows: list[Row]) -> None:
        again, reported = run(PLAN, out)
        assert again == [row for row in rows if row["seed"] == 0]  # times included
        assert reported == []

    def test_more_seeds_can_be_asked_for(self, rows: list[Row], tmp_path: Path) -> None:
        plan = replace(SEEDS, methods=("mbc-dmp",))
        first, _ = run(replace(plan, seeds=1), tmp_path)
        both, reported = run(plan, tmp_path)
        assert [row["seed"] for _, row in reported if row is not None] == [1]
        assert both[0] == first[0]
        expected = [r for r in rows if r["method"] == "mbc-dmp" and not r["variant"]]
        assert [figures(row) for row in both] == [figures(row) for row in expected]

    def test_an_interrupted_search_goes_on_from_its_checkpoint(self, rows: list[Row], tmp_path: Path) -> None:
        plan = replace(PLAN, methods=("mbc-dmp",), seeds=1, ablations=False)

        def stop(share: float, row: Row | None) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            prepare(plan, tmp_path, keep=True, prepared=lambda name: None).perform(1, stop)
        folder = tmp_path / "runs" / plan.runs[0].folder
        assert {p.name for p in folder.iterdir()} == {"checkpoint.npz"}
        resumed, reported = run(plan, tmp_path)
        assert len(reported) == 2  # the second iteration, and the row
        expected = next(r for r in rows if r["method"] == "mbc-dmp" and not r["variant"])
        assert figures(resumed[0]) == figures(expected)

    def test_a_finished_run_of_another_controller_is_not_taken_for_this_one(self, out: Path, tmp_path: Path) -> None:
        plan = replace(PLAN, methods=("mbc",), ablations=False)
        run(plan, tmp_path)
        with pytest.raises(OutputError, match="a finished run of another controller"):
            run(replace(plan, settings=replace(TINY, config="paper")), tmp_path)

    def test_a_damaged_row_is_said_to_be_one(self, tmp_path: Path) -> None:
        (tmp_path / "row.json").write_text('{"motion": "tr')
        with pytest.raises(OutputError, match=r"row\.json: cannot be read"):
            finished_row(tmp_path)

    def test_a_motion_that_is_no_clip_cannot_be_ablated(self, tmp_path: Path, out: Path) -> None:
        plan = replace(PLAN, motions=(str(out / "motions" / "trot.npz"),))
        with pytest.raises(ConfigError, match="--ablations need the clip"):
            run(plan, tmp_path)

    def test_a_motion_that_does_not_repeat_is_optimised_over_the_whole_of_it(self, tmp_path: Path) -> None:
        once = replace(load_motion("trot"), cycle=None)
        once.save(tmp_path / "once.npz")
        plan = ComparisonPlan(TINY, (str(tmp_path / "once.npz"),), ("mbc-dmp",), seeds=1, ablations=False)
        (row,), _ = run(plan, tmp_path / "out")
        assert row["evaluation_s"] == pytest.approx((once.n_samples - 1) / once.rate_hz)
        assert row["evaluations"] > 0
        assert row["style_distance_realised"] is not None, "it ran to its end"

    def test_a_motion_that_ends_is_evaluated_to_its_end(self, tmp_path: Path) -> None:
        once = replace(load_motion("trot"), cycle=None)
        once.save(tmp_path / "once.npz")
        whole = (once.n_samples - 1) / once.rate_hz
        for seconds in (0.8, 0.1):
            settings = replace(TINY, evaluation_s=seconds, perturbed_episodes=3)
            plan = ComparisonPlan(settings, (str(tmp_path / "once.npz"),), ("mbc",), seeds=1, ablations=False)
            (row,), _ = run(plan, tmp_path / f"out-{seconds:g}")
            lasted = min(seconds, whole)
            assert row["evaluation_s"] == pytest.approx(lasted)
            assert row["simulated_s"] == pytest.approx(whole + lasted * (1 + 3))
            found = evaluate(once, episodes=4, duration_s=lasted, seed=20230617).rollout
            assert row["reward_mean_perturbed"] == pytest.approx(found.reward[1:].mean())


@pytest.mark.slow
class TestFolder:
    def test_everything_is_written(self, out: Path) -> None:
        figures = {"comparison.png", "tracking.png", "ablations.png"}
        assert {p.name for p in out.iterdir()} == {
            *figures, "results.csv", "table.md", "ablations.md", "runs", "motions",
        }  # fmt: skip
        assert all((out / name).read_bytes().startswith(PNG) for name in figures)

    def test_the_csv_holds_the_rows(self, out: Path, rows: list[Row]) -> None:
        with (out / "results.csv").open(newline="") as file:
            found = list(csv.DictReader(file))
        assert list(found[0]) == list(COLUMNS)
        assert [float(r["reward_mean"]) for r in found] == [r["reward_mean"] for r in rows]
        assert found[0]["style_distance"] == ""

    def test_the_optimised_motion_is_kept_with_its_run(self, out: Path, rows: list[Row]) -> None:
        motion = Motion.load(out / "runs" / "trot-mbc-dmp-seed1" / "motion.npz")
        assert motion.demonstration is not None
        saved = json.loads((out / "runs" / "trot-mbc-dmp-seed1" / "row.json").read_text())
        assert saved in rows

    def test_a_smaller_comparison_leaves_nothing_of_the_larger_one(self, rows: list[Row], tmp_path: Path) -> None:
        folder = ComparisonFolder.at(tmp_path)
        (tmp_path / "ablations.md").write_text("old")
        plan = replace(PLAN, methods=("raibert", "mbc"), ablations=False)
        write_comparison(folder, plan, rows[:2])
        assert {p.name for p in tmp_path.iterdir()} == {"results.csv", "table.md", "comparison.png"}

    def test_what_is_kept_stays_in_all_tables_and_figures(self, out: Path, rows: list[Row], tmp_path: Path) -> None:
        copy = shutil.copytree(out, tmp_path / "copy")
        plan = replace(PLAN, methods=("lh",), seeds=1, ablations=False)
        prepared = prepare(plan, copy, keep=True, prepared=lambda name: None)
        assert prepared.tasks == ()
        assert len(prepared.kept) == len(rows) - 1
        write_comparison(ComparisonFolder.at(copy), plan, prepared.finished())
        for name in ("results.csv", "table.md", "ablations.md"):
            assert (copy / name).read_text() == (out / name).read_text()
        assert {p.name for p in copy.iterdir()} == {p.name for p in out.iterdir()}

    def test_a_kept_run_of_another_motion_than_it_says_is_refused(self, out: Path, tmp_path: Path) -> None:
        copy = shutil.copytree(out, tmp_path / "copy")
        shutil.copy(copy / "motions" / "trot-raw.npz", copy / "motions" / "trot.npz")
        plan = replace(PLAN, motions=("pace",), methods=("mbc",), ablations=False)
        with pytest.raises(OutputError, match="a finished run of another controller, motion"):
            prepare(plan, copy, keep=True, prepared=lambda name: None)
        assert prepare(plan, copy, keep=False, prepared=lambda name: None).kept == ()

    def test_unfinished_ablations_say_so(self, out: Path, rows: list[Row], tmp_path: Path) -> None:
        copy = shutil.copytree(out, tmp_path / "copy")
        write_comparison(ComparisonFolder.at(copy), PLAN, rows[:-1])
        expected = sum(row["method"] == "mbc-dmp" for row in rows)
        assert f"Unfinished: {expected - 1} of {expected} runs." in (copy / "ablations.md").read_text()
        assert "Unfinished" not in (copy / "table.md").read_text()


@pytest.mark.slow
class TestTables:
    def test_means_and_deviations_over_the_seeds(self, rows: list[Row]) -> None:
        found = {(s.method, s.variant): s for s in summaries(rows)}
        own = [r["reward_mean"] for r in rows if (r["method"], r["variant"]) == ("mbc-dmp", "")]
        assert found["mbc-dmp", ""].mean("reward_mean") == pytest.approx(np.mean(own))
        assert found["mbc-dmp", ""].std("reward_mean") == pytest.approx(abs(own[0] - own[1]) / np.sqrt(2))
        assert found["mbc", ""].std("reward_mean") is None
        assert [s.method for s in found.values() if not s.variant] == list(PAPER_METHODS)

    def test_the_comparison_has_a_line_a_method_and_the_papers_numbers_in_none(self, rows: list[Row]) -> None:
        own = [r for r in rows if not r["variant"]]
        text = comparison_table(own, len(own))
        lines = [line for line in text.splitlines() if line.startswith("| `trot`")]
        assert [line.split(" | ")[1] for line in lines] == ["Raibert", "MBC", "LH", "MBC-DMP", "LH-DMP"]
        assert f"**{own[1]['reward_mean']:.3f}**" in lines[1]
        assert "±" in lines[3].split(" | ")[2]
        assert not any("0.803" in line for line in lines)
        assert "not a row of ours" in text
        assert "Unfinished" not in text
        assert "over 2 seeds of CMA-ES, 2 iterations of 4 candidates" in text

    def test_an_unfinished_one_says_so(self, rows: list[Row]) -> None:
        assert "Unfinished: 1 of 7 runs." in comparison_table(rows[:1], 7)

    def test_different_numbers_of_seeds_are_said(self, rows: list[Row]) -> None:
        own = [r for r in rows if not r["variant"] and (r["method"], r["seed"]) != ("lh-dmp", 1)]
        assert "over 1 to 2 seeds of CMA-ES" in comparison_table(own, len(own))

    def test_the_ablations_are_held_against_the_method(self, rows: list[Row]) -> None:
        own = [r for r in rows if r["method"] == "mbc-dmp"]
        lines = [line for line in ablation_table(own, len(own)).splitlines() if line.startswith("| `trot`")]
        assert [line.split(" | ")[1] for line in lines] == ["mbc-dmp, as it is", *PLAN.variants]
        base = np.mean([r["reward_mean"] for r in own if not r["variant"]])
        first = np.mean([r["reward_mean"] for r in own if r["variant"] == PLAN.variants[0]])
        assert lines[1].split(" | ")[3] == f"{first - base:+.3f}"
