"""`fastmimic doctor`: what works here, and what to do about the rest."""

import json
from importlib import metadata
from pathlib import Path

import pytest

from cli.running import Run
from fastmimic.commands import doctor


def checks(run: Run) -> dict[str, dict[str, object]]:
    done = run("doctor", "--json")
    assert done.status == 0
    return dict(json.loads(done.out)["checks"])


def test_it_says_what_works_and_what_to_do_about_the_rest(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    done = run("doctor")
    assert done.status == 0
    lines = {line.split("  ")[0]: line for line in done.out.splitlines()}
    assert lines["compiled controller"].split()[2] == "works"
    assert "no" in lines["pictures and videos"].split()
    assert "MUJOCO_GL=off switches it off" in lines["pictures and videos"]
    assert "apt-get install libegl1" in lines["pictures and videos"]


def test_recordings_are_counted_in_their_folder(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTMIMIC_DATA", str(tmp_path))
    found = checks(run)["recordings"]
    assert found["works"] is False
    assert str(tmp_path) in str(found["said"])
    assert "fastmimic data fetch" in str(found["said"])


def test_an_extra_lacks_what_is_not_installed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name == "viser":
            raise metadata.PackageNotFoundError(name)
        return "1"

    monkeypatch.setattr(doctor.metadata, "version", version)
    found = checks(run)
    assert found["extra view"] == {"works": False, "said": "viser missing: pip install 'fastmimic[view]'"}
    assert found["extra formats"]["works"] is True


def test_every_extra_of_users_is_one_of_the_package() -> None:
    assert all(doctor._extras().values())


def test_without_the_compiler_it_says_so(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from fastmimic.control import controller

    monkeypatch.setattr(controller, "control_step", lambda: None)
    assert "NUMBA_DISABLE_JIT" in str(checks(run)["compiled controller"]["said"])


def test_without_a_folder_that_can_be_written_it_says_so(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels then have Numba's cache that keeps nothing."""
    from numba.core.caching import NullCache

    from fastmimic.control import controller

    def kernel() -> None:
        """Stands for one."""

    kernel._cache = NullCache()  # type: ignore[attr-defined]
    monkeypatch.setattr(controller, "control_step", kernel)
    assert "no folder can be written" in str(checks(run)["compiled controller"]["said"])
