"""What `import dpmacro` offers: its names, its cost, what `segment` takes, and the manners of DPBoost."""

import copy
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import torch
from jaxtyping import TypeCheckError
from refusals import A, L, N, X, fitted, refused
from sklearn.base import clone

import dpmacro
from dpmacro import DPBoost, segment

NAMES = [
    "Annotation",
    "DPBoost",
    "DPBoostResult",
    "Demonstrations",
    "MacroPolicy",
    "Segmentation",
    "Stages",
    "annotate",
    "segment",
    "write_labels",
]
SECONDS = 0.5  # of a processor, at most, over importing torch


def python(code):
    """What a fresh Python prints."""
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_offers_what_is_listed():
    assert sorted(dpmacro.__all__) == NAMES
    for name in NAMES:
        assert getattr(dpmacro, name).__name__ == name


def test_offers_nothing_else_but_packages():
    code = """
import importlib, pkgutil, dpmacro
for name in dpmacro.__all__: getattr(dpmacro, name)
packages = {one.name for one in pkgutil.iter_modules(dpmacro.__path__)}
print(sorted({one for one in dir(dpmacro) if not one.startswith("_")} - packages))
"""
    assert python(code).strip() == str(NAMES)


def test_a_name_that_is_not_there_is_told_what_is():
    with pytest.raises(AttributeError, match=f"'boost': it offers {', '.join(dpmacro.__all__)}$"):
        dpmacro.boost  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'Boost'"):
        from dpmacro import Boost  # noqa: F401


def test_importing_costs_little_over_torch():
    code = """
import time, torch
before = time.process_time()
import dpmacro
imported = time.process_time()
dpmacro.DPBoost, dpmacro.segment
used = time.process_time()
for name in dpmacro.__all__: getattr(dpmacro, name)
print(imported - before, used - before, time.process_time() - before)
"""
    imported, used, everything = map(float, python(code).split())
    assert imported < SECONDS / 10 and used < SECONDS and everything < 2 * SECONDS


COSTS = torch.rand(N, 2, generator=torch.Generator().manual_seed(0))
CHANGES = torch.zeros(N, 2, 2)
DIAGONAL = torch.eye(2, dtype=torch.bool)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("costs", value) for value in ("x", None, COSTS[:, 0], COSTS[:0], COSTS[:, :0], COSTS + 0j)),
        *(("costs", value) for value in (COSTS.double() * 1e308, COSTS * np.nan, COSTS / 0)),
        *(("costs", value) for value in (COSTS.to_sparse(), [[1], [1, 2]])),
        *(("max_transitions", value) for value in (-1, 1.5, "1", True, None, 2**64)),
        *(("lengths", value) for value in ([10, 13], [10.5, 13.5], [24, 0], 24)),
        *(("transition_costs", value) for value in (CHANGES[:, 0], torch.zeros(N, 3, 3), "x", 1.0)),
        *(("transition_costs", value) for value in (CHANGES.masked_fill(~DIAGONAL, np.nan), CHANGES + 1e31)),
    ],
)
def test_what_segment_cannot_take_is_named(name, value):
    given = {"costs": COSTS, "lengths": L, "max_transitions": 1, name: value}
    try:
        refused(name, segment, **given)
    except TypeCheckError:
        pytest.skip("annotations are checked at run time, before the argument is")


@pytest.mark.parametrize(
    "costs",
    [
        COSTS.numpy(),
        COSTS.tolist(),
        pd.DataFrame(COSTS.numpy()),
        COSTS.double(),
        COSTS.clone().requires_grad_(),
    ],
)
def test_segment_takes_costs_of_any_kind(costs):
    expected = segment(COSTS, torch.tensor(L), 2)
    for changes in (CHANGES.numpy().astype(int), CHANGES.masked_fill(DIAGONAL, np.nan)):
        found = segment(costs, L, 2, changes)
        assert torch.equal(found.labels, expected.labels)
    assert not found.cost.requires_grad


def test_has_the_manners_of_scikit_learn():
    model = fitted(seed=3)
    twin = clone(model)
    assert twin is not model and twin.get_params() == model.get_params() and not hasattr(twin, "result_")
    assert DPBoost(**model.get_params()).get_params() == model.get_params()
    assert clone(DPBoost(macros=3)).macros == 3
    assert model.set_params(macros=3, shrinkage=0.5) is model
    assert (model.macros, model.shrinkage, model.seed) == (3, 0.5, 3)
    refused("macro", model.set_params, macro=2)


def test_shows_the_options_that_are_not_default():
    assert repr(DPBoost()) == "DPBoost()"
    assert repr(DPBoost(macros=3, recipe="paper")) == "DPBoost(macros=3, recipe='paper')"


def test_a_second_fit_and_a_copy_are_the_same():
    model = fitted()
    labels, loss, predicted = model.labels_, model.result_.loss, model.predict(X, L)
    twin = copy.deepcopy(model)
    assert torch.equal(twin.predict(X, L), predicted) and torch.equal(twin.segment(X, A, L), labels)
    model.fit(X, A, L)
    assert torch.equal(model.labels_, labels) and torch.equal(model.result_.loss, loss)
