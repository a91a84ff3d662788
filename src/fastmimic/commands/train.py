"""`fastmimic train`: trains a policy that imitates a motion, by reinforcement learning."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional

from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import ConfigError
from fastmimic.base.files import check_folder
from fastmimic.base.machine import available_cores
from fastmimic.base.progress import note, share_progress, tenths
from fastmimic.base.text import plain
from fastmimic.commands import options as opt
from fastmimic.commands.console import put
from fastmimic.runs.work_folder import CONFIG
from fastmimic.simulation.conditions import parse_range

if TYPE_CHECKING:
    from fastmimic.learning.training import Advance

PAPER_STEPS: Final = 100_000_000


@opt.command
class Train:
    """Trains a policy to imitate a motion (PPO; Peng et al. 2018, 2020): the RL baseline."""

    motion: Annotated[Positional[str], opt.option("MOTION")]
    steps: int = PAPER_STEPS
    seed: int = 0
    robots: int = 64
    hidden: tuple[int, ...] = (512, 256)
    entropy: float = 0.0
    randomize: Annotated[tuple[str, ...], opt.option("NAME=LOWER:UPPER ...")] = ()
    evaluate_every: int = 500_000
    device: Annotated[str, opt.option("auto|cpu|cuda")] = "auto"
    threads: Annotated[int | None, opt.option("N")] = None
    update_threads: int = 1
    robot: opt.RobotChoice = None
    out: Annotated[Path | None, opt.option("FOLDER")] = None
    clip: opt.ClipReading
    folder: opt.Folder

    def run(self) -> None:
        for name in ("steps", "evaluate_every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"--{name.replace('_', '-')} must be at least 1, found {getattr(self, name)}")
        from fastmimic.learning.learner import TrainingSettings, check_installed, choose_device
        from fastmimic.learning.training import CHECKPOINT, TrainingFolder, train

        settings = opt.apply(TrainingSettings, self, randomize=tuple(map(parse_range, self.randomize)))
        check_installed()
        device = choose_device(self.device)
        robot, motion = self.clip.load(self.motion, self.robot)
        motion = motion.target
        out = self.out or opt.RUNS / opt.folder_name(motion.name, robot.name, "rl", self.seed)
        content = (robot.content, motion.root_pos_w, motion.root_quat_wxyz, motion.joint_pos, motion.contact)
        subject = {"robot": robot.name, "motion": motion.name, "content": fingerprint(*content)}
        same = {**subject, "device": device, "evaluate_every": self.evaluate_every, **plain(settings)}
        resume = self.folder.resume
        folder = TrainingFolder.at(out)
        folder.check(same, resume=resume, overwrite=self.folder.overwrite, begun=(out / CHECKPOINT).is_file())
        check_folder(out)
        threads = self.threads if self.threads is not None else available_cores()
        if not resume:
            folder.clear()
        record = {"training": same, "motion": motion.provenance.as_dict()}
        folder.write(CONFIG, json.dumps(record, indent=1, sort_keys=True) + "\n")
        note(f"{motion.name} on {robot.name}: {self.steps:,} steps of {self.robots} robots, networks on {device}")
        try:
            with _progress() as progress:
                evaluations = train(
                    robot,
                    motion,
                    self.steps,
                    folder,
                    settings,
                    device=device,
                    threads=threads,
                    resume=resume,
                    evaluate_every=self.evaluate_every,
                    progress=progress,
                )
        except KeyboardInterrupt:
            if (out / CHECKPOINT).is_file():
                note(f"to continue from the checkpoint: the same command with --out {out} --resume")
            raise
        if evaluations:
            best = max(evaluations, key=lambda e: e.reward_mean + e.reward_mean_perturbed)
            perturbed = f"perturbed starts {best.reward_mean_perturbed:.3f}, {best.fell_perturbed:.0%} fell"
            fell = ", fell" if best.fell else ""
            put(f"best evaluation, at {best.steps:,} steps: reward {best.reward_mean:.3f}{fell}; {perturbed}")
        put(f"to run it: fastmimic evaluate {self.motion} --policy {out / 'policy.npz'}")


@contextmanager
def _progress() -> "Iterator[Callable[[Advance], None]]":
    """A bar on a terminal, otherwise a line for each tenth."""
    due = tenths(-1)
    with share_progress("training") as tell:

        def report(at: "Advance") -> None:
            left = (at.total - at.steps) / at.steps_per_s
            evaluated = "" if at.evaluated is None else f", evaluated {at.evaluated.reward_mean:.3f}"
            text = (
                f"reward/step {at.iteration.reward:.3f}{evaluated}, {at.steps_per_s:.0f} steps/s,"
                f" {left // 3600:.0f}:{left // 60 % 60:02.0f} h left"
            )
            line = f"{at.steps:,}/{at.total:,} steps: {text}" if due(at.steps, at.total) else ""
            tell(at.steps / at.total, text, line)

        yield report
