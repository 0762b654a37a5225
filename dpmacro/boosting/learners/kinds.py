"""The kinds of strong classifiers by name, so that a file can tell which kind it holds."""

from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier
from dpmacro.boosting.learners.convnet import ConvNetClassifier
from dpmacro.boosting.learners.stumps import StumpClassifier

__all__ = ["KINDS", "classifier_from", "classifier_tensors"]

KINDS: dict[str, type[StrongClassifier]] = {kind.kind: kind for kind in (StumpClassifier, ConvNetClassifier)}


def classifier_tensors(classifier: StrongClassifier) -> dict[str, Tensor]:
    """The tensors that define a strong classifier, each named <kind>.<name>."""
    return {f"{classifier.kind}.{name}": tensor for name, tensor in classifier.tensors().items()}


def classifier_from(tensors: dict[str, Tensor]) -> StrongClassifier:
    """The strong classifier that `classifier_tensors` described.

    Raises KeyError for an unknown kind, and ValueError where there are no tensors or those of several kinds.
    """
    kinds = {name.split(".")[-2] for name in tensors}
    if len(kinds) != 1:
        raise ValueError(f"tensors of {', '.join(sorted(kinds)) or 'no kind'}: give those of one classifier")
    return KINDS[kinds.pop()](**{name.split(".")[-1]: tensor for name, tensor in tensors.items()})
