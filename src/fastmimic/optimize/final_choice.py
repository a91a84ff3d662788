"""How a search chooses its result among its best candidates."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FinalChoice:
    """The validation at the end of a search. It does not change the search, so checkpoints do not depend on it.

    Attributes:
        candidates: number of candidates that compete for being the result.
        episodes: of each; one begins at the motion's start, the others perturbed.
        robots: of each, in place of `episodes`, where candidates are scored over several robots.
        duration_s: length of an episode, s.
    """

    candidates: int = 8
    episodes: int = 4
    robots: int = 8
    duration_s: float = 10.0

    @property
    def simulated_s(self) -> float:
        """Time to simulate for the validation on one robot, s."""
        return self.candidates * self.episodes * self.duration_s
