"""`fastmimic evaluate`: what a motion is worth under the controller."""

import json
from dataclasses import dataclass
from typing import Annotated, Any

from tyro.conf import Positional, arg

from fastmimic.commands.console import put, slow_start, table
from fastmimic.commands.options import MotionOptions, check_duration
from fastmimic.conventions import LEGS


@dataclass(frozen=True, kw_only=True)
class Evaluate(MotionOptions):
    """Runs episodes of a motion in simulation and scores them against its demonstration.

    Episode 0 starts at the motion's start, unperturbed; the others at a random phase, with joints off by up
    to 0.05 rad and the base's velocity by up to 0.1 m/s.
    """

    motion: Annotated[Positional[str], arg(metavar="MOTION")]
    """A robot motion (.npz), a clip, or a name of 'fastmimic motions'."""
    episodes: int = 1
    """How many."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """Length of each; by default 10, or the whole of a motion that does not repeat."""
    seed: int = 0
    """Of the perturbations."""
    method: Annotated[str, arg(metavar="NAME")] = "mbc"
    """Whose controller: raibert, mbc, lh; the motion is run as it is."""
    config: Annotated[str, arg(metavar="default|paper")] = "default"
    """The controller's parameters."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        """Prints the figures; returns the exit status."""
        if self.duration is not None:
            check_duration(self.duration)
        from fastmimic.pipeline import evaluate

        robot, motion = self.load(self.motion)
        with slow_start():
            evaluation = evaluate(
                motion,
                robot,
                episodes=self.episodes,
                duration_s=self.duration,
                seed=self.seed,
                method=self.method,
                config=self.config,
            )
        figures = evaluation.as_dict()
        if self.json:
            put(json.dumps(_finite(figures), allow_nan=False))
        else:
            for line in _lines(figures, robot.name):
                put(line)
        return 0


def _lines(figures: dict[str, Any], robot: str) -> list[str]:
    several = figures["episodes"] > 1
    spread = f" ± {figures['reward_std']:.3f}" if several else ""
    fell = f"{figures['fell']:.0%} of the episodes" if several else ("yes" if figures["fell"] else "no")
    clearance = ", ".join(
        f"{leg} {'–' if c is None else f'{1e3 * c:.0f}'}"
        for leg, c in zip(LEGS, figures["swing_clearance_m"], strict=True)
    )
    rows = [("reward", f"{figures['reward_mean']:.3f}{spread}")]
    rows += [(f"  {name.replace('_', ' ')}", f"{value:.3f}") for name, value in figures["components"].items()]
    rows += [
        ("fell", fell),
        ("swing clearance, mm", clearance),
        ("drift, m/s", f"{figures['drift_m_per_s']:.3f}"),
        ("early contacts, 1/s", f"{figures['early_contacts_per_s']:.1f}"),
        ("stance slip, mm", f"{1e3 * figures['stance_slip_m']:.1f}"),
        ("foot z rmse, mm", f"{1e3 * figures['foot_z_rmse_m']:.1f}"),
        ("foot x rmse, mm", f"{1e3 * figures['foot_x_rmse_m']:.1f}"),
    ]
    episodes = f"{figures['episodes']} episode{'s' if several else ''} of {figures['duration_s']:g} s"
    return [f"{figures['motion']} on {robot}, {episodes}", *table(rows)]


def _finite(figures: dict[str, Any]) -> dict[str, Any]:
    from fastmimic.report.run_folder import finite

    plain: dict[str, Any] = finite(figures)
    return plain
