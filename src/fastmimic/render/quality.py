"""How carefully a video is drawn: quick, or as well as MuJoCo can."""

from dataclasses import dataclass
from typing import Final

from fastmimic.base.errors import ConfigError, did_you_mean


@dataclass(frozen=True)
class Quality:
    """What drawing a frame takes.

    Attributes:
        name: as on the command line.
        size: width and height if nothing is said, pixels.
        shadow_map: resolution of the light's depth map, pixels each way; 0 for the robot's geoms flattened onto the
            ground, which without a graphics card is ten times as quick.
        samples: of each pixel, for smooth edges; 0 for one.
        reflectance: share of what the ground mirrors.
        textured: whether the ground's pattern is a texture, which blurs with distance, or tiles, which is quicker.
        facets: of a round shape, around it.
        preset, crf: libx264's effort and loss.
    """

    name: str
    size: tuple[int, int]
    shadow_map: int
    samples: int
    reflectance: float
    textured: bool
    facets: int
    preset: str
    crf: int


PREVIEW: Final = Quality("preview", (800, 450), 0, 0, 0.0, False, 8, "ultrafast", 25)
HIGH: Final = Quality("high", (1280, 720), 2048, 4, 0.06, True, 36, "medium", 19)
QUALITIES: Final = {quality.name: quality for quality in (PREVIEW, HIGH)}


def quality_named(name: str) -> Quality:
    """The quality of that name.

    Raises:
        ConfigError: there is none; the message lists them.
    """
    if name not in QUALITIES:
        raise ConfigError(f"unknown quality '{name}'; there are {', '.join(QUALITIES)}{did_you_mean(name, QUALITIES)}")
    return QUALITIES[name]
