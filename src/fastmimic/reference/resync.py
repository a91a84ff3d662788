"""Re-synchronises the controller's clock after a push (`RecoveryConfig`). While the robot's velocity differs from the
reference, the reference's origin moves to the robot, so that swing feet are placed for balance. The clock may run
slower or faster, and then returns to the demonstration's time."""

from typing import Any

import numpy as np

from fastmimic.base.jit import inlined, kernel
from fastmimic.reference.table import advance_clock


@kernel
def advance_recovering(config: Any, clocks: Any, tables: Any, observations: Any) -> None:
    """One control step of the clocks (n,) of `CLOCK`; same as `advance_clocks` for robots that are not in recovery.
    `config` (1,) is the packed controller configuration, `observations` (n,) the controllers' input (`OBSERVATION`);
    robot i follows table min(i, k − 1) of `tables` (k, t) of `SAMPLE`."""
    for i in range(clocks.shape[0]):
        table = tables[min(i, tables.shape[0] - 1)]
        _advance(config[0], clocks[i], table, observations[i])


@inlined
def _advance(config: Any, clock: Any, table: Any, obs: Any) -> None:
    ref = table[clock.sample]
    c, s = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    error = np.hypot(
        c * ref.lin_vel[0] - s * ref.lin_vel[1] - obs.lin_vel[0],
        s * ref.lin_vel[0] + c * ref.lin_vel[1] - obs.lin_vel[1],
    )
    clock.recovering = 1 if error > (config.recovery_end if clock.recovering == 1 else config.recovery_start) else 0
    rate = 1.0
    if clock.recovering == 1:
        rate = config.recovery_rate
    elif clock.lag > 0.5:
        rate = 1.0 - config.recovery_catch_up
    elif clock.lag < -0.5:
        rate = 1.0 + config.recovery_catch_up
    clock.fraction += rate
    clock.lag += rate - 1.0
    while clock.fraction >= 1.0 - 1e-9:
        clock.fraction -= 1.0
        advance_clock(clock, table.shape[0], obs.root_pos[0], obs.root_pos[1], table)
    if clock.recovering == 1:
        root = table[clock.sample].root_pos
        c, s = np.cos(clock.origin[2]), np.sin(clock.origin[2])
        x = obs.root_pos[0] - (clock.origin[0] + c * root[0] - s * root[1])
        y = obs.root_pos[1] - (clock.origin[1] + s * root[0] + c * root[1])
        clock.origin[0] += config.recovery_resync * x
        clock.origin[1] += config.recovery_resync * y
        clock.jump += config.recovery_resync * np.hypot(x, y)
