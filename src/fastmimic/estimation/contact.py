"""Contact estimation: which feet stand, from force sensors with drifting offsets and the controller's schedule."""

from typing import Any

from fastmimic.base.jit import inlined


@inlined
def estimate_contact(config: Any, state: Any, leg: int, force: float, planned: bool) -> None:
    """Advances one foot's contact by one control step; `force` is measured in N, `planned` means scheduled stance. The
    sensor's offset is learnt while the leg swings, as it cannot be told from a load otherwise; the rest goes through
    hysteresis. A foot bears the base's estimate if it is loaded in scheduled stance: a loaded foot in early swing is
    being pulled away."""
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
