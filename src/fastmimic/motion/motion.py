"""`Motion`, a robot's reference motion, and its file."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from fastmimic.base.arrays import Array, Flags, Indices
from fastmimic.base.conventions import LARGEST, RATE_RANGE_HZ
from fastmimic.base.errors import ConfigError, FastMimicError, MotionError, OutputError
from fastmimic.base.files import from_json, read_arrays, replace_file
from fastmimic.base.rotations import quat_rotate
from fastmimic.motion.provenance import Provenance

FORMAT_VERSION: Final = 1

ARRAYS: Final = {  # name -> trailing shape
    "root_pos_w": (3,),
    "root_quat_wxyz": (4,),
    "joint_pos": (12,),
    "joint_vel": (12,),
    "foot_pos_b": (4, 3),
    "contact": (4,),
    "root_lin_vel_w": (3,),
    "root_ang_vel_w": (3,),
}
_DEMONSTRATION: Final = "demonstration_"
_PART: Final = "part{}_"
_ANIMAL: Final = "animal_"


@dataclass(frozen=True, eq=False)
class Motion:
    """A robot's reference motion at a fixed rate. Its arrays are read-only.

    Samples cover [0, T): sample t would repeat sample 0 moved by `cycle`.

    Attributes:
        rate_hz: samples a second.
        root_pos_w: (t, 3) base position, world, m.
        root_quat_wxyz: (t, 4) base orientation, body → world.
        joint_pos, joint_vel: (t, 12) rad and rad/s.
        foot_pos_b: (t, 4, 3) centres of the foot spheres, body frame, m.
        contact: (t, 4) bool, True in stance.
        root_lin_vel_w, root_ang_vel_w: (t, 3) base velocity, m/s, and angular velocity, rad/s, world.
        cycle: (dx, dy, dyaw) of one period in sample 0's heading frame, m and rad; None if not periodic.
        provenance: where it comes from and how it was made.
        demonstration: the motion that an optimised one is scored against, or None.
        parts: the cyclic motions of a stitched demonstration (see `fastmimic.stitching.join`).
        animal: of a motion made executable (`fastmimic.trajectory`), the animal's kinematic motion at the same phases.
    """

    rate_hz: float
    root_pos_w: Array
    root_quat_wxyz: Array
    joint_pos: Array
    joint_vel: Array
    foot_pos_b: Array
    contact: Flags
    root_lin_vel_w: Array
    root_ang_vel_w: Array
    cycle: Array | None = None
    provenance: Provenance = field(default_factory=Provenance)
    demonstration: "Motion | None" = None
    parts: "tuple[Motion, ...]" = ()
    animal: "Motion | None" = None

    def __post_init__(self) -> None:
        if not RATE_RANGE_HZ[0] <= self.rate_hz <= RATE_RANGE_HZ[1]:
            raise MotionError(f"rate_hz must be in {RATE_RANGE_HZ[0]:g} to {RATE_RANGE_HZ[1]:g}, found {self.rate_hz}")
        n = len(self.root_pos_w)
        if n < 2:
            raise MotionError(f"a motion needs at least 2 samples, found {n}")
        for name, tail in ARRAYS.items():
            dtype = np.bool_ if name == "contact" else np.float64
            array: Any = np.array(getattr(self, name), dtype=dtype)
            if array.shape != (n, *tail):
                raise MotionError(f"{name} has shape {array.shape}; expected {(n, *tail)}")
            if (wrong := ~(np.abs(array) <= LARGEST)).any():
                sample = int(np.argwhere(wrong)[0][0])
                raise MotionError(f"{name} is not finite at sample {sample}, or beyond {LARGEST:g}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        norm = np.linalg.norm(self.root_quat_wxyz, axis=1)
        if np.any(np.abs(norm - 1) > 1e-6):
            sample = int(np.argmax(np.abs(norm - 1)))
            raise MotionError(f"root_quat_wxyz is not a unit quaternion at sample {sample} (norm {norm[sample]:.4g})")
        if self.cycle is not None:
            cycle = np.array(self.cycle, dtype=np.float64)
            if cycle.shape != (3,) or not np.all(np.isfinite(cycle)):
                raise MotionError(f"cycle must be three finite numbers (dx, dy, dyaw), found {self.cycle}")
            cycle.flags.writeable = False
            object.__setattr__(self, "cycle", cycle)

    @property
    def n_samples(self) -> int:
        return len(self.root_pos_w)

    @property
    def dt(self) -> float:
        """Time between samples, s."""
        return 1.0 / self.rate_hz

    @property
    def period_s(self) -> float:
        """Duration covered by the samples (one cycle if periodic), s."""
        return self.n_samples / self.rate_hz

    @property
    def name(self) -> str:
        return self.provenance.name

    @property
    def about(self) -> str:
        """Length, rate, and mean velocity if it is periodic, in words."""
        text = f"{self.period_s:.2f} s at {self.rate_hz:g} Hz"
        if self.cycle is None:
            return f"{text}, not periodic"
        dx, dy, dyaw = self.cycle / self.period_s
        return f"{text}, {dx:+.2f} m/s forward, {dy:+.2f} m/s left, yaw {dyaw:+.2f} rad/s"

    def __repr__(self) -> str:
        kind = "optimised, " if self.demonstration is not None else ""
        kind += "kinematic" if self.target.animal is None else "executable"
        return f"<Motion {self.name} for {self.provenance.robot}: {kind}, {self.about}>"

    @property
    def foot_pos_w(self) -> Array:
        """Centres of the feet (t, 4, 3), world, m."""
        return self.root_pos_w[:, None] + quat_rotate(self.root_quat_wxyz[:, None], self.foot_pos_b)

    @property
    def cycle_starts(self) -> Indices:
        """Samples at which a cycle starts: the first, and those that a stitched motion records."""
        later = self.provenance.stitch.cycle_starts if self.provenance.stitch is not None else ()
        return np.array([0, *(i for i in later if 0 < i < self.n_samples)], dtype=np.int64)

    @property
    def runs_once(self) -> bool:
        """Whether it has no cycles, at whose starts the reference is synchronised with the robot."""
        return self.cycle is None and len(self.cycle_starts) == 1

    @property
    def segment_starts(self) -> tuple[int, ...]:
        """First samples of a stitched motion's segments; empty for other motions."""
        return tuple(s.first for s in self.provenance.stitch.segments) if self.provenance.stitch is not None else ()

    @property
    def target(self) -> "Motion":
        """The motion that this one is scored against: its demonstration, or itself."""
        return self.demonstration if self.demonstration is not None else self

    def check_robot(self, name: str) -> None:
        """Raises `MotionError` if the motion is for another robot."""
        of = self.provenance.robot
        if of is not None and of != name:
            said = f"motion '{self.name}' is for robot '{of}', not for '{name}'"
            raise MotionError(f"{said}: give that robot (by its MJCF, if it is your own), or retarget its clip")

    def check_rate(self, rate_hz: float, error: type[FastMimicError] = ConfigError) -> None:
        """Raises `ConfigError`, or another error, if the motion has another rate."""
        if abs(self.rate_hz - rate_hz) > 1e-9:
            said = f"motion '{self.name}' has {self.rate_hz:g} samples a second; expected {rate_hz:g}"
            raise error(f"{said}: retarget its clip with that rate")

    def save(self, path: str | Path | BinaryIO) -> None:
        """Writes an `.npz` without pickles to a stream or a file, replaced only when complete; raises `OutputError`."""
        if isinstance(path, str | Path) and Path(path).suffix != ".npz":
            raise OutputError(f"{path}: a motion is written to an .npz")
        arrays: dict[str, Any] = _to_arrays(self)
        if self.demonstration is not None:
            arrays |= {_DEMONSTRATION + k: v for k, v in _to_arrays(self.demonstration).items()}
        if isinstance(path, str | Path):
            replace_file(path, lambda file: np.savez_compressed(file, **arrays))
        else:
            np.savez_compressed(path, **arrays)

    @classmethod
    def load(cls, path: str | Path | BinaryIO) -> "Motion":
        """Reads a file or open stream that `save` wrote. Raises `MotionError`: missing, damaged, or not a motion."""
        arrays = read_arrays(path, MotionError, ".npz motion")
        version = arrays.get("format_version")
        if version is None:
            raise MotionError(f"{path}: an .npz without 'format_version'; not a FastMimic motion")
        if version.tolist() != FORMAT_VERSION:
            raise MotionError(f"{path}: format version {version}; this release reads version {FORMAT_VERSION}")
        try:
            return _from_arrays(arrays)
        except KeyError as error:
            raise MotionError(f"{path}: not a FastMimic motion: array {error} is missing") from None
        except (MotionError, ValueError, TypeError) as error:
            raise MotionError(f"{path}: {error}") from None


