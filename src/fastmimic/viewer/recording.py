"""Takes as one HTML page that plays them in 3D: viser's client and a recording of its scene, self-contained."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from fastmimic.robot import Robot
from fastmimic.viewer.scene import LAYERS, line_up
from fastmimic.viewer.web import FRAMES_PER_S, aim_at_first, default_camera, start_server, stop_server

if TYPE_CHECKING:
    from fastmimic.viewer.take import Take

SHOWN: Final = ("ghost", "contacts", "paths")  # layers at first; the scene tree switches others on
LONGEST_S: Final = 10.0


def recorded_page(robot: Robot, takes: Sequence["Take"], names: Sequence[str], longest_s: float = LONGEST_S) -> str:
    """A page with robots side by side that repeat their takes. While recording, a server runs on loopback.

    Args:
        takes: at one rate; the shorter ones stay at their ends.
        names: of each in the scene tree, without slashes.
        longest_s: limit of the recording, s.

    Raises:
        ConfigError: viser is not installed or too old, or no port is free.
    """
    server = start_server()
    try:
        robots = line_up(server, robot, takes, names=names)
        for name, scene in zip(names, robots, strict=True):
            for layer in LAYERS:
                scene.set_layer(layer, layer in SHOWN)
            # the robot stays in its place: its title need not move, which labels do late on a slow machine
            above = (0.0, scene.aside, robot.home_height + 0.6 * robot.leg_length)
            server.scene.add_label(f"/title/{name}", scene.take.title, position=above, anchor="bottom-center")
        aim_at_first(server, default_camera(robot, [scene.aside for scene in robots], float(takes[0].heading[0])))
        rate_hz = takes[0].rate_hz
        last = min(max(take.rows for take in takes), round(longest_s * rate_hz))
        stride = max(1, round(rate_hz / FRAMES_PER_S))
        serializer = server.get_scene_serializer()
        for row in range(0, last, stride):
            for scene in robots:
                scene.show(row, follow=True)
            serializer.insert_sleep(stride / rate_hz)
        return str(serializer.as_html())
    finally:
        stop_server(server)
