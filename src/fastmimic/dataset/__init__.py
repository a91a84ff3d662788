"""Libraries of motions that a robot can execute, with the evidence: from takes and clips to a dataset.

`build` finds what can be imitated in every source, makes a motion of each piece for each robot and seed, tries it in
other conditions, and keeps one record of each. `Library` is the folder that it makes, and what can be done with it.
"""

from fastmimic.dataset.build import Building, build
from fastmimic.dataset.folder import Library
from fastmimic.dataset.grades import GRADES
from fastmimic.dataset.recipe import Recipe
from fastmimic.dataset.sources import Source, find_sources

__all__ = ["GRADES", "Building", "Library", "Recipe", "Source", "build", "find_sources"]
