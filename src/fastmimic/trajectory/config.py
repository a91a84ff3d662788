"""Settings of the optimal control problem: one set for all motions and robots."""

from dataclasses import dataclass

from fastmimic.base.configuration import documented, parameter


@documented
@dataclass(frozen=True)
class TrajectoryConfig:
    """Limits and costs of the optimal control problem (`docs/method.md`). Forces are in multiples of the robot's
    weight. Limits have margins: the controller assumes friction 0.6, the default floor has 0.8, and feedback needs
    torque of its own."""

    node_s: float = parameter(0.008, unit="s", above=0.0, about="time between nodes; each contact mode has whole steps")
    phase_nodes: float = parameter(
        21.0, above=0.0, about="nodes of a stance or swing; their time is at most 1.5 times `node_s`"
    )
    friction: float = parameter(0.42, above=0.0, about="bound of the horizontal over the vertical force of a foot")
    torque_share: float = parameter(0.85, above=0.0, high=1.0, about="share of the joints' torque limit")
    speed_share: float = parameter(0.95, above=0.0, high=1.0, about="share of the joints' speed limit")
    joint_margin_rad: float = parameter(0.03, unit="rad", low=0.0, about="distance from the joints' ranges")
    turn_rad_per_s2: float = parameter(
        100.0,
        unit="rad/s²",
        above=0.0,
        about="greatest acceleration of roll, pitch and yaw; swinging legs turn a light trunk",
    )
    least_force: float = parameter(0.03, low=0.0, about="least vertical force of a foot in stance")
    most_force: float = parameter(2.5, above=0.0, about="greatest force of a foot along each axis")
    loading: float = parameter(
        5.0,
        above=0.0,
        about="a foot's force rises and falls no faster, in slopes of a half sine over its stance that carries its"
        " share of the weight: feet touch down early or late",
    )
    contact_m_per_s: float = parameter(
        0.3,
        unit="m/s",
        above=0.0,
        about="a foot moves no faster along each axis just before it touches down and just after it lifts off,"
        " over `node_s`",
    )
    clearance_share: float = parameter(0.8, low=0.0, about="least height of each leg's highest swing, of the animal's")
    swing_m: float = parameter(
        0.02, unit="m", scale="length", about="a swinging foot is this high, or half as high as the animal's if less"
    )
    knee_m: float = parameter(0.03, unit="m", scale="length", about="least height of the knees above the ground")
    apart_m: float = parameter(
        0.004,
        unit="m",
        scale="length",
        about="least gap between two legs' thighs and calves, were they as thick as feet",
    )
    tilt_rad: float = parameter(1.2, unit="rad", above=0.0, high=1.5, about="greatest roll and pitch")
    keep_time: bool = parameter(False, about="the contact modes keep the animal's durations")
    keep_speed: bool = parameter(False, about="the motion keeps the animal's distance a cycle")
    shortest_share: float = parameter(0.4, above=0.0, about="least duration of a contact mode, of the animal's")
    longest_share: float = parameter(1.7, low=1.0, about="greatest duration of a contact mode, of the animal's")
    capture_weight: float = parameter(0.0, low=0.0, about="cost of the capture point near a side's feet, 1/m²")
    capture_m: float = parameter(
        0.05, unit="m", above=0.0, scale="length", about="the capture point stays this far inside the feet of a side"
    )
    capture_growth: float = parameter(
        3.5, low=1.0, about="where that side alone carries the trunk until an error grows this many times"
    )
    duration_weight: float = parameter(3000.0, low=0.0, about="cost of a changed duration, 1/s²")
    stride_weight: float = parameter(30.0, low=0.0, about="cost of a changed distance a cycle, of the squared share")
    end_weight: float = parameter(
        0.3, low=0.0, about="cost of the trunk's squared difference from the animal's velocity at a passage's ends, s²"
    )
    force_weight: float = parameter(3e-2, low=0.0, about="cost of squared forces")
    force_rate_weight: float = parameter(1.3e-5, low=0.0, about="cost of the forces' squared rates, s²")
    vertical_weight: float = parameter(
        7.2, low=0.0, about="cost of the trunk's vertical motion beyond that in the reward; without it the trunk hops"
    )
    acceleration_weight: float = parameter(1.1e-4, low=0.0, about="cost of the trunk's squared acceleration, s⁴/m²")
    angular_acceleration_weight: float = parameter(1e-6, low=0.0, about="the same of roll, pitch and yaw, s⁴/rad²")
    joint_acceleration_weight: float = parameter(3e-7, low=0.0, about="the same of the joints, s⁴/rad²")
    foot_acceleration_weight: float = parameter(5e-6, low=0.0, about="the same of the feet, s⁴/m²")
    window_s: float = parameter(4.0, unit="s", above=0.0, about="longest part of a passage that is solved at once")
    overlap_s: float = parameter(1.0, unit="s", above=0.0, about="of these parts; what follows changes their ends")
    iterations: int = parameter(150, low=1, about="most iterations of the solver")
    tolerance: float = parameter(1e-4, above=0.0, about="of the solver, on the scaled optimality conditions")
