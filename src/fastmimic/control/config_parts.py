"""The parameters of each part of the controller; `fastmimic.control.config` joins them.

Forces are multiples of the robot's weight, and gains of the trunk act on accelerations and angles: neither depends on
the robot. The rest has the values of an A1 and is scaled to another robot (`fastmimic.robot.robot`): joint gains by
what the joints move, R by the mass squared, lengths by the leg.
"""

from dataclasses import dataclass
from typing import Final, Literal

from fastmimic.base.configuration import documented, parameter

Vector6 = tuple[float, float, float, float, float, float]
Vector3 = tuple[float, float, float]

MAX_HORIZON_STEPS: Final = 20


@documented
@dataclass(frozen=True)
class GaitConfig:
    """Which leg stands and which swings (paper, §III-B1)."""

    planner: Literal["schedule", "full"] = parameter(
        "full",
        choices=("schedule", "full"),
        key="planner_full",
        about="full: state machine over schedule and measured contact; schedule: the motion's schedule alone",
    )
    contact_threshold: float = parameter(
        0.3, unit="weights", scale="weight", about="vertical force above which a foot counts as loaded"
    )
    release_threshold: float = parameter(
        0.02, unit="weights", scale="weight", about="vertical force below which a loaded foot counts as free again"
    )
    min_switch_time: float = parameter(0.1, unit="s", about="least time between two switches of a leg")
    early_takeoff_time: float = parameter(
        0.04, unit="s", about="time without load after which a standing leg counts as lifted off"
    )
    step_reach: tuple[float, float] = parameter(
        (0.3, 0.15),
        unit="m",
        scale="length",
        above=0.0,
        about="how far from the reference's a foothold can be, forwards and sideways: feet make haste if the capture"
        " point would be farther off at the next touch-down (Khadiv et al. 2020)",
    )
    least_step_time: float = parameter(0.05, unit="s", above=0.0, about="that this touch-down is brought forward to")
    most_haste: float = parameter(0.5, about="greatest haste, share of the reference's own rate; 0 for none")
    follow_ground: bool = parameter(
        True,
        about="the reference follows the plane through the footholds; feet are lifted on rough ground",
    )
    ground_time: float = parameter(0.3, unit="s", above=0.0, about="time constant with which this plane is followed")
    rough_lift: float = parameter(
        3.0, about="feet swing so many times higher than the footholds are off the plane, at most"
    )
    recovery_steps: bool = parameter(
        True,
        about="trot for some steps where the next foot, on one side, cannot reach the capture point",
    )
    recovery_reach: tuple[float, float, float] = parameter(
        (0.33, 0.22, 0.055),
        unit="m",
        scale="length",
        above=0.0,
        about="that reach, forwards and sideways, and how much less it is across to the other side, and more to the"
        " foot's own",
    )
    recovery_top_speed: float = parameter(
        1.8, unit="m/s", above=0.0, about="mean speed of a motion above which it has no such trot"
    )
    recovery_switch_time: float = parameter(0.03, unit="s", about="least time between two switches of a leg meanwhile")


@documented
@dataclass(frozen=True)
class StanceConfig:
    """Forces of the standing legs (paper, eq. 1 and 2). Axes: x, y, z, roll, pitch, yaw in the heading frame."""

    forces: Literal["instant", "horizon"] = parameter(
        "instant",
        choices=("instant", "horizon"),
        key="horizon",
        about="instant: QP over the present forces; horizon: model predictive control (HorizonConfig)",
    )
    feedback: Literal["regulator", "constant"] = parameter(
        "regulator",
        choices=("regulator", "constant"),
        key="",
        about="regulator: gains along the motion (RegulatorConfig); constant: those below, as in the paper",
    )
    position_gain: Vector6 = parameter((40.0, 40.0, 300.0, 600.0, 600.0, 600.0), unit="1/s²", key="", about="k_p")
    velocity_gain: Vector6 = parameter((20.0, 20.0, 35.0, 75.0, 75.0, 75.0), unit="1/s", key="", about="k_d")
    acceleration_weight: Vector6 = parameter((1.0, 1.0, 1.0, 1.0, 1.0, 1.0), key="", about="diagonal of Q")
    disturbance_time: float = parameter(
        0.5,
        unit="s",
        about="time constant with which the acceleration that the model does not explain is estimated, such as a"
        " payload's, and made up for; 0 for never",
    )
    reference_acceleration: float = parameter(
        1.0, about="factor on the reference's own acceleration in the desired one; 0 in the paper"
    )
    leg_momentum: bool = parameter(
        True,
        about="feed-forward of what the legs' motion and the body's turning take from the ground; not in the paper,"
        " whose legs have no mass",
    )
    acceleration_limit: Vector6 = parameter(
        (15.0, 15.0, 25.0, 150.0, 150.0, 150.0),
        unit="m/s² and rad/s²",
        about="bound on each component of the desired acceleration",
    )
    force_weight: float = parameter(
        1e-4, unit="1/N²", above=0.0, key="r_weight", scale="force_weight", about="diagonal of R for an A1"
    )
    friction: float = parameter(0.6, above=0.0, key="mu", about="friction coefficient μ that the controller assumes")
    friction_sides: int = parameter(
        8,
        choices=(4, 8),
        about="sides of the pyramid in place of each foot's friction cone; the edges of 4 reach √2 times as far as"
        " the sides, those of 8 reach 1.08 times as far",
    )
    min_force: float = parameter(0.02, unit="weights", scale="weight", about="least force of each standing foot")
    max_force: float = parameter(3.0, unit="weights", scale="weight", about="greatest force of each standing foot")
    adaptation: Literal["off", "paper", "full"] = parameter(
        "full",
        choices=("off", "paper", "full"),
        about="low-gain joint feedback towards where the foot will be: full with the body's turning, paper without it"
        " (eq. 2), or off",
    )
    joint_stiffness: float = parameter(
        30.0, unit="N·m/rad", key="stance_kp", scale="joint", about="of that feedback, for an A1"
    )
    joint_damping: float = parameter(
        2.5, unit="N·m·s/rad", key="stance_kd", scale="joint", about="of that feedback, for an A1"
    )
    leg_dynamics: bool = parameter(
        True, key="stance_dynamics", about="add the torques that carry and accelerate the leg itself"
    )


