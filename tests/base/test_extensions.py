import os
import subprocess
import sys
from pathlib import Path

import pytest

from fastmimic.base import registry
from fastmimic.base.errors import ConfigError

COUNTING = "import builtins\nbuiltins.times_loaded = getattr(builtins, 'times_loaded', 0) + 1\n"


@pytest.fixture(autouse=True)
def nothing_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_loaded", set())


def test_a_file_is_loaded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import builtins

    file = tmp_path / "mine.py"
    file.write_text(COUNTING, encoding="utf-8")
    monkeypatch.setattr(builtins, "times_loaded", 0, raising=False)
    monkeypatch.setenv(registry.VARIABLE, os.pathsep.join([str(file), "", str(file)]))
    registry.load_extensions()
    registry.load_extensions()
    assert builtins.times_loaded == 1  # type: ignore[attr-defined]


def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(registry.VARIABLE, "nowhere.py")
    with pytest.raises(ConfigError, match=r"nowhere\.py: no such file"):
        registry.load_extensions()
    file = tmp_path / "broken.py"
    file.write_text("1 / 0\n", encoding="utf-8")
    monkeypatch.setenv(registry.VARIABLE, str(file))
    with pytest.raises(ConfigError, match=r"broken\.py fails: ZeroDivisionError: division by zero"):
        registry.load_extensions()


def test_an_installed_package_is_loaded(tmp_path: Path) -> None:
    """Its entry point is found by its metadata."""
    (tmp_path / "my_gait_lab.py").write_text("print('loaded')\n", encoding="utf-8")
    info = tmp_path / "my_gait_lab-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-gait-lab\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text("[fastmimic.extensions]\nlab = my_gait_lab\n", encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", "from fastmimic.base.registry import load_extensions; load_extensions()"],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "loaded\n"


def test_the_command_loads_them(tmp_path: Path) -> None:
    file = tmp_path / "broken.py"
    file.write_text("1 / 0\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "fastmimic", "robots"],
        env={**os.environ, "FASTMIMIC_EXTENSIONS": str(file), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "broken.py fails: ZeroDivisionError: division by zero" in done.stderr
    assert "Traceback" not in done.stderr
