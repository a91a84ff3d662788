"""The controller's parameters: one set for all motions and all robots.

Gains of the trunk act on accelerations and angles, so they do not depend on the robot's mass or size; forces and
thresholds are given as multiples of the robot's weight. What is left has the values of an A1 and becomes another
robot's by two ratios: R by that of the masses squared, as a force moves a heavy trunk less; gains of joints by that of
what the joints have to move, so that legs answer with the same frequency and damping.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.base.jit import record_dtype
from fastmimic.robot import Robot

Vector6 = tuple[float, float, float, float, float, float]
Vector3 = tuple[float, float, float]

ADAPTATIONS: Final = ("off", "paper", "full")
PLANNERS: Final = ("schedule", "full")
FOOTHOLDS: Final = ("reference", "raibert")
FORCES: Final = ("instant", "horizon")
MAX_HORIZON_STEPS: Final = 20
FRICTION_SIDES: Final = (4, 8)
REFERENCE_MASS: Final = 12.453000000000001
"""Of the robot whose values R and the gains of joints have, kg: an A1's to the last bit, so that nothing is rounded."""
REFERENCE_JOINT_INERTIA: Final = 0.037411360960741595
"""The mean of its `joint_inertia`, kg·m²."""


@dataclass(frozen=True)
class GaitConfig:
    """Which leg stands and which swings (paper, §III-B1).

    Attributes:
        planner: "full" for the state machine over schedule and measured contact, "schedule" for the schedule alone.
        contact_threshold: vertical force above which a foot counts as loaded, fraction of the weight.
        release_threshold: below which a loaded foot counts as free again, likewise.
        min_switch_time: least time between two switches of a leg, s.
        early_takeoff_time: time without load after which a standing leg counts as lifted off, s.
    """

    planner: Literal["schedule", "full"] = "full"
    contact_threshold: float = 0.3
    release_threshold: float = 0.02
    min_switch_time: float = 0.1
    early_takeoff_time: float = 0.04


@dataclass(frozen=True)
class StanceConfig:
    """Forces of the standing legs (paper, eq. 1 and 2). Axes: x, y, z, roll, pitch, yaw in the heading frame.

    Attributes:
        forces: "instant" for the QP over the present forces, "horizon" for model predictive control ahead of it
            (`HorizonConfig`).
        position_gain: k_p, 1/s².
        velocity_gain: k_d, 1/s.
        foothold_share: share of the x and y position error that is measured relative to where the standing feet are,
            the rest relative to the world; 0 in the paper.
        foothold_preview: s for which a foot has to go on standing, by the schedule, to count in full there: before a
            foot leaves the ground the body has to be over those that stay.
        reference_acceleration: factor on the reference's own acceleration in ẍ_des; 0 in the paper.
        leg_momentum: feed-forward of what the legs' own motion and the body's turning take from the ground, so that the
            forces move the whole robot along the reference; not in the paper, whose legs weigh nothing.
        acceleration_limit: bound on each component of ẍ_des, m/s² and rad/s².
        acceleration_weight: diagonal of Q.
        force_weight: diagonal of R, 1/N² relative to Q, for a robot as heavy as an A1; see the head of this file.
        friction: μ that the controller assumes.
        friction_sides: of the pyramid that stands for each foot's cone of friction: 4, whose edges lie √2 as far out as
            its sides, or 8, whose edges lie 1.08 as far out.
        standing_inertia: an angular acceleration beyond the reference's is given the moment that it takes while the
            standing feet stay where they are (`fastmimic.control.inertia`), and not that of a rigid body.
        min_force, max_force: of each standing foot, multiples of the weight.
        adaptation: low-gain joint feedback towards where the foot will be: "full" with the turning of the body,
            "paper" without it (eq. 2), "off".
        joint_stiffness, joint_damping: of that feedback, N·m/rad and N·m·s/rad, for an A1's legs; see the head of
            this file.
        leg_dynamics: add the torques that carry and accelerate the leg itself.
    """

    forces: Literal["instant", "horizon"] = "instant"
    position_gain: Vector6 = (150.0, 150.0, 300.0, 600.0, 600.0, 600.0)
    velocity_gain: Vector6 = (25.0, 25.0, 35.0, 75.0, 75.0, 75.0)
    foothold_share: float = 1.0
    foothold_preview: float = 0.6
    reference_acceleration: float = 1.0
    leg_momentum: bool = True
    acceleration_limit: Vector6 = (15.0, 15.0, 25.0, 150.0, 150.0, 150.0)
    acceleration_weight: Vector6 = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    force_weight: float = 1e-4
    friction: float = 0.6
    friction_sides: int = 4
    standing_inertia: bool = False
    min_force: float = 0.02
    max_force: float = 3.0
    adaptation: Literal["off", "paper", "full"] = "full"
    joint_stiffness: float = 30.0
    joint_damping: float = 2.5
    leg_dynamics: bool = True


