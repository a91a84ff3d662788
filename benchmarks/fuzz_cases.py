"""What `fuzz.py` tries: each reader with files of its kind, and each verb with options of all kinds."""

import copy
import dataclasses
import io
import json
import os
import shutil
import struct
import sys
import time
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module, resources
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from fuzz_files import NUMBERS, VALUES, WORDS, Draw, chance, changed_file, changed_numbers, changed_value, npy, pick
from hypothesis import strategies as st

from fastmimic.base.errors import FastMimicError
from fastmimic.cli import VERBS, main

TESTS: Final = Path(__file__).parents[1] / "tests"
Use = Callable[[Path, Draw], None]
"""Reads the files in a folder; anything but success and `FastMimicError` is a finding."""


class ReachedWork(BaseException):
    """A verb has taken its options and begins long work: the simulation, a search, a server, a download."""


class FailedError(Exception):
    """A verb that ended neither well nor with one line of an error."""


@dataclass(frozen=True)
class Case:
    """A kind of input: the files of a valid one, those among them that are changed, and what reads them."""

    name: str
    files: dict[str, bytes]
    use: Use
    weight: int = 1
    changed: tuple[str, ...] = ()  # all if empty

    def run(self, folder: Path, draw: Draw, *, valid: bool = False) -> None:
        """Writes a changed copy of the files into an empty folder and reads it."""
        files = dict(self.files)
        if files and not valid:
            name = pick(draw, self.changed or tuple(files))
            files[name] = changed_file(draw, name, files[name])
            if chance(draw, 40):
                del files[name]
        for name, content in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        self.use(folder, draw)


def command(*arguments: object, run: Callable[[list[str]], int] = main) -> None:
    """Runs the command line; raises `FailedError` unless it ends well or with one line of an error."""
    errors = io.StringIO()
    before, sys.stderr = sys.stderr, errors
    try:
        status = run([str(argument) for argument in arguments])
    finally:
        sys.stderr = before
    last = errors.getvalue().rstrip("\n").split("\n")[-1]
    if status not in (0, 2, 3) or (status == 2 and not last.startswith("fastmimic: error: ")):
        raise FailedError(f"status {status}: {last}")
    if "not enough memory" in last:
        raise FailedError(last)
    if status == 2:
        raise FastMimicError(last)


def stop_before_work() -> None:
    """Has long work raise `ReachedWork`."""

    def reached(*given: Any, **_: Any) -> Any:
        if given[2:] and given[2] == ():  # jobs for an executor: all are done already
            return io.StringIO()  # no outcomes, and can be closed
        raise ReachedWork

    for place in (
        "episode.loop:make_simulation",
        "episode.loop:ClosedLoop.run",
        "optimize.cma_es:_Search.run",
        "trajectory.program:Program.solve",
        "executors.local:LocalExecutor.run",
        "executors.ray_cluster:RayExecutor.__init__",
        "learning.training:train",
        "deploy.deployment:deploy",
        "deploy.driver:make_driver",
        "commands.deploy:make_driver",
        "deploy.sim_server:SimServer.__init__",
        "viewer.viewer:Viewer.__init__",
        "play.page:PlayPage.__init__",
        "commands.live:ProcessPoolExecutor",
        "steering.gait_field:_made",
        "render.video:render_video",
        "clips.data:_fetch_file",
        "identification.identify:identify",
    ):
        module, _, name = place.partition(":")
        owner: Any = import_module(f"fastmimic.{module}")
        *path, last = name.split(".")
        for part in path:
            owner = getattr(owner, part)
        if not hasattr(owner, last):
            raise AttributeError(f"{place} is not there any more: name what takes its place")
        setattr(owner, last, reached)


def remember_executable() -> None:
    """Has a motion made executable once only, so that what follows is reached also where that is stopped."""
    retarget: Any = import_module("fastmimic.retargeting.retarget")
    compute, known = retarget.nearest_executable, {}

    def remembered(robot: Any, animal: Any, **others: Any) -> Any:
        key = (robot.content, *(array.tobytes() for array in (animal.root_pos_w, animal.joint_pos)))
        if key not in known:
            known[key] = compute(robot, animal, **others)
        return known[key]

    retarget.nearest_executable = remembered