@documented
@dataclass(frozen=True)
class HorizonConfig:
    """Convex model predictive control (Di Carlo et al. 2018), used where `StanceConfig.forces` is "horizon". Axes: x,
    y, z, roll, pitch, yaw in the heading frame. Forces are multiples of the weight, so the weights do not depend on the
    robot's mass. Friction and the bounds on f_z are those of `StanceConfig`."""

    steps: int = parameter(
        10, low=1, high=MAX_HORIZON_STEPS, key="horizon_steps", about="number of the horizon's steps"
    )
    step_s: float = parameter(0.03, unit="s", above=0.0, key="horizon_step_s", about="length of a step")
    solve_rate_hz: float = parameter(
        50.0,
        unit="Hz",
        above=0.0,
        key="",
        about="how often forces are planned. Below the controller's rate the stance QP tracks the plan in between; at"
        " the controller's rate the planned forces are applied directly",
    )
    position_weight: Vector6 = parameter(
        (100.0, 100.0, 1000.0, 1000.0, 1000.0, 30.0),
        unit="1/m² and 1/rad²",
        key="horizon_position_weight",
        about="of the squared position and orientation error at the end of each step",
    )
    velocity_weight: Vector6 = parameter(
        (2.0, 2.0, 0.5, 0.02, 0.02, 1.0),
        unit="s²/m² and s²/rad²",
        key="horizon_velocity_weight",
        about="of the squared linear and angular velocity error",
    )
    force_weight: float = parameter(
        1e-2, above=0.0, key="horizon_force_weight", about="of each squared force, in multiples of the weight"
    )


@documented
@dataclass(frozen=True)
class SwingConfig:
    """Feet in the air (paper, eq. 3)."""

    foothold: Literal["regulator", "reference", "raibert"] = parameter(
        "regulator",
        choices=("reference", "raibert", "regulator"),
        key="foothold",
        about="regulator: the reference's foot, shifted as the regulator asks for; reference: shifted by K, as in the"
        " paper; raibert: a straight path at constant speed to the Raibert foothold 0.5 T_s v − K (v̄ − v) from under"
        " the hip, independent of the animal (Kang et al. 2021; paper, §IV-B)",
    )
    velocity_feedback: tuple[float, float] = parameter(
        (0.03, 0.03), unit="s", low=None, about="K in x and y (paper, eq. 3)"
    )
    joint_stiffness: float = parameter(120.0, unit="N·m/rad", key="swing_kp", scale="joint", about="for an A1")
    joint_damping: float = parameter(3.5, unit="N·m·s/rad", key="swing_kd", scale="joint", about="for an A1")
    leg_dynamics: bool = parameter(
        True, key="swing_dynamics", about="feed-forward of the leg's inverse dynamics along the reference"
    )
    level: float = parameter(
        1.0,
        about="follow the reference foot relative to gravity and ground (1), or to the trunk at its present tilt"
        " (0, as in the paper)",
    )
    liftoff_blend_time: float = parameter(
        0.03, unit="s", key="blend_time", about="time over which the foot's offset from the reference at lift-off fades"
    )
    swing_time: float = parameter(
        0.2,
        unit="s",
        above=0.0,
        about="T_s of the Raibert path. The paper does not give it; this is the swing of the code that it builds on"
        " (0.3 s of stance at a duty factor of 0.6)",
    )
    swing_height: float = parameter(
        0.05,
        unit="m",
        scale="length",
        about="apex of the Raibert path for an A1, for all motions and legs. The code that the paper builds on lifts"
        " 0.1 m, which fell more often in trials",
    )


@documented
@dataclass(frozen=True)
class LoadConfig:
    """A payload that the controller knows of."""

    mass: float = parameter(0.0, unit="kg", about="on the trunk")
    position: Vector3 = parameter((0.0, 0.0, 0.0), unit="m", low=None, about="of its centre, body frame")
