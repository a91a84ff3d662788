"""Settings of the regulator (`fastmimic.reference.regulator`): one set for all motions and robots."""

from dataclasses import dataclass

from fastmimic.base.configuration import documented, parameter

Vector3 = tuple[float, float, float]


@documented
@dataclass(frozen=True)
class RegulatorConfig:
    """Costs of the regulator. Axes: x, y, z, and roll, pitch, yaw, in the heading frame."""

    position_weight: Vector3 = parameter((0.7, 0.7, 700.0), unit="1/m²", about="of the trunk's position")
    rotation_weight: Vector3 = parameter((25.0, 25.0, 4.0), unit="1/rad²", about="of its orientation")
    velocity_weight: Vector3 = parameter((0.3, 0.3, 3.0), unit="s²/m²", about="of its velocity")
    turning_weight: Vector3 = parameter((0.4, 0.4, 0.4), unit="s²/rad²", about="of its angular velocity")
    foothold_weight: float = parameter(30.0, unit="1/m²", about="of a foot's place relative to the trunk")
    landing_weight: float = parameter(0.02, unit="s³/m²", about="of the speed at which a shifted foot lands")
    linear_cost: float = parameter(5e-3, unit="s⁴/m²", above=0.0, about="of the trunk's changed acceleration")
    angular_cost: float = parameter(5e-5, unit="s⁴/rad²", above=0.0, about="of its changed angular acceleration")
    force_cost: float = parameter(
        1.8, above=0.0, about="of changed forces, in weights; it makes footholds do what forces might not be able to"
    )
    foot_cost: float = parameter(1e-4, unit="s⁴/m²", above=0.0, about="of a swinging foot's changed acceleration")
    loading_s: float = parameter(
        0.017, unit="s", above=0.0, about="a foot counts less for so long after it lands and before it lifts off"
    )
    leg_mass: float = parameter(0.1, unit="kg", about="that a swinging foot of an A1 pushes back with, half-way up")
