"""Qualities of a video's drawing."""

from dataclasses import dataclass
from typing import Final

from fastmimic.base.errors import ConfigError, did_you_mean


@dataclass(frozen=True)
class Quality:
    """The quality of a video's drawing.

    Attributes:
        name: as on the command line.
        size: default width and height, pixels.
        shadow_map: resolution of the light's depth map, pixels each way; 0 for geoms flattened onto the ground, ten
            times as fast without a graphics card.
        samples: of each pixel, for smooth edges; 0 for one.
        reflectance: of the ground.
        textured: whether the ground's pattern is a texture, which blurs with distance, or tiles, which are faster.
        facets: around a round shape.
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
    """The quality of that name; raises `ConfigError`."""
    if name not in QUALITIES:
        raise ConfigError(f"unknown quality '{name}'; there are {', '.join(QUALITIES)}{did_you_mean(name, QUALITIES)}")
    return QUALITIES[name]
