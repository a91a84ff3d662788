"""What `metrics.json` says of each episode of a run, for the terminal and the report."""

from collections.abc import Mapping
from typing import Any, Final

from fastmimic.base.files import packaged

FIGURES: Final = packaged("fastmimic.report", "figures.json", tuple[tuple[str, str, int, float], ...])
"""Label, name in `metrics.json`, digits, scale."""


def run_columns(metrics: Mapping[str, Any]) -> dict[str, str]:
    """The episodes of a run by their names in `metrics.json` ("kinematic", "before", "after"), with their titles."""
    executable = {"kinematic": "kinematic", "before": "executable"}
    columns = executable if "kinematic" in metrics else {"before": "as retargeted"}
    if parameters := metrics["parameters"]:
        gained = any(parameter["value"] != parameter["initial"] for parameter in parameters)
        columns |= {"after": "optimised" if gained else "fitted"}
    return columns


def figure_key(name: str, column: str) -> str:
    """Where `metrics.json` has a figure of an episode, such as `reward.before` or `kinematic.components.pose`; `name`
    is that of `evaluate --json`, or of a part such as `components.pose`."""
    if column == "kinematic":
        return f"kinematic.{'reward_mean' if name == 'reward_animal' else name}"
    first, *rest = name.split(".")
    if first == "components":
        return ".".join((f"reward.components_{column}", *rest))
    return ".".join(("reward" if first == "reward_mean" else first, column, *rest))


def figure_of(metrics: Mapping[str, Any], key: str) -> Any:
    """A figure by its path, such as `swing_clearance_m.after.2`; None if missing."""
    found: Any = metrics
    for name in key.split("."):
        if isinstance(found, list):
            found = found[int(name)] if int(name) < len(found) else None
        else:
            found = found.get(name) if isinstance(found, dict) else None
    return found
