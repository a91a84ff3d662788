"""Runs what Markdown pages show: every fenced bash and python block, in order.

    python .ci/readme.py FOLDER README.md docs/*.md

All blocks run in FOLDER, with stand-ins for the reader's files and a `fastmimic` that keeps searches short. Servers,
long commands and those on a real robot, on data that is not there or on placeholders are only parsed. A block after
the line `<!-- not run: reason -->` is skipped. The first command with a wrong exit status ends the run.
"""

import os
import re
import resource
import shlex
import subprocess
import sys
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import fastmimic as fm
from fastmimic import cli
from fastmimic.base.registry import load_extensions
from fastmimic.steering import gait_field

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from few_gaits import FEW
from searches import quick_main, shorten

BLOCK = re.compile(r"^(?:<!-- not run: (.+) -->\n)?```(bash|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NOT_OURS = re.compile(r"^(?:pip|make|git|sudo|python|cd|\.ci/run|sbatch|tensorboard)\b.*$", re.MULTILINE)
COLUMN_OF_POINT = (0, 3, 11, 6, 20, 16, 15, 10, 23, 19)
"""Which of a dog file's 27 points each of `POINT_NAMES` is."""
LONG = {"view", "play", "robot-sim", "data", "train", "compare", "stress", "transfer", "library"}
"""Verbs that take long, wait for a user, or fetch."""
SHELL = re.compile(r"[|&;<>$`(){}\[\]*]|^(?!fastmimic )", re.MULTILINE)
"""In a bash block: more than commands of `fastmimic`, one a line."""


def main(folder: Path, pages: list[Path]) -> None:
    tools = folder.resolve() / "bin"
    tools.mkdir(parents=True, exist_ok=True)
    stand_in = tools / "fastmimic"
    stand_in.write_text(f'#!/bin/sh\nexec {sys.executable} {Path(__file__).resolve()} -- "$@"\n')
    stand_in.chmod(0o755)
    os.environ["PATH"] = f"{tools}{os.pathsep}{os.environ['PATH']}"
    os.chdir(folder)
    write_dog(Path("my_dog.txt"), cycles=3)
    for name in ("my_take.txt", "take.txt", "my_animal.txt"):
        write_dog(Path(name), cycles=12)
    np.save("hills.npy", np.random.default_rng(0).uniform(0.0, 0.02, (300, 300)))
    np.save("points.npy", fm.open_clip("walk").points_w)
    Path("way.csv").write_text("0.5,0.5,0,0\n1.5,0,0,0\n2,0,0,0\n")
    Path("my_robot.xml").write_text(fm.load_robot("go1").spec().to_xml(), encoding="utf-8")
    gait_field.gait_field = partial(gait_field.gait_field, **FEW)
    fm.evaluate("trot", duration_s=0.1)  # loads what commands need, once for all of them
    for page, text in [(page, page.read_text(encoding="utf-8")) for page in pages]:
        for reason, language, code in BLOCK.findall(text):
            if reason:
                say(f"-- {page.name}: not run: {reason}\n")
                continue
            say(f"-- {page.name}: {language}\n{code}")
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            if done := (run_bash if language == "bash" else run_python)(code):
                sys.exit(f"{page}: a block ends with status {done}")
            say(f"   {resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before:.1f} s of a processor\n")


def run_python(code: str) -> int:
    def work() -> None:
        shorten()
        exec(compile(code, "block", "exec"), {"__name__": "__main__"})

    return in_child(work)


def run_bash(code: str) -> int:
    code = NOT_OURS.sub("", code)
    plain = re.sub(r"^\s*(#.*)?\n| *#.*$", "", code.replace("\\\n", " "), flags=re.MULTILINE)
    if SHELL.search(plain.strip()):
        return subprocess.run(["bash", "-euo", "pipefail", "-c", code], check=False).returncode
    commands = [shlex.split(line) for line in plain.splitlines()]
    return next((done for words in commands if (done := in_child(partial(fastmimic, words[1:])))), 0)


def in_child(work: Callable[[], int | None]) -> int:
    """The exit status of a copy of this process that does `work`: faster than a new one, which imports everything."""
    if child := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    status = 1
    try:
        status = work() or 0
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else 1
        if isinstance(error.code, str):
            sys.stderr.write(error.code + "\n")
    except BaseException:  # noqa: BLE001, what it is is shown
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def fastmimic(arguments: list[str]) -> int:
    """The command line, with short searches and episodes, and with what would take long only parsed."""
    verb, rest = arguments[0], arguments[1:]
    long = verb in LONG or "--policy" in rest or "pybullet" in rest
    long = long or ("--driver" in rest and rest[rest.index("--driver") + 1] != "sim")
    data = os.path.isdir(os.environ.get("FASTMIMIC_DATA", ""))
    missing = not data and any(word.startswith(("dog:", "anim:")) for word in rest)
    missing = missing or any(
        word.startswith("runs/") and before != "--out" and not os.path.exists(word)
        for before, word in zip(arguments, rest, strict=False)
    )
    if long or missing or any(word in text for text in rest for word in ("NAME", "MOTION", "CLIPS", "…")):
        load_extensions()
        try:
            cli._parse(verb, rest)
        except cli._UsageError as error:
            sys.exit(f"{verb}: {error}")
        say("(parsed only)\n")
        return 0
    if verb in ("imitate", "stitch"):
        for name, value in (("--iterations", "2"), ("--population", "4")):
            if name in rest:
                rest[rest.index(name) + 1] = value
            else:
                rest += [name, value]
        rest += [] if "--no-video" in rest else ["--no-video"]
    if verb == "imitate" and "--duration" not in rest:
        rest += ["--duration", "4" if "push" in rest else "1.5"]  # pushes come until 3.1 s
    of_log = any("deploy-" in word for word in rest)  # is scored as long as it is
    if verb in ("evaluate", "render") and "--duration" not in rest and not of_log:
        rest += ["--duration", "1.5" if "--log" in rest else "0.5"]
    if verb == "deploy":
        rest += ["--lock-step", "--duration", "1.5"]
    return quick_main([verb, *rest])


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
    if sys.argv[1] == "--":
        sys.exit(fastmimic(sys.argv[2:]))
    if sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(Path(sys.argv[1]), [Path(page).resolve() for page in sys.argv[2:]])
