"""The table of docs/results.md: every listed motion on the A1, before and after optimisation, one configuration.

    python benchmarks/results.py [--motions dog:pace trot …] [--out runs/results] [--iterations N] [--write]

For each motion: optimise with the defaults, then score demonstration and optimised motion over 10 s,
against the animal's kinematic motion and against the executable one.

Finished motions are kept in `--out` and not run again. `--write` puts the table between the markers in docs/results.md.
Motions of the dog need `fastmimic data fetch`, or FASTMIMIC_DATA.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put

import fastmimic as fm
from fastmimic.base.files import replace_file
from fastmimic.episode.metrics import swing_clearance

CLAIMED = ("dog:pace", "dog:trot", "dog:right-turn", "anim:side-steps", "trot", "pace", "turn", "side-step")
REPORTED = (
    "dog:left-turn",
    "dog:spin",
    "dog:canter",
    "anim:turn",
    "anim:in-place",
    "walk",
    "bound",
    "backward-trot",
    "spin",
)
DURATION_S = 10.0
PAGE = Path(__file__).resolve().parent.parent / "docs/results.md"


def run(name: str, iterations: int | None, out: Path) -> dict[str, Any]:
    """One row, from `out` if it is there."""
    file = out / f"{name.replace(':', '_')}.json"
    if file.exists():
        return json.loads(file.read_text())
    print(f"{name} …", file=sys.stderr, flush=True)
    robot = fm.load_robot("a1")
    result = fm.imitate(name, robot, iterations=iterations, checkpoint=file.with_suffix(".checkpoint.npz"))
    before = fm.evaluate(result.demonstration, robot, duration_s=DURATION_S)
    after = fm.evaluate(result.motion, robot, duration_s=DURATION_S)
    perturbed = fm.evaluate(result.motion, robot, duration_s=DURATION_S, episodes=8)
    wanted = swing_clearance(result.demonstration, robot.foot_radius)
    result.motion.save(file.with_suffix(".npz"))
    retargeting = result.demonstration.provenance.as_dict()["retarget"]
    row = {
        "motion": name,
        "speed_m_per_s": float(np.linalg.norm(result.demonstration.root_lin_vel_w[:, :2].mean(axis=0))),
        "yaw_rate_rad_per_s": float(result.demonstration.root_ang_vel_w[:, 2].mean()),
        "before": before.as_dict(),
        "after": after.as_dict(),
        "perturbed": perturbed.as_dict(),
        "speed_share": retargeting["executable"]["speed_share"],
        "clearance_share_before": share(before.rollout.clearance[0], wanted),
        "clearance_share_after": share(after.rollout.clearance[0], wanted),
        "metrics": result.metrics(),
    }
    replace_file(file, lambda f: f.write(json.dumps(row, indent=1).encode()))
    return row


def share(clearance: np.ndarray, wanted: np.ndarray) -> float | None:
    """Least share of the demonstration's swing clearance over the legs; None where no leg swung."""
    ratio = clearance / wanted
    return float(np.nanmin(ratio)) if np.isfinite(ratio).any() else None


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [
        "| motion | speed, m/s (share) | turn, rad/s | against the animal: before | after | reward before | after"
        " | fell before / after | least clearance | drift, m/s | perturbed: against the animal, fell |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in rows:
        before, after, rough = r["before"], r["after"], r["perturbed"]
        clearance = "–" if r["clearance_share_after"] is None else f"{100 * r['clearance_share_after']:.0f} %"
        lines.append(
            f"| `{r['motion']}` | {r['speed_m_per_s']:.2f} ({r['speed_share']:.2f}) | {r['yaw_rate_rad_per_s']:+.2f}"
            f" | {before['reward_animal']:.3f} | **{after['reward_animal']:.3f}**"
            f" | {before['reward_mean']:.3f} | {after['reward_mean']:.3f}"
            f" | {yes(before['fell'])} / {yes(after['fell'])} | {clearance}"
            f" | {after['drift_m_per_s']:.2f} | {rough['reward_animal']:.3f}, {round(8 * rough['fell'])} of 8 |"
        )
    return "\n".join(lines)


def yes(fell: float) -> str:
    """Whether a single episode ended in a fall."""
    return "yes" if fell else "no"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="*", default=[*CLAIMED, *REPORTED])
    parser.add_argument("--out", type=Path, default=Path("runs/results"))
    parser.add_argument("--iterations", type=int, help="of CMA-ES; if left out until it gains nothing more")
    parser.add_argument("--write", action="store_true", help="put the table into docs/results.md")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    text = table([run(name, args.iterations, args.out) for name in args.motions])
    print(text)
    if args.write:
        put(PAGE, "results", text)


if __name__ == "__main__":
    main()
