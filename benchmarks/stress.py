"""What the motions withstand: the table of docs/robustness.md.

    python benchmarks/stress.py [--motions dog:pace …] [--methods mbc raibert] [--disturbances push …]
                                [--episodes 20] [--duration 6] [--out runs/robustness] [--write]

`fastmimic stress` for each motion, in a folder of its own below `--out`; what is finished there is kept and not run
again. Motions of the dog need `fastmimic data fetch`, or FASTMIMIC_DATA. `--write` puts the tables between the markers
in docs/robustness.md.
"""

import argparse
import sys
from pathlib import Path

from marked import put

from fastmimic.cli import main as fastmimic
from fastmimic.experiments.compare import PAPER_MOTIONS
from fastmimic.experiments.comparison_run import slug
from fastmimic.runs.work_folder import ENVIRONMENT, TABLE

DOCS = Path(__file__).resolve().parent.parent / "docs"
METHODS = ["mbc", "raibert"]
DISTURBANCES = ["friction", "payload", "push", "side-push"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=list(PAPER_MOTIONS))
    parser.add_argument("--methods", nargs="+", default=METHODS)
    parser.add_argument("--disturbances", nargs="+", default=DISTURBANCES)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--duration", type=float, default=6.0)
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("runs/robustness"))
    parser.add_argument("--write", action="store_true", help="put the tables into docs/robustness.md")
    args = parser.parse_args()
    tables = []
    for motion in args.motions:
        out = args.out / slug(motion)
        given = {"--episodes": args.episodes, "--duration": args.duration, "--iterations": args.iterations}
        options = [str(word) for pair in given.items() for word in pair]
        options += ["--disturbances", *args.disturbances]
        resume = ["--resume"] if (out / ENVIRONMENT).is_file() else []
        status = fastmimic(["stress", motion, "--methods", *args.methods, *options, "--out", str(out), *resume])
        if status:
            sys.exit(status)
        tables.append((out / TABLE).read_text(encoding="utf-8").strip())
    if args.write:
        command = f"python benchmarks/stress.py --motions {' '.join(args.motions)} --methods {' '.join(args.methods)}"
        command += f" --disturbances {' '.join(args.disturbances)}"
        command += f" --episodes {args.episodes} --duration {args.duration:g} --iterations {args.iterations}"
        put(DOCS / "robustness.md", "stress", "\n\n".join([f"`{command}`", *tables]))


if __name__ == "__main__":
    main()
