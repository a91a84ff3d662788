"""The robot with a payload that the controller knows of."""

import dataclasses

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.control.config_parts import LoadConfig
from fastmimic.robot import Robot


def loaded_robot(robot: Robot, load: LoadConfig) -> Robot:
    """The robot with a point mass on its trunk; its specification, from which simulations are built, is unchanged."""
    if load.mass == 0:
        return robot
    place = np.array(load.position)
    mass = robot.mass + load.mass
    trunk_mass = robot.trunk_mass + load.mass
    com_b = (robot.mass * robot.com_b + load.mass * place) / mass
    return dataclasses.replace(
        robot,
        mass=mass,
        com_b=com_b,
        inertia_b=robot.inertia_b
        + robot.mass * _point_inertia(robot.com_b - com_b)
        + load.mass * _point_inertia(place - com_b),
        trunk_mass=trunk_mass,
        trunk_com_b=(robot.trunk_mass * robot.trunk_com_b + load.mass * place) / trunk_mass,
    )


def _point_inertia(d: Array) -> Array:
    """(3, 3) inertia of a unit mass at `d` (3,), m²."""
    return np.asarray(d @ d * np.eye(3) - np.outer(d, d))
