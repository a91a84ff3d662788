"""The command `fastmimic`: imports the verb's module, parses its arguments, and prints errors as one line."""

import contextlib
import difflib
import io
import json
import logging
import os
import re
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module, resources
from typing import Any, Final, NamedTuple, NoReturn

from fastmimic import __version__
from fastmimic.base.errors import FastMimicError
from fastmimic.base.registry import load_extensions
from fastmimic.base.signals import heeded, on_signal
from fastmimic.commands.console import EXIT_INTERRUPTED

EXIT_ERROR: Final = 2
EXIT_BROKEN_PIPE: Final = 141  # as a shell reports SIGPIPE


class Verb(NamedTuple):
    """Module and dataclass of a verb, and its line in the help."""

    module: str
    dataclass: str
    about: str


_GROUPS: Final = json.loads(resources.files("fastmimic").joinpath("verbs.json").read_text("utf-8"))
GROUPS: Final = {about: {name: Verb(*entry) for name, entry in verbs.items()} for about, verbs in _GROUPS.items()}
VERBS: Final = {name: verb for verbs in GROUPS.values() for name, verb in verbs.items()}


def _listed(about: str, verbs: Mapping[str, Verb]) -> str:
    lines = "".join(f"  {name:10}{verb.about}\n" for name, verb in verbs.items())
    return f"{about[0].upper()}{about[1:]}:\n{lines}\n"


HELP: Final = f"""\
usage: fastmimic VERB ... [-h] [--version]

Turns an animal's motion into one that a quadruped robot can execute.

{"".join(_listed(*group) for group in GROUPS.items())}\
A MOTION is a built-in gait such as trot, a recording such as dog:pace (see 'fastmimic motions'), or a file.
'fastmimic VERB --help' lists the options of a verb. First try: fastmimic imitate trot
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns the exit status. `argv` are arguments without the program's name; those of the
    process if None."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # for terminals without, say, an arrow
    interrupts: list[int] = []

    def interrupted(number: int, frame: object) -> NoReturn:
        interrupts.append(number)
        raise KeyboardInterrupt

    try:
        with on_signal(interrupted, *heeded()):
            status = _dispatch(arguments)
        sys.stdout.flush()
    except FastMimicError as error:
        return _fail(" ".join(str(error).split()))
    except MemoryError:
        return _fail("not enough memory; ask for less (--duration, --episodes, --population, --size)")
    except BrokenPipeError:
        # Python flushes stdout once more at exit, which must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except (KeyboardInterrupt, Exception) as error:
        if not (interrupts or isinstance(error, KeyboardInterrupt)):
            raise
        _say("interrupted")  # whatever a library made of it
        return EXIT_INTERRUPTED
    return status


def _dispatch(arguments: list[str]) -> int:
    if not arguments:
        sys.stderr.write(HELP)
        return EXIT_ERROR
    first, rest = arguments[0], arguments[1:]
    if first in ("-h", "--help", "help"):
        sys.stdout.write(HELP)
        return 0
    if first == "--version":
        sys.stdout.write(f"fastmimic {__version__}\n")
        return 0
    if first not in VERBS:
        return _fail(_unknown(first))
    logger = logging.getLogger("fastmimic")
    if not logger.handlers:
        logger.addHandler(_Stderr(logging.INFO))
        logger.setLevel(logging.INFO)  # of long work
    load_extensions()
    try:
        return _parse(first, rest).run() or 0  # a verb that only succeeds returns nothing
    except _UsageError as error:
        return _fail(f"{error} (see 'fastmimic {first} --help')")
    except SystemExit as stop:  # --help
        return int(stop.code or 0)


def _unknown(word: str) -> str:
    close = difflib.get_close_matches(word, VERBS, n=2, cutoff=0.5)
    hint = f"did you mean {' or '.join(repr(c) for c in close)}?" if close else f"the verbs are {', '.join(VERBS)}"
    return f"unknown {'option' if word.startswith('-') else 'verb'} '{word}'; {hint}"


class _UsageError(Exception):
    """Arguments that do not parse."""


def _parse(name: str, rest: list[str]) -> Any:
    """The verb's dataclass with its arguments, parsed by tyro."""
    verb = VERBS[name]
    dataclass = getattr(import_module(f"fastmimic.commands.{verb.module}"), verb.dataclass)
    import tyro

    boxed = io.StringIO()
    try:
        with contextlib.redirect_stderr(boxed):
            return tyro.cli(dataclass, args=rest, prog=f"fastmimic {name}", config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as stop:
        if stop.code:
            _raise_usage(boxed.getvalue())
        raise


def _raise_usage(box: str) -> NoReturn:
    """Raises the message that tyro prints in a box as one line, with the option that it suggests.

    tyro 1.0 offers no hook for its errors: it prints the box and exits, or exits silently.
    """
    parts: list[list[str]] = [[]]
    for line in (line.strip("│ ") for line in box.splitlines()):
        if line[:1] in ("╭", "╰") or re.fullmatch(r"[─-]{3,}", line):
            parts.append([])
        elif line:
            parts[-1].append(line)
    parts = [part for part in parts if part]
    if len(parts) > 1 and "╭" not in box:
        del parts[0]  # the title, which a box has in its border
    said = " ".join(parts[0]) if parts else "arguments that cannot be parsed"
    if said.startswith("Missing from"):
        # their help is indented further
        missing, unknown = (
            ", ".join(re.findall(r"^(?:│ |  )    (?!fastmimic )(\S.*?)[ │]*$", part, re.MULTILINE))
            for _, _, part in (box.partition("Unrecognized")[0].rpartition("Missing"), box.rpartition("Unrecognized"))
        )
        said = f"missing: {missing}" + (f"; unknown: {unknown}" if "Unrecognized" in box else "")
    elif wrong := re.match(r"Error parsing (--\S+): .*?(int|float|INT|FLOAT)\b.*'(.*)'$", said):
        option, kind, value = wrong.groups()
        said = f"{option}: {value!r} is not a {'whole ' if kind.lower() == 'int' else ''}number"
    meant = next((part for part in parts if part[0].lower().startswith("perhaps you meant")), None)
    if meant is not None and len(meant) > 1:
        said += f"; did you mean '{meant[1].split()[0].rstrip(',')}'?"
    raise _UsageError(said)


class _Stderr(logging.Handler):
    """One line for each record, on what is stderr at that time."""

    def emit(self, record: logging.LogRecord) -> None:
        kind = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        _say(f"{kind}{record.getMessage()}")


def _say(text: str) -> None:
    sys.stderr.write(f"fastmimic: {text}\n")


def _fail(text: str) -> int:
    _say(f"error: {text}")
    return EXIT_ERROR
