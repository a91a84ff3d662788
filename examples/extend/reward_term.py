"""Adds a term to the reward: the trunk's height, which then counts in searches, tables and reports.

python examples/extend/reward_term.py [--fast]
FASTMIMIC_EXTENSIONS=examples/extend/reward_term.py fastmimic evaluate trot
"""

import sys
from typing import Any

import numpy as np

import fastmimic as fm


def height(demonstration: Any, observation: Any) -> Any:
    """1 where the trunk is as high as the demonstration's, for n robots at once, (n,)."""
    difference = observation["root_pos"][:, 2] - demonstration["root_pos"][:, 2]
    return np.exp(-500.0 * difference**2)


fm.REWARD_TERMS.register(fm.RewardTerm("height", weight=0.2, about="height of the trunk", function=height))

if __name__ == "__main__":
    seconds = 1.0 if "--fast" in sys.argv else 10.0
    evaluation = fm.evaluate("trot", "a1", duration_s=seconds).as_dict()
    print(f"reward {evaluation['reward_mean']:.3f}")
    for name, value in evaluation["components"].items():
        print(f"  {name:14} {value:.3f}")
