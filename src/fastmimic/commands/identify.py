"""`fastmimic identify`: friction and payload out of the log of a run."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from fastmimic.commands.console import put, table
from fastmimic.commands.options import check_writable
from fastmimic.robot import ROBOT_CHOICES

if TYPE_CHECKING:
    from fastmimic.episode.run_log import RunLog
    from fastmimic.identification.identify import Identification


@dataclass(frozen=True, kw_only=True)
class Identify:
    """Identifies the ground's friction and the trunk's payload from a logged run, for all motions of the robot.

    'fastmimic evaluate MOTION --observe sensors --log FILE.npz' and 'fastmimic deploy' write such a log: sensor
    readings, commands and estimates. The result is a configuration of the controller: give it to other commands with
    --config FILE.json.
    """

    log: Annotated[Positional[Path], arg(metavar="LOG.npz")]
    """Of a run of a few seconds."""
    robot: Annotated[
        str | None,
        arg(metavar="NAME|FILE.xml", help=f"{ROBOT_CHOICES}, without payload; by default the one that the log names."),
    ] = None
    unloaded: Annotated[Path | None, arg(metavar="LOG.npz")] = None
    """The log of the same robot without payload: it takes the gains of its sensors out of the payload."""
    config: Annotated[str, arg(metavar="default|robust|paper")] = "default"
    """The controller's parameters that the result changes."""
    out: Annotated[Path | None, arg(metavar="FILE.json")] = None
    """Where the configuration goes; nothing is written without."""

    def run(self) -> int:
        """Prints what was identified; returns the exit status."""
        from fastmimic.base.errors import LogError
        from fastmimic.control.config import controller_config
        from fastmimic.identification.identify import identify
        from fastmimic.robot import load_robot

        if self.out is not None:
            check_writable(self.out, ".json")
        config = controller_config(self.config)
        log = _run_log(self.log)
        unloaded = None if self.unloaded is None else _run_log(self.unloaded)
        robot = load_robot(self.robot or log.robot)
        try:
            found = identify(log, robot, unloaded)
        except LogError as error:
            raise LogError(f"{self.log}: {error}") from None
        put(f"{log.motion} on {log.robot}, {log.duration_s:g} s")
        for line in table(_rows(found, found.stance_friction(config), config.stance.friction)):
            put(line)
        if self.out is not None:
            found.save(self.out, self.config)
            put(f"the controller's parameters in {self.out}: give it to other commands as --config {self.out}")
        return 0


def _run_log(path: Path) -> "RunLog":
    """The log of a run, or what a deployment's log has of the motion itself."""
    from fastmimic.deploy.log import DeploymentLog, is_deployment_log
    from fastmimic.episode.run_log import RunLog

    return DeploymentLog.load(path).run_log() if is_deployment_log(path) else RunLog.load(path)


def _rows(found: "Identification", assumed: float, before: float) -> list[tuple[str, str]]:
    friction, payload = found.friction, found.payload
    if friction.value is None or friction.upper is None:
        said = f"at least {friction.lower:.2f}: no foot slid, so there is no more to say"
    else:
        said = (
            f"{friction.value:.2f} (95 %: {friction.lower:.2f} to {friction.upper:.2f}), from {friction.slides} slides"
        )
    changed = f"{before:g} as before" if assumed == before else f"{assumed:.2f} instead of {before:g}"
    rows = [("friction", said), ("  the controller assumes", changed)]
    if payload is None:
        return [*rows, ("payload", "not weighed: the feet never stood long enough")]
    weighed = f"{payload.mass:.2f} kg (95 %: {payload.lower:.2f} to {payload.upper:.2f})"
    if not payload.tared:
        weighed += "; --unloaded LOG of a run without payload narrows that"
    taken = f"{payload.certain:.2f} kg" if payload.certain > 0 else "none: the interval does not begin above 0"
    return [*rows, ("payload", weighed), ("  the controller is told", taken)]
