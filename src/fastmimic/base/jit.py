"""How kernels are compiled: cached, without the GIL, IEEE arithmetic."""

import contextlib
import enum
import functools
import gc
import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.files import user_cache


def kernel(function: Callable[..., Any], **changed: bool) -> Callable[..., Any]:
    """Compiles `function` with Numba: no GIL, cached on disk, no fast-math (results must not depend on the machine). It
    may not allocate: no references are counted. `changed` are more options. `NUMBA_DISABLE_JIT=1` runs it as Python."""
    from numba import njit  # slow to import; modules that only need `record_dtype` do without

    _collect_no_garbage_meanwhile()
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
    lean = {"no_cfunc_wrapper": True, "_nrt": False}  # neither function pointers nor reference counts: less to compile
    try:
        compiled = njit(**options | lean | changed)(function)
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        return njit(**options | lean | changed | {"cache": False})(function)  # no folder can be written
    return _stale_with_callees(compiled)


inlined: Final = functools.partial(kernel, forceinline=True)
"""Like `kernel`, for small functions that LLVM should inline into their callers."""
object_kernel: Final = functools.partial(kernel, _nrt=True)
"""Like `kernel`, for functions that call Python (`numba.objmode`)."""


_compiled: list[str] = []  # names of the kernels that were not in the cache


def kernels_compiled() -> int:
    """How many kernels this process has compiled, the present one included; those read from the cache do not count."""
    return len(_compiled)


@functools.cache
def _collect_no_garbage_meanwhile() -> None:
    """While a kernel is compiled: that makes many objects, and looking through all would take a sixth of the time."""
    from numba.core import event

    class Pause(event.Listener):
        kernels, resumes = 0, False  # being compiled, one calling the other; whether garbage was collected before

        def on_start(self, event: Any) -> None:
            _forget_old()
            _compiled.append(event.data["dispatcher"].py_func.__name__)
            if self.kernels == 0:
                self.resumes = gc.isenabled()
                gc.disable()
            self.kernels += 1

        def on_end(self, event: Any) -> None:
            self.kernels -= 1
            if self.kernels == 0 and self.resumes:
                gc.enable()

    event.register("numba:compile", Pause())


def record_dtype(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """A structured type for kernels: aligned, its fields attributes (`np.record`) also where the JIT is off."""
    return np.dtype((np.record, np.dtype(fields, align=True)))


def _fields(kind: str, /, **shapes: int | tuple[int, ...]) -> list[tuple[Any, ...]]:
    """Fields of a record, each by name with its shape: a length, or () for one number."""
    return [(name, kind, (shape,) if isinstance(shape, int) else shape) for name, shape in shapes.items()]


floats: Final = functools.partial(_fields, "f8")  # of real numbers
integers: Final = functools.partial(_fields, "i8")  # of whole numbers


def depends_on(compiled: Callable[..., Any], *files: str, made_of: frozenset[bytes] = frozenset()) -> None:
    """Makes the cache of a kernel, and of those decorated later that call it, stale when one of `files` changes, or one
    of the parts that it is `made_of`."""
    function: Any = getattr(compiled, "py_func", compiled)
    function.made_of = getattr(function, "made_of", frozenset()) | made_of | {_content(file) for file in files}
    cache = getattr(compiled, "_cache", None)
    if hasattr(cache, "_cache_file"):
        _keep(cache, hashlib.sha256(b"".join(sorted(function.made_of))).hexdigest())


def _keep(cache: Any, digest: str) -> None:
    """Keeps compiled code under what it was compiled from, whichever installation that is: in the user's cache folder,
    or $NUMBA_CACHE_DIR; beside the modules, as Numba does, where neither can be written."""
    from numba.core.caching import IndexDataCacheFile

    folder = cache_folder()
    cache._cache_path = cache.cache_path if folder is None else str(folder)
    base = f"{cache._impl.filename_base}-{digest[:16]}"
    cache._cache_file = file = IndexDataCacheFile(cache._cache_path, base, digest)
    file._load_index = _tolerant(type(file)._load_index, file)  # type: ignore[method-assign]


@functools.cache
def cache_folder() -> Path | None:
    """The folder of all compiled code, or None where it cannot be written."""
    from numba import config

    folder = Path(config.CACHE_DIR or user_cache()) / "compiled"  # type: ignore[attr-defined]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


@functools.cache
def _forget_old() -> None:
    """Removes code from the cache that was not used for two months."""
    folder, before = cache_folder(), time.time() - 60 * 86400.0
    for file in folder.iterdir() if folder is not None else ():
        with contextlib.suppress(OSError):
            stat = file.stat()
            if max(stat.st_atime, stat.st_mtime) < before:
                file.unlink()


@functools.cache
def _content(file: str) -> bytes:
    return hashlib.sha256(Path(file).read_bytes()).digest()


_FROZEN: Final = (int, float, complex, str, tuple, np.ndarray, np.generic, enum.Enum)


def _constants(names: dict[str, Any]) -> frozenset[bytes]:
    """The values among a module's names that Numba may compile into its functions; other files may define them."""
    found = ((name, value) for name, value in names.items() if isinstance(value, _FROZEN) and not name.startswith("__"))
    return frozenset(
        f"{name}={value.dtype}{value.shape}".encode() + value.tobytes()
        if isinstance(value, np.ndarray)
        else f"{name}={value!r}".encode()
        for name, value in found
    )


def _tolerant(load_index: Callable[[Any], dict[Any, str]], cache_file: Any) -> Callable[[], dict[Any, str]]:
    """Reads a cache's index; empty where it names a module or type that an update removed. Numba would raise."""

    def load() -> dict[Any, str]:
        try:
            return load_index(cache_file)
        except (ImportError, AttributeError):
            return {}

    return load


def _stale_with_callees(compiled: Callable[..., Any]) -> Callable[..., Any]:
    """Makes a kernel's cache depend on its callees' files; Numba looks at its own file only and would run old code. All
    kernels that the module knows by now count as called, because later kernels of the module may call them."""
    function = getattr(compiled, "py_func", compiled)
    known = (getattr(value, "py_func", value) for value in function.__globals__.values() if callable(value))
    made_of = _constants(function.__globals__).union(*(getattr(f, "made_of", ()) for f in known))
    depends_on(compiled, function.__code__.co_filename, __file__, made_of=made_of)
    return compiled
