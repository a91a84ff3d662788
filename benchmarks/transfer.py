"""What the paper's motions are worth on a robot that they were not optimised on: the table of docs/robustness.md.

    python benchmarks/transfer.py [--motions dog:trot …] [--methods mbc mbc-dmp] [--trials 3] [--iterations 200]
                                  [--out runs/transfer] [--write]

`fastmimic transfer` in `--out`; what is finished there is kept and not run again. Motions of the dog need
`fastmimic data fetch`, or FASTMIMIC_DATA. `--write` puts the table between the markers in docs/robustness.md.
"""

import argparse
import sys
from pathlib import Path

from docs_table import put

from fastmimic.cli import main as fastmimic
from fastmimic.experiments.compare import PAPER_MOTIONS
from fastmimic.runs.work_folder import ENVIRONMENT, TABLE

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=list(PAPER_MOTIONS))
    parser.add_argument("--methods", nargs="+", default=["mbc", "mbc-dmp"])
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("runs/transfer"))
    parser.add_argument("--write", action="store_true", help="put the table into docs/robustness.md")
    args = parser.parse_args()
    given = ["--identify", "--trials", str(args.trials), "--iterations", str(args.iterations), "--out", str(args.out)]
    resume = ["--resume"] if (args.out / ENVIRONMENT).is_file() else []
    status = fastmimic(["transfer", *args.motions, "--methods", *args.methods, *given, *resume])
    if status:
        sys.exit(status)
    if args.write:
        command = f"fastmimic transfer {' '.join(args.motions)} --methods {' '.join(args.methods)}"
        command += f" --identify --trials {args.trials} --iterations {args.iterations}"
        table = (args.out / TABLE).read_text(encoding="utf-8").strip()
        put(PAGE, "transfer", f"`{command}`\n\n{table}")


if __name__ == "__main__":
    main()
