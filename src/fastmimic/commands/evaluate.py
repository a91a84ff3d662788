"""`fastmimic evaluate`: what a motion is worth under the controller."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError
from fastmimic.commands.console import put, slow_start, table
from fastmimic.commands.options import MotionOptions, check_duration, check_writable, policy_controller


@dataclass(frozen=True, kw_only=True)
class Evaluate(MotionOptions):
    """Runs episodes of a motion in simulation and scores them against its demonstration.

    Episode 0 starts at the motion's start, unperturbed; the others at a random phase, with joints off by up
    to 0.05 rad and the base's velocity by up to 0.1 m/s.
    """

    motion: Annotated[Positional[str], arg(metavar="MOTION")]
    """A robot motion (.npz), a clip, a name of 'fastmimic motions', or the folder of a run; or the log of a deployment,
    which is scored as it was."""
    episodes: int = 1
    """How many."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """Length of each; by default 10, or the whole of a motion that does not repeat."""
    seed: int = 0
    """Of the perturbations and the sensors' errors."""
    method: Annotated[str | None, arg(metavar="NAME")] = None
    """Whose controller: raibert, mbc, lh; by default that with which the motion was optimised, or mbc. The motion is
    run as it is."""
    config: Annotated[str | None, arg(metavar="default|robust|paper|FILE")] = None
    """The controller's parameters; by default those with which the motion was optimised, or "default"."""
    policy: Annotated[Path | None, arg(metavar="FILE")] = None
    """A trained policy (policy.npz of 'fastmimic train') in place of a method's controller."""
    observe: Annotated[str, arg(metavar="truth|sensors")] = "truth"
    """What the controller sees: the simulator's state, or an estimate from noisy, biased and late sensors."""
    simulator: Annotated[str, arg(metavar="mujoco|pybullet")] = "mujoco"
    """Where the robot is: the one that motions are optimised in, or another with the manufacturer's own description."""
    disturb: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=VALUE")] = ()
    """What is not as the controller expects, such as payload=2 (kg) or friction=0.4; may be given several times. An
    unknown NAME lists them all."""
    log: Annotated[Path | None, arg(metavar="FILE.npz")] = None
    """Write what the robot's own computer knew of episode 0, for 'fastmimic identify': readings, commands, estimates,
    no truth. Needs --observe sensors."""
    truth: Annotated[Path | None, arg(metavar="FILE")] = None
    """For the log of a deployment on 'fastmimic robot-sim --log FILE': what that robot really did."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        """Prints the figures; returns the exit status."""
        if self.duration is not None:
            check_duration(self.duration)
        from fastmimic.deploy.log import is_deployment_log

        if is_deployment_log(self.motion):
            return self._deployed()
        if self.truth is not None:
            raise ConfigError(f"--truth is for the log of a deployment, and {self.motion} is none")
        from fastmimic.imitation.imitate import evaluate
        from fastmimic.simulation.conditions import Conditions
        from fastmimic.simulation.disturbances import names_of, parse_disturbance

        conditions = Conditions(
            simulator=self.simulator,
            observe=self.observe,
            seed=self.seed,
            disturbances=tuple(parse_disturbance(text) for text in self.disturb),
        )
        if self.log is not None:
            check_writable(self.log, ".npz")
            if self.observe != "sensors":
                raise ConfigError("--log writes what a robot's sensors say; add --observe sensors")
        robot, motion = self.load(self.motion)
        controller = None if self.policy is None else policy_controller(self.policy, robot, motion)
        with slow_start():
            evaluation = evaluate(
                motion,
                robot,
                episodes=self.episodes,
                duration_s=self.duration,
                seed=self.seed,
                method=self.method,
                config=self.config,
                controller=controller,
                conditions=conditions,
                log=self.log is not None,
            )
        if self.log is not None:
            evaluation.run_log().save(self.log)
        figures = evaluation.as_dict()
        figures |= {
            "simulator": conditions.simulator,
            "disturbances": {d.name: d.values[0] for d in conditions.disturbances},
        }
        if self.json:
            put(json.dumps(_finite(figures), allow_nan=False))
        else:
            for line in _lines(figures, robot.name):
                put(line)
            if conditions.simulator != "mujoco" or conditions.disturbances:
                put(f"in {conditions.simulator}; disturbances: {names_of(conditions.disturbances) or 'none'}")
            if self.log is not None:
                put(f"log in {self.log}")
        return 0

    def _deployed(self) -> int:
        """The figures of a deployment, out of its log."""
        from fastmimic.commands.options import DEFAULT_ROBOT
        from fastmimic.control.config import ControllerConfig
        from fastmimic.deploy.log import DeploymentLog
        from fastmimic.deploy.robot_sim.ground_truth import load_ground_truth
        from fastmimic.deploy.scoring import evaluation_of, true_states
        from fastmimic.robot import ROBOT_NAMES, load_robot

        fields = {f.name: f for f in dataclasses.fields(self)}
        given = [
            n
            for n, f in fields.items()
            if n not in ("motion", "robot", "truth", "json") and getattr(self, n) != f.default
        ]
        if given:
            raise ConfigError(f"{self.motion} is the log of a deployment, which is over: leave out --{given[0]}")
        log = DeploymentLog.load(self.motion)
        if self.truth is not None:
            found = load_ground_truth(self.truth)
            log = dataclasses.replace(log, truth=true_states(log, found.observation, found.tick))
        name = str(log.meta.get("robot", DEFAULT_ROBOT))
        if self.robot is None and name not in ROBOT_NAMES:
            raise ConfigError(f"{self.motion}: of robot '{name}', which is not built in; give its MJCF by --robot")
        robot = load_robot(self.robot or name)
        config = ControllerConfig.from_dict(log.meta["config"])
        with slow_start():
            figures = evaluation_of(robot, log, config).as_dict()
        figures |= {"driver": log.meta["driver"], "result": log.meta["result"]}
        if self.json:
            put(json.dumps(_finite(figures), allow_nan=False))
            return 0
        whose = "the simulator's truth" if log.truth is not None else "the robot's own estimate"
        for line in _lines(figures, robot.name):
            put(line)
        put(f"deployed by driver '{log.meta['driver']}'; scored by {whose}")
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
    if "estimate_drift_percent" in figures:
        drift = figures["estimate_drift_percent"]
        rows += [
            ("estimate's drift", "–" if drift is None else f"{drift:.2f} % of the distance"),
            ("  velocity rmse, m/s", f"{figures['estimate_velocity_rmse_m_per_s']:.3f}"),
            ("  height rmse, mm", f"{1e3 * figures['estimate_height_rmse_m']:.1f}"),
            ("  tilt rmse, mrad", f"{1e3 * figures['estimate_tilt_rmse_rad']:.1f}"),
            ("  heading error, mrad", f"{1e3 * figures['estimate_heading_error_rad']:.1f}"),
        ]
    episodes = f"{figures['episodes']} episode{'s' if several else ''} of {figures['duration_s']:g} s"
    method = figures["method"] + (f" ({figures['config']})" if figures["config"] != "default" else "")
    return [f"{figures['motion']} on {robot} with {method}, {episodes}", *table(rows)]


def _finite(figures: dict[str, Any]) -> dict[str, Any]:
    from fastmimic.report.run_folder import finite

    plain: dict[str, Any] = finite(figures)
    return plain
