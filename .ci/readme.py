"""Runs what Markdown pages show: every fenced bash and python block, in order.

    python .ci/readme.py FOLDER README.md docs/*.md

All blocks run in FOLDER, with stand-ins for the reader's files and a `fastmimic` that keeps searches short. Servers,
long commands and those on a real robot, on data that is not there or on placeholders are only parsed. A block after
the line `<!-- not run: reason -->` is skipped. The first command with a wrong exit status ends the run.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

import fastmimic as fm

BLOCK = re.compile(r"^(?:<!-- not run: (.+) -->\n)?```(bash|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NOT_OURS = re.compile(r"^(?:pip|make|git|sudo|python|cd|\.ci/run|sbatch|tensorboard)\b.*$", re.MULTILINE)
COLUMN_OF_POINT = (0, 3, 11, 6, 20, 16, 15, 10, 23, 19)
"""Which of a dog file's 27 points each of `POINT_NAMES` is."""
STAND_IN = """#!{python}
import os, sys
from fastmimic import cli

arguments = sys.argv[1:]
verb, rest = arguments[0], arguments[1:]
long = verb in ("view", "play", "robot-sim", "data", "train", "compare", "stress", "transfer", "library")
long = long or ("--driver" in rest and rest[rest.index("--driver") + 1] != "sim") or "--policy" in rest
long = long or "pybullet" in rest
data = os.path.isdir(os.environ.get("FASTMIMIC_DATA", ""))
missing = not data and any(word.startswith(("dog:", "anim:")) for word in rest)
missing = missing or any(
    word.startswith("runs/") and before != "--out" and not os.path.exists(word)
    for before, word in zip(arguments, rest)
)
placeholder = any(word in text for text in rest for word in ("NAME", "MOTION", "CLIPS", "\\u2026"))
if long or missing or placeholder:
    from fastmimic.base.extensions import load_extensions

    load_extensions()
    cli.VERBS[verb]
    try:
        cli._parse(verb, rest)
    except cli._UsageError as error:
        sys.exit(f"{{verb}}: {{error}}")
    sys.exit(print("(parsed only)", flush=True))
if verb in ("imitate", "stitch"):
    for name, value in (("--iterations", "2"), ("--population", "4")):
        if name in rest:
            rest[rest.index(name) + 1] = value
        else:
            rest += [name, value]
    rest += [] if "--no-video" in rest else ["--no-video"]
of_log = any(word.endswith("log.npz") for word in rest)  # is scored as long as it is
if verb in ("evaluate", "render") and "--duration" not in rest and not of_log:
    rest += ["--duration", "1.5" if "--log" in rest else "0.5"]
if verb == "deploy":
    rest += ["--lock-step", "--duration", "1.5"]
sys.exit(cli.main([verb, *rest]))
"""


def main(folder: Path, pages: list[Path]) -> None:
    tools = folder.resolve() / "bin"
    tools.mkdir(parents=True, exist_ok=True)
    stand_in = tools / "fastmimic"
    stand_in.write_text(STAND_IN.format(python=sys.executable))
    stand_in.chmod(0o755)
    write_dog(folder / "my_dog.txt", cycles=3)
    for name in ("my_take.txt", "take.txt", "my_animal.txt"):
        write_dog(folder / name, cycles=12)
    np.save(folder / "points.npy", fm.open_clip("walk").points_w)
    (folder / "my_robot.xml").write_text(fm.load_robot("go1").spec().to_xml(), encoding="utf-8")
    environment = os.environ | {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    for page in pages:
        for reason, language, code in BLOCK.findall(page.read_text(encoding="utf-8")):
            if reason:
                say(f"-- {page}: not run: {reason}\n")
                continue
            if language == "bash":
                command = ["bash", "-euo", "pipefail", "-c", NOT_OURS.sub("", code)]
            else:
                command = [sys.executable, "-c", code]
            say(f"-- {page}: {language}\n{code}")
            if done := subprocess.run(command, cwd=folder, env=environment, check=False).returncode:
                sys.exit(f"{page}: a block ends with status {done}")


def say(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


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
    main(Path(sys.argv[1]), [Path(page) for page in sys.argv[2:]])
