"""Adds two methods: the model-based controller with other parameters, and a controller of one's own.

python examples/extend/control_method.py [--fast]
FASTMIMIC_EXTENSIONS=examples/extend/control_method.py fastmimic evaluate trot --method stiff
"""

import dataclasses
import sys
from typing import Any

import fastmimic as fm
from fastmimic.control.controller import Controller


def stiff(config: Any) -> Any:
    """Swing legs with twice the stiffness."""
    swing = dataclasses.replace(config.swing, joint_stiffness=2 * config.swing.joint_stiffness)
    return dataclasses.replace(config, swing=swing)


class HalfTorque(Controller):
    """The model-based controller with half of its feed-forward torques."""

    def step(self, observation: Any, clocks: Any) -> Any:
        commands = super().step(observation, clocks)
        commands["torque"] *= 0.5
        return commands


fm.METHODS.register(fm.Method("stiff", "Stiff swing", "swing legs twice as stiff", change=stiff, color="#8e44ad"))
fm.METHODS.register(
    fm.Method("half", "Half torque", "half the torque", controller=lambda robot, m, n, c: HalfTorque(robot, [m], n, c))
)

if __name__ == "__main__":
    seconds = 1.0 if "--fast" in sys.argv else 10.0
    for method in ("mbc", "stiff", "half"):
        reward = fm.evaluate("trot", "a1", method=method, duration_s=seconds).rollout.reward[0]
        print(f"{fm.METHODS[method].label:12} {reward:.3f}")
