"""Gait planner: a state machine per leg over contact schedule and measured contact (paper, §III-B1 and its figure).

A leg leaves stance when the schedule says so (take-off), or when it has been unloaded for a while in scheduled stance
(early take-off). It enters stance when the schedule says so (touch-down), or when it meets the ground in scheduled
swing (early touch-down). Two switches of a leg are at least `min_switch_time` apart.
"""

from typing import Any

from fastmimic.base.jit import inlined


@inlined
def plan_leg(config: Any, memory: Any, leg: int, wanted: bool, force_z: float) -> bool:
    """Advances one leg by one control step; True if it has just lifted off. `wanted` is the scheduled stance, `force_z`
    the measured vertical ground force in N; `memory` is changed."""
    loaded = force_z > config.contact_threshold
    memory.since_switch[leg] += config.dt
    free = force_z < config.release_threshold
    memory.unloaded_time[leg] = memory.unloaded_time[leg] + config.dt if free else 0.0
    if config.planner_full == 0:
        stood = memory.stance[leg] == 1
        if wanted != stood:
            _switch(memory, leg, 1 if wanted else 0)
        return stood and not wanted
    least = config.recovery_switch_time if memory.recovering > 0 else config.min_switch_time
    may_switch = memory.since_switch[leg] >= least
    if memory.stance[leg] == 1:
        if loaded:
            memory.was_loaded[leg] = 1
        lost = memory.was_loaded[leg] == 1 and memory.unloaded_time[leg] >= config.early_takeoff_time
        if wanted:
            memory.early[leg] = 0
            leave = lost
        else:
            # after an early touch-down the leg stands until the schedule agrees, unless it comes free again
            leave = lost or memory.early[leg] == 0
        if leave and may_switch:
            _switch(memory, leg, 0)
            return True
    elif may_switch and (wanted or loaded):
        if not wanted:
            memory.early[leg] = 1
            memory.early_touchdowns += 1
        _switch(memory, leg, 1)
    return False


@inlined
def _switch(memory: Any, leg: int, stance: int) -> None:
    memory.stance[leg] = stance
    memory.since_switch[leg] = 0.0
    memory.was_loaded[leg] = 0
    if stance == 0:
        memory.early[leg] = 0
