"""The live robot in the viewer's scene, with pushes."""

from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.robot import Robot
from fastmimic.viewer.bodies import Puppet
from fastmimic.viewer.scene import RobotScene, linear

if TYPE_CHECKING:
    import viser

    from fastmimic.play.history import LiveHistory
    from fastmimic.viewer.take import Take

_GROUND: Final = (24.0, 24.0)
_PUSH_RGB: Final = (230, 120, 0)
_PUSH_S: Final = 0.6  # time that a push is shown
_LEAST_ARROW: Final = 0.5  # of the leg's length
_CLEAR_M: Final = 0.14  # the tip's distance from the trunk's middle


class LiveScene(RobotScene):
    """Follows a history instead of a take."""

    def __init__(self, server: "viser.ViserServer", robot: Robot, history: "LiveHistory") -> None:
        self._history = history
        super().__init__(server, "/live", robot, Puppet(robot), history.take(), 0.0, _GROUND)
        self._push_arrow = server.scene.add_arrows(
            "/live/push",
            np.array([[[0, 0, 0], [0, 0, 1e-3]]]),
            linear(np.array(_PUSH_RGB)),
            shaft_radius=0.012,
            head_radius=0.03,
            head_length=0.06,
            visible=False,
        )

    def set_take(self, take: "Take") -> None:
        """Shows another take, at the place that the history follows."""
        if not hasattr(self, "take") or take.title != self.take.title:
            self._title.text = take.title
        self.take = take
        self._path = np.broadcast_to(self._history.followed, (take.rows, 2))

    def show(self, row: int, *, follow: bool) -> None:
        """As `RobotScene.show`, with the push."""
        super().show(row, follow=follow)
        force = self._history.push(_PUSH_S)
        if force is not None:
            size = float(np.linalg.norm(force))
            arm = force / size * self._length * max(_LEAST_ARROW, size / self.take.weight)
            tip = self._history.now.pose[:3] - _CLEAR_M * force / size
            self._push_arrow.points = np.stack([tip - arm, tip])[None].astype(np.float32)
        self._push_arrow.visible = force is not None
