"""Where a robot motion came from, in words, out of its metadata."""

from typing import Any

from fastmimic.motion.motion import Motion


def provenance(motion: Motion) -> str:
    """One line: name, source, scale, period, licence."""
    from fastmimic.clips.formats import FORMATS

    source, retargeting = _dict(motion, "source"), _dict(motion, "retarget")
    parts = [str(source.get("source", "no source given"))]
    if "frames" in source:
        parts.append("frames {}:{}".format(*source["frames"]))
    if source.get("format") in FORMATS:
        parts.append(FORMATS[source["format"]].about)
    if "scale" in retargeting:
        parts.append(f"scale {retargeting['scale']:.3f}")
    parts.append(f"{motion.period_s:.3f} s" + (" a cycle" if motion.cycle is not None else f", {_once(motion)}"))
    licence = motion.meta.get("licence")
    return f"{motion.name}: {', '.join(parts)}" + (f"; licence: {licence}" if licence else "")


def _once(motion: Motion) -> str:
    if motion.target.parts:
        return "no cycle"
    held = motion.meta.get("held_s")
    return "done once, " + (f"the last {held:.2g} s of it at rest" if held else "to its end in mid-stride")


def assumed(motion: Motion) -> list[str]:
    """What reading the clip assumed, as sentences."""
    return [str(sentence) for sentence in _dict(motion, "source").get("assumed", [])]


def unmet_bounds(motion: Motion) -> list[str]:
    """The bounds of a faithful retargeting that this one does not keep, as sentences."""
    bounds = _dict(motion, "retarget").get("bounds", [])
    return [
        f"{bound['name']} {bound['value']:.3g} is beyond {bound['limit']:.3g}"
        + (f" ({bound['reason']})" if bound["reason"] else "")
        for bound in bounds
        if not bound["met"]
    ]


def _dict(motion: Motion, key: str) -> dict[str, Any]:
    value = motion.meta.get(key)
    return value if isinstance(value, dict) else {}
