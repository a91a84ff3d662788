"""The parameters of each part of the controller; `fastmimic.control.config` joins them.

Forces are multiples of the robot's weight, and gains of the trunk act on accelerations and angles: neither depends on
the robot. The rest has the values of an A1 and is scaled to another robot (`fastmimic.robot.robot`): joint gains by
what the joints move, R by the mass squared, lengths by the leg.
"""

from dataclasses import dataclass
from typing import Final, Literal

from fastmimic.base.configuration import tabulated

Vector6 = tuple[float, float, float, float, float, float]
Vector3 = tuple[float, float, float]

MAX_HORIZON_STEPS: Final = 20


@tabulated
@dataclass(frozen=True)
class GaitConfig:
    """Which leg stands and which swings (paper, §III-B1)."""

    planner: Literal["schedule", "full"] = "full"
    contact_threshold: float = 0.3
    release_threshold: float = 0.02
    min_switch_time: float = 0.1
    early_takeoff_time: float = 0.04
    step_reach: tuple[float, float] = (0.3, 0.15)
    least_step_time: float = 0.05
    most_haste: float = 0.5
    follow_ground: bool = True
    ground_time: float = 0.3
    rough_lift: float = 3.0
    recovery_steps: bool = True
    recovery_reach: tuple[float, float, float] = (0.33, 0.22, 0.055)
    recovery_top_speed: float = 1.8
    recovery_switch_time: float = 0.03


@tabulated
@dataclass(frozen=True)
class StanceConfig:
    """Forces of the standing legs (paper, eq. 1 and 2). Axes: x, y, z, roll, pitch, yaw in the heading frame."""

    forces: Literal["instant", "horizon"] = "instant"
    feedback: Literal["regulator", "constant"] = "regulator"
    position_gain: Vector6 = (40.0, 40.0, 300.0, 600.0, 600.0, 600.0)
    velocity_gain: Vector6 = (20.0, 20.0, 35.0, 75.0, 75.0, 75.0)
    acceleration_weight: Vector6 = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    disturbance_time: float = 0.5
    reference_acceleration: float = 1.0
    leg_momentum: bool = True
    acceleration_limit: Vector6 = (15.0, 15.0, 25.0, 150.0, 150.0, 150.0)
    force_weight: float = 1e-4
    friction: float = 0.6
    friction_sides: int = 8
    min_force: float = 0.02
    max_force: float = 3.0
    adaptation: Literal["off", "paper", "full"] = "full"
    joint_stiffness: float = 30.0
    joint_damping: float = 2.5
    leg_dynamics: bool = True


@tabulated
@dataclass(frozen=True)
class HorizonConfig:
    """Convex model predictive control (Di Carlo et al. 2018), used where `StanceConfig.forces` is "horizon". Axes: x,
    y, z, roll, pitch, yaw in the heading frame. Forces are multiples of the weight, so the weights do not depend on the
    robot's mass. Friction and the bounds on f_z are those of `StanceConfig`."""

    steps: int = 10
    step_s: float = 0.03
    solve_rate_hz: float = 50.0
    position_weight: Vector6 = (100.0, 100.0, 1000.0, 1000.0, 1000.0, 30.0)
    velocity_weight: Vector6 = (2.0, 2.0, 0.5, 0.02, 0.02, 1.0)
    force_weight: float = 1e-2


@tabulated
@dataclass(frozen=True)
class SwingConfig:
    """Feet in the air (paper, eq. 3)."""

    foothold: Literal["regulator", "reference", "raibert"] = "regulator"
    velocity_feedback: tuple[float, float] = (0.03, 0.03)
    joint_stiffness: float = 120.0
    joint_damping: float = 3.5
    leg_dynamics: bool = True
    level: float = 1.0
    liftoff_blend_time: float = 0.03
    swing_time: float = 0.2
    swing_height: float = 0.05


@tabulated
@dataclass(frozen=True)
class LoadConfig:
    """A payload that the controller knows of."""

    mass: float = 0.0
    position: Vector3 = (0.0, 0.0, 0.0)
