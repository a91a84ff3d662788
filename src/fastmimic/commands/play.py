"""`fastmimic play`: the robot live in the browser, steered by hand."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Annotated

from tyro.conf import Positional, arg

from fastmimic.commands.console import slow_start
from fastmimic.commands.serving import serve
from fastmimic.robot import ROBOT_CHOICES


@dataclass(frozen=True, kw_only=True)
class Play:
    """Simulates a robot under the controller live in the browser: other motions, speed, turn, swing height, pushes,
    friction and payload while it runs, by mouse, keyboard or gamepad. If it falls it gets up and goes on.

    The server listens on this machine only (127.0.0.1); Ctrl-C ends it.
    """

    motions: Annotated[Positional[tuple[str, ...]], arg(metavar="[MOTION|RUN ...]")] = ()
    """Names of 'fastmimic motions', clips, robot motions (.npz) or folders of runs that repeat; by default built-in
    gaits. "stand" and "in-place" are always there."""
    robot: Annotated[
        str | None,
        arg(metavar="NAME|FILE.xml", help=f"{ROBOT_CHOICES}; by default a1, or the robot of the first robot motion."),
    ] = None
    port: Annotated[int, arg(metavar="PORT")] = 8080
    """Where to listen; if it is taken, the next one that is free."""
    method: Annotated[str, arg(metavar="NAME")] = "mbc"
    """The controller to begin with: mbc, lh, raibert."""
    config: Annotated[str, arg(metavar="default|robust|paper|FILE")] = "default"
    """The controller's parameters."""

    def run(self) -> int:
        """Serves until Ctrl-C; returns the exit status."""
        from fastmimic.viewer.web import free_port, require_viser

        require_viser()
        free_port(self.port)  # a port that cannot be is no reason to load motions first
        from fastmimic.commands.options import DEFAULT_ROBOT
        from fastmimic.control.config import controller_config
        from fastmimic.play.motions import DEFAULTS, load_motions
        from fastmimic.play.page import PlayPage
        from fastmimic.play.session import LiveSession, check_method
        from fastmimic.reference.motion_set import MotionSet, warm_up
        from fastmimic.robot import load_robot
        from fastmimic.runs.loading import find_motion

        check_method(self.method)
        config = controller_config(self.config)
        sources = [find_motion(source) for source in self.motions or DEFAULTS]
        own = next((source.robot for source in sources if source.robot is not None), None)
        name = self.robot or own or DEFAULT_ROBOT
        robot = load_robot(name)
        # transitions take a second or so each: in another process, so that the simulation keeps its time
        with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_behind_the_scenes) as executor:
            executor.submit(warm_up, name)  # which starts, while this one is busy loading
            with slow_start():
                motions = load_motions(sources, robot)
                library = MotionSet(robot, motions, executor=executor, source=name)
                session = LiveSession(robot, library, method=self.method, config=config)
            try:
                with PlayPage(session, f"{robot.name}, live", self.port) as page:
                    return serve(page, ", ".join(library.names), self.port)
            finally:
                executor.shutdown(wait=False, cancel_futures=True)


def _behind_the_scenes() -> None:
    """Ctrl-C is for the process that serves."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
