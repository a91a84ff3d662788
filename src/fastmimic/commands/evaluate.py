"""`fastmimic evaluate` scores a motion under the controller; `fastmimic identify` learns from the log of a run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import OmitArgPrefixes, Positional

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError, LogError, naming
from fastmimic.base.progress import note, slow_start
from fastmimic.base.text import NONE, number
from fastmimic.commands import options as opt
from fastmimic.commands.console import put, put_json, put_table
from fastmimic.commands.show import check_truth, figure_rows, open_log, provenance, yes_no
from fastmimic.control.config import controller_config
from fastmimic.deploy.log import DeploymentLog, is_deployment_log
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.robot import load_robot
from fastmimic.simulation.conditions import Conditions
from fastmimic.simulation.simulators import FIRST_SIMULATOR

if TYPE_CHECKING:
    from fastmimic.identification.identify import Identification


@opt.command
class Evaluate:
    """Runs episodes of a motion in simulation and scores them against its demonstration."""

    motion: Annotated[Positional[str], opt.option("MOTION")]
    episodes: int = 1
    duration: opt.Seconds = None
    seed: int = 0
    robot: opt.RobotChoice = None
    method: opt.FoundMethod = None
    config: opt.FoundConfig = None
    policy: opt.PolicyFile = None
    observe: opt.Observation = "truth"
    foot_force: opt.FootForce = "auto"
    simulator: opt.Simulator = FIRST_SIMULATOR
    disturb: opt.Disturbances = ()
    terrain: opt.TerrainName = None
    ideal: opt.Ideal = False
    truth: Annotated[Path | None, opt.option("FILE")] = None
    json: opt.JsonFlag = False
    steered: Annotated[opt.SteeredBy, OmitArgPrefixes]
    clip: opt.ClipReading

    def run(self) -> None:
        opt.check_duration(self.duration)
        self.steered.check(self.motion == opt.STEER, others_steer=False)
        if is_deployment_log(self.motion):
            return self._deployed()
        check_truth(self.motion, self.truth)
        from fastmimic.imitation.evaluate import evaluate

        estimator = EstimatorConfig(foot_force=self.foot_force)
        conditions = opt.apply(Conditions, self, disturbances=opt.joined(self.disturb), estimator=estimator)
        if self.foot_force != "auto" and self.observe != "sensors":
            raise ConfigError("--foot-force is for a controller that sees sensors; add --observe sensors")
        if self.motion == opt.STEER:
            return self._steered(conditions)
        robot, motion = self.clip.load(self.motion, self.robot)
        controller = None if self.policy is None else opt.policy_controller(self.policy, robot, motion)
        with slow_start():
            given = {"source": motion, "robot": robot, "controller": controller, "conditions": conditions}
            evaluation = opt.apply(evaluate, self, **given, duration_s=self.duration)
        figures = evaluation.as_dict() | self._world(conditions)
        if self.json:
            return put_json(figures)
        note(provenance(motion))
        put_figures(figures | ({"drift_m_per_s": None} if motion.target.runs_once else {}), robot.name)
        put_world(conditions)

    def _world(self, conditions: Conditions) -> dict[str, Any]:
        disturbances = {d.name: d.values[0] for d in conditions.disturbances}
        return {"simulator": conditions.simulator, "disturbances": disturbances, "terrain": self.terrain}

    def _steered(self, conditions: Conditions) -> None:
        """Steers a robot by a script, as fast as it can be simulated."""
        from fastmimic.play.follow import SteeringFigures, follow
        from fastmimic.play.session import LiveSession
        from fastmimic.steering.commands import CommandScript

        if self.steered.commands is None:
            raise ConfigError("a simulation that does not wait for the clock takes velocities from --commands FILE.csv")
        for name in (*opt.given(self, "episodes", "method", "policy", "truth"), *opt.given(self.clip)):
            raise ConfigError(f"{name} is for a motion; leave it out to steer")
        if conditions.simulator != FIRST_SIMULATOR:
            raise ConfigError(f"a robot is steered in {FIRST_SIMULATOR} only, not in {conditions.simulator}")
        script, config = CommandScript(self.steered.commands), controller_config(self.config or "default")
        seconds = self.duration or script.end_s or 0.0
        if round(seconds * config.rate_hz) < 1:
            said = f"{self.steered.commands}: there is no control step in {seconds:g} s"
            raise ConfigError(f"{said}; give it a later last time, or a longer --duration")
        gaits = self.steered.gaits(self.robot)
        with slow_start():
            session = LiveSession(gaits.robot, {}, config=config, conditions=conditions, gaits=gaits)
            found = follow(session, script.velocity, seconds, SteeringFigures()).as_dict()
        if self.json:
            return put_json(found | {"motion": opt.STEER, "robot": gaits.robot.name} | self._world(conditions))
        put(f"{gaits.robot.name}, steered for {seconds:g} s by {self.steered.commands}")
        gait = ", ".join(f"{name} {share:.0%}" for name, share in found["share_of_time"].items())
        errors = f"{number(found['velocity_error_m_s'])} m/s, {number(found['yaw_rate_error_rad_s'])} rad/s"
        put_table(
            [
                ("falls", str(found["falls"])),
                ("way, m", number(found["way_m"], 1)),
                ("time", gait),
                ("velocities beyond the gaits", f"{found['commands_beyond_the_gaits']} of {found['commands']}"),
                ("velocity error, median", errors),
                ("response, median, ms", number(found["response_ms"], 0)),
            ]
        )
        put_world(conditions)

    def _deployed(self) -> None:
        """Scores a deployment from its log."""
        from fastmimic.deploy.deployment import evaluation_of

        robot, log = open_log(self, self.clip, "json", "clip", "steered")
        with slow_start():
            figures = evaluation_of(robot, log, log.facts.controller).as_dict()
        figures |= {"driver": log.facts.driver, "result": log.facts.result}
        if self.json:
            return put_json(figures)
        reference = "the simulator's ground truth" if log.truth is not None else "the robot's own estimate"
        put_figures(figures, robot.name)
        put(f"deployed by driver '{log.facts.driver}'; scored by {reference}")


def put_world(conditions: Conditions) -> None:
    """Prints where episodes ran, if not where motions are optimised."""
    if conditions.simulator != FIRST_SIMULATOR or conditions.disturbances or conditions.terrain is not None:
        said = f"in {conditions.simulator}; disturbances: {', '.join(map(str, conditions.disturbances)) or 'none'}"
        put(said if conditions.terrain is None else f"{said}; ground: {conditions.terrain}")


def put_figures(figures: dict[str, Any], robot: str) -> None:
    """Prints the figures of an evaluation."""
    several = figures["episodes"] > 1
    heights = zip(LEGS, figures["swing_clearance_m"], strict=True)
    clearance = ", ".join(f"{leg} {number(height, 0, 1e3)}" for leg, height in heights)
    rows = figure_rows(
        figures,
        reward=number(figures["reward_mean"]) + (f" ± {number(figures['reward_std'])}" if several else ""),
        fell=f"{figures['fell']:.0%} of the episodes" if several else yes_no(figures["fell"]),
        clearance=("swing clearance, mm", clearance),
    )
    if "estimate_drift_percent" in figures:
        drift = figures["estimate_drift_percent"]
        rows += [
            ("estimator drift", NONE if drift is None else f"{drift:.2f} % of the distance"),
            ("  velocity rmse, m/s", number(figures["estimate_velocity_rmse_m_per_s"])),
            ("  height rmse, mm", number(figures["estimate_height_rmse_m"], 1, 1e3)),
            ("  tilt rmse, mrad", number(figures["estimate_tilt_rmse_rad"], 1, 1e3)),
            ("  heading error, mrad", number(figures["estimate_heading_error_rad"], 1, 1e3)),
            ("  foot sensors in use", f"{figures['estimate_foot_sensors_share']:.0%}"),
        ]
    episodes = f"{figures['episodes']} episode{'s' if several else ''} of {figures['duration_s']:g} s"
    method = figures["method"] + (f" ({figures['config']})" if figures["config"] != "default" else "")
    put(f"{figures['motion']} on {robot} with {method}, {episodes}")
    put_table(rows)


@opt.command
class Identify:
    """Estimates the ground's friction and the trunk's payload from a deployment; the result holds for all motions."""

    log: Annotated[Positional[Path], opt.option("DEPLOYMENT")]
    robot: Annotated[str | None, opt.shared("NAME|FILE", "log's robot")] = None
    unloaded: Annotated[Path | None, opt.option("DEPLOYMENT")] = None
    config: opt.ConfigName = "default"
    out: Annotated[Path | None, opt.option("FILE.json")] = None

    def run(self) -> None:
        from fastmimic.identification.identify import identify

        if self.out is not None:
            opt.check_writable(self.out, ".json")
        config = controller_config(self.config)
        log = DeploymentLog.load(self.log).run_log()
        unloaded = None if self.unloaded is None else DeploymentLog.load(self.unloaded).run_log()
        robot = load_robot(self.robot or log.robot)
        with naming(self.log, LogError):
            found = identify(log, robot, unloaded)
        put(f"{log.motion} on {log.robot}, {log.duration_s:g} s")
        put_table(_identified(found, found.stance_friction(config), config.stance.friction))
        if self.out is not None:
            found.save(self.out, self.config)
            put(f"controller parameters in {self.out}; use them by --config {self.out}")


def _identified(found: "Identification", assumed: float, before: float) -> list[tuple[str, str]]:
    friction, payload = found.friction, found.payload
    if friction.value is None or friction.upper is None:
        said = f"at least {friction.lower:.2f}: no foot slid"
    else:
        interval = f"{friction.lower:.2f} to {friction.upper:.2f}"
        said = f"{friction.value:.2f} (95 %: {interval}), from {friction.slides} slides"
    changed = f"{before:g} as before" if assumed == before else f"{assumed:.2f} instead of {before:g}"
    rows = [("friction", said), ("  the controller assumes", changed)]
    if payload is None:
        return [*rows, ("payload", "unknown: the feet never stood long enough")]
    weighed = f"{payload.mass:.2f} kg (95 %: {payload.lower:.2f} to {payload.upper:.2f})"
    if not payload.tared:
        weighed += "; --unloaded with a deployment without payload narrows the interval"
    why = "the interval includes 0" if payload.upper >= 0 else "the robot is lighter than its model"
    taken = f"{payload.certain:.2f} kg" if payload.certain > 0 else f"no payload: {why}"
    return [*rows, ("payload", weighed), ("  the controller assumes", taken)]
