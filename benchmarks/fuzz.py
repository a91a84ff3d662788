"""Damaged and made-up files for all readers, and options of all kinds for all verbs: what is not read must be refused
in one line, in 10 s and 500 MB.

    python benchmarks/fuzz.py                        a minute, another seed each time
    python benchmarks/fuzz.py --inputs 10000         as many as that, however long it takes
    python benchmarks/fuzz.py --seed 7 --only 1234   that input again, with its traceback and its files

Each input follows from the seed and its number alone. A worker reads them one after the other; this process watches it,
ends it when it hangs or takes too much memory, and starts another one. Exit status 1 if there is any finding.
"""

import argparse
import contextlib
import faulthandler
import importlib
import io
import multiprocessing
import os
import random
import resource
import secrets
import sys
import tempfile
import time
import traceback
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, NamedTuple

HANG_S: Final = 10.0
MOST_MB: Final = 500.0
_SPACE_MB: Final = 8000  # of addresses beyond those in use, so that no input takes the whole machine
_BYTES: Final = 4096  # of randomness for one input
_POLL_S: Final = 0.05
_WAITS: Final = 4.0  # times as long may an input take on the clock as on the processor
_START_S: Final = 600.0


class Outcome(NamedTuple):
    """Of an input: its kind, how it ended (read, refused, begun or a finding), with what words, and what it took."""

    kind: str
    verdict: str
    words: str = ""
    memory_mb: float = 0.0
    seconds: float = 0.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="how long; not for --inputs")
    parser.add_argument("--inputs", type=int, help="how many")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**9))
    parser.add_argument("--only", type=int, metavar="N", help="one input, by its number, in this process")
    parser.add_argument("--hang", type=float, default=HANG_S, metavar="S", help="how long an input may take")
    parser.add_argument("--planted", action="store_true", help="inputs that must be found: to test this program")
    parser.add_argument("--kind", default="", help="only kinds of input whose name has this in it")
    options = parser.parse_args()
    print(f"seed {options.seed}", flush=True)
    chosen = Chosen(options.seed, options.kind, options.hang, options.planted)
    if options.only is not None:
        return once(chosen, options.only)
    return report(watch(chosen, options.seconds, options.inputs), chosen)


class Chosen(NamedTuple):
    """What is tried: the seed, a part of the names of the kinds, and how long an input may take, s."""

    seed: int
    kind: str
    hang_s: float
    planted: bool


def watch(chosen: Chosen, seconds: float, inputs: int | None) -> dict[int, Outcome]:
    """Tries inputs until the time or their number is over; returns their outcomes by number."""
    found: dict[int, Outcome] = {}
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fastmimic-fuzz-") as folder:
        worker = Worker(chosen, Path(folder))
        print(f"ready after {time.monotonic() - began:.0f} s", flush=True)
        began = time.monotonic()
        number = 0
        while number < inputs if inputs is not None else time.monotonic() - began < seconds:
            found[number] = outcome = worker.run(number)
            if is_finding(outcome):
                print(f"input {number}, {outcome.kind}: {outcome.verdict}: {outcome.words}", flush=True)
            if outcome.verdict in ("hang", "memory", "died"):
                worker.stop()
                worker = Worker(chosen, Path(folder))
            number += 1
        worker.stop()
    print(f"{len(found)} inputs in {time.monotonic() - began:.0f} s")
    return found


def is_finding(outcome: Outcome) -> bool:
    return outcome.verdict in ("traceback", "hang", "memory", "died")


def report(found: dict[int, Outcome], chosen: Chosen) -> int:
    """Prints the figures; returns the exit status."""
    counts = Counter(outcome.verdict for outcome in found.values())
    print(f"read {counts['read']}, begun {counts['begun']}, refused in one line {counts['refused']}")
    print(f"tracebacks {counts['traceback']}, processes that died {counts['died']}")
    longest, most = max(o.seconds for o in found.values()), max(o.memory_mb for o in found.values())
    print(f"hangs over {chosen.hang_s:g} s {counts['hang']}, the longest took {longest:.1f} s")
    print(f"over {MOST_MB:g} MB {counts['memory']}, the most was {most:.0f} MB")
    kinds = Counter(outcome.kind for outcome in found.values())
    print("inputs by kind:", ", ".join(f"{kind} {n}" for kind, n in sorted(kinds.items())))
    wrong = [number for number, outcome in found.items() if is_finding(outcome)]
    for number in wrong[:20]:
        print(f"again: python benchmarks/fuzz.py --seed {chosen.seed} --only {number}")
    return 1 if wrong else 0


