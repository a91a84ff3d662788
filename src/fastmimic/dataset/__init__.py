"""Libraries of motions that a robot can execute, with their evaluation.

`build_dataset` finds motions in every source, optimises each for each robot and seed, evaluates it under several
conditions, and keeps one record of each. `MotionDataset` is the folder of the result.
"""

from fastmimic.dataset.build import BuildRequest, build_dataset
from fastmimic.dataset.folder import BuildSettings, MotionDataset
from fastmimic.dataset.records import GRADES
from fastmimic.dataset.sources import DatasetSource, find_sources

__all__ = ["GRADES", "BuildRequest", "BuildSettings", "DatasetSource", "MotionDataset", "build_dataset", "find_sources"]
