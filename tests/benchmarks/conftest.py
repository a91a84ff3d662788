"""Modules of `benchmarks/`, importable by name; the folder is not on the path, as others there are named like tests."""

import sys
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
NAMES = (
    *("fuzz_cases", "fuzz_files", "learning_cost", "learning_cost_figure", "docs_table", "motion_survey"),
    *("readme_animation", "shares", "steer", "terrain"),
)


class _Finder:
    @staticmethod
    def find_spec(name: str, *_: Any) -> ModuleSpec | None:
        return spec_from_file_location(name, FOLDER / f"{name}.py") if name in NAMES else None


sys.meta_path.append(_Finder)  # type: ignore[arg-type]
