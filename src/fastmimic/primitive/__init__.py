"""Rhythmic and discrete dynamic movement primitives: fit, reconstruct and modulate a motion."""

from fastmimic.primitive.coordinates import FOOT_Z, NAMES
from fastmimic.primitive.discrete import DiscreteDmp
from fastmimic.primitive.motion_dmp import FootTable, MotionDmp
from fastmimic.primitive.rhythmic import RhythmicDmp

__all__ = ["FOOT_Z", "NAMES", "DiscreteDmp", "FootTable", "MotionDmp", "RhythmicDmp"]
