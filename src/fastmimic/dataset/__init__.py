"""Libraries of motions that a robot can execute, optimised for each robot and seed, with their evaluation."""

from fastmimic.dataset.build import BuildRequest, build_dataset
from fastmimic.dataset.excerpts import DatasetSource, find_sources
from fastmimic.dataset.folder import BuildSettings, MotionDataset
from fastmimic.dataset.index import GRADES

__all__ = ["GRADES", "BuildRequest", "BuildSettings", "DatasetSource", "MotionDataset", "build_dataset", "find_sources"]
