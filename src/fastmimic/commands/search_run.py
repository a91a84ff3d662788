"""What `imitate` and `stitch` share: a search whose results go into the folder of a run."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fastmimic.base.errors import ConfigError
from fastmimic.commands import options as opt
from fastmimic.commands.console import note
from fastmimic.optimize.final_choice import FinalChoice
from fastmimic.robot import Robot

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.runs.work_folder import RunFolder

_NOT_THE_PROBLEM: Final = ("workers", "out", "resume", "overwrite", "no_video", "quality")
"""Arguments that change where and how a run happens, but not its result."""


@dataclass(frozen=True, kw_only=True)
class SearchRun:
    """The options of a search and of the folder that it writes."""

    robot: opt.RobotChoice = None
    method: opt.MethodName = "mbc-dmp"
    config: opt.ConfigName = "default"
    seed: int = 0
    """Seed of the search. The same seed gives the same result at any number of workers."""
    workers: opt.Workers = None
    out: Annotated[Path | None, opt.option("FOLDER")] = None
    """Folder of the results. Default: runs/MOTION-ROBOT-METHOD-SEED, numbered if it exists."""
    folder: opt.Folder
    video: opt.Video
    randomization: opt.Randomizing
    choice: opt.Choice = FinalChoice()

    def check_search(self, method: str) -> None:
        """Raises `ConfigError` for options that a method without a search does not take."""
        from fastmimic.imitation.methods import method_named

        if method_named(method).optimises:
            return
        if self.folder.resume:
            raise ConfigError(f"method '{method}' does not search, so there is nothing to resume; drop --resume")
        if self.randomization.chosen() is not None:
            raise ConfigError(f"method '{method}' does not search, so --randomize has no effect; drop it")

    @contextmanager
    def opened(
        self, robot: Robot, name: str, method: str, **about: Any
    ) -> "Iterator[tuple[RunFolder, dict[str, Any]]]":
        """The folder of the run and the content of its `config.json`; a note tells how to continue after Ctrl-C.

        Args:
            robot: the robot.
            name: of the motion, in the folder's default name.
            method: the method that runs.
            about: further content of `config.json`.
        """
        from fastmimic.base.machine import versions
        from fastmimic.control.config import controller_config
        from fastmimic.imitation.methods import method_named
        from fastmimic.runs.work_folder import default_folder, open_run

        resume = self.folder.resume
        default = opt.folder_name(name, robot.name, method, self.seed)
        out = self.out or default_folder(opt.RUNS, default, resume=resume)
        arguments = opt.recorded(self) | {"method": method}
        config = {
            "arguments": arguments,
            "robot": robot.name,
            **about,
            "controller": method_named(method).configure(controller_config(self.config)).as_dict(),
            "versions": versions(),
        }
        same = {key: value for key, value in arguments.items() if key not in _NOT_THE_PROBLEM}
        with open_run(out, config, same, resume=resume, overwrite=self.folder.overwrite) as folder:
            if folder.finished and not resume:
                note(f"replacing the run in {out}")
            try:
                yield folder, config
            except KeyboardInterrupt:
                if folder.checkpoints:
                    note(f"to continue from the checkpoint: the same command with --out {folder.path} --resume")
                raise
