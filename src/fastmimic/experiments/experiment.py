"""What `stress` and `transfer` share: subjects (methods with their motions), and the folder of finished parts."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.files import write_text
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.plan import Start
from fastmimic.episode.rollout import Rollout
from fastmimic.experiments.comparison_run import Row, check_unique, read_part, slug
from fastmimic.experiments.measurement import searched
from fastmimic.imitation.methods import METHODS, Method, check_controller
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings, Progress
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions

DURATION_S: Final = 5.0  # s, length of the optimisation's episodes, as in `imitate`


@dataclass(frozen=True, eq=False)
class Subject:
    """A method with its motion."""

    method: Method
    motion: Motion  # the reference motion, with its demonstration
    config: ControllerConfig
    controller: MakeController | None = None  # of a trained policy; None for the model-based one
    policy: str = ""  # identifies the policy; empty without one

    def run(self, robot: Robot, seconds: float, start: Start, conditions: Conditions, **others: Any) -> Rollout:
        """Episodes of its motion; `others` are more arguments of `run_episodes`, such as another `config`."""
        others = {"config": self.config, "controller": self.controller} | others
        return run_episodes(robot, self.motion, start=start, duration_s=seconds, conditions=conditions, **others)

    @property
    def digest(self) -> str:
        """16 hexadecimal digits of everything that determines its episodes but the robot and the conditions."""
        names = ("root_pos_w", "root_quat_wxyz", "joint_pos", "foot_pos_b", "contact")
        arrays = (getattr(motion, name) for motion in (self.motion, self.motion.target) for name in names)
        return fingerprint(self.config.as_dict(), self.policy.encode(), *arrays)


def check_methods(names: Sequence[str], policy: bool) -> None:
    """Raises `ConfigError` if there is no method, a repeated or unknown one, or one that lacks its policy."""
    if not names:
        raise ConfigError("give at least one method, such as mbc")
    check_unique("method", names)
    for name in names:
        method = METHODS[name]
        check_controller(method, policy and method.learned)
    if policy and not any(METHODS[name].learned for name in names):
        raise ConfigError("a policy was given, and no method that uses it; add rl to --methods")


def make_subject(
    method: str,
    given: Motion,
    robot: Robot,
    search: CmaSettings,
    folder: Path,
    *,
    config: str = "default",
    policy: tuple[MakeController, str] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Subject:
    """A method with its motion; keeps an optimised motion in `folder`, and reads it from there the next time. The
    method that made an optimised motion runs it unchanged; otherwise its demonstration is optimised. `policy` is the
    controller of a trained policy, and its identifier. Raises `FastMimicError` if the motion cannot be optimised, or
    the folder holds one of other content. After Ctrl-C the next call continues from the checkpoint."""
    chosen, demonstration = METHODS[method], given.target
    configured = chosen.configure(config)
    if not chosen.optimises:
        if chosen.learned and policy is not None:
            return Subject(chosen, demonstration, configured, *policy)
        return Subject(chosen, demonstration, configured, chosen.controller)
    made = given.provenance.made_with
    if given is not demonstration and (made is None or made.method == method):
        return Subject(chosen, given, configured)
    stem = slug(f"{given.name}-{method}")
    path, checkpoint = folder / f"{stem}.npz", folder / f"{stem}.checkpoint.npz"
    if path.is_file():
        motion = Motion.load(path)
        if motion.target.joint_pos.tobytes() != demonstration.joint_pos.tobytes():
            raise OutputError(f"{path} was optimised from another motion; remove it, or choose another --out")
        return Subject(chosen, motion, configured)
    folder.mkdir(parents=True, exist_ok=True)
    known = {"method": method, "config": config, "duration_s": DURATION_S, "progress": progress}
    result = searched(demonstration, robot, search, checkpoint, **known)
    result.motion.save(path)
    checkpoint.unlink(missing_ok=True)
    return Subject(chosen, result.motion, configured)


def part_file(folder: Path, *names: str) -> Path:
    return folder / f"{slug('-'.join(names))}.json"


def finish_part(path: Path, digest: str, run: Callable[[], list[Row]]) -> None:
    """Writes the rows of `run`, unless they are there; raises `OutputError` if those are damaged or of another content,
    or cannot be written."""
    if not path.is_file():
        write_text(path, json.dumps({"digest": digest, "rows": run()}, indent=1, allow_nan=False))
    elif _read(path)[0] != digest:
        raise OutputError(f"{path} is of another motion or controller; choose another --out, or give --overwrite")


def all_parts(folder: Path) -> list[Row]:
    """The rows of all parts in a folder; raises `OutputError` for a damaged one."""
    return [row for path in sorted(folder.glob("*.json")) for row in _read(path)[1]]


def _read(path: Path) -> tuple[str, list[Row]]:
    return read_part(path, lambda found: (str(found["digest"]), [dict(row) for row in found["rows"]]))