class Worker:
    """A process that reads inputs, and how it is watched."""

    def __init__(self, chosen: Chosen, folder: Path) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._trace, self._hang_s = folder / "hang.txt", chosen.hang_s
        self._process = context.Process(target=serve, args=(other, chosen, folder), daemon=True)
        self._process.start()
        other.close()
        if not self._pipe.poll(_START_S):
            raise SystemExit("the worker does not start")
        try:
            self._pipe.recv()
        except EOFError:
            raise SystemExit("the worker does not start") from None

    def run(self, number: int) -> Outcome:
        """Has an input read; ends the process if that hangs, takes too much memory, or it dies."""
        self._pipe.send(number)
        began, start_mb, start_s = time.monotonic(), self._memory_mb(), self._processor_s()
        while not self._pipe.poll(_POLL_S):
            took = max(self._processor_s() - start_s, (time.monotonic() - began) / _WAITS)
            memory = self._memory_mb() - start_mb
            if took > self._hang_s:
                return Outcome(self._kind(), "hang", self._where(), memory, took)
            if memory > MOST_MB:
                return Outcome(self._kind(), "memory", f"{memory:.0f} MB", memory, took)
        try:
            found: Outcome = self._pipe.recv()
        except EOFError:
            self._process.join()
            return Outcome(self._kind(), "died", f"exit status {self._process.exitcode}; {self._where()}")
        return found

    def stop(self) -> None:
        self._process.kill()
        self._process.join()

    def _memory_mb(self) -> float:
        """Resident memory; 0 where the system does not tell it."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
            return pages * resource.getpagesize() / 1e6
        return 0.0

    def _processor_s(self) -> float:
        """Time on a processor, which a busy machine does not stretch; 0 where the system does not tell it."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            ticks = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
            return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
        return 0.0

    def _kind(self) -> str:
        return self._trace.read_text(errors="replace").split("\n")[0]

    def _where(self) -> str:
        """The innermost lines of what the process did at last."""
        lines = self._trace.read_text(errors="replace").splitlines()[1:]
        return " < ".join(line.strip() for line in lines if "File" in line or "rror" in line)[:600]


def serve(pipe: Connection, chosen: Chosen, folder: Path) -> None:
    """Reads inputs by their numbers until the pipe ends."""
    with open(os.devnull, "w") as nowhere:  # what libraries print below Python
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    inputs = Inputs(chosen, folder)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    with contextlib.suppress(OSError, ValueError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + _SPACE_MB * 1_000_000, hard))
    with open(folder / "hang.txt", "w") as trace:
        faulthandler.enable(trace, all_threads=False)
        pipe.send(None)
        while True:
            try:
                number = pipe.recv()
            except EOFError:
                return
            case, random_bytes = inputs.of(number)
            trace.seek(0)
            trace.truncate()
            trace.write(f"{case.name}\n")
            trace.flush()
            faulthandler.dump_traceback_later(0.9 * chosen.hang_s, file=trace)
            pipe.send(inputs.outcome(case, random_bytes))
            faulthandler.cancel_dump_traceback_later()


