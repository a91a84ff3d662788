"""H.264 video files, written so that only a whole one ever appears under its name."""

import os
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.errors import ConfigError, OutputError

# The quickest preset with two of the tools that it drops: as good as `veryfast` in 40 % of its time.
_ENCODE: Final = (
    *("-an", "-c:v", "libx264", "-preset", "ultrafast", "-crf", "25", "-x264-params", "cabac=1:deblock=1"),
    *("-pix_fmt", "yuv420p", "-movflags", "+faststart"),
)


class VideoFile:
    """Encodes frames into a temporary file beside `path` and puts it there when all went well.

    Use it as a context manager; after an exception, an interrupt included, `path` is as it was.

    Args:
        path: the `.mp4` to write.
        source_size: width and height of the frames that will be written, pixels.
        size: width and height of the video, pixels, even; frames of another size are scaled.
        fps: frames a second.

    Raises:
        OutputError: `path` cannot be written, or does not end in `.mp4`.
        ConfigError: width or height is odd or not positive.
    """

    def __init__(self, path: str | Path, source_size: tuple[int, int], size: tuple[int, int], fps: float) -> None:
        self._path = Path(path)
        if self._path.suffix.lower() != ".mp4":
            raise OutputError(f"{path}: a video's name must end in .mp4")
        if self._path.is_dir():
            raise OutputError(f"{path}: is a folder; a video cannot take its place")
        if min(size) < 2 or size[0] % 2 or size[1] % 2:
            raise ConfigError(f"H.264 needs an even width and height, found {size[0]} x {size[1]}")
        self._arguments = _arguments(source_size, size, fps)

    def __enter__(self) -> "VideoFile":
        self._temporary = _temporary_beside(self._path)
        try:
            self._messages: IO[bytes] = tempfile.TemporaryFile()
            self._encoder = subprocess.Popen(
                [_ffmpeg(), *self._arguments, str(self._temporary)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._messages,
                start_new_session=True,  # Ctrl-C is ours to handle
            )
        except BaseException:
            self._temporary.unlink(missing_ok=True)
            raise
        return self

    def write(self, frame: NDArray[np.uint8]) -> None:
        """Adds one frame, (height, width, 3), first row on top.

        Raises:
            OutputError: the encoder has stopped.
        """
        assert self._encoder.stdin is not None
        try:
            self._encoder.stdin.write(np.ascontiguousarray(frame).data)
        except OSError:
            self._encoder.wait()
            raise OutputError(f"{self._path}: the video encoder stopped ({self._complaint()})") from None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._finish()
        finally:
            if self._encoder.poll() is None:
                self._encoder.kill()
                self._encoder.wait()
            if self._encoder.stdin is not None:
                with suppress(OSError):  # what it had not read is lost with it
                    self._encoder.stdin.close()
            self._messages.close()
            self._temporary.unlink(missing_ok=True)

    def _finish(self) -> None:
        self._encoder.communicate()  # closes its input and waits
        if self._encoder.returncode:
            raise OutputError(f"{self._path}: the video encoder failed ({self._complaint()})")
        try:
            os.chmod(self._temporary, 0o644)
            os.replace(self._temporary, self._path)
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written ({error.strerror or error})") from None

    def _complaint(self) -> str:
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit status {self._encoder.returncode}"


def _temporary_beside(path: Path) -> Path:
    """An empty file in the same folder, so that replacing is atomic, with a video's ending."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=".mp4")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from None
    os.close(handle)
    return Path(name)


def _ffmpeg() -> str:
    """The ffmpeg that comes with imageio, or the system's."""
    import imageio_ffmpeg  # type: ignore[import-untyped]

    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise OutputError(f"no ffmpeg to encode a video with ({error})") from None


def _arguments(source_size: tuple[int, int], size: tuple[int, int], fps: float) -> list[str]:
    source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*source_size), "-r", f"{fps:g}")
    scale = () if source_size == size else ("-vf", "scale={}:{}:flags=area".format(*size))
    return ["-y", "-v", "error", *source, "-i", "-", *scale, *_ENCODE]
