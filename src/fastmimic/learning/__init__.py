"""The learned baseline: observation, action, policy file, training and Gymnasium environments."""

import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Final

ENVIRONMENT_ID: Final = "fastmimic/Imitation-v0"


def register() -> None:
    """Registers `ENVIRONMENT_ID` with Gymnasium, once; `import fastmimic` calls it."""
    import gymnasium

    if ENVIRONMENT_ID not in gymnasium.registry:
        gymnasium.register(
            ENVIRONMENT_ID,
            entry_point="fastmimic.learning.environment:ImitationEnv",
            vector_entry_point="fastmimic.learning.environment:ImitationVectorEnv",
        )


class AfterImport(MetaPathFinder):
    """Calls `call` now if the top-level package `name` is imported already, else right after its import."""

    def __init__(self, name: str, call: Callable[[], None]) -> None:
        self._name, self._call = name, call
        if name in sys.modules:
            call()
        else:
            sys.meta_path.insert(0, self)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self._name:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_and_call(module: ModuleType) -> None:
            load(module)
            self._call()

        spec.loader.exec_module = load_and_call  # type: ignore[method-assign]
        return spec
