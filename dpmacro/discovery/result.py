"""What a search for macro-actions found: rival segmentations, the verdicts on them and the one to keep."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from dpmacro.discovery.alternation import Alternated
from dpmacro.discovery.candidates import Judged, Task, Verdict, left_out_charges
from dpmacro.segmentation.recursion import segment, transition_counts

__all__ = ["Search"]


@dataclass(frozen=True)
class Search:
    """Rival segmentations and what left-out data says of them."""

    task: Task
    candidates: Alternated  # from every initial segmentation
    judged: tuple[Judged, ...]  # outcomes, then what the switch functions made of the best of them
    best: int  # the one to keep, a place in `judged`

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
        """Nats a frame that left-out classifiers charge the best segmentation under each bound 0, 1, ..."""
        charges = left_out_charges(self.kept, self.task)
        bound = min(2 * self.max_transitions + 2, int(self.task.lengths.max()) - 1)
        return segment(charges, self.task.lengths, bound).cost_by_bound.sum(0) / len(charges)

    @property
    def kept(self) -> Judged:
        """The one to keep."""
        return self.judged[self.best]

    @property
    def kept_transitions(self) -> int:
        """The most transitions of the one to keep in any trajectory: of the final fit, the bound."""
        return int(transition_counts(self.kept.labels, self.task.lengths).max())

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What left-out data says of each that was judged."""
        return tuple(rival.verdict for rival in self.judged)
