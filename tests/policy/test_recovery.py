import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features.history import History
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.planner import MacroPlanner, PolicyState
from dpmacro.policy.recovery import LoopBreaker, RecoveringPlanner, Stretches
from dpmacro.worlds.base import Planner

LABELS = torch.tensor([0, 0, 0, 1, 1, 0, 0])
ACTIONS = torch.tensor([1, 1, 0, 2, 2, 0, 1])
LENGTHS = torch.tensor([5, 2])

KEY = "observation.image"


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
    breaker = LoopBreaker(stretches, 0)
    assert [breaker.act(bytes([frame]), 0, scores(2, 0)) for frame in range(3)] == [2, 2, 2]
    assert not breaker.replaying


def test_the_second_best_action_is_taken_at_the_closest_decision_of_a_loop(stretches):
    """Frame 0 leads into a loop of 1, 2, 3 and 4, of whose decisions that at 3 is the closest."""
    breaker = LoopBreaker(stretches, 0)
    leads = {0: 0.1, 1: 3.0, 2: 4.0, 3: 0.5, 4: 2.0}
    for frame in [0, 1, 2, 3, 4, 1, 2]:
        assert breaker.act(bytes([frame]), 0, scores(2, 1, leads[frame])) == 2
        assert not breaker.replaying
    done = [breaker.act(bytes([3]), 0, scores(2, 1, leads[3]))]
    while breaker.replaying:
        done.append(breaker.act(b"elsewhere", 0, scores(2, 1)))
    assert done in ([1, 1, 0, 2], [1, 2])  # from the first 1 of a segment to its end


def test_a_loop_that_was_left_is_forgotten(stretches):
    breaker = LoopBreaker(stretches, 0)
    leads = {0: 3.0, 1: 2.0, 2: 1.0}
    for frame in [0, 1, 2, 0, 1]:
        breaker.act(bytes([frame]), 0, scores(2, 1, leads[frame]))
    for frame in [7, 1]:  # frame 2 is the closest, and still to come
        assert breaker.act(bytes([frame]), 0, scores(2, 1)) == 2 and not breaker.replaying


def test_the_first_replay_is_as_long_as_the_loop_and_the_next_twice_as_long():
    breaker = LoopBreaker(Stretches.of(torch.zeros(90).long(), torch.ones(90).long(), torch.tensor([90])), 0)
    own = ["a", "b", "c", "a", "b"]  # b is the closest
    done = [breaker.act(frame.encode(), 0, scores(2, 1, 0.1 if frame == "b" else 1.0)) for frame in own]
    assert done == [2, 2, 2, 2, 1]
    assert [breaker.act(b"", 0, scores(2, 1)) for _ in range(2)] == [1, 1]
    done = [breaker.act(frame.encode(), 0, scores(2, 1, 0.1 if frame == "b" else 1.0)) for frame in own]
    assert done == [2, 2, 2, 2, 1]
    assert [breaker.act(b"", 0, scores(2, 1)) for _ in range(6)] == [*[1] * 5, 2]


def test_a_loop_that_was_left_without_a_replay_does_not_count():
    breaker = LoopBreaker(Stretches.of(torch.zeros(90).long(), torch.ones(90).long(), torch.tensor([90])), 0)
    for time in range(3):
        for frame, lead in ((b"a", 2.0), (b"b", 0.1), (b"a", 2.0), (b"c", 3.0)):
            assert breaker.act(bytes([time]) + frame, 0, scores(2, 1, lead)) == 2
    assert [breaker.act(b"x", 0, scores(2, 1)) for _ in range(3)] == [2, 1, 2]


def test_of_equal_scores_the_first_is_the_best_and_the_next_the_second_best(stretches):
    breaker = LoopBreaker(stretches, 0)
    equal = np.array([1.0, 1.0, 0.0], np.float32)
    assert [breaker.act(b"a", 0, equal) for _ in range(2)] == [0, 1]


def test_every_further_replay_is_twice_as_long():
    breaker = LoopBreaker(Stretches.of(torch.zeros(9).long(), torch.ones(9).long(), torch.tensor([9])), 0)
    done = [breaker.act(b"a", 0, scores(2, 1)) for _ in range(21)]
    assert done == [2, 1, 2, 1, 1, 2, *[1] * 4, 2, *[1] * 8, 2, 1]
    breaker.act(b"a", 1, scores(2, 1))  # another macro-action begins with one step again
    assert [breaker.act(b"a", 0, scores(2, 1)) for _ in range(4)] == [2, 1, 2, 1]


