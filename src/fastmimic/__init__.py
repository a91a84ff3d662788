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

__version__ = "0.1.0"

if TYPE_CHECKING:
    from fastmimic.control.config import ControllerConfig
    from fastmimic.errors import FastMimicError
    from fastmimic.motion.catalogue import motion_names, open_clip
    from fastmimic.motion.clip import Clip
    from fastmimic.motion.motion import Motion
    from fastmimic.motion.retarget import retarget
    from fastmimic.optimize.randomization import Randomization
    from fastmimic.pipeline import Evaluation, Imitation, evaluate, imitate, load_motion
    from fastmimic.primitive import MotionDmp
    from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
    from fastmimic.simulation.conditions import Conditions
    from fastmimic.stitching import Stitching, stitch

_WHERE = {
    "Clip": "fastmimic.motion.clip",
    "Conditions": "fastmimic.simulation.conditions",
    "ControllerConfig": "fastmimic.control.config",
    "Evaluation": "fastmimic.pipeline",
    "FastMimicError": "fastmimic.errors",
    "Imitation": "fastmimic.pipeline",
    "Motion": "fastmimic.motion.motion",
    "MotionDmp": "fastmimic.primitive",
    "ROBOT_NAMES": "fastmimic.robot",
    "Randomization": "fastmimic.optimize.randomization",
    "Robot": "fastmimic.robot",
    "evaluate": "fastmimic.pipeline",
    "imitate": "fastmimic.pipeline",
    "load_motion": "fastmimic.pipeline",
    "load_robot": "fastmimic.robot",
    "motion_names": "fastmimic.motion.catalogue",
    "open_clip": "fastmimic.motion.catalogue",
    "retarget": "fastmimic.motion.retarget",
    "Stitching": "fastmimic.stitching",
    "stitch": "fastmimic.stitching",
}

__all__ = [
    "ROBOT_NAMES",
    "Clip",
    "Conditions",
    "ControllerConfig",
    "Evaluation",
    "FastMimicError",
    "Imitation",
    "Motion",
    "MotionDmp",
    "Randomization",
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
