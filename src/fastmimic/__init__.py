"""FastMimic: animal motions that a quadruped robot can execute, under one model-based controller, without training.

Conventions, everywhere: SI units; world frame with z up; body frame at the trunk's base with x forward, y left, z
up; quaternions (w, x, y, z), unit, body → world; legs in the order FR, FL, RR, RL, joints abduction, hip, knee in
each, flat index 3·leg + joint; arrays batch first, then time; contact True = stance; foot position = centre of the
foot sphere; angular velocities in the world frame; float64.

    import fastmimic as fm

    result = fm.imitate("trot", robot="a1")
    result.motion.save("trot.npz")
"""

import sys
from typing import Any

from fastmimic.learning import register_when_imported as _register_when_imported

__version__ = "0.2.0"


def _public() -> dict[str, tuple[str, str]]:
    """Each public name with its module and its name there: the imports of `__init__.pyi`, which type checkers read."""
    import ast
    from pathlib import Path

    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {name.asname or name.name: (str(node.module), name.name) for node in imports for name in node.names}


_register_when_imported()  # `gymnasium.make("fastmimic/Imitation-v0")`, without importing it


def _show_in_notebooks() -> None:
    """Has IPython show motions and results with figures and video, if this is a notebook."""
    from_shell = getattr(sys.modules.get("IPython"), "get_ipython", None)
    shell = from_shell() if from_shell is not None else None
    if shell is None:
        return

    def as_html(shown: Any) -> str:
        from fastmimic.report.notebook import as_html

        return as_html(shown)

    names = _public()
    for name in ("Motion", "Evaluation", "Imitation", "Stitching"):
        shell.display_formatter.formatters["text/html"].for_type_by_name(*names[name], as_html)


_show_in_notebooks()


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used: `import fastmimic` itself loads nothing heavy."""
    if name == "__all__":
        value: Any = sorted(_public())
    elif name.startswith("_") or name not in (public := _public()):
        raise AttributeError(f"module 'fastmimic' has no attribute '{name}'")
    else:
        from importlib import import_module

        module, own = public[name]
        value = getattr(import_module(module), own)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_public()})
