"""Whatever a file holds, reading it gives a clip or one clear error; valid content comes back as it was."""

import json
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sample_files import (
    csv_text,
    csv_values,
    deepmimic_document,
    deepmimic_text,
    keypoint_text,
    keypoint_values,
    save_motion,
    table_text,
)

from fastmimic.base.errors import FastMimicError
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import ReadOptions, csv_motion, deepmimic, detect_format, keypoints, read_clip
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

TEXTS = [text.encode() for text in (keypoint_text(5), deepmimic_text(5), csv_text(5), csv_text(5, header=True))]
shared_fixtures = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def read_or_refuse(path: Path, content: bytes, robot: Robot) -> None:
    """A finite clip, a motion, or an error of one line that names the file; nothing else is raised."""
    path.write_bytes(content)
    message = None
    try:
        result = Motion.load(path) if detect_format(path) == "npz" else read_clip(path, ReadOptions(robot=robot))
        assert not isinstance(result, Clip) or np.all(np.isfinite(result.points_w))
    except FastMimicError as error:
        message = str(error)
    assert message is None or (message.startswith(str(path)) and "\n" not in message)


def npz_content() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return save_motion(Path(folder) / "motion.npz").read_bytes()


VALID = [*TEXTS, npz_content()]


@st.composite
def mutations(draw: st.DrawFn) -> bytes:
    """A valid file with a slice cut out, put in, or replaced."""
    content = draw(st.sampled_from(VALID))
    start = draw(st.integers(0, len(content)))
    end = draw(st.integers(start, min(len(content), start + 200)))
    patch = draw(
        st.binary(max_size=20)
        | st.sampled_from(
            [b"nan", b"-inf", b"1e999", b",", b"\n", b"[", b"]", b"{", b"null", b"1_0", b'"', b"#", b"9" * 30]
        )
    )
    return content[:start] + patch + content[end:]


@shared_fixtures
@given(content=st.binary(max_size=400) | st.text(max_size=200).map(str.encode))
def test_arbitrary_content(tmp_path: Path, a1: Robot, content: bytes):
    read_or_refuse(tmp_path / "file", content, a1)


@shared_fixtures
@given(content=mutations())
def test_damaged_files(tmp_path: Path, a1: Robot, content: bytes):
    read_or_refuse(tmp_path / "file", content, a1)


@shared_fixtures
@given(cut=st.integers(0, 10_000), which=st.sampled_from(VALID))
def test_truncated_files(tmp_path: Path, a1: Robot, cut: int, which: bytes):
    read_or_refuse(tmp_path / "file", which[: cut % len(which)], a1)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=20) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=30,
)


@shared_fixtures
@given(key=st.sampled_from(["LoopMode", "FrameDuration", "Frames"]), value=json_values)
def test_json_with_other_values(tmp_path: Path, a1: Robot, key: str, value):
    read_or_refuse(tmp_path / "file", json.dumps(deepmimic_document() | {key: value}).encode(), a1)


@shared_fixtures
@given(text=st.text(alphabet="0123456789.,-+einf \n\t#;", max_size=300))
def test_number_like_text(tmp_path: Path, a1: Robot, text: str):
    read_or_refuse(tmp_path / "file", text.encode(), a1)


small = st.floats(-0.02, 0.02)  # m: keeps hips above toes and left on the left
lengths = st.integers(2, 6)


@given(noise=lengths.flatmap(lambda n: arrays(np.float64, (n, 27, 3), elements=small)))
def test_keypoints_come_back(noise: np.ndarray):
    values = keypoint_values(len(noise)) + noise
    clip = keypoints.parse(table_text(values))
    order = [0, 3, 11, 6, 20, 16, 15, 10, 23, 19]
    np.testing.assert_allclose(clip.points_w, values[:, order][..., [2, 0, 1]], atol=0.6e-5)  # five decimals


@given(joints=lengths.flatmap(lambda n: arrays(np.float64, (n, 12), elements=st.floats(-1.5, 1.5))))
def test_deepmimic_angles_come_back_as_feet(joints: np.ndarray):
    frames = [[0, 0, 0.4, 0.5, 0.5, 0.5, 0.5, *row] for row in joints.tolist()]
    clip = deepmimic.parse(json.dumps({"LoopMode": "Clamp", "FrameDuration": 0.02, "Frames": frames}))
    np.testing.assert_allclose(clip.toes_w - [0, 0, 0.4], deepmimic.laikago_feet(joints), atol=1e-12)


@shared_fixtures
@given(noise=lengths.flatmap(lambda n: arrays(np.float64, (n, 12), elements=st.floats(-0.3, 0.3))))
def test_csv_angles_come_back_as_feet(a1: Robot, noise: np.ndarray):
    values = csv_values(len(noise))
    values[:, 7:] += noise
    clip = csv_motion.parse(table_text(values, ","), robot=a1)
    np.testing.assert_allclose(
        clip.toes_w - values[:, None, :3], foot_positions(a1, values[:, 7:]), atol=1e-4
    )  # angles with five decimals on legs of 0.4 m
