"""What a fitted DPBoost holds: a segmentation, and the functions that were fitted to it."""

from dataclasses import dataclass

from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier
from dpmacro.boosting.losses.base import Loss
from dpmacro.discovery.result import Discovery
from dpmacro.estimator.hindsight import SwitchTerms
from dpmacro.features.quantising import Quantiser
from dpmacro.switching.functions import SwitchFunctions

__all__ = ["DPBoostResult"]


@dataclass(frozen=True)
class DPBoostResult:
    """A segmentation and what was fitted to it.

    Attributes:
        labels: macro-action of every frame, 0..Q-1, each used.
        confidence: 0..1, how sure classifiers that never saw the frame are of its label.
        loss: objective per frame after every round of the final fit.
        action_loss: what the classifiers minimise.
        classifiers: problems are macro-actions, outputs those of the loss.
        switches: between the macro-actions.
        terms: how the switch functions joined the final segmentation; None where they did not.
        max_transitions: S of the final segmentation.
        order: of macro-actions in it, "free" or "chain".
        unsettled: frames whose label is not the one that the switch functions were fitted to; 0 where the
            final fit settled.
        quantiser: from raw feature columns to levels; None where levels were given.
        discovery: the candidates; None where there was nothing to discover.
        final: the labels scored on left-out data; None likewise.
    """

    labels: Int64[Tensor, " frames"]
    confidence: Float[Tensor, " frames"]
    loss: Float[Tensor, " rounds"]
    action_loss: Loss
    classifiers: StrongClassifier
    switches: SwitchFunctions
    terms: SwitchTerms | None
    max_transitions: int
    order: str
    unsettled: int
    quantiser: Quantiser | None
    discovery: Discovery | None
    final: Discovery | None

    @property
    def macros(self) -> int:
        """The macro-actions that are used."""
        return int(self.labels.max()) + 1

    @property
    def switch_weight(self) -> float:
        """How much the switch functions counted in the final segmentation; 0 where nothing."""
        return 0.0 if self.terms is None else self.terms.weight
