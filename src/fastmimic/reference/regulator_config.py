"""Settings of the regulator (`fastmimic.reference.regulator`): one set for all motions and robots."""

from dataclasses import dataclass

from fastmimic.base.configuration import tabulated

Vector3 = tuple[float, float, float]


@tabulated
@dataclass(frozen=True)
class RegulatorConfig:
    """Costs of the regulator. Axes: x, y, z, and roll, pitch, yaw, in the heading frame."""

    position_weight: Vector3 = (0.7, 0.7, 700.0)
    rotation_weight: Vector3 = (25.0, 25.0, 4.0)
    velocity_weight: Vector3 = (0.3, 0.3, 3.0)
    turning_weight: Vector3 = (0.4, 0.4, 0.4)
    foothold_weight: float = 30.0
    landing_weight: float = 0.02
    linear_cost: float = 5e-3
    angular_cost: float = 5e-5
    force_cost: float = 1.8
    foot_cost: float = 1e-4
    loading_s: float = 0.017
    leg_mass: float = 0.1