def planted(scratch: Path) -> list[Case]:
    """Inputs that must be found wrong, and one that must not."""
    held: list[bytes] = []

    def fill(folder: Path, draw: Draw) -> None:
        while True:
            held.append(bytes([len(held) + 1]) * 50_000_000)

    def fails(folder: Path, draw: Draw) -> None:
        raise KeyError("planted")

    def refuses(folder: Path, draw: Draw) -> None:
        raise FastMimicError("planted")

    uses: dict[str, Use] = {
        "planted traceback": fails,
        "planted hang": lambda folder, draw: time.sleep(1e3),
        "planted memory": fill,
        "planted death": lambda folder, draw: os._exit(3),
        "planted refusal": refuses,
    }
    return [Case(name, {}, use) for name, use in uses.items()]


def of_tests(name: str) -> Any:
    """A module of the tests, which writes small valid files."""
    path = TESTS / name
    spec = spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cases(scratch: Path) -> list[Case]:
    """All kinds of input; valid files are written to `scratch`, where those of before are used."""
    remember_executable()
    make_folders(scratch)
    found = [*_clips(scratch), *_robots(scratch), *_settings(), *_motions(scratch), *_logs(scratch), *_terrains()]
    found += [*_policies(scratch), *_folders(scratch)]
    inputs = {name: content for case in found if "folder" not in case.name for name, content in case.files.items()}
    return [*found, *_options(inputs)]


def _clips(scratch: Path) -> list[Case]:
    """A file of each format; it is read, or also segmented or retargeted."""
    from fastmimic.clips.catalogue import open_clip
    from fastmimic.clips.formats import ReadOptions, read_clip
    from fastmimic.commands.motion_files import Inspect, SegmentTake
    from fastmimic.commands.options import ClipFileOptions, ClipOptions
    from fastmimic.motion.export import export_motion
    from fastmimic.robot import load_robot
    from fastmimic.runs.loading import load_motion

    samples, poses = of_tests("clips/sample_files.py"), of_tests("clips/pose_files.py")
    trot, robot = open_clip("trot"), load_robot("a1")
    points, rate = trot.points_w[::4], trot.rate_hz / 4
    texts = {
        "keypoints.txt": samples.keypoint_text(12),
        "laikago.txt": samples.deepmimic_text(12),
        "robot.csv": samples.csv_text(12),
        "header.csv": samples.csv_text(12, header=True),
    }
    of_points: dict[str, Callable[[Path, Any, float], Any]] = {
        "deeplabcut.csv": lambda path, p, _: path.write_text(poses.deeplabcut_csv({"": p})),
        "animals.csv": lambda path, p, _: path.write_text(poses.deeplabcut_csv({"rex": p, "ina": p}, likelihood=0.9)),
        "anipose.csv": lambda path, p, _: path.write_text(poses.anipose_csv(p)),
        "dog.bvh": lambda path, p, hz: path.write_text(_bvh(p, poses, hz)),
        "named.csv": lambda path, p, _: path.write_text(_named(p, poses)),
        "table.h5": lambda path, p, _: poses.deeplabcut_h5(path, p),
        "fixed.h5": lambda path, p, _: poses.deeplabcut_fixed_h5(path, p),
        "sleap.h5": lambda path, p, _: poses.sleap_anipose_h5(path, [p], names=True),
        "flat.h5": lambda path, p, _: poses.sleap_analysis_h5(path, p),
        "markers.c3d": poses.c3d,
        "ai4.npz": poses.ai4animation_npz,
        "linear.glb": poses.glb,
        "cubic.glb": lambda path, p, hz: poses.glb(path, p, hz, "CUBICSPLINE", 2),
    }
    files = {name: text.encode() for name, text in texts.items()}
    writers: dict[str, Callable[[Path], Any]] = {
        **{name: partial(_written, write, points, rate) for name, write in of_points.items()},
        "trajectory.npz": lambda path: np.savez(
            path, q=(q := samples.csv_values()), v=np.zeros((len(q), 18)), dt=np.full(len(q), 0.02)
        ),
        "amp.txt": lambda path: export_motion(load_motion("trot", robot), robot, path, "amp"),
    }
    for name, write in writers.items():
        write(scratch / name)
        files[name] = (scratch / name).read_bytes()

    def use(own: str, folder: Path, draw: Draw) -> None:
        path = folder / own
        fps = pick(draw, (None, None, 30.0, 100.0, 1e4))
        how = draw(st.integers(0, 9))
        if how == 0:
            Inspect(source=str(path), clip=ClipOptions(no_executable=True, fps=fps)).run()
        elif how == 1:
            SegmentTake(take=str(path), file=ClipFileOptions(fps=fps)).run()
        else:
            up, frames = pick(draw, (None, None, "z", "-y")), pick(draw, (None, None, (0, 5), (2, 9)))
            read_clip(path, ReadOptions(robot=robot, fps=fps, up=up, frames=frames))

    def other_points(folder: Path, draw: Draw) -> None:
        name, changed = pick(draw, list(of_points)), np.array(points)
        for _ in range(draw(st.integers(1, 3))):
            changed = changed_numbers(draw, changed)
        try:
            _written(of_points[name], changed, pick(draw, (rate, rate, rate, *VALUES)), folder / name)
        except (ValueError, ArithmeticError, LookupError, TypeError, struct.error):  # what its program cannot write
            (folder / name).write_bytes(files[name])
        use(name, folder, draw)

    found = [Case(f"clip {name}", {name: content}, partial(use, name), 3) for name, content in files.items()]
    return [*found, Case("clip of other points", {}, other_points, 15)]


