"""`fastmimic play`: a live simulated robot in the browser, playing motions or steered."""

import signal
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional

from fastmimic.base.progress import slow_start
from fastmimic.commands import options as opt
from fastmimic.commands.console import on_signal
from fastmimic.commands.pictures import serve
from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.robot import load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.simulation.conditions import Conditions


@opt.told
@dataclass(frozen=True, kw_only=True)
class Play:
    """Simulates a robot under the controller live in the browser. Switch motions or steer, push the robot, change
    friction and payload, by mouse, keyboard or gamepad. A robot that falls gets up again.

    The server answers this machine's browsers only, at the whole address that it prints; Ctrl-C ends it.
    """

    motions: Annotated[Positional[tuple[str, ...]], opt.option("[MOTION|RUN ...]")] = ()
    robot: opt.RobotChoice = None
    port: opt.Port = 8080
    method: Annotated[str, opt.shared("NAME", "first method")] = "mbc"
    config: opt.ConfigName = "default"
    observe: opt.Observation = "truth"
    disturb: opt.Disturbances = ()
    seed: int = 0
    ideal: opt.Ideal = False
    terrain: opt.TerrainName = None
    steered: Annotated[opt.SteeredBy, OmitArgPrefixes]

    def run(self) -> int:
        from fastmimic.viewer.viewer import free_port, require_viser

        require_viser()
        free_port(self.port)  # before the motions are loaded
        from fastmimic.play.page import PlayPage
        from fastmimic.play.session import DEFAULTS, LiveSession, check_method, load_motions
        from fastmimic.reference.motion_set import MotionSet, warm_up

        check_method(self.method)
        config = controller_config(self.config)
        conditions = opt.apply(Conditions, self, disturbances=opt.joined(self.disturb))
        self.steered.check(self.motions == (opt.STEER,))
        if self.motions == (opt.STEER,):
            return self._steered(config, conditions)
        sources = [find_motion(source) for source in self.motions or DEFAULTS]
        name = opt.robot_name(self.robot, *sources)
        robot = load_robot(name)
        # transitions take about a second each: another process makes them, so that the simulation keeps real time
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            with on_signal(signal.SIG_IGN, signal.SIGINT):  # it ignores Ctrl-C from its first moment on: we handle it
                executor.submit(warm_up, name)  # while this process loads
            with slow_start():
                motions = load_motions(sources, robot)
                library = MotionSet(robot, motions, executor=executor, source=name, regulator=config.regulator)
                session = LiveSession(robot, library, method=self.method, config=config, conditions=conditions)
            try:
                with PlayPage(session, f"{robot.name}, live", self.port) as page:
                    return serve(page, ", ".join(library.names), self.port)
            finally:
                # waits: the interpreter's own exit does not close the pool safely
                executor.shutdown(cancel_futures=True)

    def _steered(self, config: ControllerConfig, conditions: Conditions) -> int:
        from fastmimic.play.page import PlayPage
        from fastmimic.play.session import LiveSession

        with self.steered.opened() as commands:
            gaits = self.steered.gaits(self.robot)
            with slow_start():
                session = LiveSession(
                    gaits.robot, {}, method=self.method, config=config, conditions=conditions, gaits=gaits
                )
            with PlayPage(session, f"{gaits.robot.name}, steered", self.port, commands) as page:
                return serve(page, " and ".join(self.steered.gait) or opt.STEER, self.port)
