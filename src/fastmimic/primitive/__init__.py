"""Rhythmic and discrete dynamic movement primitives: fit, reconstruct and modulate a motion."""

from fastmimic.primitive.discrete import DiscreteDmp
from fastmimic.primitive.motion_dmp import FOOT_Z, NAMES, FootTable, MotionDmp
from fastmimic.primitive.rhythmic import RhythmicDmp

__all__ = ["FOOT_Z", "NAMES", "DiscreteDmp", "FootTable", "MotionDmp", "RhythmicDmp"]
