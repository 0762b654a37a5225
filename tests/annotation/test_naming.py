"""Names of stages from what is known of the data by construction, and those of users."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from dpmacro.annotation.naming import LONGEST, LONGEST_NAME, checked_names, stage_names
from dpmacro.annotation.telling import traits
from dpmacro.data.demonstrations import Demonstrations

STATE = "observation.state"
LENGTHS = np.array([40, 60, 50])
STAGES = np.concatenate([np.arange(length) * 3 // length for length in LENGTHS])
TURNS = ("forward", "turn left", "turn right")


def made(actions, names, state=None, state_names=(), lengths=LENGTHS, **more):
    observations = {"task_index": np.zeros(int(lengths.sum()), np.int64)}
    if state is not None:
        observations[STATE] = np.asarray(state, np.float32)
    return Demonstrations(
        observations,
        np.asarray(actions, np.int64 if np.ndim(actions) == 1 else np.float32),
        lengths,
        tuple(names),
        10,
        None,
        {},
        Path("data"),
        state_names={STATE: tuple(state_names)} if state is not None else {},
        **more,
    )


def noise(dims, seed=0):
    return np.random.default_rng(seed).normal(size=(len(STAGES), dims)) * 0.01


def names_of(demonstrations, labels=STAGES, stages=3, **more):
    return [one.name for one in stage_names(demonstrations, labels, stages, **more)]


def along_time(rates):
    """A column that starts at 0 in every demonstration and changes by so much a frame in each stage."""
    steps = np.asarray(rates)[STAGES]
    return np.concatenate([np.cumsum(part) for part in np.split(steps, np.cumsum(LENGTHS)[:-1])])


def test_dimensions_that_rise_fall_and_stand_high():
    state = np.column_stack([along_time([1, 0, 0]), along_time([0, 0, -1]), noise(1)[:, 0]])
    actions = noise(2)
    actions[:, 1] += STAGES == 1
    one = made(actions, ["dx", "gripper"], state, ["shoulder.pos", "elbow.pos", "wrist.pos"])
    found = stage_names(one, STAGES, 3)
    assert [own.name for own in found] == ["shoulder.pos rises", "gripper high", "elbow.pos falls"]
    assert found[0].reason.startswith(
        "The mean change of state shoulder.pos is 1.4 standard deviations above"
    )
    assert found[1].reason == (
        "The mean of action gripper is 1.4 standard deviations above that of all frames."
    )


def test_what_falls_less_than_elsewhere_does_not_rise():
    found = traits(made(noise(1), ["x"], along_time([-3, -2, -1])[:, None], ["z"]), STAGES, 3)
    told = {(one.name, one.verb) for own in found for one in own if one.verb in ("rises", "falls")}
    assert told == {("z", "falls")}
    assert not [one for one in found[2] if one.verb in ("rises", "falls")], "it falls, but less than all"


def test_changes_do_not_reach_into_other_demonstrations():
    """Every demonstration begins anew: a change across the border would be the largest."""
    state = np.concatenate([np.arange(length) / 4 for length in LENGTHS])[:, None]
    labels = np.concatenate([(np.arange(length) >= length - 2).astype(int) for length in LENGTHS])
    found = traits(made(noise(1), ["x"], state, ["z"]), labels, 2)
    assert {one.verb for one in found[1] if one.name == "z"} == {"high"}


def test_the_most_over_represented_action():
    actions = np.zeros(len(STAGES), int)
    actions[STAGES == 1] = np.resize([1, 1, 0], (STAGES == 1).sum())
    actions[STAGES == 2] = np.resize([2, 0, 0, 0], (STAGES == 2).sum())
    found = stage_names(made(actions, TURNS), STAGES, 3)
    assert [own.name for own in found] == ["mostly forward", "mostly turn left", "more turn right"]
    assert found[1].reason == "Of its actions 68% are turn left, of all 23%."


def test_the_most_telling_dimension_names_a_stage():
    actions = noise(3)
    actions[:, 0] += STAGES > 0
    actions[:, 1] += 0.5 * (STAGES == 1)
    one = made(actions * [1, 1, 0] + noise(3, 1), ["grip", "x", "y"])
    found = stage_names(one, STAGES, 3)
    assert [own.name for own in found] == ["grip low", "x high", "grip high"]


def test_equal_stages_are_numbered():
    actions = (STAGES > 0).astype(int)
    labels = np.where(STAGES == 2, 1 + (np.arange(len(STAGES)) % 2), STAGES)
    found = stage_names(made(actions, TURNS), labels, 3)
    assert [own.name for own in found] == ["mostly forward", "mostly turn left", "mostly turn left 2"]
    odd = made(np.append(actions, [2] * 9), ("x", "a", "a 2"), lengths=np.append(LENGTHS, 9))
    assert names_of(odd, np.append(labels, [3] * 9), 4)[1:] == ["mostly a", "mostly a 3", "mostly a 2"]
    assert found[2].reason.endswith("The number tells it from another stage of that name.")


def test_the_second_thing_is_one_that_the_others_do_not_share():
    actions = noise(3)
    actions[:, 0] += 3.0 * (STAGES < 2)
    actions[:, 1] += 2.0 * (STAGES < 2)
    actions[:, 2] += 1.0 * (STAGES == 0)
    actions[:, 2] -= 1.0 * (STAGES == 1)
    mixed = actions + np.random.default_rng(1).normal(size=actions.shape) * [0, 1, 3]
    assert names_of(made(mixed, ["grip", "x", "y"])) == ["grip high, y high", "grip high, y low", "grip low"]


def test_one_stage_has_the_words_of_the_task():
    actions = noise(1)
    words = "pick up the banana and put it onto the white plate on the left"
    [found] = stage_names(made(actions, ["x"], tasks=(words,)), STAGES * 0, 1)
    assert found.name == "pick up the banana and put it onto the…" and "words of the task" in found.reason
    assert names_of(made(actions, ["x"], tasks=("lift\nit\x07",)), STAGES * 0, 1) == ["lift it"]
    for tasks in [(), ("0",), ("pick", "place"), ("\n",)]:
        assert names_of(made(actions, ["x"], tasks=tasks), STAGES * 0, 1) == ["whole demonstration"]


def test_a_stage_without_frames_and_one_that_nothing_tells():
    assert names_of(made(noise(1) * 0 + 5, ["x"]), stages=5) == [
        "stage 0",
        "stage 1",
        "stage 2",
        "no frames",
        "no frames 2",
    ]
    assert names_of(made(np.zeros(len(STAGES), int), TURNS)) == ["stage 0", "stage 1", "stage 2"]


def test_more_than_half_is_most():
    actions = np.where(STAGES == 0, np.arange(len(STAGES)) % 2, 0)
    actions[np.flatnonzero(STAGES == 0)[-1]] = 0
    assert names_of(made(actions, TURNS))[0] == "more turn left"
    actions[np.flatnonzero(STAGES == 0)[:3]] = 1
    assert names_of(made(actions, TURNS))[0] == "mostly turn left"


@pytest.mark.parametrize("names", [("0", "1"), (), ("", "\n")])
def test_dimensions_without_names_have_numbers(names):
    actions = noise(2) + np.column_stack([STAGES == 0, STAGES == 2])
    state = noise(2) + 4 * np.column_stack([STAGES == 1, STAGES == 1])
    found = names_of(made(actions, names, state, names))
    assert found == ["action 0 high", "state 0 high", "action 1 high"]
    assert names_of(made(np.minimum(STAGES, 1), names), stages=3)[:2] == [
        "mostly action 0",
        "mostly action 1",
    ]


def test_names_that_look_alike_are_told_apart():
    actions = np.arange(len(STAGES)) % 2
    found = names_of(made(actions, ["caf\u00e9", "cafe\u0301"]), actions, 2)
    assert found == ["mostly caf\u00e9", "mostly caf\u00e9 2"]


def test_what_is_missing_or_infinite_or_huge_counts_nowhere():
    actions = noise(4) + np.column_stack([STAGES == 0, STAGES == 1, STAGES == 2, STAGES == 0])
    actions[::3, 0], actions[1::3, 1] = np.nan, np.inf
    actions[:, 3] = np.nan
    assert names_of(made(actions, "abcd")) == ["a high", "b high", "c high"]
    actions[STAGES == 0, 0] = np.nan
    assert names_of(made(actions, "abcd"))[1:] == ["b high", "c high"]
    large = np.where(STAGES[:, None] == [0, 1, 2], 3e38, -3e38)
    assert names_of(made(large, "abc", large, "xyz")) == ["a high", "b high", "c high"]


def test_long_names_are_cut_such_that_their_ends_stay():
    long = [f"the_left_arm_of_the_robot_with_two_arms_joint_{k}.pos" for k in range(3)]
    actions = noise(3) + np.eye(3)[STAGES]
    found = names_of(made(actions, long))
    assert found == [f"the_left_arm_of_t…_arms_joint_{k}.pos high" for k in range(3)]
    words = "a very long name of an action that nobody would give to it"
    assert all(len(name) == LONGEST for name in found)
    labels = np.arange(len(STAGES)) % 4
    twins = names_of(made((labels > 1).astype(int), [words, words[::-1], "c"]), labels, 4)
    assert len(set(twins)) == 4 and all(len(name) <= LONGEST for name in twins)


@st.composite
def drawn(draw):
    """Demonstrations of a few whole numbers, with dimensions that are alike, and stages, some unused."""
    lengths = draw(st.lists(st.integers(2, 8), min_size=1, max_size=4))
    size, stages = sum(lengths), draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    texts = st.text(st.characters(codec="utf-8"), max_size=60)
    dims = draw(st.integers(1, 3))
    names = draw(st.lists(texts, min_size=dims, max_size=dims))
    if draw(st.booleans()):
        actions = rng.choice(dims, size, p=rng.dirichlet(np.ones(dims)))
    else:
        actions = rng.integers(-1, 2, (size, dims)).astype(float)
        actions[rng.random(actions.shape) < draw(st.sampled_from([0, 0.2]))] = np.nan
    state = rng.integers(0, 8, (size, 2)).astype(float) if draw(st.booleans()) else None
    if state is not None and draw(st.booleans()):
        state[:, 1] = 7 - state[:, 0]
    tasks = tuple(draw(st.lists(texts, max_size=2)))
    labels = rng.integers(0, draw(st.integers(1, stages)), size)
    return (actions, names, state, ["a", "b"], np.array(lengths)), tasks, labels, stages


@settings(max_examples=150, deadline=None)
@given(drawn(), st.randoms())
def test_names_can_be_used_and_the_order_of_demonstrations_changes_nothing(problem, random):
    arguments, tasks, labels, stages = problem
    one = made(*arguments, tasks=tasks)
    found = stage_names(one, labels, stages)
    names = [own.name for own in found]
    assert checked_names(names, stages) == tuple(names)
    assert all(len(name) <= LONGEST for name in names)
    assert all(own.reason.endswith(".") and "\n" not in own.reason for own in found)
    order = random.sample(range(len(one.lengths)), len(one.lengths))
    mixed = np.concatenate([labels[one.trajectories[k]] for k in order])
    assert stage_names(one.select(order), mixed, stages) == found


@settings(max_examples=150, deadline=None)
@given(drawn())
def test_what_is_said_is_true(problem):
    arguments, tasks, labels, stages = problem
    one = made(*arguments, tasks=tasks)
    named = [f"action{k}" for k in range(len(one.action_names))]
    one = replace(one, action_names=tuple(named), state_names={STATE: ("state0", "state1")})
    columns = dict(zip(named, one.actions.T, strict=True)) if one.vector else {}
    columns |= {
        f"state{k}": values for k, values in enumerate(one.observations.get(STATE, np.zeros((0, 0))).T)
    }
    for stage, own in enumerate(traits(one, labels, stages)):
        held = labels == stage
        for said in own:
            if said.first:
                share, overall = (
                    float((some == named.index(said.name)).mean())
                    for some in (one.actions[held], one.actions)
                )
                assert share > overall and (share > 0.5) == (said.verb == "mostly")
                continue
            values = columns[said.name]
            if said.verb in ("high", "low"):
                off = np.nanmean(values[held]) - np.nanmean(values)
            else:  # no more than the span of a quarter of a second, 2 frames, on either side
                rates = [np.nan] * len(values)
                for part in one.trajectories:
                    for n in range(part.start, part.stop):
                        low, high = max(n - 2, part.start), min(n + 2, part.stop - 1)
                        rates[n] = (values[high] - values[low]) / (high - low)
                off = np.nanmean(np.array(rates)[held])
            assert off > 0 if said.verb in ("high", "rises") else off < 0


def test_users_names_are_used_as_they_are():
    one = made(noise(1), ["x"])
    found = stage_names(one, STAGES, 3, ["reach", "carry", "Größe 東"])
    assert [own.name for own in found] == ["reach", "carry", "Größe 東"]
    assert {own.reason for own in found} == {"The user gave it."}
    refused("names", stage_names, one, STAGES, 3, ["reach", "carry"])


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("reach", r"^names are 'reach': give a list"),
        (5, r"^names are 5: give a list"),
        (["a", "b"], r"^names are 2 \(\['a', 'b'\]\) for 3 stages: give one for each"),
        (["a", "b", 3], r"^names\[2\] is 3: give a text"),
        (["a", "", "c"], r"^names\[1\] is '': a name needs"),
        (["a", " \u3000", "c"], r"^names\[1\] is .*: a name needs"),
        (["a", "b\tb", "c"], r"^names\[1\] is 'b\\tb', with '\\t', which nobody can see: leave it out"),
        (["a", "b\ud800", "c"], r"^names\[1\] is 'b\\ud800', with '\\ud800'"),
        (["a", "b\u2028b", "c"], r"with '\\u2028'"),
        (["a", "b ", "c"], r"^names\[1\] is 'b ': leave out the spaces"),
        (["a", "b", "a"], r"^names\[2\] is 'a', as names\[0\] is: give every stage"),
        (["é", "e\u0301", "a"], r"^names\[1\] is .*, as names\[0\] is"),
        (["x" * (LONGEST_NAME + 1), "b", "c"], r"^names\[0\] is 'x+\.\.\., of 81 characters: give 80"),
    ],
)
def test_names_that_cannot_be_used(names, message):
    with pytest.raises(ValueError, match=message) as caught:
        checked_names(names, 3)
    assert "\n" not in str(caught.value)
    str(caught.value).encode()


def test_names_of_80_characters_can_be_used():
    assert checked_names(("x" * LONGEST_NAME, "b")) == ("x" * LONGEST_NAME, "b")
