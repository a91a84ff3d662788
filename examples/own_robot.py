"""Uses your own robot: any MJCF of a quadruped with abduction, hip and knee joints in four legs.

    python examples/own_robot.py [ROBOT.xml] [--fast]

Without a file it makes one: an A1 that carries 2 kg.
"""

import sys
import tempfile
from pathlib import Path

import fastmimic as fm


def loaded_a1(folder: str) -> Path:
    """Writes the MJCF of an A1 whose trunk carries 2 kg."""
    spec = fm.load_robot("a1").spec()
    spec.modelname = "a1-with-payload"
    spec.body("trunk").mass += 2.0
    path = Path(folder) / "robot.xml"
    path.write_text(spec.to_xml())
    return path


files = [a for a in sys.argv[1:] if a.endswith(".xml")]
with tempfile.TemporaryDirectory() as folder:
    robot = fm.load_robot(files[0] if files else loaded_a1(folder))
print(f"{robot.name}: {robot.mass:.2f} kg, legs {robot.leg_length:.3f} m, joints {', '.join(robot.joint_names)}")
for sentence in robot.assumed:
    print(f"assumed: {sentence}")

result = fm.imitate("pace", robot, iterations=3 if "--fast" in sys.argv else 200)
print(f"pace: reward {result.before.reward[0]:.3f} before, {result.after.reward[0]:.3f} after")
