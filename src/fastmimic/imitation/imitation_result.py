"""The result of `imitate`: the optimised motion, its rollouts and its metrics."""

from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.machine import versions
from fastmimic.base.text import plain
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.metrics import Metrics, swing_clearance
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import History
from fastmimic.optimize.parameters import Parameter
from fastmimic.optimize.randomization import Randomization
from fastmimic.robot import Robot

_BEFORE_AND_AFTER: Final = ("early_contacts_per_s", "stance_slip_m", "foot_z_rmse_m", "foot_x_rmse_m", "qp_failures")


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A randomised search's result on held-out robots: one episode per robot from the motion's start, with the
    demonstration (`before`) and the optimised motion (`after`)."""

    randomization: Randomization
    before: Rollout
    after: Rollout

    def as_dict(self) -> dict[str, Any]:
        """Settings and results, JSON-serialisable."""
        return {
            **self.randomization.as_dict(),
            "held_out": {
                "robots": len(self.before.reward),
                "before": _over_robots(self.before),
                "after": _over_robots(self.after),
            },
        }


def _over_robots(rollout: Rollout) -> dict[str, float]:
    found = Metrics.of(rollout)
    return {"mean": found.reward_mean, "std": found.reward_std, "worst": found.reward_worst, "fell": found.fell}


@dataclass(frozen=True, eq=False, kw_only=True)
class Imitation:
    """An optimised motion and the course of its optimisation.

    Attributes:
        motion: the optimised motion, with its demonstration.
        before, after: one nominal episode of `duration_s` with the demonstration and with the optimised motion, logged.
        parameters: the optimised parameters, with bounds.
        values: (k,) their values, physical units.
        wall_s: total time, s; includes the time before a resume.
        held_out: results on other robots; None without randomisation.
    """

    motion: Motion
    robot: Robot
    method: str
    config: ControllerConfig
    before: Rollout
    after: Rollout
    parameters: tuple[Parameter, ...] = ()
    values: Array = field(default_factory=lambda: np.zeros(0))
    history: History | None = None
    seed: int
    duration_s: float
    evaluations: int = 0
    simulated_s: float
    iterations: int = 0
    wall_s: float
    interrupted: bool = False
    held_out: HeldOut | None = None

    @property
    def demonstration(self) -> Motion:
        """The demonstration that scores the robot."""
        return self.motion.target

    def metrics(self) -> dict[str, Any]:
        """All metrics of the run, JSON-serialisable; undefined ones (no swing, no step) are None."""
        before, after = Metrics.of(self.before), Metrics.of(self.after)

        def both(name: str) -> dict[str, Any]:
            return {"before": getattr(before, name), "after": getattr(after, name)}

        found = {
            "motion": self.motion.name,
            "robot": self.robot.name,
            "method": self.method,
            "config": self.config.name,
            "seed": self.seed,
            "duration_s": self.duration_s,
            "reward": {
                **both("reward_mean"),
                "components_before": before.components,
                "components_after": after.components,
            },
            **({"randomization": self.held_out.as_dict()} if self.held_out is not None else {}),
            "fell": both("fell_once"),
            "drift_m_per_s": both("drift_m_per_s"),
            "swing_clearance_m": {
                "demonstration": swing_clearance(self.demonstration, self.robot.foot_radius),
                **both("swing_clearance_m"),
            },
            **{name: both(name) for name in _BEFORE_AND_AFTER},
            "evaluations": self.evaluations,
            "iterations": self.iterations,
            "interrupted": self.interrupted,
            **({"segments": self._segments()} if self.demonstration.parts else {}),
            "wall_s": self.wall_s,
            "simulated_s": self.simulated_s,
            "realtime_factor": self.simulated_s / self.wall_s if self.wall_s > 0 else None,
            "parameters": [asdict(p) | {"value": float(v)} for p, v in zip(self.parameters, self.values, strict=True)],
            "versions": versions(),
        }
        return plain(found)

    def _segments(self) -> list[dict[str, Any]]:
        rate, found = self.demonstration.rate_hz, []
        segments = self.demonstration.provenance.stitched.segments
        for segment, *parts in zip(segments, self.before.parts, self.after.parts, strict=True):
            before, after = (Metrics.of(part) for part in parts)
            found.append(
                {
                    "motion": segment.name,
                    "cycles": segment.cycles,
                    "first_s": segment.first / rate,
                    "last_s": segment.last / rate,
                    "reward": {"before": before.reward_mean, "after": after.reward_mean},
                    "fell": {"before": before.fell_once, "after": after.fell_once},
                    "swing_clearance_m": {"before": before.swing_clearance_m, "after": after.swing_clearance_m},
                }
            )
        return found