_LATER: Final = ("friction_sides", "standing_inertia")  # left out of `as_dict` where they are as they were before


@dataclass(frozen=True)
class HorizonConfig:
    """Convex model predictive control (Di Carlo et al. 2018), in force where `StanceConfig.forces` is "horizon".

    Axes: x, y, z, roll, pitch, yaw in the heading frame. Motion and forces in multiples of the weight make the weights
    independent of the robot's mass. Friction and the bounds on f_z are the stance's.

    Attributes:
        steps: of the horizon.
        step_s: length of one, s.
        solve_rate_hz: how often the forces ahead are planned anew. Below the controller's rate the stance QP tracks the
            plan in between; at the controller's rate the planned forces are applied as they are.
        position_weight: of the squared position and orientation error at the end of each step, 1/m² and 1/rad².
        velocity_weight: of the squared linear and angular velocity error, s²/m² and s²/rad².
        force_weight: of each squared force, in multiples of the robot's weight.
    """

    steps: int = 10
    step_s: float = 0.03
    solve_rate_hz: float = 50.0
    position_weight: Vector6 = (100.0, 100.0, 1000.0, 1000.0, 1000.0, 30.0)
    velocity_weight: Vector6 = (2.0, 2.0, 0.5, 0.02, 0.02, 1.0)
    force_weight: float = 1e-2


@dataclass(frozen=True)
class SwingConfig:
    """Feet in the air (paper, eq. 3).

    Attributes:
        velocity_feedback: K in x and y, s. In x the standing feet can hold the body back or push it on; in y, on two
            feet, only the next step can.
        position_feedback: the same for the base's position error, a fraction of it; 0 in the paper.
        joint_stiffness, joint_damping: N·m/rad and N·m·s/rad, for an A1's legs; see the head of this file.
        leg_dynamics: feed-forward of the leg's inverse dynamics along the reference.
        level: follow the reference foot relative to gravity and the ground (1) or to the trunk as it happens to be
            inclined (0); the paper's form is 0.
        liftoff_blend_time: time over which the foot's offset from the reference at lift-off fades, s.
        foothold: "reference" for the reference's foot, as above; "raibert" for a path that takes nothing from the
            animal: straight, at constant speed, to the Raibert foothold 0.5 T_s v − K (v̄ − v) from under the hip (Kang
            et al. 2021, as the paper's §IV-B gives it).
        swing_time: T_s of that path, s. The paper does not give it; this is the swing of the code that it builds on
            (0.3 s of stance at a duty factor of 0.6).
        swing_height: apex of its parabola, m; for all motions and legs. The code that the paper builds on lifts 0.1 m,
            which fell more often in trials.
    """

    velocity_feedback: tuple[float, float] = (0.02, 0.07)
    position_feedback: float = 0.15
    joint_stiffness: float = 120.0
    joint_damping: float = 3.5
    leg_dynamics: bool = True
    level: float = 1.0
    liftoff_blend_time: float = 0.03
    foothold: Literal["reference", "raibert"] = "reference"
    swing_time: float = 0.2
    swing_height: float = 0.05


@dataclass(frozen=True)
class LoadConfig:
    """A payload that the controller knows of.

    Attributes:
        mass: on the trunk, kg.
        position: of its centre, body frame, m.
    """

    mass: float = 0.0
    position: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RecoveryConfig:
    """After a push: the controller's reference yields to the robot. Off, nothing of it is computed.

    The robot is in recovery from when its horizontal velocity is off by `start_error` until it is off by less than
    `end_error`, as the controller sees it. The reward goes on with the demonstration's own clock.

    Attributes:
        enabled: whether there is any.
        start_error, end_error: m/s.
        resync_time: time constant with which the reference's x and y go to the robot's meanwhile, s; 0 for at once.
        phase_rate: of the reference's clock meanwhile: 1 goes on, 0 waits.
        catch_up: share by which the clock then goes faster or slower until it is in step again.
        foothold_feedback: added to the swing feet's velocity feedback in x and y meanwhile, s.
    """

    enabled: bool = False
    start_error: float = 0.35
    end_error: float = 0.15
    resync_time: float = 0.02
    phase_rate: float = 1.0
    catch_up: float = 0.1
    foothold_feedback: tuple[float, float] = (0.0, 0.0)


