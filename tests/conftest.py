"""Fixtures shared by all tests; what a run skipped, and how to include it."""

import fcntl
import gc
import os
import tempfile
from collections import defaultdict
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from browsing import browser
from fastmimic.robot import Robot, load_robot
from fastmimic.steering.gait_field import GaitField, gait_field
from few_gaits import FEW

__all__ = ["browser"]

SKIPPED = "fastmimic/skipped"
"""Where the cache keeps the tests and files that the last run skipped."""
SLOW = "slow: whole programs, browsers, robots on a wire, long searches"


gc.set_threshold(50_000, 20, 100)  # to look through all that is imported as often as usual takes a tenth of the time


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder with the real dog motions, named by FASTMIMIC_DATA."""
    value = os.environ.get("FASTMIMIC_DATA")
    if not value:
        pytest.skip("FASTMIMIC_DATA is not set: run 'fastmimic data fetch', then name its folder")
    return Path(value)


@pytest.fixture(scope="session")
def robot() -> Robot:
    """The A1."""
    return load_robot("a1")


@pytest.fixture(scope="session")
def a1(robot: Robot) -> Robot:
    """The A1, where a test has several robots."""
    return robot


@pytest.fixture(scope="session")
def gaits() -> GaitField:
    """A walk, a trot and a canter of the A1 at few velocities, whose solutions are in the package."""
    return gait_field("a1", **FEW)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the slow tests, too")
    parser.addoption("--skipped", action="store_true", help="run the tests that the last run skipped, and no others")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # the process that hears of all tests
        config.pluginmanager.register(Skips(config.getoption("--skipped")), "skips")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With `--skipped`, a file is left out unless something of it was skipped."""
    if not config.getoption("--skipped") or collection_path.suffix != ".py" or collection_path.name == "conftest.py":
        return None
    files = {name.split("::")[0] for name in config.cache.get(SKIPPED, [])} if config.cache else set()
    return collection_path.relative_to(config.rootpath).as_posix() not in files or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--slow") and not config.getoption("--skipped"):
        for item in items:
            if item.get_closest_marker("slow") is not None:
                item.add_marker(pytest.mark.skip(reason=SLOW))
    if config.getoption("--skipped") and config.cache:
        wanted = set(config.cache.get(SKIPPED, []))
        items[:] = [item for item in items if item.nodeid in wanted or item.nodeid.split("::")[0] in wanted]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """A `real_time` test goes before all others, one at a time: its processes have to keep time. Where that is not
    permitted it waits until no other test runs, and others wait for it. Tests that start a cluster wait for one
    another: Ray joins one that it finds on the machine."""
    real_time = item.get_closest_marker("real_time") is not None
    with ExitStack() as held:
        if real_time:
            held.enter_context(locked("real-time"))
        first = real_time and held.enter_context(before_others())
        with locked("turn"):  # who waits to be alone holds up those who come later
            held.enter_context(locked("machine", fcntl.LOCK_EX if real_time and not first else fcntl.LOCK_SH))
        if item.get_closest_marker("cluster") is not None:
            held.enter_context(locked("cluster"))
        return (yield)


@contextmanager
def before_others() -> Generator[bool, None, None]:
    """Lets this process and those that it starts go before others; gives whether that is permitted."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, -15)
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, 0)


@contextmanager
def locked(name: str, how: int = fcntl.LOCK_EX) -> Generator[None, None, None]:
    """Holds a lock that all test processes of this user know."""
    with open(Path(tempfile.gettempdir()) / f"fastmimic-{name}-{os.getuid()}.lock", "w") as lock:
        fcntl.flock(lock, how)
        yield


class Skips:
    """Remembers what was skipped, and says so at the end."""

    def __init__(self, again: bool) -> None:
        self.again = again
        self.reasons: dict[str, list[str]] = defaultdict(list)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self._note(report)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._note(report)

    def _note(self, report: pytest.CollectReport | pytest.TestReport) -> None:
        if report.skipped and isinstance(report.longrepr, tuple) and not hasattr(report, "wasxfail"):
            reason = report.longrepr[2].removeprefix("Skipped: ")
            if report.nodeid not in self.reasons[reason]:  # each worker tells of a file that it skips
                self.reasons[reason].append(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        chosen = session.config.option.markexpr or session.config.option.keyword  # says little of what is missing
        cache = getattr(session.config, "cache", None)  # with `-p no:cacheprovider` there is none
        if cache is not None and not self.again and not chosen:
            cache.set(SKIPPED, sorted(name for names in self.reasons.values() for name in names))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if not self.reasons:
            terminalreporter.write_line("skipped: nothing")
            return
        terminalreporter.section("skipped, and how to include it")
        for reason, names in sorted(self.reasons.items(), key=lambda entry: -len(entry[1])):
            files = sorted({name.split("::")[0] for name in names})
            shown = ", ".join(files[:3]) + (f" and {len(files) - 3} more" if len(files) > 3 else "")
            terminalreporter.write_line(f"{len(names):4d} in {shown}: {reason}")
        terminalreporter.write_line("To run them: install what is missing, then make test-skipped.")
