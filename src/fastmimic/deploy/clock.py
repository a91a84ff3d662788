"""Time as the loop knows it: the computer's, or one that passes only when it is told to."""

import ctypes
import gc
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Protocol

SPIN_S: Final = 0.0005
"""Before a deadline the loop looks at the clock without sleeping, since a sleep ends late by as much."""
SHORT_SPIN_S: Final = 0.0001
"""With real-time scheduling: sleeps end in time, and Linux takes the core away for a while from what never sleeps."""
PRIORITY: Final = 60
"""Of `SCHED_FIFO`: above all that is not real time, below the kernel's own threads."""
_MCL_CURRENT_AND_FUTURE: Final = 3


class Clock(Protocol):
    """A monotonic clock, s."""

    def now(self) -> float: ...

    def sleep_until(self, moment: float) -> None:
        """Returns at that moment, at once if it has passed."""


class RealClock:
    """That of `time.perf_counter`. Sleeps until shortly before a moment and then spins."""

    def __init__(self, spin_s: float = SPIN_S) -> None:
        self._spin_s = spin_s

    def now(self) -> float:
        return time.perf_counter()

    def sleep_until(self, moment: float) -> None:
        left = moment - time.perf_counter() - self._spin_s
        if left > 0.0:
            time.sleep(left)
        while time.perf_counter() < moment:
            pass


class VirtualClock:
    """A clock on which only sleeping takes time: the loop and what it talks to go in lock step, as fast as they can."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now(self) -> float:
        return self.time_s

    def sleep_until(self, moment: float) -> None:
        self.time_s = max(self.time_s, moment)


@contextmanager
def undisturbed(*, real_time: bool) -> Iterator[list[str]]:
    """Keeps Python's garbage collector, and if wanted other processes and the swap, out of the way for a while.

    Args:
        real_time: whether to ask for a real-time scheduler and for memory that stays where it is.

    Yields:
        A sentence for each thing that was asked for and not permitted.
    """
    refused: list[str] = []
    gc.collect()
    was_enabled = gc.isenabled()
    gc.freeze()
    gc.disable()
    restore = _ask_for_real_time(refused) if real_time else None
    try:
        yield refused
    finally:
        if restore is not None:
            policy, priority = restore
            os.sched_setscheduler(0, policy, os.sched_param(priority))
            ctypes.CDLL(None).munlockall()
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def _ask_for_real_time(refused: list[str]) -> tuple[int, int] | None:
    """Asks the kernel; returns scheduler and priority as they were, None where there are no such things."""
    if not hasattr(os, "sched_setscheduler"):
        refused.append("this system has no real-time scheduler")
        return None
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        refused.append(
            f"no real-time scheduling ({error.strerror}): give this user an 'rtprio' of {PRIORITY} in"
            " /etc/security/limits.conf, or the process CAP_SYS_NICE"
        )
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
        refused.append(
            f"memory cannot be locked ({os.strerror(ctypes.get_errno())}): raise 'memlock' in"
            " /etc/security/limits.conf, or give the process CAP_IPC_LOCK"
        )
    return before
