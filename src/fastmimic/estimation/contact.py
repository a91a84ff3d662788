"""Which feet stand: the force sensors, whose offsets drift, and what the controller means the legs to do."""

from typing import Any

from fastmimic.base.jit import inlined


@inlined
def estimate_contact(config: Any, state: Any, leg: int, force: float, planned: bool) -> None:
    """Advances one foot's contact by one control step.

    The sensor's offset is learnt while the leg swings (the sensor cannot be told from its offset otherwise), and the
    rest goes through hysteresis. A foot bears the base's estimate if it is loaded and its leg is meant to stand: a
    loaded foot whose leg has begun to swing is being pulled away.

    Args:
        config: packed estimator configuration.
        state: the robot's `STATE` record, changed in place.
        leg: index.
        force: as measured, N.
        planned: whether the controller lets the leg stand.
    """
    state.swing_time[leg] = 0.0 if planned else state.swing_time[leg] + config.dt
    state.filtered[leg] += config.force_gain * (force - state.filtered[leg])
    load = state.filtered[leg] - state.tare[leg]
    if state.loaded[leg] == 1:
        if load < config.release_force:
            state.loaded[leg] = 0
    elif load > config.contact_force:
        state.loaded[leg] = 1
    if state.loaded[leg] == 0 and state.swing_time[leg] > config.tare_delay:
        state.tare[leg] += config.tare_gain * load
    state.force[leg] = max(load, 0.0) if state.loaded[leg] == 1 else 0.0
    bears = planned and state.loaded[leg] == 1
    state.stance_time[leg] = state.stance_time[leg] + config.dt if bears else 0.0
