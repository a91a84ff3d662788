"""The command line itself: help, versions, mistakes in the arguments, and how it ends."""

import os
import subprocess
import sys
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path

import pytest

import fastmimic
from cli.running import Run
from fastmimic import cli
from fastmimic.base.files import packaged
from fastmimic.commands.motion_files import Robots

HEAVY = ("scipy", "numba", "mujoco", "matplotlib", "casadi")


def modules_after(code: str) -> set[str]:
    """What a fresh interpreter has imported after running `code`."""
    script = f"import sys\n{code}\nsys.stderr.write(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stderr.split())


def test_help_lists_every_verb(run: Run) -> None:
    done = run("--help")
    assert done.status == 0
    assert all(f"  {verb}" in done.out and what.about in done.out for verb, what in cli.VERBS.items())
    groups = [line for line in done.out.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert groups[0] == "Make a motion:"
    assert len(groups) == len(cli.GROUPS)
    assert done.err == ""


def test_the_table_of_help_texts_is_of_options() -> None:
    texts = packaged("fastmimic.commands", "help.json", dict[str, dict[str, str]])
    modules = [
        import_module(f"fastmimic.commands.{name}") for name in ("options", *{v.module for v in cli.VERBS.values()})
    ]
    kinds = {kind.__name__: kind for module in modules for kind in vars(module).values() if is_dataclass(kind)}
    assert {*texts, *texts["details"]} - {"shared", "details"} <= set(kinds)
    for name, kind in kinds.items():
        assert set(texts.get(name, {})) <= {field.name for field in fields(kind)}


def test_without_arguments_there_is_help_on_stderr_and_a_status(run: Run) -> None:
    done = run()
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("usage: fastmimic VERB")


def test_version(run: Run) -> None:
    assert run("--version").out == f"fastmimic {fastmimic.__version__}\n"


def test_importing_the_package_and_help_load_nothing_heavy() -> None:
    loaded = modules_after("import fastmimic; from fastmimic.cli import main; assert main(['--help']) == 0")
    assert "fastmimic.cli" in loaded
    assert not loaded & {*HEAVY, "tyro", "rich"}


@pytest.mark.slow
def test_a_verbs_help_loads_nothing_heavy() -> None:
    code = f"from fastmimic.cli import main\nfor verb in {list(cli.VERBS)}: assert main([verb, '--help']) == 0"
    loaded = modules_after(code)
    assert "tyro" in loaded
    assert not loaded & set(HEAVY)


@pytest.mark.parametrize("verb", cli.VERBS)
def test_every_verb_of_the_table_is_there(verb: str, run: Run) -> None:
    entry = cli.VERBS[verb]
    dataclass = getattr(import_module(f"fastmimic.commands.{entry.module}"), entry.dataclass)
    assert callable(dataclass.run)
    assert run(verb, "--help").out.startswith(f"usage: fastmimic {verb}")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["imitat", "trot"], "unknown verb 'imitat'; did you mean 'imitate'?"),
        (["xyz"], "unknown verb 'xyz'; the verbs are imitate, retarget"),
        (["--verbose"], "unknown option '--verbose'"),
        (["imitate"], "missing: MOTION (see"),
        (["export", "trot", "--bogus", "3", "--out", "x"], "missing: --format NAME; unknown: --bogus, 3 (see"),
        (["export"], "missing: MOTION, --format NAME, --out FILE (see"),
        (["imitate", "trot", "pace"], "pace"),
        (
            ["imitate", "trot", "--duratoin", "3"],
            "did you mean '--duration'? (see 'fastmimic imitate --help')",
        ),
        (["imitate", "trot", "--duration", "long"], "--duration: 'long' is not a number"),
        (["imitate", "trot", "--iterations", "1.5"], "--iterations: '1.5' is not a whole number"),
        (["imitate", "trot", "--seed"], "--seed"),
        (["evaluate", "trot", "--episodes", "1.5"], "--episodes: '1.5' is not a whole number"),
        (["data", "lost"], "data takes list or fetch, found 'lost'; did you mean 'list'?"),
    ],
)
def test_a_mistake_in_the_arguments_is_one_line(arguments: list[str], said: str, run: Run) -> None:
    assert said in run(*arguments).error


def test_ctrl_c_ends_with_130_and_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(self: Robots) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(Robots, "run", interrupted)
    done = run("robots")
    assert (done.status, done.out, done.err) == (130, "", "fastmimic: interrupted\n")


def test_running_out_of_memory_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def too_much(self: Robots) -> int:
        raise MemoryError

    monkeypatch.setattr(Robots, "run", too_much)
    assert "not enough memory" in run("robots").error


def test_a_bug_is_not_dressed_up_as_a_users_error(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def bug(self: Robots) -> int:
        raise ZeroDivisionError

    monkeypatch.setattr(Robots, "run", bug)
    with pytest.raises(ZeroDivisionError):
        run("robots")


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "fastmimic", "--help"]
    with open(write, "wb") as gone:
        done = subprocess.run(command, stdout=gone, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_terminal_without_an_arrow_is_no_error(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "fastmimic", "robots"]
    done = subprocess.run(command, capture_output=True, env=environment, cwd=tmp_path, check=True)
    assert b"torque N?m" in done.stdout
