"""What motions withstand that the controller does not know of: a load, the floor's friction, late motors, stiff joints.

    python benchmarks/stress.py [--robots a1 go2] [--motions dog:pace …] [--observe truth sensors] [--episodes 40]
                                [--json] [--write]

Each figure is that of `fastmimic evaluate MOTION --robot … --observe … --episodes 40 --disturb …`: the share of
episodes of 10 s without a fall, and the mean reward against the animal. Motions of the dog need `fastmimic data fetch`,
or FASTMIMIC_DATA. `--write` puts the table between the markers in docs/robustness.md.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from docs_table import put

import fastmimic as fm

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"
MOTIONS = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps", "trot", "walk")
DISTURBANCES = {
    "payload=5": "5 kg",
    "friction=0.4": "friction 0.4",
    "friction=1.2": "friction 1.2",
    "delay=0.008": "motors 8 ms late",
    "joint-friction=1": "joint friction 1 N·m",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["a1", "go2"])
    parser.add_argument("--motions", nargs="+", default=list(MOTIONS))
    parser.add_argument("--observe", nargs="+", default=["truth", "sensors"])
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/robustness.md")
    given = parser.parse_args()
    rows = []
    for observe in given.observe:
        for robot in given.robots:
            for motion in given.motions:
                of = {"robot": robot, "observe": observe, "motion": motion}
                rows.append({**of, "figures": withstood(robot, observe, motion, given.episodes)})
                print(rows[-1], file=sys.stderr, flush=True)
    text = table(rows, given.episodes)
    print(json.dumps({"rows": rows}, indent=1) if given.json else text)
    if given.write:
        put(PAGE, "stress", text)


def withstood(robot: str, observe: str, motion: str, episodes: int) -> dict[str, dict[str, float]]:
    """The share of episodes without a fall and the reward against the animal under each disturbance."""
    found = {}
    for disturbance in DISTURBANCES:
        as_text: Any = (disturbance,)
        conditions = fm.Conditions(observe=observe, disturbances=as_text)
        figures = fm.evaluate(motion, robot, conditions=conditions, episodes=episodes).as_dict()
        found[disturbance] = {"up": 1.0 - figures["fell"], "reward_animal": figures["reward_animal"]}
    return found


def table(rows: list[dict[str, Any]], episodes: int) -> str:
    """As Markdown."""
    lines = [f"| robot | observes | motion | {' | '.join(DISTURBANCES.values())} |"]
    lines.append("| --- " * (3 + len(DISTURBANCES)) + "|")
    for row in rows:
        cells = [f"{each['up']:.0%}, {each['reward_animal']:.2f}" for each in row["figures"].values()]
        lines.append(f"| {row['robot']} | {row['observe']} | `{row['motion']}` | {' | '.join(cells)} |")
    said = f"Share of {episodes} episodes of 10 s without a fall, and the mean reward against the animal."
    return "\n".join([*lines, "", said])


if __name__ == "__main__":
    main()
