"""The table of figures before and after that `imitate` prints."""

from typing import TYPE_CHECKING, Any, Final

from fastmimic.commands.console import table

if TYPE_CHECKING:
    from fastmimic.imitation.imitate import Imitation

NONE: Final = "–"
MILLIMETRES: Final = ("stance_slip_m", "foot_z_rmse_m", "foot_x_rmse_m")


def comparison(result: "Imitation") -> list[str]:
    """Lines for a human; the figures are those of `metrics.json`."""
    metrics = result.metrics()
    columns = {"before": "before", "after": "after"} if result.history is not None else {"before": "not optimised"}
    cells = {column: _column(metrics, column) for column in columns}
    names = list(cells["before"])
    rows = [["", *columns.values()], *([name, *(cells[c][name] for c in columns)] for name in names)]
    lines = table(rows, right=range(1, len(rows[0])))
    return [f"{result.motion.name} on {result.robot.name}, {result.duration_s:g} s", *lines, _effort(metrics)]


def least_share(realised: list[float | None], wanted: list[float | None]) -> float | None:
    """The smallest share of the demonstration's swing clearance among the legs that swing."""
    shares = [r / w for r, w in zip(realised, wanted, strict=True) if r is not None and w]
    return min(shares) if shares else None


def _column(metrics: dict[str, Any], column: str) -> dict[str, str]:
    """One column: what each row shows."""
    reward, clearance = metrics["reward"], metrics["swing_clearance_m"]
    share = least_share(clearance[column], clearance["demonstration"])
    cells = {"reward": f"{reward[column]:.3f}"}
    if "randomization" in metrics:
        others = metrics["randomization"]["held_out"]
        over = others[column]
        cells[f"  over {others['robots']} other robots"] = f"{over['mean']:.3f}"
        cells["  with the worst of them"] = f"{over['worst']:.3f}"
    for term, value in reward[f"components_{column}"].items():
        cells[f"  {term.replace('_', ' ')}"] = f"{value:.3f}"
    cells["fell"] = "yes" if metrics["fell"][column] else "no"
    if "randomization" in metrics:
        cells["  of the other robots"] = f"{metrics['randomization']['held_out'][column]['fell']:.0%}"
    cells["swing clearance, least share"] = NONE if share is None else f"{share:.0%}"
    cells["drift, m/s"] = f"{metrics['drift_m_per_s'][column]:.3f}"
    cells["early contacts, 1/s"] = f"{metrics['early_contacts_per_s'][column]:.1f}"
    for name in MILLIMETRES:
        cells[f"{name.removesuffix('_m').replace('_', ' ')}, mm"] = f"{1e3 * metrics[name][column]:.1f}"
    return cells


def _effort(metrics: dict[str, Any]) -> str:
    done = f"{metrics['simulated_s']:.0f} s simulated in {metrics['wall_s']:.1f} s"
    if not metrics["evaluations"]:
        return done
    return f"{metrics['evaluations']} episodes in {metrics['iterations']} iterations, {done}"
