"""Gymnasium knows the environment right after `import fastmimic`, in either order, at no cost without Gymnasium."""

import subprocess
import sys

import pytest

pytest.importorskip("gymnasium")
MAKE = "gymnasium.make('{}', motion='trot').spec.id"


@pytest.mark.slow
@pytest.mark.parametrize(
    "program",
    [
        f"import fastmimic, gymnasium; print({MAKE.format('fastmimic/Imitation-v0')})",
        f"import gymnasium, fastmimic; print({MAKE.format('fastmimic/Imitation-v0')})",
        f"import gymnasium; print({MAKE.format('fastmimic:fastmimic/Imitation-v0')})",
    ],
)
def test_make_finds_it(program: str) -> None:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "fastmimic/Imitation-v0"


def test_the_package_does_not_import_gymnasium() -> None:
    program = "import sys, fastmimic; sys.exit('gymnasium' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