def _horizon_checks(horizon: HorizonConfig, rate_hz: float, used: bool) -> tuple[tuple[bool, str], ...]:
    """What a horizon must satisfy, and what to say where it does not; its rates matter only where it is used."""
    weights = (*horizon.position_weight, *horizon.velocity_weight)
    ratio = rate_hz / horizon.solve_rate_hz if math.isfinite(horizon.solve_rate_hz) and horizon.solve_rate_hz > 0 else 0
    return (
        (
            isinstance(horizon.steps, int) and 1 <= horizon.steps <= MAX_HORIZON_STEPS,
            f"horizon.steps must be a whole number from 1 to {MAX_HORIZON_STEPS}, not {horizon.steps}",
        ),
        (
            not used or (math.isfinite(horizon.step_s) and horizon.step_s * rate_hz >= 1 - 1e-9),
            f"horizon.step_s must be at least one control step, {1 / max(rate_hz, 1e-9):g} s, not {horizon.step_s:g}",
        ),
        (
            not used or (ratio >= 1 - 1e-9 and abs(ratio - round(ratio)) < 1e-6),
            f"horizon.solve_rate_hz must be rate_hz = {rate_hz:g} or a whole fraction of it, not"
            f" {horizon.solve_rate_hz:g}",
        ),
        (len(horizon.position_weight) == 6, "horizon.position_weight must have six numbers"),
        (len(horizon.velocity_weight) == 6, "horizon.velocity_weight must have six numbers"),
        (
            all(math.isfinite(w) and w >= 0 for w in weights) and any(w > 0 for w in weights),
            "horizon.position_weight and velocity_weight must be finite, not negative and not all 0",
        ),
        (
            math.isfinite(horizon.force_weight) and horizon.force_weight > 0,
            "horizon.force_weight must be finite and positive",
        ),
    )


def _number_checks(config: "ControllerConfig") -> list[tuple[bool, str]]:
    """That every number is finite, and that none is negative that is a gain, a time, a share or a limit: all of them
    but the feedback of the swing feet, which may point either way."""
    found = []
    for part in ("", "gait", "stance", "swing", "load", "recovery"):
        settings = getattr(config, part) if part else config
        for field in dataclasses.fields(settings):
            value, name = getattr(settings, field.name), f"{part}.{field.name}" if part else field.name
            numbers = [v for v in (value if isinstance(value, tuple) else (value,)) if isinstance(v, int | float)]
            found.append((all(math.isfinite(v) for v in numbers), f"{name} must be finite"))
            if not field.name.endswith(("feedback", "position")):
                found.append((all(v >= 0 for v in numbers), f"{name} must not be negative"))
    return found


@dataclass(frozen=True)
class ControllerConfig:
    """All parameters of the controller.

    Attributes:
        rate_hz: control steps a second.
        joint_margin: distance from the joint limits that commanded positions keep, rad.
        robot: the only one that they are for; empty for parameters of all robots.
        load: a payload.
        recovery: what happens after a push.
    """

    name: str = "default"
    rate_hz: float = 500.0
    joint_margin: float = 0.01
    gait: GaitConfig = dataclasses.field(default_factory=GaitConfig)
    stance: StanceConfig = dataclasses.field(default_factory=StanceConfig)
    horizon: HorizonConfig = dataclasses.field(default_factory=HorizonConfig)
    swing: SwingConfig = dataclasses.field(default_factory=SwingConfig)
    robot: str = ""
    load: LoadConfig = dataclasses.field(default_factory=LoadConfig)
    recovery: RecoveryConfig = dataclasses.field(default_factory=RecoveryConfig)

    def __post_init__(self) -> None:
        checks = (
            *_number_checks(self),
            (self.rate_hz > 0, "rate_hz must be positive"),
            (self.gait.planner in PLANNERS, f"gait.planner must be one of {', '.join(PLANNERS)}"),
            (
                0 <= self.gait.release_threshold <= self.gait.contact_threshold,
                "gait.release_threshold must be in [0, contact_threshold]",
            ),
            (self.stance.forces in FORCES, f"stance.forces must be one of {', '.join(FORCES)}"),
            (self.stance.adaptation in ADAPTATIONS, f"stance.adaptation must be one of {', '.join(ADAPTATIONS)}"),
            (self.stance.friction > 0, "stance.friction must be positive"),
            (
                self.stance.friction_sides in FRICTION_SIDES,
                f"stance.friction_sides must be {' or '.join(map(str, FRICTION_SIDES))}",
            ),
            (self.stance.force_weight > 0, "stance.force_weight must be positive"),
            (0 <= self.stance.min_force < self.stance.max_force, "stance.min_force must be in [0, max_force)"),
            *_horizon_checks(self.horizon, self.rate_hz, self.stance.forces == "horizon"),
            (self.swing.foothold in FOOTHOLDS, f"swing.foothold must be one of {', '.join(FOOTHOLDS)}"),
            (self.swing.swing_time > 0, "swing.swing_time must be positive"),
            (
                self.recovery.end_error <= self.recovery.start_error,
                "recovery.end_error must not be above recovery.start_error",
            ),
            (self.recovery.phase_rate <= 2, "recovery.phase_rate must be at most 2"),
            (self.recovery.catch_up < 1, "recovery.catch_up must be below 1"),
            (len(self.load.position) == 3, "load.position must have three numbers"),
        )
        for ok, message in checks:
            if not ok:
                raise ConfigError(f"controller configuration '{self.name}': {message}")

    def as_dict(self) -> dict[str, Any]:
        """Nested plain values, JSON-serialisable. Parts that are not used are left out, so that parameters
        without them have the same values, and the same digest, as before there were such parts."""
        found = dataclasses.asdict(self)
        for name, unused in (("robot", ""), ("load", LoadConfig()), ("recovery", RecoveryConfig())):
            if getattr(self, name) == unused:
                del found[name]
        for field in _LATER:
            if getattr(self.stance, field) == getattr(StanceConfig(), field):
                del found["stance"][field]
        return found


