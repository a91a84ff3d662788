"""The learned baseline: observation, action, policy file, training and Gymnasium environments."""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any, Final

ENVIRONMENT_ID: Final = "fastmimic/Imitation-v0"


def register() -> None:
    """Registers `ENVIRONMENT_ID` with Gymnasium, once."""
    import gymnasium

    if ENVIRONMENT_ID not in gymnasium.registry:
        one, several = (f"fastmimic.learning.environment:{name}" for name in ("ImitationEnv", "ImitationVectorEnv"))
        gymnasium.register(ENVIRONMENT_ID, entry_point=one, vector_entry_point=several)


def register_when_imported() -> None:
    """Registers now if Gymnasium is imported already, else right after its import."""
    if "gymnasium" in sys.modules:
        register()
    else:
        sys.meta_path.insert(0, _AfterImport())


class _AfterImport(MetaPathFinder):
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: Any = None) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            register()

        spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec
