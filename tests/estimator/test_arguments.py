"""What DPBoost takes and refuses: options, features, actions and lengths of every kind."""

import numpy as np
import pandas as pd
import pytest
import torch
from jaxtyping import TypeCheckError
from refusals import SMALL, A, L, N, X, fitted, refused

from dpmacro.estimator.arguments import as_device, check_options
from dpmacro.estimator.dpboost import DPBoost

T = torch.tensor(X)
WHOLE = (X * 9).round().astype(np.int64)

WRONG_OPTIONS = [
    *(("macros", value) for value in (0, -1, "2", None, True, 2.0, torch.tensor(2), [2], 2**31)),
    *(("max_transitions", value) for value in (-1, 1.5, "1", True)),
    *(("rounds", value) for value in (0, 1.5)),
    *(("shrinkage", value) for value in (0, 1.5, "0.1", float("nan"), True, None)),
    *(("restarts", value) for value in (0, None)),
    *(("switch_rounds", value) for value in (0, "9")),
    *(("switch_window", value) for value in (0, 2.5)),
    *(("switch_weight", value) for value in (-1, float("nan"), float("inf"), "1", True, 1j)),
    *(("early_stopping", value) for value in ("no", 0, None)),
    *(("recipe", value) for value in ("papers", None, ["paper"])),
    *(("seed", value) for value in (-1, 2**64, 2**63, 1.5, "0", True)),
    *(("device", value) for value in ("nonsense", 3, None, "meta", "cuda:99", torch.float32)),
]


@pytest.mark.parametrize(("name", "value"), WRONG_OPTIONS)
def test_a_wrong_option_is_named(name, value):
    refused(name, check_options, {**DPBoost().get_params(), name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("macros", 0), ("seed", -1), ("switch_weight", -1.0), ("recipe", "papers"), ("device", "nonsense")],
)
def test_wrong_options_are_refused_wherever_they_come_in(name, value):
    refused(name, DPBoost, **{name: value})
    model = DPBoost()
    refused(name, model.set_params, restarts=5, **{name: value})
    assert model.get_params() == DPBoost().get_params()  # none of them was taken
    setattr(model, name, value)
    refused(name, model.fit, X, A, L)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is such a device here")
def test_a_device_that_is_not_there_is_refused():
    refused("device", check_options, {**DPBoost().get_params(), "device": "cuda"})


@pytest.mark.parametrize("device", ["cpu", "cpu:0", torch.device("cpu")])
def test_a_device_is_the_one_that_tensors_are_on(device):
    assert as_device(device) == torch.zeros(1, device=device).device


@pytest.mark.parametrize(
    "options",
    [
        {
            "macros": np.int64(2),
            "seed": np.uint8(3),
            "early_stopping": np.True_,
            "shrinkage": np.float32(0.5),
        },
        {"max_transitions": 2**70, "shrinkage": 1, "switch_weight": 0},
        {"device": torch.device("cpu"), "seed": 2**63 - 1, "switch_window": 100},
        {"recipe": "paper"},
    ],
)
def test_sensible_options_work(options):
    try:
        model = fitted(**options)
    except TypeCheckError:
        pytest.skip("annotations are checked at run time: a float must not be an int, nor NumPy's")
    assert len(model.labels_) == N


def with_one(value):
    """The features with one other number."""
    found = X.astype(np.float64)
    found[3, 1] = value
    return found


