"""`fastmimic robots`: lists the built-in robots."""

from dataclasses import dataclass

from fastmimic.commands.console import note, put_table


@dataclass(frozen=True, kw_only=True)
class Robots:
    """Lists the built-in robots. For your own, give --robot FILE.xml, the MJCF of a quadruped."""

    def run(self) -> int:
        """Prints the list; returns the exit status."""
        from fastmimic.robot import ROBOT_NAMES, load_robot

        rows = [("name", "mass kg", "leg m", "torque N·m", "joint speed rad/s")]
        for name in ROBOT_NAMES:
            robot = load_robot(name)
            torque, speed = (
                " ".join(f"{v:g}" for v in limit[:3]) for limit in (robot.torque_limit, robot.joint_speed_limit)
            )
            rows.append((name, f"{robot.mass:.2f}", f"{robot.leg_length:.3f}", torque, speed))
        put_table(rows)
        note("your own: --robot FILE.xml, an MJCF with abduction, hip and knee joints in each of four legs")
        return 0
