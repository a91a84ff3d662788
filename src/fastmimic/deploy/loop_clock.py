"""Time as the loop knows it: the computer's, or one that passes only when it is told to."""

import contextlib
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


class LoopClock(Protocol):
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
    before = _ask_for_real_time(refused) if real_time else {}
    try:
        yield refused
    finally:
        _restore(before)
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def _ask_for_real_time(refused: list[str]) -> dict[int, tuple[int, int]]:
    """Asks the kernel for all threads of the process, since a driver's receive what the loop waits for.

    Returns:
        Scheduler and priority of each thread as they were.
    """
    if not hasattr(os, "sched_setscheduler"):
        refused.append("this system has no real-time scheduler")
        return {}
    before = {}
    try:
        for thread in _threads():
            kept = os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(PRIORITY))
            before[thread] = kept
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


def _restore(before: dict[int, tuple[int, int]]) -> None:
    """Puts the threads that are still there back."""
    for thread, (policy, priority) in before.items():
        with contextlib.suppress(OSError):
            os.sched_setscheduler(thread, policy, os.sched_param(priority))
    if before:
        ctypes.CDLL(None).munlockall()


def _threads() -> list[int]:
    """Those of this process; 0 is the calling one where they cannot be told."""
    try:
        return [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return [0]
