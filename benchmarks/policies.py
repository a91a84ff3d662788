"""What a learned policy costs beside an optimised motion: the tables and the figure of docs/learning.md.

    python benchmarks/policies.py [--builtin | --motions dog:trot …] [--steps 1_000_000] [--seeds 1] [--slice 100_000]
                                  [--searches FOLDER …] [--transfers FOLDER …] [--trainings FOLDER …]
                                  [--out runs/policies] [--report] [--write]

Trains a policy for each motion and runs its transfer, by `fastmimic train` and `fastmimic transfer` in `--out`. The
motions learn in turn, a slice of steps each, so that they have had about the same number of steps whenever it is
stopped; the same command goes on, also for more steps. `--searches` are folders of `fastmimic compare` with the
methods mbc and mbc-dmp, `--transfers` those of `fastmimic transfer` with them; they are only read, and without them
`--out` gets its own. `--trainings` are reported as well. Motions of the dog need `fastmimic data fetch`, or
FASTMIMIC_DATA. `--report` trains nothing more. `--write` puts the tables between the markers in docs/learning.md; the
figure stays in `--out`.
"""

import argparse
import sys
from pathlib import Path

from docs_table import put
from learning_cost import (
    cost_table,
    paper_cost,
    read_evaluations,
    search_courses,
    training_course,
)
from learning_cost_figure import cost_figure

from fastmimic.cli import main as fastmimic
from fastmimic.experiments.compare import BUILT_IN_MOTIONS, PAPER_MOTIONS
from fastmimic.experiments.comparison_run import RUNS, Run, slug
from fastmimic.experiments.transfer import STAGES, all_trials, transfer_table
from fastmimic.learning.training import EVALUATIONS
from fastmimic.render.figure_style import save
from fastmimic.runs.work_folder import ENVIRONMENT, MOTION

DOCS = Path(__file__).resolve().parent.parent / "docs"
FIGURE = "policies.png"
SEARCHED = ("mbc", "mbc-dmp")


def run(*command: str) -> None:
    """One command of `fastmimic`; ends the program if it fails."""
    status = fastmimic(list(command))
    if status:
        sys.exit(status)


def steps_done(folder: Path) -> int:
    """Policy steps of the training in a folder."""
    return read_evaluations(folder)[-1].steps if (folder / EVALUATIONS).is_file() else 0


def train(args: argparse.Namespace) -> None:
    """A slice of each motion in turn, seed by seed, until all have their steps."""
    for seed in range(args.seeds):
        for upto in range(args.slice, args.steps + args.slice, args.slice):
            for motion in args.motions:
                folder = policy_folder(args.out, motion, seed)
                if steps_done(folder) >= min(upto, args.steps):
                    continue
                options = ["--resume"] if (folder / "checkpoint.pt").is_file() else []
                options += ["--steps", str(min(upto, args.steps)), "--seed", str(seed), "--threads", str(args.threads)]
                run("train", motion, *options, "--evaluate-every", str(args.evaluate_every), "--out", str(folder))


def policy_folder(out: Path, motion: str, seed: int) -> Path:
    """Where the training of a motion is."""
    return out / "policies" / slug(f"{motion}-seed{seed}")


def transfer(args: argparse.Namespace, trained: list[Path]) -> str:
    """The table of the policies' transfer beside that of the model-based methods, which `--transfers` or a run has."""
    rows = []
    for folder, course in zip(trained, (training_course(folder) for folder in trained), strict=True):
        out = args.out / "transfer" / f"{folder.name}-{course.row['steps']}"
        policy = ["--methods", "rl", "--policy", str(folder / "policy.npz")]
        run("transfer", course.row["motion"], *policy, "--out", str(out), *(["--resume"] if out.is_dir() else []))
        rows += all_trials(out)
    others = args.transfers
    if not others:
        others = [args.out / "transfer" / "model-based"]
        found = [args.searches[0] / RUNS / Run(motion, "mbc-dmp", "", 0).folder / MOTION for motion in args.motions]
        given = [*map(str, found), "--methods", *SEARCHED, "--out", str(others[0])]
        run("transfer", *given, *(["--resume"] if others[0].is_dir() else []))
    stages = {stage.name for stage in STAGES}
    known = [row for folder in others for row in all_trials(folder)]
    rows += [row for row in known if row["motion"] in args.motions and row["stage"] in stages]
    rows.sort(key=lambda row: args.motions.index(row["motion"]))
    return transfer_table(rows, 0)


def search(args: argparse.Namespace) -> Path:
    """The comparison of the searches that the trainings are put beside, and of the same motions without any."""
    folder: Path = args.out / "searches"
    given = ["--methods", *SEARCHED, "--seeds", str(args.seeds), "--iterations", str(args.iterations)]
    resume = ["--resume"] if (folder / ENVIRONMENT).is_file() else []
    run("compare", "--motions", *args.motions, *given, "--out", str(folder), *resume)
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=list(PAPER_MOTIONS))
    parser.add_argument("--builtin", action="store_true", help="trot, pace, turn and side-step, which need no data")
    parser.add_argument("--steps", type=int, default=1_000_000, help="policy steps of each motion and seed")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--slice", type=int, default=100_000, help="steps of a motion before it is the next one's turn")
    parser.add_argument("--evaluate-every", type=int, default=50_000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--iterations", type=int, default=200, help="of the searches, where they are run")
    parser.add_argument("--searches", nargs="+", type=Path, help="comparisons with mbc and mbc-dmp")
    parser.add_argument("--transfers", nargs="+", type=Path, help="transfers with mbc and mbc-dmp")
    parser.add_argument("--trainings", nargs="+", type=Path, default=[], help="trained elsewhere, reported as well")
    parser.add_argument("--out", type=Path, default=Path("runs/policies"))
    parser.add_argument("--report", action="store_true", help="of what is trained by now; train nothing more")
    parser.add_argument("--write", action="store_true", help="put tables and figure into docs/")
    args = parser.parse_args()
    if args.builtin:
        args.motions = list(BUILT_IN_MOTIONS)
    if not args.report:
        train(args)
    places = [policy_folder(args.out, motion, seed) for motion in args.motions for seed in range(args.seeds)]
    trained = [folder for folder in [*places, *args.trainings] if steps_done(folder)]
    if not trained:
        sys.exit(f"{args.out} holds no training yet")
    courses = [training_course(folder) for folder in trained]
    args.motions = list(dict.fromkeys([*args.motions, *(course.row["motion"] for course in courses)]))
    args.searches = args.searches or [search(args)]
    for folder in args.searches:
        courses += [course for method in SEARCHED for course in search_courses(folder, method, args.motions)]
    courses.sort(key=lambda course: args.motions.index(course.row["motion"]))
    save(cost_figure(courses, paper_cost(courses), "Learning beside optimising, a1"), args.out / FIGURE)
    tables = {"policies": cost_table(courses), "policies-transfer": transfer(args, trained)}
    for name, text in tables.items():
        (args.out / f"{name}.md").write_text(text, encoding="utf-8")
        print(text)
        if args.write:
            put(DOCS / "learning.md", name, text.strip())


if __name__ == "__main__":
    main()
