"""The nearest of many pieces: by period, speed, turning and footfall; of equally near ones the first."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from fastmimic.dataset import DatasetSource
from fastmimic.dataset.excerpts import Excerpt, survey
from fastmimic.dataset.jobs import FARTHEST, OTHER_FOOTFALL, Neighbours, place_of


def distance(a: Excerpt, b: Excerpt) -> float:
    other = None not in (a.footfall, b.footfall) and a.footfall != b.footfall
    return math.dist(place_of(a), place_of(b)) + OTHER_FOOTFALL * other


def test_the_nearest_is_the_least_distant_of_all() -> None:
    (trot,) = survey(DatasetSource("trot"), 0.5).pieces
    draw = np.random.default_rng(1)
    footfalls = ("trot", "pace", "bound", None)

    def piece(i: int):  # type: ignore[no-untyped-def]
        numbers = draw.choice([0.3, 0.4, 0.5], 1)[0], *np.round(draw.normal(0, 1, 2), 1).tolist()  # with equal ones
        known = dict(zip(("period_s", "speed_m_per_s", "yaw_rate_rad_per_s"), numbers, strict=True))
        return replace(trot, digest=f"{i:04}", footfall=footfalls[draw.integers(4)], **known)

    pieces = {p.digest: p for p in map(piece, range(400))}
    rows = [{"id": f"{draw.integers(1 << 60):016x}", "piece": digest, "motion_file": digest} for digest in pieces]
    known = Neighbours(Path("/library"), pieces, {"a1": rows})
    for i in range(100):
        asked = piece(i)
        near = min(rows, key=lambda row: (round(distance(asked, pieces[row["piece"]]), 9), row["id"]))
        found = known.nearest(asked, "a1")
        assert found is not None
        assert found.of == near["id"]
    far = replace(trot, speed_m_per_s=trot.speed_m_per_s + 100.0)
    assert all(distance(far, other) > FARTHEST for other in pieces.values())
    assert known.nearest(far, "a1") is None
    assert known.nearest(trot, "go2") is None
    assert known.nearest(replace(trot, repeats=False), "a1") is None
