"""What the executors are given to do in their tests."""

import os
import signal
from pathlib import Path
from typing import Any

from fastmimic.base.errors import ClipError
from fastmimic.executors import Report


def do(job: Any, report: Report) -> Any:
    """Twice a number; 'wrong' and 'defect' raise, 'die' kills its process, and a path does so once."""
    report(0.5)
    if job == "wrong":
        raise ClipError("this job is wrong")
    if job == "defect":
        raise ZeroDivisionError("a defect")
    if job == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if isinstance(job, Path):
        try:
            job.touch(exist_ok=False)
        except FileExistsError:
            return "done the second time"
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * job
