"""Runs what a Markdown file shows: each fenced block that follows the line `<!-- run -->`, bash and python, in order.

    python .ci/readme.py README.md FOLDER

All blocks run in FOLDER, which is made, with stand-ins for the reader's own files in it: `my_dog.txt`, `my_robot.xml`.
"""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

import fastmimic as fm

BLOCK = re.compile(r"^<!-- run -->\n```(bash|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INTERPRETERS = {"bash": ["bash", "-euo", "pipefail", "-c"], "python": [sys.executable, "-c"]}
COLUMN_OF_POINT = (0, 3, 11, 6, 20, 16, 15, 10, 23, 19)
"""Which of a dog file's 27 points each of `POINT_NAMES` is."""


def main(source: Path, folder: Path) -> None:
    blocks = BLOCK.findall(source.read_text(encoding="utf-8"))
    if not blocks:
        sys.exit(f"{source}: no block follows '<!-- run -->'")
    folder.mkdir(parents=True, exist_ok=True)
    write_dog(folder / "my_dog.txt", cycles=3)
    (folder / "my_robot.xml").write_text(fm.load_robot("go1").spec().to_xml(), encoding="utf-8")
    for language, code in blocks:
        sys.stdout.write(f"-- {language}\n{code}")
        sys.stdout.flush()
        subprocess.run([*INTERPRETERS[language], code], cwd=folder, check=True)


def write_dog(path: Path, cycles: int) -> None:
    """Writes several cycles of a built-in walk as a keypoint file: 60 frames a second, y up."""
    clip = fm.open_clip("walk")  # straight ahead along x, one cycle
    points = clip.points_w[:: round(clip.rate_hz / 60)]
    travel = float(np.mean(np.diff(points[:, 0, 0]))) * len(points)
    values = np.zeros((cycles, len(points), 27, 3))
    for cycle in range(cycles):
        moved = points + cycle * np.array([travel, 0.0, 0.0])
        values[cycle][:, COLUMN_OF_POINT] = moved[..., [1, 2, 0]]  # (x, y, z) here is (z, x, y) there
    np.savetxt(path, values.reshape(-1, 81), fmt="%.6f", delimiter=",")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
