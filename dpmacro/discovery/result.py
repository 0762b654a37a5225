"""What a search found: candidate segmentations with their scores, and the one to keep."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from dpmacro.discovery.alternation import Alternated
from dpmacro.discovery.candidates import Candidate, left_out_charges
from dpmacro.discovery.criteria import CandidateScores
from dpmacro.discovery.task import Task
from dpmacro.segmentation.recursion import segment
from dpmacro.segmentation.segments import transition_counts

__all__ = ["Discovery"]


@dataclass(frozen=True)
class Discovery:
    """Candidate segmentations and what left-out data says of them."""

    task: Task  # of the trajectories that were searched
    alternated: Alternated  # from every initial segmentation
    candidates: tuple[Candidate, ...]  # outcomes, then what the switch functions made of the best of them
    best: int  # the one to keep, a place in `candidates`
    drawn: Bool[Tensor, " trajectories"] | None = None  # that were searched; None for all of them

    @property
    def macros(self) -> int:
        """Q, of which some may not be used."""
        return self.task.macros

    @property
    def max_transitions(self) -> int:
        """S, no more than the longest trajectory allows."""
        return self.task.max_transitions

    @property
    def changes(self) -> float:
        """Transitions per trajectory of the segmentation to keep."""
        return float(transition_counts(self.kept.labels, self.task.lengths).float().mean())

    @property
    def cost_by_bound(self) -> Float[Tensor, " bounds"]:
        """Nats a frame that left-out classifiers charge the best segmentation under each bound 0, 1, ...

        Macro-actions without frames are left out, and the bounds go up to twice the transitions that the
        segmentation to keep has in any trajectory, plus two.
        """
        charges = left_out_charges(self.kept, self.task)[:, self.kept.used]
        used = self.kept.transitions(self.task.lengths)
        bound = min(2 * used + 2, int(self.task.lengths.max()) - 1)
        return segment(charges, self.task.lengths, bound).cost_by_bound.sum(0) / len(charges)

    @property
    def kept(self) -> Candidate:
        """The one to keep."""
        return self.candidates[self.best]

    @property
    def scores(self) -> tuple[CandidateScores, ...]:
        """What left-out data says of each candidate."""
        return tuple(one.scores for one in self.candidates)