def _written(write: Callable[[Path, Any, float], Any], points: Any, rate: float, path: Path) -> None:
    if not len(points) or not 1e-30 < rate < 1e30:
        raise ValueError("at this ezc3d ends the process")
    with np.errstate(all="ignore"):
        write(path, points, rate)


def _bvh(points: Any, poses: Any, rate: float) -> str:
    joints = "".join(
        f"JOINT {name}\n{{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}}\n" for name in poses.JOINTS
    )
    turned = (100 * points[..., [1, 2, 0]]).reshape(len(points), -1)
    rows = "\n".join("0 0 0 " + " ".join(f"{v:.4f}" for v in row) for row in turned)
    head = "HIERARCHY\nROOT all\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n"
    return f"{head}{joints}}}\nMOTION\nFrames: {len(points)}\nFrame Time: {1 / rate:.6f}\n{rows}\n"


def _named(points: Any, poses: Any) -> str:
    head = ",".join(["time", *(f"{name}_{axis}" for name in poses.NAMES for axis in "xyz")])
    rows = [",".join(f"{v:.5f}" for v in (i / 60, *frame.ravel())) for i, frame in enumerate(points)]
    return "\n".join([head, *rows]) + "\n"


def _robots(scratch: Path) -> list[Case]:
    from fastmimic.commands.motion_files import Robots

    urdf = of_tests("robot/test_urdf.py")

    def use(own: str, folder: Path, draw: Draw) -> None:
        Robots(robot=str(folder / own)).run()

    xml = resources.files("fastmimic.robot").joinpath("a1.xml").read_bytes()
    vendors = urdf.urdf().encode()
    files = {"robot.xml": xml, "robot.urdf": vendors}
    return [Case(f"robot {name}", {name: content}, partial(use, name), 10) for name, content in files.items()]


