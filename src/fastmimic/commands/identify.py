"""`fastmimic identify`: estimates friction and payload from the log of a run."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from fastmimic.commands import options as opt
from fastmimic.commands.console import put, put_table
from fastmimic.robot import ROBOT_CHOICES

if TYPE_CHECKING:
    from fastmimic.episode.run_log import RunLog
    from fastmimic.identification.identify import Identification


@dataclass(frozen=True, kw_only=True)
class Identify:
    """Estimates the ground's friction and the trunk's payload from a logged run; the result holds for all motions.

    'fastmimic evaluate MOTION --observe sensors --log FILE.npz' and 'fastmimic deploy' write such a log: sensor
    readings, commands and estimates. The result is a controller configuration for --config FILE.json of other verbs.
    """

    log: Annotated[Positional[Path], opt.option("LOG.npz")]
    """Log of a run of a few seconds."""
    robot: Annotated[
        str | None, opt.option("NAME|FILE.xml", f"{ROBOT_CHOICES}, without payload. Default: the log's robot.")
    ] = None
    unloaded: Annotated[Path | None, opt.option("LOG.npz")] = None
    """Log of the same robot without payload; it cancels the gain errors of the sensors."""
    config: opt.ConfigName = "default"
    out: Annotated[Path | None, opt.option("FILE.json")] = None
    """File of the configuration. Default: it is not written."""

    def run(self) -> int:
        """Prints what was identified; returns the exit status."""
        from fastmimic.base.errors import LogError
        from fastmimic.control.config import controller_config
        from fastmimic.identification.identify import identify
        from fastmimic.robot import load_robot

        if self.out is not None:
            opt.check_writable(self.out, ".json")
        config = controller_config(self.config)
        log = _run_log(self.log)
        unloaded = None if self.unloaded is None else _run_log(self.unloaded)
        robot = load_robot(self.robot or log.robot)
        try:
            found = identify(log, robot, unloaded)
        except LogError as error:
            raise LogError(f"{self.log}: {error}") from None
        put(f"{log.motion} on {log.robot}, {log.duration_s:g} s")
        put_table(_rows(found, found.stance_friction(config), config.stance.friction))
        if self.out is not None:
            found.save(self.out, self.config)
            put(f"controller parameters in {self.out}; use them by --config {self.out}")
        return 0


def _run_log(path: Path) -> "RunLog":
    """The log of a run, or the part of a deployment's log in which the motion ran."""
    from fastmimic.deploy.log import DeploymentLog, is_deployment_log
    from fastmimic.episode.run_log import RunLog

    return DeploymentLog.load(path).run_log() if is_deployment_log(path) else RunLog.load(path)


def _rows(found: "Identification", assumed: float, before: float) -> list[tuple[str, str]]:
    friction, payload = found.friction, found.payload
    if friction.value is None or friction.upper is None:
        said = f"at least {friction.lower:.2f}: no foot slid"
    else:
        said = (
            f"{friction.value:.2f} (95 %: {friction.lower:.2f} to {friction.upper:.2f}), from {friction.slides} slides"
        )
    changed = f"{before:g} as before" if assumed == before else f"{assumed:.2f} instead of {before:g}"
    rows = [("friction", said), ("  the controller assumes", changed)]
    if payload is None:
        return [*rows, ("payload", "unknown: the feet never stood long enough")]
    weighed = f"{payload.mass:.2f} kg (95 %: {payload.lower:.2f} to {payload.upper:.2f})"
    if not payload.tared:
        weighed += "; --unloaded LOG of a run without payload narrows the interval"
    taken = f"{payload.certain:.2f} kg" if payload.certain > 0 else "no payload: the interval includes 0"
    return [*rows, ("payload", weighed), ("  the controller assumes", taken)]