def test_an_action_that_no_demonstrator_took_is_taken_once(stretches):
    breaker = LoopBreaker(stretches, 0)
    done = [breaker.act(b"a", 1, scores(2, 0)) for _ in range(4)]
    assert done == [2, 0, 2, 0]


def test_the_same_frames_under_another_macro_action_are_new(stretches):
    breaker = LoopBreaker(stretches, 0)
    assert [breaker.act(b"a", macro, scores(2, 0)) for macro in (0, 1, 0)] == [2, 2, 2]


def test_another_macro_action_ends_a_replay(stretches):
    breaker = LoopBreaker(stretches, 0)
    while not breaker.replaying:
        breaker.act(b"a", 0, scores(2, 1))
    assert breaker.act(b"b", 1, scores(2, 0)) == 2


def test_where_there_is_one_action_there_is_no_other(stretches):
    breaker = LoopBreaker(stretches, 0)
    assert [breaker.act(b"a", 0, np.zeros(1, np.float32)) for _ in range(5)] == [0] * 5


def test_every_episode_draws_the_same(stretches):
    breaker = LoopBreaker(stretches, 0)
    runs = []
    for _ in range(2):
        breaker.reset()
        runs.append([breaker.act(b"a", 0, scores(2, 1)) for _ in range(40)])
    assert runs[0] == runs[1]


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 1)), max_size=60))
def test_the_planner_decides_or_a_demonstrator_of_the_macro_action(steps):
    stretches = Stretches.of(LABELS, ACTIONS, LENGTHS)
    breaker = LoopBreaker(stretches, 0)
    known = [set(np.concatenate(stretches.of_macro(macro)).tolist()) for macro in range(2)]
    for frame, macro in steps:
        action = breaker.act(bytes([frame]), macro, scores(2, 1))
        assert action in {1, *known[macro]} if breaker.replaying else action == 2


class Flickering:
    """A policy of three actions under one macro-action, 2 before 1 before 0, whatever it sees."""

    device = torch.device("cpu")
    config = PolicyConfig("baseline", 1, (0,), {KEY: InputConfig((2, 2, 3))}, {}, ("a", "b", "c"), 3)

    def initial_state(self, batch):
        return PolicyState(torch.zeros(batch).long(), torch.full((batch,), -1), History({KEY: (0, 1)}, batch))

    def decide(self, observation, state):
        seen, history = state.history.push(observation)
        return torch.tensor([[0.0, 1.0, 2.0]]), PolicyState(state.macro, state.action, history, seen)

    def restored(self, scores, observation):
        raise AssertionError("actions are classes")


FRAME = {"pixels": np.zeros((2, 2, 3), np.uint8)}


def taken(planner, steps):
    planner.reset()
    return [planner.act(FRAME, {}) for _ in range(steps)]


def test_a_planner_in_a_loop_takes_the_second_best_action():
    """Its first decision sees one frame, the next ones two; the third is the first that was made before."""
    stretches = Stretches.of(torch.zeros(4).long(), torch.tensor([0, 1, 0, 1]), torch.tensor([4]))
    planner = RecoveringPlanner(MacroPlanner(Flickering()), stretches, 0)
    for _ in range(2):
        assert taken(planner, 8) == [2, 2, 1, 2, 1, 0, 2, 1]
    assert taken(MacroPlanner(Flickering()), 8) == [2] * 8


def test_switch_functions_and_runs_know_what_recovery_did():
    stretches = Stretches.of(torch.zeros(2).long(), torch.tensor([1, 0]), torch.tensor([2]))
    planner = RecoveringPlanner(MacroPlanner(Flickering()), stretches, 0)
    assert planner.memory is None and planner.macro == 0
    for action in taken(planner, 3)[2:]:
        assert action == 1 and planner.planner.memory == (0, 1)
    assert isinstance(planner, Planner)


def test_the_seed_decides_what_is_drawn():
    lengths = torch.tensor([9] * 6)
    actions = torch.cat([torch.tensor([1, *[number] * 8]) for number in range(6)])
    stretches = Stretches.of(torch.zeros(54).long(), actions, lengths)
    runs = [taken(RecoveringPlanner(MacroPlanner(Flickering()), stretches, seed), 40) for seed in range(4)]
    again = taken(RecoveringPlanner(MacroPlanner(Flickering()), stretches, 3), 40)
    assert runs[3] == again and len({tuple(run) for run in runs}) > 1
