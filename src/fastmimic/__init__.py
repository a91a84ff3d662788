"""FastMimic: animal motions that a real quadruped can execute, under one model-based controller, without training.

Conventions, everywhere: SI units; world frame with z up; body frame at the trunk's base with x forward, y left, z
up; quaternions (w, x, y, z), unit, body → world; legs in the order FR, FL, RR, RL, joints abduction, hip, knee in
each, flat index 3·leg + joint; arrays batch first, then time; contact True = stance; foot position = centre of the
foot sphere; angular velocities in the world frame; float64.

    import fastmimic as fm

    result = fm.imitate("trot", robot="a1")
    result.motion.save("trot.npz")
"""

from typing import TYPE_CHECKING, Any

from fastmimic.base.after_import import after_import
from fastmimic.clips.clip import Clip
from fastmimic.motion.motion import Motion
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot

__version__ = "0.1.0"

if TYPE_CHECKING:
    from fastmimic.base.errors import FastMimicError
    from fastmimic.clips.catalogue import motion_names, open_clip
    from fastmimic.control.config import ControllerConfig
    from fastmimic.episode.reward import REWARD_TERMS, RewardTerm
    from fastmimic.imitation.imitate import Evaluation, Imitation, evaluate, imitate
    from fastmimic.imitation.methods import METHODS, Method
    from fastmimic.imitation.stitch import Stitching, stitch
    from fastmimic.optimize.randomization import Randomization
    from fastmimic.primitive import MotionDmp
    from fastmimic.retargeting.retarget import retarget
    from fastmimic.runs.loading import load_motion
    from fastmimic.simulation.conditions import Conditions

_WHERE = {
    "Clip": "fastmimic.clips.clip",
    "Conditions": "fastmimic.simulation.conditions",
    "ControllerConfig": "fastmimic.control.config",
    "Evaluation": "fastmimic.imitation.imitate",
    "METHODS": "fastmimic.imitation.methods",
    "Method": "fastmimic.imitation.methods",
    "REWARD_TERMS": "fastmimic.episode.reward",
    "RewardTerm": "fastmimic.episode.reward",
    "FastMimicError": "fastmimic.base.errors",
    "Imitation": "fastmimic.imitation.imitate",
    "Motion": "fastmimic.motion.motion",
    "MotionDmp": "fastmimic.primitive",
    "ROBOT_NAMES": "fastmimic.robot",
    "Randomization": "fastmimic.optimize.randomization",
    "Robot": "fastmimic.robot",
    "evaluate": "fastmimic.imitation.imitate",
    "imitate": "fastmimic.imitation.imitate",
    "load_motion": "fastmimic.runs.loading",
    "load_robot": "fastmimic.robot",
    "motion_names": "fastmimic.clips.catalogue",
    "open_clip": "fastmimic.clips.catalogue",
    "retarget": "fastmimic.retargeting.retarget",
    "Stitching": "fastmimic.imitation.stitch",
    "stitch": "fastmimic.imitation.stitch",
}

__all__ = [
    "METHODS",
    "REWARD_TERMS",
    "ROBOT_NAMES",
    "Clip",
    "Conditions",
    "ControllerConfig",
    "Evaluation",
    "FastMimicError",
    "Imitation",
    "Method",
    "Motion",
    "MotionDmp",
    "Randomization",
    "RewardTerm",
    "Robot",
    "Stitching",
    "evaluate",
    "imitate",
    "load_motion",
    "load_robot",
    "motion_names",
    "open_clip",
    "retarget",
    "stitch",
]


def _register_environments() -> None:
    """Makes `gymnasium.make("fastmimic/Imitation-v0")` work, without importing Gymnasium for it."""
    from fastmimic.learning.registration import register

    register()


after_import("gymnasium", _register_environments)


def __getattr__(name: str) -> Any:
    """Imports what is asked for when it is asked for: `import fastmimic` itself loads nothing heavy."""
    if name not in _WHERE:
        raise AttributeError(f"module 'fastmimic' has no attribute '{name}'")
    from importlib import import_module

    value = getattr(import_module(_WHERE[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
