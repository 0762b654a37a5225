"""Strong classifiers of every kind through a file, and what no kind wrote."""

import pytest
import torch

from dpmacro.boosting.learners.kinds import KINDS, classifier_from, classifier_tensors
from dpmacro.boosting.learners.stumps import StumpClassifier


def stumps():
    """Two stumps for each of three problems."""
    columns = torch.arange(6).view(2, 3)
    return StumpClassifier(columns, columns.byte(), torch.randn(2, 3, 2, 4))


def test_kinds_bear_their_names():
    assert all(kind.kind == name for name, kind in KINDS.items())


def test_a_classifier_comes_back_from_its_tensors():
    before = stumps()
    tensors = classifier_tensors(before)
    assert set(tensors) == {"stumps.columns", "stumps.thresholds", "stumps.votes"}
    after = classifier_from(tensors)
    assert isinstance(after, StumpClassifier)
    assert all(torch.equal(value, after.tensors()[name]) for name, value in before.tensors().items())


def test_tensors_may_be_numbered():
    numbered = {f"0.{name}": tensor for name, tensor in classifier_tensors(stumps()).items()}
    assert isinstance(classifier_from(numbered), StumpClassifier)


def test_an_unknown_kind_is_named():
    with pytest.raises(KeyError, match="forest"):
        classifier_from({"forest.trees": torch.zeros(1)})


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({}, "tensors of no kind"),
        ({"stumps.votes": torch.zeros(1), "convnet.head": torch.zeros(1)}, "tensors of convnet, stumps"),
    ],
)
def test_tensors_of_no_or_several_classifiers_are_refused(tensors, message):
    with pytest.raises(ValueError, match=message):
        classifier_from(tensors)
