"""`fastmimic deploy` with a simulated robot: what it writes and prints, how it ends, and bad input."""

import io
import json
import shutil
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from mcap.reader import make_reader

from cli.running import Run
from fastmimic.base.errors import DriverError
from fastmimic.cli import main
from fastmimic.deploy.deployment import DeployOptions
from fastmimic.deploy.driver import RobotDriver
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion

QUICK = ("--driver", "sim", "--lock-step", "--duration", "0.2")


@pytest.fixture(scope="module")
def deployed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a deployment. Not to be changed."""
    folder = tmp_path_factory.mktemp("deployed") / "there"
    assert main(["deploy", "stand", *QUICK, "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a deployment with a controller that plans ahead, and what it printed. Not to be changed."""
    folder, out = tmp_path_factory.mktemp("planned") / "there", io.StringIO()
    with redirect_stdout(out):
        assert main(["deploy", "stand", *QUICK, "--method", "lh", "--json", "--out", str(folder)]) == 0
    return folder, out.getvalue()


@pytest.mark.slow
def test_it_prints_the_figures_and_writes_the_folder(run: Run, in_folder: Path) -> None:
    done = run("deploy", "stand", *QUICK)
    assert done.status == 0
    assert "stopped by" in done.out
    assert "duration" in done.out
    assert done.err.splitlines()[-3:] == ["blending out of stand", "sitting down", "releasing the joints"]
    folder = in_folder / "runs" / "deploy-stand-a1-sim"
    assert {path.name for path in folder.iterdir()} == {"log.mcap", "motion.npz", "deployment.json"}
    written = json.loads((folder / "deployment.json").read_text())
    log = DeploymentLog.load(folder / "log.mcap")
    assert written["result"]["periods"] == len(log.rows)
    assert written["driver"] == "sim"
    assert written["limits"]["tilt"] == 0.6
    assert Motion.load(folder / "motion.npz").name == "stand"
    again = run("deploy", "stand", *QUICK)
    assert "runs/deploy-stand-a1-sim-2/log.mcap" in again.out


@pytest.mark.slow
def test_json_is_one_object_on_stdout(run: Run) -> None:
    done = run("deploy", "stand", *QUICK, "--json", "--out", "there", "--log", "elsewhere.mcap")
    found = json.loads(done.out)
    assert found["stopped_by"] == "duration"
    assert not found["fell"]
    for name in ("period_error_us", "control_us", "write_us", "round_trip_us"):
        assert {"median", "p99", "max"} == found[name].keys()
    assert {"sent", "received", "lost", "rejected", "foreign"} == found["packets"].keys()
    assert found["reward_mean"] > 0.9
    assert found["log"] == "elsewhere.mcap"
    assert Path("elsewhere.mcap").is_file()
    assert not Path("there/log.mcap").exists()