def _settings() -> list[Case]:
    """Controllers' parameters, limits, maps of points, velocities, and lists of sources."""
    from fastmimic.clips.formats.points import read_point_map
    from fastmimic.control.config import FILE_FORMAT, ControllerConfig, controller_config, pack_config
    from fastmimic.dataset import find_sources
    from fastmimic.deploy.safety import SafetyLimits, read_limits
    from fastmimic.robot import load_robot
    from fastmimic.steering.commands import CommandScript

    poses, robot = of_tests("clips/pose_files.py"), load_robot("a1")
    config = {**FILE_FORMAT, "base": "paper", **ControllerConfig().as_dict()}
    limits = "".join(f"{name} = {value}\n" for name, value in dataclasses.asdict(SafetyLimits.of(robot)).items())
    points = dict(zip(import_module("fastmimic.clips.clip").POINT_NAMES, poses.NAMES, strict=True))
    way = "time_s,forwards,left,turn\n0.5,0.5,0,0\n3,0.8,0,-0.8\n6,0,0,0\n"
    sources = "source,frames,fps,up,scale,licence\ntrot,3:40,,,1.0,own\nwalk,,,,,\n"

    def controller(folder: Path, draw: Draw) -> None:
        pack_config(controller_config(str(folder / "config.json")), robot)

    def limited(folder: Path, draw: Draw) -> None:
        given = [f"{pick(draw, ('tilt', 'torque', '', 'x'))}={pick(draw, NUMBERS)}"] if chance(draw, 4) else []
        read_limits(robot, folder / "limits.toml", given)

    def lists(folder: Path, draw: Draw) -> None:
        find_sources(folder / "sources.csv")
        find_sources(folder / "sources.list")

    return [
        Case("configuration", {"config.json": json.dumps(config).encode()}, controller, 8),
        Case("limits", {"limits.toml": limits.encode()}, limited, 8),
        Case(
            "point map", {"map.json": json.dumps(points).encode()}, lambda f, d: _ignore(read_point_map(f / "map.json"))
        ),
        Case("velocities", {"way.csv": way.encode()}, lambda f, d: _ignore(CommandScript(f / "way.csv")), 3),
        Case("sources", {"sources.csv": sources.encode(), "sources.list": b"trot\nwalk # slow\n\nx.txt\n"}, lists, 4),
    ]


def _ignore(_: Any) -> None: ...


def _motions(scratch: Path) -> list[Case]:
    """Robot motions, and checkpoints."""
    from fastmimic.commands.evaluate import Evaluate
    from fastmimic.commands.motion_files import Export, Inspect
    from fastmimic.commands.options import ClipOptions, SteeredBy
    from fastmimic.motion.motion import Motion
    from fastmimic.optimize.cma_es import Checkpoint
    from fastmimic.runs.loading import load_motion

    motion = load_motion("trot", "a1")
    dataclasses.replace(motion, demonstration=motion).save(scratch / "motion.npz")
    Checkpoint("x", np.zeros((2, 4, 3)), np.zeros((2, 4)), 1.0).save(scratch / "checkpoint.npz")
    content = (scratch / "motion.npz").read_bytes()

    def use(folder: Path, draw: Draw) -> None:
        path, clip = folder / "motion.npz", ClipOptions()
        how = draw(st.integers(0, 9))
        if how == 0:
            form, ending = pick(draw, (("mjlab", "npz"), ("csv", "csv"), ("deepmimic", "txt"), ("amp", "txt")))
            Export(motion=str(path), format=form, out=folder / f"out.{ending}", clip=clip).run()
        elif how == 1:
            Evaluate(motion=str(path), duration=0.1, clip=clip, steered=SteeredBy()).run()
        elif how <= 4:
            Inspect(source=str(path), clip=clip).run()
        else:
            Motion.load(path)

    kept = (scratch / "checkpoint.npz").read_bytes()
    return [
        Case("motion", {"motion.npz": content}, use, 15),
        Case("checkpoint", {"c.npz": kept}, lambda f, d: _ignore(Checkpoint.load(f / "c.npz")), 3),
    ]