def _to_arrays(motion: Motion) -> dict[str, Any]:
    parts: dict[str, Any] = {}
    for i, part in enumerate(motion.parts):
        parts |= {_PART.format(i) + k: v for k, v in _to_arrays(part).items()}
    if motion.animal is not None:
        parts |= {_ANIMAL + k: v for k, v in _to_arrays(motion.animal).items()}
    return parts | {
        "format_version": np.int64(FORMAT_VERSION),
        "rate_hz": np.float64(motion.rate_hz),
        **{name: getattr(motion, name) for name in ARRAYS},
        "cycle": np.zeros(0) if motion.cycle is None else motion.cycle,
        "meta_json": np.str_(json.dumps(motion.provenance.as_dict(), sort_keys=True)),
    }


def _from_arrays(arrays: dict[str, Any]) -> Motion:
    def of(prefix: str) -> dict[str, Any]:
        return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}

    demonstration, animal = of(_DEMONSTRATION), of(_ANIMAL)
    parts: list[Motion] = []
    while part := of(_PART.format(len(parts))):
        parts.append(_from_arrays(part))
    return Motion(
        rate_hz=float(arrays["rate_hz"]),
        **{name: arrays[name] for name in ARRAYS},
        cycle=arrays["cycle"] if arrays["cycle"].size else None,
        provenance=Provenance.from_dict(from_json(str(arrays["meta_json"]))),
        demonstration=_from_arrays(demonstration) if demonstration else None,
        parts=tuple(parts),
        animal=_from_arrays(animal) if animal else None,
    )
