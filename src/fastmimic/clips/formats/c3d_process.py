"""Reads a C3D with ezc3d and saves what is used of it: `python c3d_process.py TAKE.c3d OUT.npz`. See `c3d.py`."""

import sys
from importlib import import_module

import numpy as np


def main(source: str, out: str) -> None:
    """Saves points (3, k, t), residuals (k, t), labels, unit and rate."""
    file = import_module("ezc3d").c3d(source)
    about = file["parameters"]["POINT"]
    np.savez(
        out,
        points=file["data"]["points"][:3],
        residuals=file["data"]["meta_points"]["residuals"][0],
        labels=np.array([label for key in ("LABELS", "LABELS2") if key in about for label in about[key]["value"]]),
        unit="".join(about["UNITS"]["value"][:1]),
        rate=about["RATE"]["value"][0],
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
