"""The table of figures before and after that `imitate` prints."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from fastmimic.commands.console import table

if TYPE_CHECKING:
    from fastmimic.pipeline import Imitation


def comparison(result: "Imitation") -> list[str]:
    """Lines for a human; the figures are those of `metrics.json`."""
    metrics = result.metrics()
    optimised = result.history is not None
    columns = ("before", "after") if optimised else ("before",)
    rows = [["", *(columns if optimised else ("not optimised",))]]

    def row(name: str, value: Callable[[str], Any], form: Callable[[Any], str]) -> None:
        rows.append([name, *("–" if value(c) is None else form(value(c)) for c in columns)])

    reward, clearance = metrics["reward"], metrics["swing_clearance_m"]
    row("reward", lambda c: reward[c], "{:.3f}".format)
    for term in reward["components_before"]:
        row(f"  {term.replace('_', ' ')}", lambda c, t=term: reward[f"components_{c}"][t], "{:.3f}".format)
    row("fell", lambda c: metrics["fell"][c], lambda fell: "yes" if fell else "no")
    wanted = clearance["demonstration"]
    row("swing clearance, least share", lambda c: least_share(clearance[c], wanted), "{:.0%}".format)
    row("drift, m/s", lambda c: metrics["drift_m_per_s"][c], "{:.3f}".format)
    row("early contacts, 1/s", lambda c: metrics["early_contacts_per_s"][c], "{:.1f}".format)
    for name in ("stance_slip", "foot_z_rmse", "foot_x_rmse"):
        row(
            f"{name.replace('_', ' ')}, mm",
            lambda c, n=name: metrics[f"{n}_m"][c],
            lambda m: f"{1e3 * m:.1f}",
        )
    lines = table(rows, right=range(1, len(rows[0])))
    return [f"{result.motion.name} on {result.robot.name}, {result.duration_s:g} s", *lines, _effort(metrics)]


def least_share(realised: list[float | None], wanted: list[float | None]) -> float | None:
    """The smallest share of the demonstration's swing clearance among the legs that swing."""
    shares = [r / w for r, w in zip(realised, wanted, strict=True) if r is not None and w]
    return min(shares) if shares else None


def _effort(metrics: dict[str, Any]) -> str:
    done = f"{metrics['simulated_s']:.0f} s simulated in {metrics['wall_s']:.1f} s"
    if not metrics["evaluations"]:
        return done
    return f"{metrics['evaluations']} episodes in {metrics['iterations']} iterations, {done}"
