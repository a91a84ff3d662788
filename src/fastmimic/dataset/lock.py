"""Locks of a library: for any number of builders, or one repair.

A process keeps a file in the folder and touches it regularly. Operating systems' locks are unreliable on network file
systems; modification times are consistent, because the file system sets them.
"""

import os
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from fastmimic.base.errors import LibraryError
from fastmimic.base.files import check_folder, write_text

SUFFIX: Final = ".lock"
BUILDING: Final = "building"
MENDING: Final = "mending"
BEAT_S: Final = 15.0
SILENT_S: Final = 120.0  # s without a touch after which a process counts as dead; on this machine that is seen at once


@contextmanager
def working(folder: Path, what: str) -> Iterator[None]:
    """Marks a library as being built (`BUILDING`), or keeps all others out of it during a repair (`MENDING`). Raises
    `LibraryError` if a repair, or for a repair any other process, works there, and `OutputError` if the folder cannot
    be written to."""
    check_folder(folder)
    own = folder / f"{what}-{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(3)}{SUFFIX}"
    write_text(own, _machine() or "")
    ended = threading.Event()

    def touch() -> None:
        while not ended.wait(BEAT_S):
            with suppress(OSError):
                own.touch()

    beating = threading.Thread(target=touch, daemon=True)
    beating.start()
    try:
        for other, who in _living(folder, own):
            if what == MENDING:
                raise LibraryError(
                    f"{folder}: is being {'built' if other == BUILDING else 'mended'} now ({who}), and would lose what"
                    " that has begun; mend it when that has ended, or, if it was killed,"
                    f" {SILENT_S / 60:.0f} minutes later"
                )
            if other == MENDING:
                raise LibraryError(f"{folder}: is being mended now ({who}); build again when that has ended")
        yield
    finally:
        ended.set()
        beating.join()
        with suppress(OSError):
            own.unlink(missing_ok=True)


def _living(folder: Path, own: Path) -> Iterator[tuple[str, str]]:
    """What other living processes do, and where these are; removes the files of dead ones."""
    now = own.stat().st_mtime
    for path in folder.glob(f"*-*-*-*{SUFFIX}"):
        if path == own:
            continue
        what, _, place = path.name.partition("-")
        host, pid, _ = place.rsplit("-", 2)
        try:
            silent = now - path.stat().st_mtime > SILENT_S
            here = path.read_text() == (_machine() or "-")
        except OSError:  # it has just ended
            continue
        if silent or (here and not Path("/proc", pid).exists()):
            with suppress(OSError):
                path.unlink()
        else:
            yield what, f"process {pid} on {host}"


def _machine() -> str | None:
    """An identifier of this machine or container, for process ids; None if unknown."""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{socket.gethostname()} {boot} {os.readlink('/proc/self/ns/pid')}"
    return None
