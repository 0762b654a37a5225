import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.recovery import Recovery, Stretches

LABELS = torch.tensor([0, 0, 0, 1, 1, 0, 0])
ACTIONS = torch.tensor([1, 1, 0, 2, 2, 0, 1])
LENGTHS = torch.tensor([5, 2])


@pytest.fixture
def stretches() -> Stretches:
    return Stretches.of(LABELS, ACTIONS, LENGTHS)


def test_segments_are_those_of_the_labels_within_trajectories(stretches):
    assert [part.tolist() for part in stretches.of_macro(0)] == [[1, 1, 0], [0, 1]]
    assert [part.tolist() for part in stretches.of_macro(1)] == [[2, 2]]


def test_a_file_gives_the_same_back(stretches):
    again = Stretches.from_tensors(stretches.tensors())
    assert [part.tolist() for part in again.of_macro(0)] == [[1, 1, 0], [0, 1]]


def test_parts_that_do_not_fit_are_refused(stretches):
    with pytest.raises(ValueError, match="4 actions"):
        Stretches.from_tensors({**stretches.tensors(), "actions": stretches.actions[:4]})


def test_too_many_actions_for_a_byte_are_refused():
    with pytest.raises(ValueError, match="an action is 256"):
        Stretches.of(torch.zeros(2, dtype=torch.int64), torch.tensor([0, 256]), torch.tensor([2]))


def test_what_is_new_is_left_to_the_planner(stretches):
    recovery = Recovery(stretches, 2)
    assert [recovery.act(bytes([frame]), 0, 7) for frame in range(3)] == [7, 7, 7]
    assert not recovery.replaying


def test_what_was_seen_before_starts_a_stretch_to_the_end_of_a_segment(stretches):
    recovery = Recovery(stretches, 2)
    recovery.act(b"a", 1, 7)
    done = [recovery.act(b"a", 1, 7)]
    assert recovery.replaying
    assert done == [2]
    while recovery.replaying:
        done.append(recovery.act(bytes([len(done)]), 1, 7))
    assert done in ([2, 7], [2, 2, 7])


def test_the_same_sight_in_another_macro_action_is_new(stretches):
    recovery = Recovery(stretches, 2)
    assert [recovery.act(b"a", macro, 7) for macro in (0, 1, 0)] == [7, 7, 7]


def test_another_macro_action_ends_a_stretch(stretches):
    recovery = Recovery(stretches, 2)
    while not recovery.replaying:
        recovery.act(b"a", 0, 7)
    assert recovery.act(b"b", 1, 7) == 7


def test_a_macro_action_without_segments_is_left_alone(stretches):
    recovery = Recovery(stretches, 3)
    assert [recovery.act(b"a", 2, 7) for _ in range(5)] == [7] * 5


def test_every_episode_draws_the_same(stretches):
    recovery = Recovery(stretches, 2)
    runs = []
    for _ in range(2):
        recovery.reset()
        runs.append([recovery.act(b"a", 0, 7) for _ in range(40)])
    assert runs[0] == runs[1]


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 1)), max_size=60))
def test_only_actions_of_the_macro_action_or_the_planner_are_taken(steps):
    stretches = Stretches.of(LABELS, ACTIONS, LENGTHS)
    recovery = Recovery(stretches, 2)
    known = [set(np.concatenate(stretches.of_macro(macro)).tolist()) for macro in range(2)]
    for sight, macro in steps:
        action = recovery.act(bytes([sight]), macro, 7)
        assert action in known[macro] if recovery.replaying else action == 7