WRONG_DATA = {
    "features": [
        "abc",
        None,
        3,
        X[:, 0],
        X[None],
        X[:0],
        X[:, :0],
        X.astype(str),
        X + 0j,
        [[1, 2], [3]],
        T.to_sparse(),
        torch.quantize_per_tensor(T, 0.1, 0, torch.qint8),
        T.to("meta"),
        with_one(np.nan),
        with_one(-np.inf),
        np.full((N, 2), np.inf, np.float16),
        np.where(X > 0, X, None),
        np.ma.masked_greater(X, 0),
        pd.DataFrame({"a": ["x"] * N}),
        (row for row in X),
    ],
    "actions": [
        "abc",
        None,
        0,
        A + 0.5,
        A - 1,
        A * 2**20,
        np.where(A == 1, np.nan, 0),
        np.eye(2)[A],
        A[:, None],
        A[:-1],
        [],
        A + 0j,
        A.astype(str),
        np.full(N, 2**64 - 1, np.uint64),
        pd.Series(["left", "right"] * (N // 2), dtype="category"),
    ],
    "lengths": [
        "24",
        None,
        24,
        [10, 13],
        [10.5, 13.5],
        [24, 0],
        [25, -1],
        [[10, 14]],
        [],
        [np.nan],
        [2**63 - 1, 2**63 - 1, N + 2],
        ["10", "14"],
    ],
}


@pytest.mark.parametrize(
    ("name", "place"), [(name, place) for name, values in WRONG_DATA.items() for place in range(len(values))]
)
def test_wrong_data_is_named(name, place):
    value = WRONG_DATA[name][place]
    refused(name, fitted, **{name: value}, macros=1)


def test_data_that_is_too_little_for_the_options_is_named():
    refused("macros", fitted, macros=N + 1)
    refused("early_stopping", fitted, lengths=[N], early_stopping=True)
    try:
        refused("on_round", DPBoost(**SMALL).fit, X, A, L, 3)
    except TypeCheckError:
        pytest.skip("annotations are checked at run time, before the argument is")


@pytest.mark.parametrize(
    "features",
    [
        X.tolist(),
        X.astype(np.float64),
        X.astype(np.float16),
        T.bfloat16(),
        T.clone().requires_grad_(),
        T.T.contiguous().T,
        X[:, ::-1],
        X > 0,
        (X * 9).astype(np.int8),
        np.abs(X * 9).astype(np.uint16),
        X.astype(np.float64) * 1e300,
        np.where(X > 0, 2**63 - 1, -(2**63)),
        pd.DataFrame(X),
        pd.DataFrame({"a": X[:, 0], "b": WHOLE[:, 1], "c": X[:, 2] > 0}),
        np.zeros((N, 1)),
    ],
)
@pytest.mark.filterwarnings("error")
def test_sensible_features_work(features):
    model = fitted(features, macros=1)
    assert torch.equal(model.segment(features, A, L), model.labels_)
    assert len(model.predict(features, L)) == N
    assert 0 <= model.score(features, A, L) <= 1


@pytest.mark.parametrize(
    "actions",
    [
        *(A.tolist(), A.astype(float), A > 0, A.astype(np.uint8), A.astype(object), A[::-1].copy()[::-1]),
        *(torch.tensor(A).bfloat16(), pd.Series(A, index=range(100, 100 + N)), pd.Series(A, dtype="Int64")),
    ],
)
@pytest.mark.parametrize("lengths", [tuple(L), np.array(L, np.uint8), pd.Series(L)])
def test_the_same_actions_and_lengths_give_the_same_labels(actions, lengths):
    expected = fitted(macros=1, rounds=2)
    found = fitted(actions=actions, lengths=lengths, macros=1, rounds=2)
    assert torch.equal(found.result_.loss, expected.result_.loss)


def test_what_is_not_fitted_says_so():
    for call, arguments in (
        (DPBoost().predict, (X, L)),
        (DPBoost().segment, (X, A, L)),
        (DPBoost().score, (X, A, L)),
    ):
        with pytest.raises(ValueError, match="found nothing yet: call fit first"):
            call(*arguments)


def test_new_data_is_checked_as_that_of_fit():
    model = fitted()
    for wrong, name in (
        ((X[:, :2], A, L), "features"),
        ((X * np.nan, A, L), "features"),
        ((X, A[:3], L), "actions"),
        ((X, np.eye(2)[A], L), "actions"),
        ((X, A, [3]), "lengths"),
    ):
        refused(name, model.segment, *wrong)
        refused(name, model.score, *wrong)
        if name != "actions":
            refused(name, model.predict, wrong[0], wrong[2])


@pytest.mark.parametrize(
    ("known", "new", "alike"),
    [
        (WHOLE, WHOLE + 0.5, WHOLE),  # between two whole numbers: as the lower one
        (WHOLE, WHOLE - 1e-9, WHOLE - 1),
        (WHOLE, WHOLE * 0 + 1e300, WHOLE * 0 + 2**40),
        ((WHOLE + 40).astype(np.uint8), WHOLE + 40, (WHOLE + 40).astype(np.uint8)),
        ((WHOLE + 40).astype(np.uint8), WHOLE * 0 - 5, WHOLE * 0 - 9),
        ((WHOLE + 40).astype(np.uint8), WHOLE * 0 + 300, (WHOLE * 0 + 255).astype(np.uint8)),
        (X, X.astype(np.float64), X),
        (X, WHOLE, WHOLE.astype(np.float32)),
    ],
)
def test_new_features_may_be_of_another_type(known, new, alike):
    model = fitted(known, macros=1)
    assert torch.equal(model._levels(new), model._levels(alike))
    assert torch.equal(model._levels(new[:1]), model._levels(alike[:1]))
