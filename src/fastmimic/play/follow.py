"""A steered robot that follows velocities as fast as it can be simulated, and how well."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.play.session import LiveSession
from fastmimic.steering.commands import CommandErrors


@dataclass
class SteeringFigures:
    """What came of commands: time simulated and in each gait, s, way, m, falls, the number of commands, and of those
    beyond the gaits, for which the nearest velocity was taken, and the errors."""

    seconds: float = 0.0
    gaits_s: dict[str, float] = field(default_factory=dict)
    way_m: float = 0.0
    falls: int = 0
    commands: int = 0
    beyond: int = 0
    errors: CommandErrors = field(default_factory=CommandErrors)

    def as_dict(self) -> dict[str, Any]:
        """JSON-serialisable."""
        return {
            "minutes": self.seconds / 60.0,
            "way_m": self.way_m,
            "share_of_time": {name: seconds / self.seconds for name, seconds in self.gaits_s.items()},
            "commands": self.commands,
            "commands_beyond_the_gaits": self.beyond,
            "falls": self.falls,
            **self.errors.as_dict(),
        }


def follow(
    session: LiveSession,
    velocity: Callable[[float], Array | None],
    seconds: float,
    found: SteeringFigures,
    go_on: Callable[[], bool] = lambda: True,
) -> SteeringFigures:
    """Steers a session by the velocity (3,) wanted at a time since now, s, None for the last one, for so many simulated
    seconds, or while `go_on`, asked after each control step, says so; adds what came of it to the figures. The errors
    are from the velocities wanted, whether the gaits have them or not."""
    begins, states, wanted, fell, last = session.steps, [], [], [], np.full(3, np.nan)
    for step in range(round(seconds * session.rate_hz)):
        new = velocity(step * session.dt)
        if new is not None and not np.array_equal(new, last):
            last = np.array(new, np.float64)
            found.beyond += bool(np.abs(session.steer(last) - last).max() > 1e-6)
            found.commands += 1
        falls, before = session.falls, session.observation["root_pos"][:2].copy()
        session.step()
        states.append(session.observation.copy())
        wanted.append(np.nan_to_num(last))
        fell.append(session.falls > falls)
        found.way_m += float(np.hypot(*(session.observation["root_pos"][:2] - before)))
        found.gaits_s[session.state] = found.gaits_s.get(session.state, 0.0) + session.dt
        if not go_on():
            break
    found.falls += sum(fell)
    found.seconds += (session.steps - begins) * session.dt
    found.errors.add(np.array(states), np.array(wanted), session.dt, np.array(fell))
    return found