@pytest.mark.parametrize(("said", "asked"), [("auto", None), ("on", True), ("off", False)])
def test_real_time_scheduling_is_requested_as_said(
    said: str, asked: bool | None, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []

    def deploy(motion: Motion, robot: Robot, driver: RobotDriver, options: DeployOptions, **_: object) -> None:
        found.append(options.real_time)
        raise DriverError("seen enough")

    monkeypatch.setattr("fastmimic.deploy.deployment.deploy", deploy)
    assert run("deploy", "stand", *QUICK, "--real-time", said).error == "seen enough"
    assert found == [asked]


def test_its_log_can_be_evaluated(run: Run, in_folder: Path, deployed: Path) -> None:
    (in_folder / "there").symlink_to(deployed)
    done = run("evaluate", "there/log.mcap", "--json")
    found = json.loads(done.out)
    assert found["motion"] == "stand"
    assert found["driver"] == "sim"
    assert found["reward_mean"] == found["result"]["reward_truth_mean"]
    assert "the simulator's ground truth" in run("evaluate", "there/log.mcap").out
    assert "there/log.mcap: the log is 0.50 s long" in run("identify", "there/log.mcap").error
    assert "drop --episodes" in run("evaluate", "there/log.mcap", "--episodes", "2").error


@pytest.mark.slow
def test_a_violation_has_a_status_and_a_line_of_its_own(run: Run) -> None:
    done = run("deploy", "stand", *QUICK, "--limit", "height_least=0.999", "--out", "there")
    assert done.status == 3
    assert "stopped by" in done.out
    last = done.err.splitlines()[-1]
    assert last.startswith("fastmimic: the base is 0.2")
    assert last.endswith("the robot was damped while following the motion")
    assert json.loads(Path("there/deployment.json").read_text())["result"]["stopped_by"] == "height"


@pytest.mark.slow
def test_a_dry_run_shows_the_commands(run: Run) -> None:
    done = run("deploy", "stand", *QUICK, "--dry-run", "--out", "there")
    assert done.status == 0
    assert "standing up, 1.5 s" in done.out
    assert "FR_knee" in done.out
    assert "of 33.5" in done.out
    assert not DeploymentLog.load("there/log.mcap").rows["sent"].any()


def test_a_planning_controller_plans_in_every_period(planned: tuple[Path, str]) -> None:
    folder, out = planned
    rows = DeploymentLog.load(folder / "log.mcap").rows
    following = rows[rows["phase"] == DeploymentPhase.FOLLOW]
    assert (following["solve_s"] > 0.0).all()
    assert json.loads(out)["solve_us"]["median"] > 0.0


def test_its_report_is_a_page_of_its_own(run: Run, in_folder: Path, planned: tuple[Path, str]) -> None:
    shutil.copytree(planned[0], in_folder / "there")
    assert run("report", "there").status == 0
    page = Path("there/report.html").read_text(encoding="utf-8")
    for said in ("stand on a1, deployed by driver sim", "Ended as planned (duration)", 'id="log"', "height_least"):
        assert said in page
    Path("there/log.mcap").unlink()
    done = run("report", "there")
    assert "without the pictures" in done.err
    assert 'id="log"' not in Path("there/report.html").read_text(encoding="utf-8")


BAD = {
    "no such driver": (["trot", "--driver", "spot"], "unknown driver 'spot'; there are go2, a1, b2, a2, sim"),
    "no model": (
        ["trot", "--driver", "b2", "--yes"],
        "driver 'b2' needs the robot's model: give its file",
    ),
    "no such motion": (["trto", *QUICK], "did you mean 'trot'"),
    "another robot's motion": (["{go1}", *QUICK, "--robot", "a1"], "is for robot 'go1', not for 'a1'"),
    "a motion for another driver": (
        ["{go1}", "--driver", "go2", "--yes"],
        "is for robot 'go1', and driver 'go2' drives a go2",
    ),
    "another robot than the driver's": (
        ["trot", "--driver", "go2", "--robot", "a1", "--yes"],
        "driver 'go2' drives a go2, not 'a1'",
    ),
    "both ends": (["trot", *QUICK, "--cycles", "2"], "cycles and duration both say"),
    "no cycles": (["stand", "--driver", "sim", "--cycles", "0"], "at least 1"),
    "duration": (["stand", "--driver", "sim", "--duration", "nan"], "--duration must be above 0"),
    "no such limit": (["stand", *QUICK, "--limit", "tlit=1"], "did you mean 'tilt'"),
    "no limits": (["stand", *QUICK, "--limits", "none.toml"], "none.toml: cannot be read"),
    "a simulated robot's option": (["trot", "--driver", "go2", "--loss", "0.1"], "--loss is for '--driver sim'"),
    "a wire's option": (
        ["trot", *QUICK, "--interface", "eth0"],
        "--interface and --domain are for a robot on the wire",
    ),
    "nobody to ask": (["trot", "--driver", "go2"], "standard input is not a terminal"),
    "no planning": (["stand", *QUICK, "--solve-rate", "100"], "does not plan ahead"),
    "no such method": (["stand", *QUICK, "--method", "mpc"], "unknown method 'mpc'"),
    "a policy's method": (["stand", *QUICK, "--method", "rl"], "needs a trained policy"),
    "no policy": (["trot", *QUICK, "--policy", "none.npz"], "none.npz"),
    "loss": (["stand", *QUICK, "--loss", "2"], "link: loss must be in [0, 1]"),
    "somebody's folder": (["stand", *QUICK, "--out", "taken"], "taken holds an earlier deployment or something else"),
    "log": (["stand", *QUICK, "--log", "log.txt"], "must end in .mcap"),
    "disturbance": (["stand", *QUICK, "--disturb", "wind=3"], "wind"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(case: str, run: Run, in_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", open(Path("/dev/null")))  # noqa: SIM115
    arguments, said = BAD[case]
    taken = in_folder / "taken"
    taken.mkdir()
    (taken / "thesis.txt").write_text("")
    files = {}
    if any("{go1}" in a for a in arguments):
        files["go1"] = in_folder / "go1.npz"
        load_motion("trot", "go1").save(files["go1"])
    done = run("deploy", *[a.format(**files) for a in arguments])
    assert said in done.error
    assert sorted(path.name for path in taken.iterdir()) == ["thesis.txt"]
    assert not (in_folder / "runs").exists()


def test_a_damaged_log_is_said_to_be_one(run: Run, in_folder: Path, deployed: Path) -> None:
    content = bytearray((deployed / "log.mcap").read_bytes())
    summary = make_reader(io.BytesIO(content)).get_summary()
    assert summary is not None
    first = summary.chunk_indexes[0]
    content[first.chunk_start_offset + first.chunk_length // 2] ^= 1
    Path("bad.mcap").write_bytes(content)
    for verb in ("evaluate", "identify", "view"):
        assert "bad.mcap: the log is damaged (crc validation failed in Chunk" in run(verb, "bad.mcap").error