def default_config() -> ControllerConfig:
    """The full controller with the project's gains."""
    return ControllerConfig()


def paper_config() -> ControllerConfig:
    """The paper's form: no feed-forward of accelerations or leg dynamics, eq. 2 and 3 as printed."""
    return ControllerConfig(
        name="paper",
        stance=StanceConfig(
            position_gain=(40.0, 40.0, 300.0, 600.0, 600.0, 600.0),
            velocity_gain=(20.0, 20.0, 35.0, 75.0, 75.0, 75.0),
            foothold_share=0.0,
            reference_acceleration=0.0,
            leg_momentum=False,
            adaptation="paper",
            leg_dynamics=False,
        ),
        swing=SwingConfig(
            velocity_feedback=(0.03, 0.03),
            position_feedback=0.0,
            leg_dynamics=False,
            level=0.0,
            liftoff_blend_time=0.0,
        ),
    )


def robust_config() -> ControllerConfig:
    """Ours for a robot that is not the model: the trunk turns over standing feet, and forces keep within what the floor
    has in any direction. In the simulator of the optimisation it is within 0.005 of ours."""
    return ControllerConfig(name="robust", stance=StanceConfig(standing_inertia=True, friction_sides=8))


CONFIGS: Final = {"default": default_config, "robust": robust_config, "paper": paper_config}


def controller_config(name: str) -> ControllerConfig:
    """Returns the configuration of that name, or that in a file (`.json`, see `fastmimic.control.config_file`).

    Raises:
        ConfigError: there is none, or the file cannot be read.
    """
    if name.endswith(".json"):
        from fastmimic.control.config_file import read_config

        return read_config(name)
    if name not in CONFIGS:
        raise ConfigError(
            f"unknown configuration '{name}'; there are {', '.join(CONFIGS)}, or a file"
            f" (.json){did_you_mean(name, CONFIGS)}"
        )
    return CONFIGS[name]()


