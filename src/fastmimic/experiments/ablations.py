"""Ablations of `mbc-dmp`: named variants without the paper's parts and without later additions."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from fastmimic.base.configuration import changed
from fastmimic.base.files import packaged
from fastmimic.base.registry import Registry
from fastmimic.control.config import CONFIGS, ControllerConfig

ABLATED: Final = "mbc-dmp"


@dataclass(frozen=True)
class Ablation:
    """A variant of `ABLATED`, optimised and evaluated with its own changes of the controller's configuration."""

    name: str
    summary: str
    changes: Mapping[str, Any] = field(default_factory=dict)  # nested like the configuration
    paper: bool = False  # whether they are of the paper's configuration, in place of the given one
    consistent: bool = True  # whether retargeting makes the motion consistent (`RetargetConfig.consistent`)
    n_basis: int | None = None  # basis functions of each DMP

    def change(self, config: ControllerConfig) -> ControllerConfig:
        """The variant's configuration, in place of the method's."""
        return changed(CONFIGS["paper"] if self.paper else config, self.changes, self.name)


ABLATIONS: Final = Registry("ablation", packaged("fastmimic.experiments", "ablations.json", tuple[Ablation, ...]))
"""All variants by name; the 100 basis functions of `MotionDmp` are the method itself."""


def ablations_of(config: ControllerConfig) -> tuple[Ablation, ...]:
    """The variants that differ from the method under a configuration, which may already include one of them."""
    return tuple(
        ablation
        for ablation in ABLATIONS.values()
        if ablation.change(config) != config or not ablation.consistent or ablation.n_basis is not None
    )


def ablation_named(name: str) -> Ablation:
    """The variant of that name; the method itself for an empty name. Raises `ConfigError` if there is none."""
    return ABLATIONS[name] if name else Ablation("", "")
