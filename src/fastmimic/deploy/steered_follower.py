"""A steered robot's way from standing to standing: a field of gaits in the place of a motion."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.deploy.sequence import Follower, MotionSequence
from fastmimic.steering.gait_field import RATE_HZ, GaitField
from fastmimic.steering.steered import Steered

_STANDS_S: Final = 0.5  # before it sits down


class SteeredFollower(Follower):
    """The position in a sequence of standing, in whose middle the robot is steered. `commands` has the velocity (3,)
    wanted at a time since then, s: forwards, to the left, m/s, turning to the left, rad/s; None is as before. Once
    `leaving` is set the robot comes to stand."""

    steered = True

    def __init__(self, sequence: MotionSequence, gaits: GaitField, commands: Callable[[float], Array | None]) -> None:
        self._steered, self._commands = Steered(gaits), commands
        super().__init__(sequence)

    @property
    def text(self) -> str:
        return self._steered.state if self.in_motion else "standing"

    def enter_motion(self, pose: Array, passed: int = 0) -> None:
        self.in_motion, self.gains, self._stood = True, self._steered.gains[None], 0
        self._steered.put(*pose)
        self._show()

    def advance_motion(self, observation: NDArray[Any], memory: NDArray[Any]) -> bool:
        """A control step while it is steered; it ends in standing."""
        memory["lag"] = 0.0  # in haste, too, feet that stand keep their places
        wanted = np.zeros(3) if self.leaving else self._commands(self.steps / RATE_HZ)
        if wanted is not None:
            self.wanted = self._steered.steer(wanted)
        self._steered.advance(observation["root_pos"][0, :2], float(memory["haste"][0]))
        self._show()
        self._stood += int(self.leaving and self._steered.place["stands"][0] == 1.0)
        self.done = self._stood > _STANDS_S * RATE_HZ
        return False

    def _show(self) -> None:
        self._steered.fill(self.tables[0])
        self.clock["origin"] = self._steered.place["pose"]
