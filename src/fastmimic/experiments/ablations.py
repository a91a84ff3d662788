"""Ablations of `mbc-dmp`: named variants without the paper's parts and without later additions."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from fastmimic.base.registry import Registry
from fastmimic.control.config import ControllerConfig, paper_config
from fastmimic.primitive.rhythmic import N_BASIS

ABLATED: Final = "mbc-dmp"


@dataclass(frozen=True)
class Ablation:
    """A variant of `ABLATED`, optimised and evaluated with its own `change` of the controller's configuration."""

    name: str
    summary: str
    change: Callable[[ControllerConfig], ControllerConfig] = lambda config: config
    consistent: bool = True  # whether retargeting makes the motion consistent (`RetargetConfig.consistent`)
    n_basis: int = N_BASIS  # basis functions of each DMP


def _with(part: str, **values: object) -> Callable[[ControllerConfig], ControllerConfig]:
    """Replaces parameters of a part of the controller, such as `stance`."""
    return lambda config: dataclasses.replace(config, **{part: dataclasses.replace(getattr(config, part), **values)})


_stance, _swing = partial(_with, "stance"), partial(_with, "swing")

_ABLATIONS = (
    Ablation("no-adaptation", "no joint feedback in stance (without eq. 2)", _stance(adaptation="off")),
    Ablation("paper-adaptation", "eq. 2 as printed, without the turning of the body", _stance(adaptation="paper")),
    Ablation("full-adaptation", "eq. 2 with the turning of the body", _stance(adaptation="full")),
    Ablation(
        "constant-gains",
        "the paper's k_p, k_d and K (eq. 1 and 3) in place of the regulator",
        lambda config: _swing(foothold="reference")(_stance(feedback="constant")(config)),
    ),
    Ablation("paper-footholds", "footholds shifted by K alone (eq. 3)", _swing(foothold="reference")),
    Ablation("no-step-timing", "feet step in the motion's own time, even after a push", _with("gait", most_haste=0.0)),
    Ablation("no-disturbance-estimate", "what the model does not explain is left", _stance(disturbance_time=0.0)),
    Ablation("no-state-machine", "legs switch by the schedule alone", _with("gait", planner="schedule")),
    Ablation(
        "raw-retargeting",
        "the scaled animal as it is, feet that slide and hover included; scored against itself",
        consistent=False,
    ),
    Ablation("paper-controller", "eq. 1 to 3 as printed: all additions below left out", lambda config: paper_config()),
    Ablation("no-leg-momentum", "forces for a body without legs", _stance(leg_momentum=False)),
    Ablation(
        "no-leg-dynamics",
        "legs get no torques of their own inverse dynamics",
        lambda config: _swing(leg_dynamics=False)(_stance(leg_dynamics=False)(config)),
    ),
    Ablation("no-reference-acceleration", "feedback alone accelerates the body", _stance(reference_acceleration=0.0)),
    Ablation("10-basis-functions", "DMPs of 10 basis functions", n_basis=10),
    Ablation("25-basis-functions", "DMPs of 25 basis functions", n_basis=25),
)

ABLATIONS: Final = Registry("ablation", _ABLATIONS)
"""All variants by name; the 100 basis functions of `MotionDmp` are the method itself."""


def ablations_of(config: ControllerConfig) -> tuple[Ablation, ...]:
    """The variants that differ from the method under a configuration, which may already include one of them."""
    return tuple(
        ablation
        for ablation in ABLATIONS.values()
        if ablation.change(config) != config or not ablation.consistent or ablation.n_basis != N_BASIS
    )


def ablation_named(name: str) -> Ablation:
    """The variant of that name; the method itself for an empty name. Raises `ConfigError` if there is none."""
    return ABLATIONS[name] if name else Ablation("", "")
