"""Settings of the optimal control problem: one set for all motions and robots."""

from dataclasses import dataclass

from fastmimic.base.configuration import tabulated


@tabulated
@dataclass(frozen=True)
class TrajectoryConfig:
    """Limits and costs of the optimal control problem (`docs/method.md`). Forces are in multiples of the robot's
    weight. Limits have margins: the controller assumes friction 0.6, the default floor has 0.8, and feedback needs
    torque of its own."""

    node_s: float = 0.008
    phase_nodes: float = 21.0
    friction: float = 0.42
    torque_share: float = 0.85
    speed_share: float = 0.95
    joint_margin_rad: float = 0.03
    turn_rad_per_s2: float = 100.0
    least_force: float = 0.03
    most_force: float = 2.5
    loading: float = 5.0
    contact_m_per_s: float = 0.3
    clearance_share: float = 0.8
    swing_m: float = 0.02
    knee_m: float = 0.03
    apart_m: float = 0.004
    tilt_rad: float = 1.2
    keep_time: bool = False
    keep_speed: bool = False
    window_strides: bool = False
    shortest_share: float = 0.4
    longest_share: float = 1.7
    capture_weight: float = 0.0
    capture_m: float = 0.05
    capture_growth: float = 3.5
    duration_weight: float = 3000.0
    stride_weight: float = 30.0
    end_weight: float = 0.3
    force_weight: float = 3e-2
    force_rate_weight: float = 1.3e-5
    vertical_weight: float = 7.2
    acceleration_weight: float = 1.1e-4
    angular_acceleration_weight: float = 1e-6
    joint_acceleration_weight: float = 3e-7
    foot_acceleration_weight: float = 5e-6
    window_s: float = 4.0
    overlap_s: float = 1.0
    iterations: int = 150
    tolerance: float = 1e-4
