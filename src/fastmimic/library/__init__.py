"""Libraries of motions that a robot can execute, with the evidence: from takes and clips to a dataset.

`build` finds what can be imitated in every source, makes a motion of each piece for each robot and seed, tries it in
other conditions, and keeps one record of each. `Library` is the folder that it makes, and what can be done with it.
"""

from fastmimic.library.build import Building, build
from fastmimic.library.folder import Library
from fastmimic.library.grades import GRADES
from fastmimic.library.recipe import Recipe
from fastmimic.library.sources import Source, find_sources

__all__ = ["GRADES", "Building", "Library", "Recipe", "Source", "build", "find_sources"]
