"""Errors and response of a made-up robot that follows its velocities exponentially."""

import numpy as np
import pytest

from fastmimic.robot.state import OBSERVATION
from fastmimic.steering.commands import CommandErrors

DT, LAG_S, SHORT = 0.002, 0.3, 0.9


def run(wanted: np.ndarray, heading: float) -> np.ndarray:
    """States (t,) whose velocity reaches 0.9 of that wanted, with a lag."""
    found = np.zeros(len(wanted), OBSERVATION)
    velocity = np.zeros(3)
    for state, target in zip(found, wanted, strict=True):
        velocity += (SHORT * target - velocity) * DT / LAG_S
        state["root_quat"] = [np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)]
        c, s = np.cos(heading), np.sin(heading)
        state["lin_vel"][:2] = c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]
        state["ang_vel"][2] = velocity[2]
    return found


def commands(*parts: tuple[float, tuple[float, float, float]]) -> np.ndarray:
    return np.concatenate([np.tile(velocity, (round(seconds / DT), 1)) for seconds, velocity in parts])


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_are_those_of_the_lag_and_the_missing_share(heading: float) -> None:
    wanted = commands((1.0, (0.0, 0.0, 0.0)), (4.0, (1.0, 0.0, 0.0)), (4.0, (1.0, 0.3, 1.5)))
    found = CommandErrors()
    found.add(run(wanted, heading), wanted, DT)
    assert found.velocity == pytest.approx([0.0, 0.1, np.hypot(0.1, 0.03)], abs=1e-3)
    assert found.yaw_rate == pytest.approx([0.0, 0.0, 0.15], abs=1e-3)
    reached = -LAG_S * np.log(1 - 0.63 / SHORT)  # of a lag; the mean over half a second adds up to half of that
    assert len(found.response_s) == 3
    assert all(reached < seconds < reached + 0.15 for seconds in found.response_s)
    assert found.as_dict()["velocity_error_m_s"] == pytest.approx(0.1, abs=1e-3)


def test_a_fall_and_a_moving_stick_do_not_count() -> None:
    wanted = commands((1.0, (0.5, 0.0, 0.0)), *((0.02, (0.5 + 0.01 * i, 0.0, 0.0)) for i in range(1, 20)))
    fell = np.zeros(len(wanted), bool)
    found = CommandErrors()
    found.add(run(wanted, 0.0), wanted, DT, fell)
    assert len(found.velocity) == 1
    fell[100] = True
    found = CommandErrors()
    found.add(run(wanted, 0.0), wanted, DT, fell)
    assert found.as_dict() == {"velocity_error_m_s": None, "yaw_rate_error_rad_s": None, "response_ms": None}