class Inputs:
    """All inputs of a seed. To begin with, each kind is read once, valid: that imports and compiles what is needed."""

    def __init__(self, chosen: Chosen, folder: Path) -> None:
        sys.path.insert(0, str(Path(__file__).parent))
        from fastmimic.base.files import user_cache

        os.environ.setdefault("NUMBA_CACHE_DIR", str(user_cache()))  # of code that is compiled already
        import fuzz_cases

        self._cases = fuzz_cases
        self._seed, self._planted = chosen.seed, chosen.planted
        made, self._work = folder / "made", folder / "work"
        for path in (made, self._work):
            path.mkdir(exist_ok=True)
        os.environ["FASTMIMIC_DATA"] = str(folder / "no-data")
        os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
        os.chdir(self._work)
        every = fuzz_cases.planted if chosen.planted else fuzz_cases.cases
        self._all = [case for case in every(made) if chosen.kind in case.name]
        if not self._all:
            raise SystemExit(f"no kind of input has '{chosen.kind}' in its name")
        self._weights = [case.weight for case in self._all]
        if chosen.planted:
            return
        fuzz_cases.stop_before_work()
        for name in ("torch", "rsl_rl"):  # no input has to wait for these
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
        for case in self._all:
            outcome = self.outcome(case, bytes(_BYTES), valid=True)
            if outcome.verdict not in ("read", "begun", "refused"):
                raise SystemExit(f"{case.name}, unchanged: {outcome.words}")

    def of(self, number: int) -> tuple[Any, bytes]:
        """The kind of an input, and the bytes from which it is made."""
        source = random.Random(f"{self._seed} {number}")
        if self._planted:
            return self._all[number % len(self._all)], source.randbytes(_BYTES)
        return source.choices(self._all, self._weights)[0], source.randbytes(_BYTES)

    def outcome(self, case: Any, random_bytes: bytes, *, valid: bool = False, show: bool = False) -> Outcome:
        """Makes an input and has it read."""
        from hypothesis import HealthCheck, given, settings
        from hypothesis import strategies as st

        from fastmimic.base.errors import FastMimicError

        self._cases.empty(self._work)
        verdict, words = "not made", ""

        @settings(database=None, deadline=None, suppress_health_check=list(HealthCheck))
        @given(st.data())
        def read(data: Any) -> None:
            nonlocal verdict, words
            verdict = "read"
            try:
                case.run(self._work, data.draw, valid=valid)
            except FastMimicError as error:
                verdict, words = "refused", str(error)
            except self._cases.ReachedWork:
                verdict = "begun"
            except Exception as error:
                if type(error).__module__.startswith("hypothesis"):
                    raise
                verdict, words = "traceback", described(error)
                if show:
                    traceback.print_exc()

        peak = PeakMemory()
        began = time.monotonic()
        quiet = contextlib.nullcontext() if show else contextlib.redirect_stdout(io.StringIO())
        with quiet, contextlib.nullcontext() if show else contextlib.redirect_stderr(io.StringIO()):
            read.hypothesis.fuzz_one_input(random_bytes)  # type: ignore[attr-defined]
        took, memory = time.monotonic() - began, peak.mb()
        if memory > MOST_MB:
            verdict, words = "memory", f"{memory:.0f} MB"
        words = words.encode("ascii", "backslashreplace").decode()
        return Outcome(case.name, verdict, words, memory, took)


def described(error: BaseException) -> str:
    """An exception with the lines of the package that it came through."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f"{Path(frame.filename).name}:{frame.lineno}" for frame in frames if "fastmimic" in frame.filename]
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]} at {' > '.join(own[-4:])}"


class PeakMemory:
    """The most memory since it was made, beyond that at the time."""

    def __init__(self) -> None:
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # Linux: the peak begins anew
        self._before = self._status("VmRSS")

    def mb(self) -> float:
        return self._status("VmHWM") - self._before

    @staticmethod
    def _status(name: str) -> float:
        try:
            lines = Path("/proc/self/status").read_text().splitlines()
        except OSError:  # not Linux: the peak of the whole process
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        return next(float(line.split()[1]) for line in lines if line.startswith(name)) / 1e3


def once(chosen: Chosen, number: int) -> int:
    """Reads one input in this process; its files are left for inspection."""
    folder = Path(tempfile.mkdtemp(prefix="fastmimic-fuzz-"))
    inputs = Inputs(chosen, folder)
    case, random_bytes = inputs.of(number)
    outcome = inputs.outcome(case, random_bytes, show=True)
    print(f"{outcome.kind}: {outcome.verdict} {outcome.words} ({outcome.seconds:.1f} s, {outcome.memory_mb:.0f} MB)")
    print(f"its files are in {folder / 'work'}")
    return int(is_finding(outcome))


if __name__ == "__main__":
    sys.exit(main())
