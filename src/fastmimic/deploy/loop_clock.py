"""The loop's clock: real or virtual time; and real-time scheduling."""

import contextlib
import ctypes
import gc
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Protocol

SPIN_S: Final = 0.0005  # before a deadline the loop polls the clock: a sleep ends this late
SHORT_SPIN_S: Final = 0.0001  # with real-time scheduling: sleeps end in time, and Linux throttles polling
PRIORITY: Final = 60  # in `SCHED_FIFO`: below the kernel's threads
_MCL_CURRENT_AND_FUTURE: Final = 3


class LoopClock(Protocol):
    """A monotonic clock, s."""

    def now(self) -> float: ...

    def sleep_until(self, moment: float) -> None:
        """Returns at that moment, or at once if it has passed."""


class RealClock:
    """`time.perf_counter`. Sleeps until shortly before a moment and then spins."""

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


def real_clock(real_time: bool) -> RealClock:
    return RealClock(SHORT_SPIN_S if real_time else SPIN_S)


class VirtualClock:
    """A clock that advances only by sleeping: loop and simulated robot run in lock step, as fast as possible."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now(self) -> float:
        return self.time_s

    def sleep_until(self, moment: float) -> None:
        self.time_s = max(self.time_s, moment)


@contextmanager
def undisturbed(*, real_time: bool) -> Iterator[list[str]]:
    """Disables Python's garbage collector; `real_time` requests real-time scheduling and locked memory. Yields a
    sentence for each request refused."""
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
    """Requests real-time scheduling and locked memory; returns each thread's former scheduler and priority."""
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
    """Restores the scheduling of the remaining threads."""
    for thread, (policy, priority) in before.items():
        with contextlib.suppress(OSError):
            os.sched_setscheduler(thread, policy, os.sched_param(priority))
    if before:
        ctypes.CDLL(None).munlockall()


def _threads() -> list[int]:
    """The threads of this process; 0, the calling thread, where they cannot be listed."""
    try:
        return [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return [0]
