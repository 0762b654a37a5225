"""A small training set, a quick DPBoost on it, and what it means that an argument is refused."""

import numpy as np
import pytest

from dpmacro import DPBoost

N = 24
X = np.random.default_rng(0).normal(size=(N, 3)).astype(np.float32)
A = (X[:, 0] > 0).astype(np.int64)
L = [10, 14]
SMALL = {"macros": 2, "rounds": 3, "restarts": 2, "switch_rounds": 3}


def fitted(features=X, actions=A, lengths=L, **options):
    return DPBoost(**{**SMALL, **options}).fit(features, actions, lengths)


def refused(name, call, *arguments, **options):
    """`call` raises a ValueError of one line that starts with the name, says a value, and a remedy."""
    with pytest.raises(ValueError, match=rf"^{name}\b.+: .+") as caught:
        call(*arguments, **options)
    assert type(caught.value) is ValueError
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250