def _logs(scratch: Path) -> list[Case]:
    """Logs of runs, of deployments, and of the simulated robot."""
    from fastmimic.commands.evaluate import Evaluate, Identify
    from fastmimic.commands.options import ClipOptions, SteeredBy
    from fastmimic.control.config import ControllerConfig
    from fastmimic.deploy import log as logs
    from fastmimic.deploy.log_file import LogFile
    from fastmimic.robot.state import OBSERVATION
    from fastmimic.runs.loading import load_motion

    steps = 20
    rows, truth = np.zeros(steps, logs.ROW), np.zeros(steps, OBSERVATION)
    rows["in_motion"], rows["time_s"], rows["sequence"] = True, 0.002 * np.arange(steps), np.arange(steps)
    for quat in (rows["reading"]["quat"], rows["estimate"]["root_quat"], truth["root_quat"]):
        quat[:, 0] = 1.0
    meta = {"rate_hz": 500.0, "robot": "a1", "motion": "trot", "driver": "sim", "method": "mbc", "latency_s": 0.002}
    meta |= {"config": ControllerConfig().as_dict(), "torque_limit": [33.5] * 12}
    meta |= {"foot_force": "auto", "result": {"stopped_by": "end", "stopped_because": None, "log_ends": None}}
    motion = load_motion("trot", "a1")

    def write(path: Path, facts: dict[str, Any], rows: Any = rows, truth: Any = truth) -> bytes:
        """Writes a log; returns what there is of it before it ends."""
        path.unlink(missing_ok=True)
        log = logs.new_log_file(path, motion, facts, steps, with_truth=True)
        log.add_rows(np.arange(len(rows)), {logs.PERIODS: rows, logs.TRUTH: truth})
        begun = log.path.read_bytes()
        log.end({"result": facts["result"]} if "result" in facts else {})
        return begun

    killed = write(scratch / "log.mcap", meta)
    (scratch / "truth.mcap").unlink(missing_ok=True)
    real = LogFile(scratch / "truth.mcap", {logs.ROBOT_SIM: logs.GROUND_TRUTH}, steps)
    real.add_rows(np.arange(steps), {logs.ROBOT_SIM: np.zeros(steps, logs.GROUND_TRUTH)})
    real.end({})

    def use(own: str, folder: Path, draw: Draw) -> None:
        path = folder / own
        if draw(st.booleans()):
            Identify(log=path).run()
        else:
            Evaluate(motion=str(path), clip=ClipOptions(), steered=SteeredBy()).run()

    def other_facts(folder: Path, draw: Draw) -> None:
        facts = changed_value(draw, copy.deepcopy(meta))
        try:
            write(folder / "log.mcap", facts if isinstance(facts, dict) else {})
        except UnicodeEncodeError:  # no program writes half a character
            write(folder / "log.mcap", meta)
        use("log.mcap", folder, draw)

    def other_rows(folder: Path, draw: Draw) -> None:
        """Numbers that no robot sends."""
        left = pick(draw, (steps, steps, 0, 1, 2, 3))
        held = rows[:left].copy(), truth[:left].copy()
        for _ in range(draw(st.integers(1, 3))):
            field = pick(draw, held)
            while field.dtype.names:
                field = field[pick(draw, field.dtype.names)]
            changed = changed_numbers(draw, field)
            field[: len(changed)] = changed
        write(folder / "log.mcap", {k: v for k, v in meta.items() if k != "result" or chance(draw, 2)}, *held)
        use("log.mcap", folder, draw)

    named = {name: (scratch / name).read_bytes() for name in ("log.mcap", "truth.mcap")}
    return [
        Case("log of a deployment", {"log.mcap": named["log.mcap"]}, partial(use, "log.mcap"), 8),
        Case("log of a deployment with other facts", {}, other_facts, 8),
        Case("log of a deployment with other rows", {}, other_rows, 8),
        Case("log of a killed deployment", {"log.mcap": killed}, partial(use, "log.mcap"), 8),
        Case(
            "ground truth",
            {"truth.mcap": named["truth.mcap"]},
            lambda f, d: _ignore(logs.load_ground_truth(f / "truth.mcap")),
            5,
        ),
    ]


