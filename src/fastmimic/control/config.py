"""The controller's parameters: one set for all motions and all robots.

Gains act on accelerations and angles, so they do not depend on the robot's mass or size; forces and thresholds
are given as multiples of the robot's weight.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from fastmimic.errors import ConfigError, did_you_mean
from fastmimic.jit import record_dtype

Vector6 = tuple[float, float, float, float, float, float]
Vector3 = tuple[float, float, float]

ADAPTATIONS: Final = ("off", "paper", "full")
PLANNERS: Final = ("schedule", "full")


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
        position_gain: k_p, 1/s².
        velocity_gain: k_d, 1/s.
        supported_gain: k_p and k_d of x and y, in place of those above, while three or more feet stand and the
            horizontal position can be controlled; on two feet it trades against the angle about their line.
        foothold_share: share of the x and y position error that is measured relative to where the standing feet are,
            the rest relative to the world; 0 in the paper.
        reference_acceleration: factor on the reference's own acceleration in ẍ_des; 0 in the paper.
        sway: share of the inverted pendulum's sway over the reference's footholds that is added to the reference; 0 in
            the paper.
        acceleration_limit: bound on each component of ẍ_des, m/s² and rad/s².
        acceleration_weight: diagonal of Q.
        force_weight: diagonal of R, 1/N² relative to Q.
        friction: μ that the controller assumes.
        min_force, max_force: of each standing foot, multiples of the weight.
        adaptation: low-gain joint feedback towards where the foot will be: "full" with the turning of the body,
            "paper" without it (eq. 2), "off".
        joint_stiffness, joint_damping: of that feedback, N·m/rad and N·m·s/rad.
        leg_dynamics: add the torques that carry and accelerate the leg itself.
    """

    position_gain: Vector6 = (40.0, 40.0, 300.0, 600.0, 600.0, 600.0)
    velocity_gain: Vector6 = (20.0, 20.0, 35.0, 75.0, 75.0, 75.0)
    supported_gain: tuple[float, float] = (100.0, 20.0)
    foothold_share: float = 1.0
    reference_acceleration: float = 1.0
    sway: float = 0.5
    acceleration_limit: Vector6 = (15.0, 15.0, 25.0, 150.0, 150.0, 150.0)
    acceleration_weight: Vector6 = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    force_weight: float = 1e-4
    friction: float = 0.6
    min_force: float = 0.02
    max_force: float = 3.0
    adaptation: Literal["off", "paper", "full"] = "full"
    joint_stiffness: float = 30.0
    joint_damping: float = 2.5
    leg_dynamics: bool = True


@dataclass(frozen=True)
class SwingConfig:
    """Feet in the air (paper, eq. 3).

    Attributes:
        velocity_feedback: K, s.
        sway: share of the inverted pendulum's sway that counts as the reference's in the feedback; 0 in the paper.
        settled_time: a foot that lifts off after all four have stood for this long takes a deliberate step: it goes to
            the reference's place in the world, without the feedback, which is that of a running gait; never in the
            paper. On two feet such a step has the stance's `supported_gain`.
        filter_time: time constant of the low-pass on v̄ − v before K, s; 0 in the paper. A gait that sways within each
            step would otherwise step wider with every sway.
        position_feedback: the same for the base's position error, a fraction of it; 0 in the paper.
        joint_stiffness, joint_damping: N·m/rad and N·m·s/rad.
        leg_dynamics: feed-forward of the leg's inverse dynamics along the reference.
        level: follow the reference foot relative to gravity and the ground (1) or to the trunk as it happens to be
            inclined (0); the paper's form is 0.
        liftoff_blend_time: time over which the foot's offset from the reference at lift-off fades, s.
    """

    velocity_feedback: float = 0.07
    sway: float = 0.5
    settled_time: float = 0.12
    filter_time: float = 0.03
    position_feedback: float = 0.15
    joint_stiffness: float = 120.0
    joint_damping: float = 3.5
    leg_dynamics: bool = True
    level: float = 1.0
    liftoff_blend_time: float = 0.03


