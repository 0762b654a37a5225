import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.policy.recovery import Recovery, Stretches

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
    with pytest.raises(ValueError, match="an action is 256: a policy holds 256 at most"):
        Stretches.of(torch.zeros(2, dtype=torch.int64), torch.tensor([0, 256]), torch.tensor([2]))


def scores(first, second, lead=1.0):
    """Of actions 0..2, as a planner would have them."""
    found = np.full(3, -5.0, np.float32)
    found[first], found[second] = 1.0, 1.0 - lead
    return found


def test_what_is_new_is_left_to_the_planner(stretches):
    recovery = Recovery(stretches, 2)
    assert [recovery.act(bytes([frame]), 0, scores(2, 0)) for frame in range(3)] == [2, 2, 2]
    assert not recovery.replaying


def test_the_most_doubted_decision_of_a_circle_is_taken_the_other_way(stretches):
    """Frame 0 leads into a circle of 1, 2, 3 and 4, of which 3 is nearest to a tie."""
    recovery = Recovery(stretches, 2)
    leads = {0: 0.1, 1: 3.0, 2: 4.0, 3: 0.5, 4: 2.0}
    for frame in [0, 1, 2, 3, 4, 1, 2]:
        assert recovery.act(bytes([frame]), 0, scores(2, 1, leads[frame])) == 2
        assert not recovery.replaying
    done = [recovery.act(bytes([3]), 0, scores(2, 1, leads[3]))]
    while recovery.replaying:
        done.append(recovery.act(b"elsewhere", 0, scores(2, 1)))
    assert done in ([1, 1, 0, 2], [1, 2])  # from the first 1 of a segment to its end


def test_who_leaves_the_circle_is_not_held_to_it(stretches):
    recovery = Recovery(stretches, 2)
    leads = {0: 3.0, 1: 2.0, 2: 1.0}
    for frame in [0, 1, 2, 0, 1]:
        recovery.act(bytes([frame]), 0, scores(2, 1, leads[frame]))
    for frame in [7, 1]:  # frame 2 is doubted, and still to come
        assert recovery.act(bytes([frame]), 0, scores(2, 1)) == 2 and not recovery.replaying


def test_a_long_circle_is_left_for_as_long_as_it_is_then_for_twice_as_long():
    recovery = Recovery(Stretches.of(torch.zeros(90).long(), torch.ones(90).long(), torch.tensor([90])), 2)
    own = ["a", "b", "c", "a", "b"]  # b is doubted
    done = [recovery.act(sight.encode(), 0, scores(2, 1, 0.1 if sight == "b" else 1.0)) for sight in own]
    assert done == [2, 2, 2, 2, 1]
    assert [recovery.act(b"", 0, scores(2, 1)) for _ in range(2)] == [1, 1]
    done = [recovery.act(sight.encode(), 0, scores(2, 1, 0.1 if sight == "b" else 1.0)) for sight in own]
    assert done == [2, 2, 2, 2, 1]
    assert [recovery.act(b"", 0, scores(2, 1)) for _ in range(6)] == [*[1] * 5, 2]


def test_a_circle_that_was_left_without_a_stretch_does_not_count():
    recovery = Recovery(Stretches.of(torch.zeros(90).long(), torch.ones(90).long(), torch.tensor([90])), 2)
    for time in range(3):
        for sight, lead in ((b"a", 2.0), (b"b", 0.1), (b"a", 2.0), (b"c", 3.0)):
            assert recovery.act(bytes([time]) + sight, 0, scores(2, 1, lead)) == 2
    assert [recovery.act(b"x", 0, scores(2, 1)) for _ in range(3)] == [2, 1, 2]


def test_of_equal_scores_the_planner_takes_the_first_and_doubt_the_next(stretches):
    recovery = Recovery(stretches, 2)
    equal = np.array([1.0, 1.0, 0.0], np.float32)
    assert [recovery.act(b"a", 0, equal) for _ in range(2)] == [0, 1]


def test_every_further_circle_is_left_for_twice_as_long():
    recovery = Recovery(Stretches.of(torch.zeros(9).long(), torch.ones(9).long(), torch.tensor([9])), 2)
    done = [recovery.act(b"a", 0, scores(2, 1)) for _ in range(21)]
    assert done == [2, 1, 2, 1, 1, 2, *[1] * 4, 2, *[1] * 8, 2, 1]
    recovery.act(b"a", 1, scores(2, 1))  # another macro-action begins with a nudge again
    assert [recovery.act(b"a", 0, scores(2, 1)) for _ in range(4)] == [2, 1, 2, 1]


def test_an_action_that_no_demonstrator_took_is_taken_once(stretches):
    recovery = Recovery(stretches, 2)
    done = [recovery.act(b"a", 1, scores(2, 0)) for _ in range(4)]
    assert done == [2, 0, 2, 0]


def test_the_same_sight_in_another_macro_action_is_new(stretches):
    recovery = Recovery(stretches, 2)
    assert [recovery.act(b"a", macro, scores(2, 0)) for macro in (0, 1, 0)] == [2, 2, 2]


def test_another_macro_action_ends_a_stretch(stretches):
    recovery = Recovery(stretches, 2)
    while not recovery.replaying:
        recovery.act(b"a", 0, scores(2, 1))
    assert recovery.act(b"b", 1, scores(2, 0)) == 2


def test_where_there_is_one_action_there_is_no_other(stretches):
    recovery = Recovery(stretches, 2)
    assert [recovery.act(b"a", 0, np.zeros(1, np.float32)) for _ in range(5)] == [0] * 5


def test_every_episode_draws_the_same(stretches):
    recovery = Recovery(stretches, 2)
    runs = []
    for _ in range(2):
        recovery.reset()
        runs.append([recovery.act(b"a", 0, scores(2, 1)) for _ in range(40)])
    assert runs[0] == runs[1]


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 1)), max_size=60))
def test_the_planner_decides_or_a_demonstrator_of_the_macro_action(steps):
    stretches = Stretches.of(LABELS, ACTIONS, LENGTHS)
    recovery = Recovery(stretches, 2)
    known = [set(np.concatenate(stretches.of_macro(macro)).tolist()) for macro in range(2)]
    for sight, macro in steps:
        action = recovery.act(bytes([sight]), macro, scores(2, 1))
        assert action in {1, *known[macro]} if recovery.replaying else action == 2
