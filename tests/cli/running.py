"""What a command did, and how to follow one that runs."""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

QUICK_MAIN: Final = Path(__file__).parent / "quick_main.py"
TINY: Final = ("--iterations", "3", "--population", "4", "--duration", "0.6", "--no-video")
"""Settings of `imitate` with which a search takes a moment."""


@dataclass(frozen=True)
class Outcome:
    """What a command did."""

    status: int
    out: str
    err: str

    @property
    def error(self) -> str:
        """The one line of an error, without its prefix; fails if there is anything else."""
        assert self.status == 2, self
        assert self.out == ""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        assert lines[0].startswith("fastmimic: error: ")
        return lines[0].removeprefix("fastmimic: error: ")


Run = Callable[..., Outcome]


def wait_for_iteration(process: subprocess.Popen[str], iteration: int) -> None:
    """Reads the process's progress until it has done that many iterations."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("iteration ") and int(line.split()[1].split("/")[0]) >= iteration:
            return
    raise AssertionError(f"the process ended with {process.wait()} before iteration {iteration}")