def _terrains() -> list[Case]:
    from PIL import Image

    from fastmimic.robot import load_robot
    from fastmimic.simulation.conditions import Conditions, parse_terrain
    from fastmimic.simulation.mujoco_sim import build_model

    heights = (np.arange(600).reshape(20, 30) % 7).astype(np.uint8)
    files = {"hills.npy": npy(0.01 * heights)}
    for name, mode in (("grey.png", "L"), ("deep.png", "I;16"), ("colour.png", "RGB")):
        stream = io.BytesIO()
        Image.fromarray(heights).convert(mode if mode != "I;16" else "I").convert(mode).save(stream, "PNG")
        files[name] = stream.getvalue()

    def use(own: str, folder: Path, draw: Draw) -> None:
        text = str(folder / own)
        text += pick(draw, ("", "", "@0.1", "@nan", "@1e-9", "@1e300", "@x"))
        text += pick(draw, ("", "", "=0.3", "=0", "=1e3", "=-1", "=nan", "=x"))
        ground = Conditions(terrain=parse_terrain(text)).ground
        if chance(draw, 10):
            build_model(load_robot("a1"), ground=ground)

    return [Case(f"terrain {name}", {name: content}, partial(use, name), 3) for name, content in files.items()]


def _policies(scratch: Path) -> list[Case]:
    from fastmimic.learning.policy import Policy
    from fastmimic.robot import load_robot
    from fastmimic.runs.loading import load_motion

    robot = load_robot("a1")
    motion = load_motion("trot", robot)
    of_tests("learning/hand_made.py").follower(robot, motion).save(scratch / "policy.npz")

    def use(folder: Path, draw: Draw) -> None:
        policy = Policy.load(folder / "policy.npz")
        policy.check(robot, motion)
        policy.network()

    return [Case("policy", {"policy.npz": (scratch / "policy.npz").read_bytes()}, use, 5)]


_SEARCH: Final = ("--iterations", "2", "--population", "4", "--duration", "0.6")
_MADE: Final = {
    "run": ("imitate", "trot", *_SEARCH, "--no-video", "--workers", "1"),
    "stress": (
        "stress",
        "trot",
        "--disturbances",
        "payload",
        "--episodes",
        "1",
        "--duration",
        "0.5",
        "--methods",
        "mbc",
    ),
    "comparison": ("compare", "--motions", "trot", "--methods", "mbc-dmp", "--seeds", "1", *_SEARCH, "--workers", "1"),
    "library": (
        *("library", "build", "trot", *_SEARCH, "--trial", "0.6", "--perturbed", "1", "--others", "1"),
        *("--no-second-simulator", "--workers", "1"),
    ),
    "deployment": ("deploy", "stand", "--driver", "sim", "--lock-step", "--duration", "0.1"),
}
"""Commands that make small folders."""


def make_folders(scratch: Path) -> None:
    """Makes the folders that are not there yet."""
    quick = of_tests("searches.py").quick_main
    for name, arguments in _MADE.items():
        if not (scratch / name).exists():
            quick([*arguments, "--out", str(scratch / name)])


