"""`fastmimic play`: simulates the robot live in the browser, steered by hand."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Annotated

from tyro.conf import Positional

from fastmimic.commands import options as opt
from fastmimic.commands.console import slow_start
from fastmimic.commands.serving import serve


@dataclass(frozen=True, kw_only=True)
class Play:
    """Simulates a robot under the controller live in the browser. Switch motions, steer, change speed, yaw rate, swing
    height, friction and payload, and push the robot, by mouse, keyboard or gamepad. A robot that falls gets up again.

    The server listens on this machine only (127.0.0.1); Ctrl-C ends it.
    """

    motions: Annotated[Positional[tuple[str, ...]], opt.option("[MOTION|RUN ...]")] = ()
    """Periodic motions: names from 'fastmimic motions', clips, robot motions (.npz) or folders of runs. Default: the
    built-in gaits. "stand" and "in-place" are always available."""
    robot: opt.RobotChoice = None
    port: opt.Port = 8080
    method: Annotated[str, opt.option("NAME", lambda: f"Controller at the start: {opt.controllers()}.")] = "mbc"
    config: opt.ConfigName = "default"

    def run(self) -> int:
        """Serves until Ctrl-C; returns the exit status."""
        from fastmimic.viewer.web import free_port, require_viser

        require_viser()
        free_port(self.port)  # before the motions are loaded
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
        name = self.robot or own or opt.DEFAULT_ROBOT
        robot = load_robot(name)
        # transitions take about a second each: another process makes them, so that the simulation keeps real time
        with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_behind_the_scenes) as executor:
            executor.submit(warm_up, name)  # while this process loads
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
    """Ignores Ctrl-C: the serving process handles it."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
