"""What each part of the controller is worth, without optimisation: variants of `mbc` on the README's motions.

    python benchmarks/ablations.py [--motions trot pace …] [--episodes 8] [--duration 10] [--write]

Each variant leaves one thing out (`fastmimic.experiments.ablations`); the motion and what it is scored against stay the
same. `fastmimic compare --ablations` does it with the motion optimised anew for each variant, which takes hours; this
takes minutes. `--write` puts the table between the markers in docs/method.md. Motions of the dog need `fastmimic data
fetch`, or FASTMIMIC_DATA.
"""

import argparse
import sys
from pathlib import Path

from docs_table import put

import fastmimic as fm
from fastmimic.control.config import ControllerConfig
from fastmimic.experiments.ablations import ABLATED, ablations_of

MOTIONS = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps", "trot", "pace", "turn", "side-step")
PAGE = Path(__file__).resolve().parent.parent / "docs" / "method.md"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="*", default=MOTIONS)
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--write", action="store_true", help="put the table into docs/method.md")
    args = parser.parse_args()
    robot, config = fm.load_robot("a1"), ControllerConfig()
    # what changes the motion, and not the controller, is another question
    changed = {a.name: a.change(config) for a in ablations_of(config) if a.consistent and a.n_basis is None}
    variants = {"the whole controller": config, **{f"`{name}`": c for name, c in changed.items()}}
    cells: dict[str, list[str]] = {name: [] for name in variants}
    for name in args.motions:
        print(f"{name} …", file=sys.stderr, flush=True)
        motion = fm.load_motion(name, robot)
        for variant, its in variants.items():
            found = fm.evaluate(motion, robot, episodes=args.episodes, duration_s=args.duration, config=its).rollout
            fell = int(found.fell.sum())
            cells[variant].append(f"{found.reward.mean():.3f}" + (f" ({fell} fell)" if fell else ""))
    lines = [
        f"| {ABLATED.removesuffix('-dmp')} | " + " | ".join(f"`{m}`" for m in args.motions) + " |",
        "| --- |" + " --- |" * len(args.motions),
        *(f"| {variant} | " + " | ".join(values) + " |" for variant, values in cells.items()),
        "",
        f"Mean reward over {args.episodes} episodes of {args.duration:g} s, one from the start and the others"
        " perturbed, and how many of them fell. A1, retargeted motions, not optimised.",
    ]
    text = "\n".join(lines)
    print(text)
    if args.write:
        put(PAGE, "ablations", text)


if __name__ == "__main__":
    main()
