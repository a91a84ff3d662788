"""What a motion's file says of itself: typed, complete, and refused where it is malformed."""

import dataclasses
import json

import pytest

from fastmimic.base.errors import MotionError
from fastmimic.motion.provenance import (
    ClipOrigin,
    DmpRecord,
    MadeWith,
    Provenance,
    RetargetBound,
    RetargetOutcome,
    Span,
    StitchedSegment,
    StitchRecord,
)

DMP = DmpRecord(
    n_basis=2,
    alpha=4.0,
    fit_rms={"feet_m": 0.1},
    names=("root_z", "FR_foot_z"),
    goal=(0.1, 0.2),
    amplitude=(1.0, 1.5),
    fitted_goal=(0.1, 0.3),
    foot_samples_out_of_reach=(0, 0, 0, 0),
    foot_shift_to_reach_m=(0.0, 0.0, 0.0, 0.0),
)
LEG = Span(3, 6, stands=False)
STITCH = StitchRecord(
    segments=(
        StitchedSegment("trot", 0, 3, 0, 10, 0, None, None, None),
        StitchedSegment("turn", 1, 2, 10, 20, 4, Span(8, 12), (LEG, LEG, LEG, LEG), Span(2, 18)),
    ),
    cycle_starts=(5, 15),
    transitions=({"slip_m": 0.0},),
    dmp=(DMP, None),
)
WHOLE = Provenance(
    name="trot",
    robot="a1",
    source=ClipOrigin(source="trot.txt", frames=(3, 9), assumed=("one cycle",), loop={"LoopMode": "Wrap"}),
    retarget={"scale": 0.8, "samples": 4, "bounds": [{"name": "slip", "value": None, "limit": 1, "met": False}]},
    dmp=DMP,
    stitch=STITCH,
    made_with=MadeWith("mbc-dmp", None),
)


def test_it_goes_through_json() -> None:
    text = json.dumps(WHOLE.as_dict(), sort_keys=True)
    again = Provenance.from_dict(json.loads(text))
    assert again == WHOLE
    assert json.dumps(again.as_dict(), sort_keys=True) == text
    found = json.loads(text)
    assert (found["licence"], found["made_with"]["config"]) == (None, None)
    assert Provenance.from_dict(found | {"owner": "somebody"}) == WHOLE  # a key of another program
    assert found["stitch"]["segments"][0]["trunk"] is None
    assert "held_s" not in found
    assert "primitive" not in found["dmp"]


def test_what_a_clip_and_retargeting_always_say_is_typed() -> None:
    assert WHOLE.retargeted == RetargetOutcome(0.8, (RetargetBound("slip", None, 1, False),))
    assert (Provenance().origin, Provenance().retargeted) == (ClipOrigin(), RetargetOutcome())
    with pytest.raises(MotionError, match=r"got `int`.* - at `\$\.source\.source`"):
        _ = Provenance.from_dict({"source": {"source": 3}})


def test_modulation_names_every_dimension() -> None:
    assert list(DMP.modulation()) == [("root_z", 0.1, 0.1, 1.0), ("FR_foot_z", 0.2, 0.3, 1.5)]


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ((), [], "provenance: Expected `object`, got `array`"),
        (("name",), 3, r"provenance: Expected `str`, got `int` - at `\$\.name`"),
        (("dmp",), "none", r"Expected `object \| null`, got `str` - at `\$\.dmp`"),
        (("dmp", "goal", 1), "x", r"Expected `float`, got `str` - at `\$\.dmp\.goal\[1\]`"),
        (("dmp", "goal", 1), True, r"Expected `float`, got `bool` - at `\$\.dmp\.goal\[1\]`"),
        (("dmp", "goal"), [1.0], "'goal', 'amplitude' and 'fitted_goal' must have a number for each of 'names'"),
        (("dmp", "alpha"), ..., r"missing required field `alpha` - at `\$\.dmp`"),
        (("stitch", "dmp"), [], "'stitch.dmp' must have an entry for each of 'stitch.segments'"),
        (
            ("stitch", "segments", 1, "feet"),
            [],
            r"`array` of length 4.* - at `\$\.stitch\.segments\[1\]\.feet`",
        ),
        (("stitch", "cycle_starts", 0), 0.5, r"Expected `int`, got `float` - at `\$\.stitch\.cycle_starts\[0\]`"),
        (
            ("stitch", "transitions", 0, "slip_m"),
            "x",
            r"Expected `int \| float`, got `str`.*\.transitions",
        ),
        (("source", "frames"), [3], r"`array` of length 2.* - at `\$\.source\.frames`"),
        (
            ("retarget", "bounds", 0, "limit"),
            "x",
            r"Expected `float`, got `str` - at `\$\.retarget\.bounds\[0\]",
        ),
        (("made_with", "config"), ..., r"missing required field `config` - at `\$\.made_with`"),
    ],
)
def test_what_is_malformed_is_one_clear_error(path: tuple[str | int, ...], value: object, message: str) -> None:
    found = inner = json.loads(json.dumps({"meta_json": WHOLE.as_dict()}))
    *place, last = ("meta_json", *path)
    for key in place:
        inner = inner[key]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    with pytest.raises(MotionError, match=message):
        Provenance.from_dict(found["meta_json"])


def test_only_a_stitched_motion_has_segments() -> None:
    assert WHOLE.stitched is STITCH
    with pytest.raises(MotionError, match="motion 'trot' is not a stitched one"):
        _ = dataclasses.replace(WHOLE, stitch=None).stitched


def test_assumptions_are_sentences() -> None:
    assert WHOLE.assumed == ("one cycle",)
    assert Provenance().assumed == ()