def _folders(scratch: Path) -> list[Case]:
    """The folders of runs, experiments, libraries and deployments, and the verbs that read them."""
    verbs: dict[str, tuple[tuple[str, ...], ...]] = {
        "run": (
            *(
                ("report", "."),
                ("report", "."),
                ("evaluate", "."),
                ("view", ".", "--kinematic"),
                ("inspect", "."),
                ("play", "."),
            ),
            *(
                ("imitate", *_MADE["run"][1:], "--out", ".", how)
                for how in ("--resume", "--overwrite", "--no-optimize")
            ),
            *(("stitch", ".", "trot", "--out", "x"), ("export", ".", "--format", "mjlab", "--out", "x.npz")),
        ),
        "stress": (("report", "."), (*_MADE["stress"], "--out", ".", "--resume")),
        "comparison": (("report", "."), (*_MADE["comparison"], "--out", ".", "--resume")),
        "library": (
            *(("library", "list", "."), ("library", "list", ".", "--superseded"), ("library", "show", ".", "trot")),
            *(("library", "verify", ".", "--mend"), ("library", "verify", ".", "--rerun", "1"), (*_MADE["library"],)),
            *(("library", "export", ".", "--to", "x"), ("library", "list", ".", "--json")),
        ),
        "deployment": (("report", "."), ("evaluate", "log.mcap"), ("identify", "."), ("evaluate", ".")),
    }

    quick = of_tests("searches.py").quick_main

    def use(name: str, folder: Path, draw: Draw) -> None:
        for _ in range(pick(draw, (1, 1, 2))):
            arguments = pick(draw, verbs[name])
            out = ("--out", ".") if arguments == _MADE["library"] else ()
            command(*arguments, *out, run=quick)

    found = []
    for name in verbs:
        paths = [path for path in sorted((scratch / name).rglob("*")) if path.is_file() and path.suffix != ".png"]
        files = {str(path.relative_to(scratch / name)): path.read_bytes() for path in paths}
        found.append(Case(f"folder of a {name}", files, partial(use, name), 8))
    return found


_COUNTS: Final = (
    "episodes",
    "iterations",
    "population",
    "robots",
    "workers",
    "trials",
    "perturbed",
    "others",
    "seeds",
    "steps",
)
"""Options whose large values ask for as much work or memory as they say."""
_TEXTS: Final[dict[str, tuple[str, ...]]] = {
    "motion": (
        "trot",
        "walk",
        "dog:pace",
        "motion.npz",
        "laikago.txt",
        "stand",
        "keypoints.txt",
        "log.mcap",
        ".",
        "none",
    ),
    "robot": ("a1", "go1", "go2", "robot.xml", "robot.urdf", "keypoints.txt"),
    "method": ("mbc", "mbc-dmp", "lh", "lh-dmp", "rl"),
    "config": ("default", "paper", "config.json", "map.json"),
    "terrain": ("stairs-up=0.05", "slope=10", "rough=0.02", "hills.npy", "grey.png@0.1=0.5", "slope=1e9", "stones=nan"),
    "disturb": ("payload=2", "push=10@2.5", "friction=0.3", "latency=5", "payload=", "push=1@-1", "foot-force-scale=0"),
    "randomize": ("friction", "payload=0:3", "payload=3:0", "motors=nan:1"),
    "frames": ("0:30", "5:5", "9:2", "0:100000"),
    "up": ("x", "y", "z", "-x", "w"),
    "travel": ("auto", "recover", "as-is"),
    "observe": ("truth", "sensors"),
    "simulator": ("mujoco", "pybullet"),
    "quality": ("preview", "high"),
    "size": ("640x360", "99999x1", "10x10"),
    "format": ("mjlab", "csv", "deepmimic", "amp", "lerobot", "motion-lib", "isaaclab"),
    "limit": ("tilt=0.5", "qp_failures=nan", "tilt=", "x=1", "qp_failures=1e30"),
    "driver": ("sim", "go2", "a1"),
    "action": ("list", "fetch"),
    "datasets": ("dog",),
    "start": ("lying", "standing"),
    "sensors": ("real", "ideal"),
    "executor": ("local", "ray"),
    "grade": ("A", "B", "rejected"),
    "device": ("cpu", "cuda"),
}
_LIKE: Final = {name: "motion" for name in ("motions", "source", "take", "clip", "sources", "runs", "library")}
_OUTS: Final = (
    "out",
    "out.npz",
    "out.mp4",
    "out.json",
    "out.csv",
    "a/b.txt",
    "motion.npz",
    ".",
    "/proc/none/x",
    "out.png",
)
_PATHS: Final = ("out", "log", "to", "figure", "folder")


