"""Video files: H.264, VP9 or GIF, written atomically; qualities of drawing and encoding."""

import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.files import replacing
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


def encoder_arguments(path: str | Path, size: tuple[int, int], fps: float, quality: Quality, frames: int) -> list[str]:
    """Arguments of ffmpeg for a video of `frames` frames of `size`, width and height in pixels, even but for a GIF.
    GIFs repeat. Raises `OutputError` if `path` is a folder or has another ending, `ConfigError` if width or height is
    odd or not positive, or a GIF would be far too large."""
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise OutputError(f"{path}: a video's name must end in {' or '.join(ENDINGS)}")
    if Path(path).is_dir():
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
    source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*size), "-r", f"{fps:g}")
    filters = "vflip" + (f",format=rgb24,{_PALETTE}" if gif else "")
    made = (*_encode(ending, quality), "-f", ending[1:])
    return ["-y", "-v", "error", *source, "-i", "-", "-an", "-lavfi", filters, *made]


@contextmanager
def encoded(path: str | Path, arguments: list[str]) -> Iterator[Callable[[NDArray[np.uint8]], None]]:
    """Encodes a video with the arguments of `encoder_arguments`, which replaces `path` on success: gives a function
    that adds a frame, (height, width, 3), first row on top. A frame as OpenGL drew it, last row first in memory, is not
    copied. Raises `OutputError` if `path` cannot be written, or the encoder stops or fails."""
    with replacing(path) as temporary, tempfile.TemporaryFile() as messages:
        encoder = subprocess.Popen(
            [ffmpeg(), *arguments, str(temporary)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            start_new_session=True,  # Ctrl-C is ours to handle
        )
        assert encoder.stdin is not None
        pipe = encoder.stdin
        with suppress(ImportError, AttributeError, OSError):  # a larger buffer; only Linux can
            import fcntl

            fcntl.fcntl(pipe.fileno(), fcntl.F_SETPIPE_SZ, _PIPE)

        def problem(what: str) -> OutputError:
            messages.seek(0)
            lines = messages.read().decode(errors="replace").strip().splitlines()
            complaint = lines[-1] if lines else f"exit status {encoder.returncode}"
            return OutputError(f"{path}: the video encoder {what} ({complaint})")

        def write(frame: NDArray[np.uint8]) -> None:
            try:
                pipe.write(np.ascontiguousarray(frame[::-1]).data)
            except OSError:
                encoder.wait()
                raise problem("stopped") from None

        try:
            yield write
            encoder.communicate()  # closes its input and waits
            if encoder.returncode:
                raise problem("failed")
        finally:
            encoder.kill()  # if it has not ended
            encoder.wait()
            with suppress(OSError):  # what it had not read is lost with it
                pipe.close()


def ffmpeg() -> str:
    import imageio_ffmpeg  # type: ignore[import-untyped]

    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise OutputError(f"no ffmpeg to encode a video with ({error})") from None


def _encode(ending: str, quality: Quality) -> tuple[str, ...]:
    if ending == ".gif":
        return ("-loop", "0")
    if ending == ".webm":
        speed = ("-deadline", "realtime", "-cpu-used", "8") if quality.preset == PREVIEW.preset else ("-cpu-used", "4")
        return (*_VP9, "-crf", str(quality.crf + 10), *speed)
    x264 = ("-c:v", "libx264", "-preset", quality.preset, "-crf", str(quality.crf))
    return (*x264, "-pix_fmt", "yuv420p", "-movflags", "+faststart")
