"""Video files: H.264, VP9 or GIF, written atomically; qualities of drawing and encoding."""

import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.registry import Registry

FPS: Final = 30.0
GIF_FPS: Final = 20.0
GIF_SIZE: Final = (640, 360)
ENDINGS: Final = (".mp4", ".gif", ".webm")
GIF_MEGAPIXELS: Final = 60  # of all frames together: about 20 MB

_VP9: Final = ("-c:v", "libvpx-vp9", "-b:v", "0", "-row-mt", "1", "-pix_fmt", "yuv420p")
_PALETTE: Final = (
    "split[all][drawn];[all]palettegen=stats_mode=full[palette];"
    "[drawn][palette]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)  # 256 colours from all frames, which the encoder holds until the end
_PIPE: Final = 2**20  # bytes, the most that Linux allows


@dataclass(frozen=True)
class Quality:
    """A video's quality of drawing. Without a shadow map, geoms are flattened onto the ground: ten times as fast."""

    name: str  # as on the command line
    size: tuple[int, int]  # default width and height, pixels
    shadow_map: int  # resolution of the light's depth map, pixels each way; 0 for none
    samples: int  # of each pixel, for smooth edges; 0 for one
    reflectance: float  # of the ground
    textured: bool  # whether the ground's pattern is a texture, which blurs with distance, or tiles, which are faster
    facets: int  # around a round shape
    preset: str  # libx264's effort
    crf: int  # and loss


PREVIEW: Final = Quality("preview", (800, 450), 0, 0, 0.0, False, 8, "ultrafast", 25)
HIGH: Final = Quality("high", (1280, 720), 2048, 4, 0.06, True, 36, "medium", 19)
QUALITIES: Final = Registry("quality", (PREVIEW, HIGH))


class VideoFile:
    """Encodes frames into a temporary file, which replaces `path` on success. A context manager. GIFs repeat. Frames of
    `source_size`, width and height in pixels, are scaled to the video's `size`, which is even but for a GIF; `frames`
    is their number, if known. Raises `OutputError` if `path` cannot be written or has another ending, `ConfigError` if
    width or height is odd or not positive, or a GIF would be far too large."""

    def __init__(
        self,
        path: str | Path,
        source_size: tuple[int, int],
        size: tuple[int, int],
        fps: float,
        quality: Quality = PREVIEW,
        frames: int = 0,
    ) -> None:
        self._path = Path(path)
        ending = self._path.suffix.lower()
        if ending not in ENDINGS:
            raise OutputError(f"{path}: a video's name must end in {' or '.join(ENDINGS)}")
        if self._path.is_dir():
            raise OutputError(f"{path}: is a folder; a video cannot take its place")
        gif = ending == ".gif"
        if min(size) < 2 or (not gif and (size[0] % 2 or size[1] % 2)):
            raise ConfigError(f"H.264 and VP9 need an even width and height, found {size[0]} x {size[1]}")
        megapixels = size[0] * size[1] * frames / 1e6
        if gif and megapixels > GIF_MEGAPIXELS:
            raise ConfigError(
                f"{path}: a GIF of {frames} frames of {size[0]} x {size[1]} would be enormous; make it smaller, shorter"
                f" or of fewer frames a second, up to {GIF_MEGAPIXELS} megapixels in all ({megapixels:.0f}), or an .mp4"
            )
        self._arguments = _arguments(source_size, size, fps, ending, quality)

    def __enter__(self) -> "VideoFile":
        path = self._path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=path.suffix.lower())
        except OSError as error:
            raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from None
        os.close(handle)
        self._temporary = Path(name)
        try:
            self._messages: IO[bytes] = tempfile.TemporaryFile()
            self._encoder = subprocess.Popen(
                [_ffmpeg(), *self._arguments, str(self._temporary)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._messages,
                start_new_session=True,  # Ctrl-C is ours to handle
            )
            assert self._encoder.stdin is not None
            self._pipe = self._encoder.stdin
            _widen(self._pipe)
        except BaseException:
            self._temporary.unlink(missing_ok=True)
            raise
        return self

    def write(self, frame: NDArray[np.uint8]) -> None:
        """Adds a frame, (height, width, 3), first row on top; raises `OutputError` if the encoder has stopped. A frame
        as OpenGL drew it, last row first in memory, is not copied."""
        try:
            self._pipe.write(np.ascontiguousarray(frame[::-1]).data)
        except OSError:
            self._encoder.wait()
            raise OutputError(f"{self._path}: the video encoder stopped ({self._complaint()})") from None

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._finish()
        finally:
            if self._encoder.poll() is None:
                self._encoder.kill()
                self._encoder.wait()
            with suppress(OSError):  # what it had not read is lost with it
                self._pipe.close()
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


def _widen(pipe: IO[bytes]) -> None:
    """Enlarges a pipe's buffer where allowed."""
    if not sys.platform.startswith("linux"):
        return
    import fcntl

    with suppress(OSError):
        fcntl.fcntl(pipe.fileno(), fcntl.F_SETPIPE_SZ, _PIPE)


def _ffmpeg() -> str:
    import imageio_ffmpeg  # type: ignore[import-untyped]

    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise OutputError(f"no ffmpeg to encode a video with ({error})") from None


def _arguments(
    source_size: tuple[int, int], size: tuple[int, int], fps: float, ending: str, quality: Quality
) -> list[str]:
    source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*source_size), "-r", f"{fps:g}")
    scale = "" if source_size == size else ",scale={}:{}:flags=area".format(*size)
    filters = f"vflip{scale}" + (f",format=rgb24,{_PALETTE}" if ending == ".gif" else "")
    return ["-y", "-v", "error", *source, "-i", "-", "-an", "-lavfi", filters, *_encode(ending, quality)]


def _encode(ending: str, quality: Quality) -> tuple[str, ...]:
    if ending == ".gif":
        return ("-loop", "0")
    if ending == ".webm":
        speed = ("-deadline", "realtime", "-cpu-used", "8") if quality.preset == PREVIEW.preset else ("-cpu-used", "4")
        return (*_VP9, "-crf", str(quality.crf + 10), *speed)
    x264 = ("-c:v", "libx264", "-preset", quality.preset, "-crf", str(quality.crf))
    return (*x264, "-pix_fmt", "yuv420p", "-movflags", "+faststart")