def _options(inputs: dict[str, bytes]) -> list[Case]:
    """Each verb with options of its own and other kinds, in a folder with a valid file of each kind."""

    def of(verb: str) -> Use:
        entry = VERBS[verb]
        kind = getattr(import_module(f"fastmimic.commands.{entry.module}"), entry.dataclass)

        def use(folder: Path, draw: Draw) -> None:
            for name, content in inputs.items():
                (folder / name).write_bytes(content)
            arguments = _arguments(draw, kind)
            if chance(draw, 15):
                arguments.insert(
                    draw(st.integers(0, len(arguments))), pick(draw, ("--nonsense", "--", "-h", "", "--no-"))
                )
            command(verb, *(word.replace("\0", "").encode("utf-8", "replace").decode() for word in arguments))

        return use

    return [Case(f"options of {verb}", {}, of(verb), 2) for verb in VERBS]


def _arguments(draw: Draw, kind: Any, most: int = 4) -> list[str]:
    """Words of a command line: positional arguments, and some of the options."""
    hints = typing.get_type_hints(kind, include_extras=True)
    positional: list[str] = []
    options: list[tuple[str, Any]] = []
    for field in dataclasses.fields(kind):
        hint = hints[field.name]
        inner, marks = _unwrapped(hint)
        union = [part for part in typing.get_args(inner) if dataclasses.is_dataclass(_unwrapped(part)[0])]
        if union:  # of subcommands
            chosen = pick(draw, union)
            name = next(mark.name for mark in _unwrapped(chosen)[1] if hasattr(mark, "name"))
            return [name, *_arguments(draw, _unwrapped(chosen)[0], most)]
        if dataclasses.is_dataclass(inner):
            own = typing.get_type_hints(inner, include_extras=True)
            options += [(f.name, own[f.name]) for f in dataclasses.fields(inner)]
        elif "Positional" in str(marks) or "POSITIONAL" in str(marks).upper():
            positional += _words(draw, field.name, inner)
        else:
            options.append((field.name, hint))
            if field.default is dataclasses.MISSING and not chance(draw, 10):
                positional += [f"--{field.name.replace('_', '-')}", *_words(draw, field.name, inner)]
    for _ in range(draw(st.integers(0, most)) if options else 0):
        name, hint = pick(draw, options)
        inner, _marks = _unwrapped(hint)
        words = [] if inner is bool else _words(draw, name, inner)
        positional += [f"--{name.replace('_', '-')}", *words]
    return positional


def _unwrapped(hint: Any) -> tuple[Any, list[Any]]:
    """A type without its annotations and None, and the annotations."""
    marks: list[Any] = []
    while True:
        if typing.get_origin(hint) is typing.Annotated:
            hint, *more = typing.get_args(hint)
            marks += more
            continue
        given = [part for part in typing.get_args(hint) if part is not types.NoneType]
        if typing.get_origin(hint) in (typing.Union, types.UnionType) and len(given) == 1:
            hint = given[0]
            continue
        return hint, marks


def _words(draw: Draw, name: str, kind: Any) -> list[str]:
    """What is written for an option of that type."""
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)[0]
        return [word for _ in range(draw(st.integers(0, 3))) for word in _words(draw, name, inner)]
    if chance(draw, 12):
        return [pick(draw, (*WORDS, *NUMBERS))[:200]]
    if typing.get_origin(kind) is Literal:
        return [str(pick(draw, typing.get_args(kind)))]
    if kind is int:
        large = () if name in _COUNTS else (2**31, 2**63, 10**20)
        return [str(pick(draw, (-1, 0, 1, 2, 3, 7, *large)))]
    if kind is float:
        return [pick(draw, ("0.5", "1", "2", "0", "-1", "nan", "inf", "1e-9", "1e6", "50", "0.1"))]
    if name in _PATHS:
        return [pick(draw, _OUTS)]
    among = _TEXTS.get(_LIKE.get(name, name))
    return [pick(draw, among or (*_TEXTS["motion"], *_OUTS, "policy.npz", "config.json", "limits.toml", "map.json"))]


def empty(folder: Path) -> None:
    """Removes what an input has left."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
