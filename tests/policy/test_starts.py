"""Where demonstrations start with different macro-actions the first frame of a run tells with which."""

from dataclasses import replace

import gymnasium as gym
import pytest
import torch
from safetensors.torch import load_file

from dpmacro.boosting.learners.base import Frames
from dpmacro.policy.policy import MacroPolicy
from tests.policy.test_policy import KEY, change_config, random_policy, run, seen


def told_at(policy, images, starts):
    """The start whose classifier is surest of each image being the first of a run."""
    levels = policy.quantiser.levels(policy.features.values(seen(images, images)))
    scores = policy.switcher.scores(Frames(levels))[:, len(policy.config.switches) :, 0]
    return torch.tensor(starts)[scores.argmax(1)]


def several_starts(starts=(0, 2), switches=((0, 1), (2, 1)), seed=0):
    """A policy that never switches, and an image for each of two starts: it begins differently at them."""
    policy, images = random_policy(switches=switches, starts=starts, seed=seed)
    policy = replace(policy, config=replace(policy.config, thresholds=(100.0,) * len(switches)))
    told = told_at(policy, images, starts)
    first, second = (images[told == start][:1] for start in starts)
    assert len(first) and len(second), "the random stumps tell two starts"
    return policy, images, first, second


@pytest.mark.parametrize("switches", [(), ((0, 1), (2, 1))])
def test_a_run_starts_with_the_macro_action_that_its_first_frame_tells(tmp_path, switches):
    policy, images, first, second = several_starts(switches=switches, seed=1)
    policy.save(tmp_path)
    loaded = MacroPolicy.load(tmp_path)
    assert loaded.config.starts == (0, 2)
    for own in (policy, loaded, policy.to("cpu")):
        _, state = own.act({KEY: torch.cat([first, second])}, own.initial_state(2))
        assert state.macro.tolist() == [0, 2]
        _, state = own.act({KEY: torch.cat([second, first])}, state)
        assert state.macro.tolist() == [0, 2], "later frames are not asked"
        for shown, macro in ((first, 0), (second, 2)):
            assert set(run(own, torch.cat([shown, images]))[1]) == {macro}


def test_a_start_is_told_anew_where_an_environment_begins_anew():
    policy, _, first, second = several_starts()
    _, state = policy.act({KEY: torch.cat([first, first])}, policy.initial_state(2))
    state = policy.restart(state, torch.tensor([False, True]))
    _, state = policy.act({KEY: torch.cat([second, second])}, state)
    assert state.macro.tolist() == [0, 2]
    planner = policy.planner()
    for shown, macro in ((second, 2), (first, 0)):
        planner.reset(gym.Env())
        planner.act({"pixels": shown[0].numpy()}, {})
        assert planner.macro == macro


def test_a_switch_function_may_fire_right_at_the_start():
    """It follows the macro-action that the first frame told, not another."""
    policy, _, first, second = several_starts()
    eager = replace(policy, config=replace(policy.config, thresholds=(-100.0, 100.0)))
    _, state = eager.act({KEY: torch.cat([first, second])}, eager.initial_state(2))
    assert state.macro.tolist() == [1, 2]
    cued = replace(eager, config=replace(eager.config, cues=((0, 1, 2), (0, 1, 2))))
    _, state = cued.act({KEY: torch.cat([first, second])}, cued.initial_state(2))
    assert state.macro.tolist() == [0, 2], "nothing was done before a first frame"


def test_a_single_start_asks_no_classifier(tmp_path):
    policy, images = random_policy(switches=(), starts=(2,))
    assert policy.switcher is None and policy.initial_state(3).macro.tolist() == [2] * 3
    policy.save(tmp_path)
    assert not any(name.startswith("switcher") for name in load_file(tmp_path / "model.safetensors"))
    assert set(run(MacroPolicy.load(tmp_path), images)[1]) == {2}


def test_starts_need_the_tensors_of_their_classifiers(tmp_path):
    policy, _ = random_policy(switches=())
    policy.save(tmp_path)
    change_config(tmp_path, {"starts": [0, 2]})
    with pytest.raises(ValueError, match="cannot be read"):
        MacroPolicy.load(tmp_path)