@dataclass(frozen=True)
class ControllerConfig:
    """All parameters of the controller.

    Attributes:
        rate_hz: control steps a second.
        joint_margin: distance from the joint limits that commanded positions keep, rad.
    """

    name: str = "default"
    rate_hz: float = 500.0
    joint_margin: float = 0.01
    gait: GaitConfig = dataclasses.field(default_factory=GaitConfig)
    stance: StanceConfig = dataclasses.field(default_factory=StanceConfig)
    swing: SwingConfig = dataclasses.field(default_factory=SwingConfig)

    def __post_init__(self) -> None:
        checks = (
            (self.rate_hz > 0, "rate_hz must be positive"),
            (self.gait.planner in PLANNERS, f"gait.planner must be one of {', '.join(PLANNERS)}"),
            (
                0 <= self.gait.release_threshold <= self.gait.contact_threshold,
                "gait.release_threshold must be in [0, contact_threshold]",
            ),
            (self.gait.min_switch_time >= 0, "gait.min_switch_time must not be negative"),
            (self.stance.adaptation in ADAPTATIONS, f"stance.adaptation must be one of {', '.join(ADAPTATIONS)}"),
            (self.stance.friction > 0, "stance.friction must be positive"),
            (self.stance.force_weight > 0, "stance.force_weight must be positive"),
            (0 <= self.stance.min_force < self.stance.max_force, "stance.min_force must be in [0, max_force)"),
            (min(self.stance.acceleration_weight) >= 0, "stance.acceleration_weight must not be negative"),
            (self.swing.liftoff_blend_time >= 0, "swing.liftoff_blend_time must not be negative"),
            (self.swing.filter_time >= 0, "swing.filter_time must not be negative"),
        )
        for ok, message in checks:
            if not ok:
                raise ConfigError(f"controller configuration '{self.name}': {message}")

    def as_dict(self) -> dict[str, Any]:
        """Nested plain values, JSON-serialisable."""
        return dataclasses.asdict(self)


def default_config() -> ControllerConfig:
    """The full controller with the project's gains."""
    return ControllerConfig()


def paper_config() -> ControllerConfig:
    """The paper's form: no feed-forward of accelerations or leg dynamics, eq. 2 and 3 as printed."""
    return ControllerConfig(
        name="paper",
        stance=StanceConfig(
            supported_gain=(40.0, 20.0),
            foothold_share=0.0,
            reference_acceleration=0.0,
            sway=0.0,
            adaptation="paper",
            leg_dynamics=False,
        ),
        swing=SwingConfig(
            velocity_feedback=0.03,
            sway=0.0,
            settled_time=1e3,
            filter_time=0.0,
            position_feedback=0.0,
            leg_dynamics=False,
            level=0.0,
            liftoff_blend_time=0.0,
        ),
    )


CONFIGS: Final = {"default": default_config, "paper": paper_config}


def controller_config(name: str) -> ControllerConfig:
    """Returns the configuration of that name; raises `ConfigError` if there is none."""
    if name not in CONFIGS:
        raise ConfigError(
            f"unknown configuration '{name}'; there are {', '.join(CONFIGS)}{did_you_mean(name, CONFIGS)}"
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
        ("supported_gain", "f8", (2,)),
        ("foothold_share", "f8"),
        ("reference_acceleration", "f8"),
        ("acceleration_limit", "f8", (6,)),
        ("q_weight", "f8", (6,)),
        ("r_weight", "f8"),
        ("mu", "f8"),
        ("min_force", "f8"),
        ("max_force", "f8"),
        ("adaptation", "i8"),
        ("stance_sway", "f8"),
        ("swing_sway", "f8"),
        ("stance_kp", "f8"),
        ("stance_kd", "f8"),
        ("stance_dynamics", "f8"),
        ("velocity_feedback", "f8"),
        ("settled_time", "f8"),
        ("filter_gain", "f8"),
        ("position_feedback", "f8"),
        ("swing_kp", "f8"),
        ("swing_kd", "f8"),
        ("swing_dynamics", "f8"),
        ("level", "f8"),
        ("blend_time", "f8"),
    ]
)


def pack_config(config: ControllerConfig, weight: float) -> NDArray[Any]:
    """The configuration as a structured array of one record, for the kernels.

    Args:
        config: the parameters.
        weight: the robot's weight, N.
    """
    gait, stance, swing = config.gait, config.stance, config.swing
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
    record["supported_gain"] = stance.supported_gain
    record["foothold_share"] = stance.foothold_share
    record["reference_acceleration"] = stance.reference_acceleration
    record["acceleration_limit"] = stance.acceleration_limit
    record["q_weight"] = stance.acceleration_weight
    record["r_weight"] = stance.force_weight
    record["mu"] = stance.friction
    record["min_force"] = stance.min_force * weight
    record["max_force"] = stance.max_force * weight
    record["adaptation"] = ADAPTATIONS.index(stance.adaptation)
    record["stance_sway"] = stance.sway
    record["swing_sway"] = swing.sway
    record["stance_kp"] = stance.joint_stiffness
    record["stance_kd"] = stance.joint_damping
    record["stance_dynamics"] = float(stance.leg_dynamics)
    record["velocity_feedback"] = swing.velocity_feedback
    record["settled_time"] = swing.settled_time
    record["filter_gain"] = 1.0 / (1.0 + swing.filter_time * config.rate_hz)
    record["position_feedback"] = swing.position_feedback
    record["swing_kp"] = swing.joint_stiffness
    record["swing_kd"] = swing.joint_damping
    record["swing_dynamics"] = float(swing.leg_dynamics)
    record["level"] = swing.level
    record["blend_time"] = swing.liftoff_blend_time
    return record
