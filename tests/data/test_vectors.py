"""What is learned of vectors: constant numbers in any unit, targets told from changes, and the way back."""

import json

import numpy as np
import pytest
import torch

from dpmacro.data.vectors import ActionTransform

LENGTHS = np.array([60, 80, 60])
N = LENGTHS.sum()


def walk(seed=0, dims=3, step=0.01):
    """A slow walk of a pose."""
    return np.random.default_rng(seed).normal(size=(N, dims), scale=step).cumsum(0).astype(np.float32)


def gripper():
    """Closed in the middle of every trajectory."""
    return np.concatenate([(np.arange(n) > n // 3) & (np.arange(n) < n // 2) for n in LENGTHS])


NEXT = np.diff(walk(), axis=0, append=walk()[-1:])
BESIDE = {
    "a target": (walk() + NEXT, True),
    "a target with noise": (walk() + np.random.default_rng(1).normal(size=(N, 3), scale=0.01), True),
    "a change": (NEXT, False),
    "a velocity": (100 * NEXT, False),
    "another pose": (walk(seed=2), False),
    "the mirrored state": (-walk(), False),
    "the state in other units": (1000 * walk(), False),
}


@pytest.mark.parametrize("case", BESIDE)
def test_targets_are_told_from_changes_by_the_data(case):
    actions, relative = BESIDE[case]
    found = ActionTransform.fit(actions.astype(np.float32), LENGTHS, walk())
    assert found.relative is relative and found.nearness is not None
    assert ("less the state" in found.report()[0]) is not relative


def test_a_state_of_other_numbers_is_no_matter():
    found = ActionTransform.fit(walk(), LENGTHS, walk(dims=2))
    assert not found.relative and found.nearness is None and found.report() == []
    assert not ActionTransform.fit(walk(), LENGTHS).relative


@pytest.mark.parametrize(("state", "has"), [(None, "no state"), (walk(dims=2), "a state of 2 numbers")])
def test_relative_needs_a_state(state, has):
    with pytest.raises(
        ValueError, match=f"action_relative is true, but beside actions of 3 numbers there is {has}"
    ):
        ActionTransform.fit(walk(), LENGTHS, state, relative=True)


@pytest.mark.parametrize("relative", [True, False, None])
@pytest.mark.parametrize("constant", [False, True])
def test_what_is_learned_leads_back(relative, constant):
    actions, state = walk() + NEXT, walk()
    if constant:
        actions[:, 1] = 0.25
        state[:, 2] = actions[:, 2] - 0.5
    found = ActionTransform.fit(actions, LENGTHS, state, relative)
    targets = found.targets(actions, state)
    assert targets.dtype == np.float32
    assert np.allclose(targets.mean(0), 0, atol=1e-4) and np.allclose(targets.std(0), 1, atol=1e-4)
    back = found.restore(torch.from_numpy(targets), torch.from_numpy(state))
    assert np.allclose(back.numpy(), actions, atol=1e-5)
    assert ActionTransform.from_dict(json.loads(json.dumps(found.to_dict()))) == found


def test_acting_is_relative_to_the_state_of_acting():
    found = ActionTransform.fit(walk() + NEXT, LENGTHS, walk(), relative=True)
    zero = torch.zeros(2, 3)
    there = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert torch.allclose(
        found.restore(zero, there) - there, torch.tensor(found.mean).repeat(2, 1), atol=1e-5
    )
    for call in (lambda: found.restore(zero), lambda: found.targets(walk(), walk(dims=2))):
        with pytest.raises(ValueError, match=r"less a state of 3 numbers, got .*: give that"):
            call()


def spike():
    values = np.full(N * 10, 0.5)
    values[77] = 3.0
    return values


CONSTANT = {
    "one value": (np.full(N, 0.25), True),
    "zero": (np.zeros(N), True),
    "rounding": (1000 + 1e-4 * np.random.default_rng(0).random(N), True),
    "one frame of another value in one trajectory": (spike()[:N], True),
    "small units": (1e-9 * np.random.default_rng(0).normal(size=N), False),
    "large units": (1e9 * np.random.default_rng(0).normal(size=N), False),
    "a small movement far from 0": (1000 + np.random.default_rng(0).random(N), False),
    "a gripper": (gripper().astype(float), False),
    "a press in every trajectory": (
        np.concatenate([np.arange(n) == n // 2 for n in LENGTHS]).astype(float),
        False,
    ),
}


@pytest.mark.parametrize("case", CONSTANT)
def test_constant_numbers_are_found_in_any_unit(case):
    column, constant = CONSTANT[case]
    lengths = LENGTHS * (1 if case[:9] != "one frame" else 10)
    other = np.random.default_rng(3).normal(size=lengths.sum())
    column = spike() if case[:9] == "one frame" else column
    actions = np.stack([other, column], 1).astype(np.float32)
    found = ActionTransform.fit(actions, lengths, names=("a", "b"))
    assert found.kept == ((0,) if constant else (0, 1))
    assert any("constant and left out of the actions: b (" in line for line in found.report()) is constant
    restored = found.restore(torch.zeros(1, len(found.kept)))[0, 1].item()
    expected = np.median(actions[:, 1]) if constant else actions[:, 1].mean(dtype=float)
    assert restored == pytest.approx(expected, rel=1e-5, abs=1e-12)


def test_numbers_that_follow_the_state_follow_it_when_acting():
    actions = walk() + NEXT
    state = walk()
    state[:, 2] = actions[:, 2] - 0.5
    found = ActionTransform.fit(actions, LENGTHS, state, relative=True, names=("x", "y", "z"))
    assert (
        found.kept == (0, 1)
        and "always as far from the state, and left out of the actions: z" in found.report()
    )
    assert found.restore(torch.zeros(1, 2), torch.tensor([[0.0, 0.0, 7.0]]))[0, 2].item() == pytest.approx(
        7.5
    )


def test_nothing_to_learn_is_refused():
    with pytest.raises(
        ValueError, match=r"all 3 numbers of the action are constant \(0, 1, 2\): nothing to learn"
    ):
        ActionTransform.fit(np.ones((N, 3), np.float32), LENGTHS)


@pytest.mark.parametrize(
    "change", [{"kept": []}, {"kept": [9]}, {"scale": [0, 1, 1]}, {"mean": None}, {"names": ["x"]}]
)
def test_a_transform_that_is_none_is_refused(change):
    values = ActionTransform.fit(walk(), LENGTHS).to_dict()
    with pytest.raises(ValueError, match="train the policy again"):
        ActionTransform.from_dict({**values, **change})
