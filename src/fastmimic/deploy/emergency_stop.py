"""The operator's stop: keys in the terminal, and signals to the process."""

import os
import select
import signal
import sys
import threading
from types import FrameType
from typing import Any, Final, Self

EMERGENCY_KEYS: Final = " \r\nqQ"  # damp at once: the robot sinks to the ground
LEAVE_KEYS: Final = "sS"  # blend out and sit down
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class StopSwitch:
    """A context manager that watches the terminal and the process's signals.

    Within it, SIGINT and SIGTERM are counted and do not end the program. Keys need no Enter if standard input is a
    terminal.

    Attributes:
        signals: number of signals so far.
        key: whether an emergency key was pressed.
        leave: whether the key to sit down was pressed.
    """

    def __init__(self, stream: Any = None) -> None:
        """Reads keys from `stream`; standard input if None."""
        self._stream = stream if stream is not None else sys.stdin
        self._file: int | None = None
        self._saved: Any = None
        self._handlers: dict[int, Any] = {}
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
            if not select.select([self._file], [], [], 0.1)[0]:
                continue
            pressed = os.read(self._file, 64)
            if not pressed:
                break
            return pressed[:1] in (b"\r", b"\n")
        return False

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._handlers = {number: signal.signal(number, self._count) for number in _SIGNALS}
        try:
            descriptor = self._stream.fileno()
            if os.isatty(descriptor):
                import termios
                import tty

                self._saved = termios.tcgetattr(descriptor)
                tty.setcbreak(descriptor)
                self._file = descriptor
        except (ImportError, OSError, ValueError, AttributeError):  # no terminal, or not a system that has them
            self._file = None
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if self._saved is not None:
            import termios

            termios.tcsetattr(self._stream.fileno(), termios.TCSADRAIN, self._saved)
        self._file = self._saved = None

    def _count(self, number: int, frame: FrameType | None) -> None:
        self.signals += 1
