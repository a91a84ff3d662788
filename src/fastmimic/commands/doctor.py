"""Verb `doctor`: what works on this machine."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final

from fastmimic.base.errors import DriverError, OutputError
from fastmimic.base.machine import available_cores, versions
from fastmimic.commands.console import put, put_json, put_table

_EXTRAS: Final = ("view", "pybullet", "rl", "formats", "library", "ray", "go2")
_NEEDED: Final = re.compile(r"""^([\w.-]+).*extra == ['"]([\w-]+)['"]""")


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Tries what runs need on this machine, and says what to install or to allow for the rest.

    Exit status 0, also where something is missing: every verb says by itself what it lacks.
    """

    json: bool = False  # Print one JSON object: what was tried, whether it works, and why not.

    def run(self) -> None:
        checks: dict[str, Callable[[], str]] = {
            "compiled controller": _cache,
            "pictures and videos": _drawing,
            "video encoder": _encoder,
            "recordings": _recordings,
            "real-time scheduling": _real_time,
            "the Go2's wire": _wire,
        }
        found = {name: _tried(check) for name, check in checks.items()}
        found |= {f"extra {name}": _installed(name, packages) for name, packages in _extras().items()}
        if self.json:
            tried = {name: {"works": works, "said": said} for name, (works, said) in found.items()}
            return put_json({"cores": available_cores(), "versions": versions(), "checks": tried})
        put(", ".join(f"{name} {version}" for name, version in versions().items()) + f"; {available_cores()} cores")
        put_table([(name, "works" if works else "no", said) for name, (works, said) in found.items()])


def _tried(check: Callable[[], str]) -> tuple[bool, str]:
    try:
        return True, check()
    except (OutputError, DriverError) as error:
        return False, " ".join(str(error).split())


def _cache() -> str:
    """Where Numba keeps what it has compiled: a folder that cannot be written means compiling at every start."""
    from fastmimic.control.controller import control_step

    cache = getattr(control_step, "_cache", None)
    if cache is None:
        raise OutputError("NUMBA_DISABLE_JIT is set: the controller runs as Python, some hundred times as slowly")
    if cache.cache_path is None:
        raise OutputError("no folder can be written: every start compiles anew; set NUMBA_CACHE_DIR")
    folder = Path(cache.cache_path)
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        raise OutputError(f"{folder} cannot be written: every start compiles anew; set NUMBA_CACHE_DIR")
    return f"kept in {folder}" if any(folder.glob("*.nbc")) else f"to be compiled on first use, into {folder}"


def _drawing() -> str:
    import mujoco

    from fastmimic.render.offscreen import NoRendererError, Offscreen, backends

    try:
        Offscreen(mujoco.MjModel.from_xml_string("<mujoco/>")).close()
    except NoRendererError as error:
        raise OutputError(f"{error}; on Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri") from None
    return f"OpenGL by {' or '.join(backends())}"


def _encoder() -> str:
    from fastmimic.render.encoding import ffmpeg

    return ffmpeg()


def _recordings() -> str:
    from fastmimic.clips.data import data_folder, list_datasets

    datasets = list_datasets()
    here, all_files = sum(len(names) for _, names in datasets), sum(len(data.files) for data, _ in datasets)
    if here < all_files:
        raise OutputError(f"{here} of {all_files} files in {data_folder()}: 'fastmimic data fetch' downloads the rest")
    return f"{here} files in {data_folder()}"


def _real_time() -> str:
    from fastmimic.deploy.computer import undisturbed

    with undisturbed(real_time=True) as refused:
        pass
    if refused:
        raise DriverError("; ".join(refused))
    return "permitted, with locked memory"


def _wire() -> str:
    from fastmimic.deploy.dds.cyclone import LOOPBACK, MAX_DOMAIN, Participant

    Participant(MAX_DOMAIN).close()
    return f"CycloneDDS opens a domain on {LOOPBACK}"


def _extras() -> dict[str, list[str]]:
    """The extras of users, each with the packages that it installs."""
    found: dict[str, list[str]] = {name: [] for name in _EXTRAS}
    for line in metadata.requires("fastmimic") or []:
        needed = _NEEDED.match(line)
        if needed is not None and needed[2] in found:
            found[needed[2]].append(needed[1])
    return found


def _installed(extra: str, packages: list[str]) -> tuple[bool, str]:
    here, missing = [], []
    for name in packages:
        try:
            here.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        return False, f"{', '.join(missing)} missing: pip install 'fastmimic[{extra}]'"
    return True, ", ".join(here)
