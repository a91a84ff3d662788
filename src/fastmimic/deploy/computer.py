"""What the loop needs of the computer: a clock, real-time scheduling, and the operator's keys and signals."""

import contextlib
import ctypes
import gc
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Final, Self

import numpy as np

SPIN_S: Final = 0.0005  # before a deadline the loop polls the clock: a sleep ends this late
SHORT_SPIN_S: Final = 0.0001  # with real-time scheduling: sleeps end in time, and Linux throttles polling
REHEARSAL_S: Final = 1.0
PRIORITY: Final = 60  # in `SCHED_FIFO`: below the kernel's threads
EMERGENCY_KEYS: Final = " \r\nqQ"  # damp at once: the robot sinks to the ground
LEAVE_KEYS: Final = "sS"  # blend out and sit down
_LIMITS: Final = "/etc/security/limits.conf"
_SWITCH_S: Final = 1e-4  # how long another thread may keep the interpreter from the loop
_SIGNALS: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_MCL_CURRENT_FUTURE_ON_FAULT: Final = 7  # what was never touched stays out of memory: gigabytes of libraries


class LoopClock:
    """The computer's monotonic clock, s."""

    spin_s = SPIN_S

    def now(self) -> float:
        return time.perf_counter()

    def sleep_until(self, moment: float) -> None:
        """Returns at that moment, or at once if it has passed; shortly before it, it spins."""
        left = moment - time.perf_counter() - self.spin_s
        if left > 0.0:
            time.sleep(left)
        while time.perf_counter() < moment:
            pass


class VirtualClock(LoopClock):
    """A clock that advances only by sleeping: loop and simulated robot run in lock step, as fast as possible."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now(self) -> float:
        return self.time_s

    def sleep_until(self, moment: float) -> None:
        self.time_s = max(self.time_s, moment)


class Rehearsal:
    """Runs the loop's periods for a second before anything is sent: called before each, it waits for the period's
    deadline, and says whether there is one more. It keeps how late the periods began and how long they took, s."""

    def __init__(self, clock: LoopClock, period_s: float) -> None:
        self._clock, self._period_s = clock, period_s
        self._deadline = self._began = 0.0
        self.late: list[float] = []
        self.took: list[float] = []

    def __call__(self) -> bool:
        now = self._clock.now()
        if self._began:
            self.took.append(now - self._began)
        if len(self.took) * self._period_s >= REHEARSAL_S:
            return False
        self._deadline = max(self._deadline + self._period_s, now)
        self._clock.sleep_until(self._deadline)
        self._began = self._clock.now()
        self.late.append(self._began - self._deadline)
        return True

    def text(self, most_late_s: float) -> str:
        """A line on what this computer holds; a period may begin `most_late_s` late."""
        late, took, period = max(self.late), max(self.took), self._period_s
        said = f"rehearsed {1.0 / period:.0f} Hz: periods at most {1e3 * late:.1f} ms late, done in {1e3 * took:.1f} ms"
        if late < most_late_s and float(np.percentile(self.took, 99)) < period:
            allowed = f"below {1e3 * most_late_s:g} ms late, and 99 of 100 done in {1e3 * period:g} ms"
            return f"{said}: this computer keeps up ({allowed})"
        return f"{said}: this computer is too busy or too slow; end other work, or allow real-time scheduling"


@contextmanager
def undisturbed(*, real_time: bool) -> Iterator[list[str]]:
    """Without garbage collection, or threads that keep the loop waiting; `real_time` requests that scheduling and
    locked memory. Yields what was refused."""
    refused: list[str] = []
    was_enabled, interval = gc.isenabled(), sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.disable()
    before = _ask_for_real_time(refused) if real_time else {}
    try:
        yield refused
    finally:
        for thread, (policy, priority) in before.items():
            with contextlib.suppress(OSError):  # it may have ended
                os.sched_setscheduler(thread, policy, os.sched_param(priority))
        if real_time and hasattr(os, "sched_setscheduler"):
            ctypes.CDLL(None).munlockall()
        sys.setswitchinterval(interval)
        if was_enabled:
            gc.enable()


def _ask_for_real_time(refused: list[str]) -> dict[int, tuple[int, int]]:
    """Requests real-time scheduling and locked memory; returns each thread's former scheduler and priority."""
    if not hasattr(os, "sched_setscheduler"):
        refused.append("this system has no real-time scheduler")
        return {}
    before = {}
    tasks = Path("/proc/self/task")
    threads = [int(task.name) for task in tasks.iterdir()] if tasks.is_dir() else [0]  # 0: the calling thread
    try:
        for thread in threads:
            kept = os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(PRIORITY))
            before[thread] = kept
    except OSError as error:
        remedy = f"give this user an 'rtprio' of {PRIORITY} in {_LIMITS}, or the process CAP_SYS_NICE"
        refused.append(f"no real-time scheduling ({error.strerror}): {remedy}")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_FUTURE_ON_FAULT) != 0:
        remedy = f"raise 'memlock' in {_LIMITS}, or give the process CAP_IPC_LOCK"
        refused.append(f"memory cannot be locked ({os.strerror(ctypes.get_errno())}): {remedy}")
    return before


class StopSwitch:
    """A context manager that watches the terminal and the process's signals. Within it, SIGINT, SIGTERM and SIGHUP (the
    terminal is gone) are counted in `signals` and do not end the program. Keys need no Enter if standard input is a
    terminal; `key` and `leave` say whether an emergency key and the key to sit down were pressed."""

    def __init__(self, stream: Any = None) -> None:
        """Reads keys from `stream`; standard input if None."""
        self._stream = stream if stream is not None else sys.stdin
        self._file: int | None = None
        self._undo = contextlib.ExitStack()
        self.signals, self.key, self.leave = 0, False, False

    def poll(self) -> None:
        """Reads the pressed keys; takes some microseconds."""
        if self._file is None:
            return
        while select.select([self._file], [], [], 0.0)[0]:
            try:
                pressed = os.read(self._file, 64)
            except OSError:
                pressed = b""
            if not pressed:  # the terminal is gone
                self._file = None
                return
            for character in pressed.decode(errors="replace"):
                self.key = self.key or character in EMERGENCY_KEYS
                self.leave = self.leave or character in LEAVE_KEYS

    def wait_for_consent(self) -> bool:
        """Waits for a key or a signal; returns whether it was Enter."""
        while not self.signals and self._file is not None:
            if select.select([self._file], [], [], 0.1)[0]:
                return os.read(self._file, 64)[:1] in (b"\r", b"\n")
        return False

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                self._undo.callback(signal.signal, number, signal.signal(number, self._count))
        # there may be no terminal, or a system without
        with contextlib.suppress(ImportError, OSError, ValueError, AttributeError):
            descriptor = self._stream.fileno()
            if os.isatty(descriptor):
                import termios
                import tty

                self._undo.callback(termios.tcsetattr, descriptor, termios.TCSADRAIN, termios.tcgetattr(descriptor))
                tty.setcbreak(descriptor)
                self._file = descriptor
        return self

    def __exit__(self, *_: object) -> None:
        self._file = None
        self._undo.close()

    def _count(self, number: int, frame: FrameType | None) -> None:
        self.signals += 1