_DTYPE = record_dtype(
    [
        ("dt", "f8"),
        ("joint_margin", "f8"),
        ("planner_full", "i8"),
        ("contact_threshold", "f8"),
        ("release_threshold", "f8"),
        ("min_switch_time", "f8"),
        ("early_takeoff_time", "f8"),
        ("kp", "f8", (6,)),
        ("kd", "f8", (6,)),
        ("foothold_share", "f8"),
        ("foothold_preview", "f8"),
        ("reference_acceleration", "f8"),
        ("leg_momentum", "f8"),
        ("acceleration_limit", "f8", (6,)),
        ("q_weight", "f8", (6,)),
        ("r_weight", "f8"),
        ("mu", "f8"),
        ("friction_sides", "i8"),
        ("standing_inertia", "i8"),
        ("min_force", "f8"),
        ("max_force", "f8"),
        ("adaptation", "i8"),
        ("horizon", "i8"),
        ("horizon_steps", "i8"),
        ("horizon_step_s", "f8"),
        ("horizon_interval", "i8"),
        ("horizon_position_weight", "f8", (6,)),
        ("horizon_velocity_weight", "f8", (6,)),
        ("horizon_force_weight", "f8"),
        ("stance_kp", "f8"),
        ("stance_kd", "f8"),
        ("stance_dynamics", "f8"),
        ("velocity_feedback", "f8", (2,)),
        ("position_feedback", "f8"),
        ("swing_kp", "f8"),
        ("swing_kd", "f8"),
        ("swing_dynamics", "f8"),
        ("level", "f8"),
        ("blend_time", "f8"),
        ("raibert", "i8"),
        ("swing_time", "f8"),
        ("swing_height", "f8"),
        ("recovery_start", "f8"),
        ("recovery_end", "f8"),
        ("recovery_resync", "f8"),
        ("recovery_rate", "f8"),
        ("recovery_catch_up", "f8"),
        ("recovery_feedback", "f8", (2,)),
    ]
)


def stiffness_ratio(robot: Robot) -> float:
    """By which gains of joints are multiplied for a robot: what its joints have to move over what an A1's have to."""
    return float(np.mean(robot.joint_inertia)) / REFERENCE_JOINT_INERTIA


def pack_config(config: ControllerConfig, robot: Robot) -> NDArray[Any]:
    """The configuration for a robot, as a structured array of one record, for the kernels."""
    weight = robot.mass * GRAVITY
    stiffer = stiffness_ratio(robot)
    gait, stance, swing, horizon = config.gait, config.stance, config.swing, config.horizon
    record = np.zeros(1, _DTYPE)
    record["dt"] = 1.0 / config.rate_hz
    record["joint_margin"] = config.joint_margin
    record["planner_full"] = gait.planner == "full"
    record["release_threshold"] = gait.release_threshold * weight
    record["contact_threshold"] = gait.contact_threshold * weight
    record["min_switch_time"] = gait.min_switch_time
    record["early_takeoff_time"] = gait.early_takeoff_time
    record["kp"] = stance.position_gain
    record["kd"] = stance.velocity_gain
    record["foothold_share"] = stance.foothold_share
    record["foothold_preview"] = stance.foothold_preview
    record["reference_acceleration"] = stance.reference_acceleration
    record["leg_momentum"] = float(stance.leg_momentum)
    record["acceleration_limit"] = stance.acceleration_limit
    record["q_weight"] = stance.acceleration_weight
    record["r_weight"] = stance.force_weight * (REFERENCE_MASS / robot.mass) ** 2
    record["mu"] = stance.friction
    record["friction_sides"] = stance.friction_sides
    record["standing_inertia"] = stance.standing_inertia
    record["min_force"] = stance.min_force * weight
    record["max_force"] = stance.max_force * weight
    record["adaptation"] = ADAPTATIONS.index(stance.adaptation)
    record["horizon"] = FORCES.index(stance.forces)
    record["horizon_steps"] = horizon.steps
    record["horizon_step_s"] = horizon.step_s
    record["horizon_interval"] = round(config.rate_hz / horizon.solve_rate_hz)
    record["horizon_position_weight"] = horizon.position_weight
    record["horizon_velocity_weight"] = horizon.velocity_weight
    record["horizon_force_weight"] = horizon.force_weight
    record["stance_kp"] = stance.joint_stiffness * stiffer
    record["stance_kd"] = stance.joint_damping * stiffer
    record["stance_dynamics"] = float(stance.leg_dynamics)
    record["velocity_feedback"] = swing.velocity_feedback
    record["position_feedback"] = swing.position_feedback
    record["swing_kp"] = swing.joint_stiffness * stiffer
    record["swing_kd"] = swing.joint_damping * stiffer
    record["swing_dynamics"] = float(swing.leg_dynamics)
    record["level"] = swing.level
    record["blend_time"] = swing.liftoff_blend_time
    record["raibert"] = swing.foothold == "raibert"
    record["swing_time"] = swing.swing_time
    record["swing_height"] = swing.swing_height
    recovery = config.recovery
    record["recovery_start"] = recovery.start_error
    record["recovery_end"] = recovery.end_error
    record["recovery_resync"] = record["dt"] / max(recovery.resync_time, 1.0 / config.rate_hz)
    record["recovery_rate"] = recovery.phase_rate
    record["recovery_catch_up"] = recovery.catch_up
    record["recovery_feedback"] = recovery.foothold_feedback
    return record
