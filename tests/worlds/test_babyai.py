"""Runs of BabyAI's bot: what is seen, done and meant, frame by frame."""

import inspect
import sys
from itertools import groupby

import gymnasium as gym
import numpy as np
import pytest
from minigrid.core.actions import Actions
from minigrid.utils import baby_ai_bot
from minigrid.wrappers import RGBImgPartialObsWrapper
from noise import AVATAR

from dpmacro.evaluation import recording
from dpmacro.evaluation.recording import run_expert
from dpmacro.evaluation.rollouts import PlannerSource, run_episodes
from dpmacro.worlds.babyai import ACTIONS, LEVELS, SUBGOALS, Bot, make

PUT_NEXT, UNLOCK_PICKUP, SYNTH = LEVELS[2], LEVELS[4], LEVELS[5]


def run_bot(level, seed, tile=8):
    return run_expert({"id": level, "tile": tile}, seed)


DOES = {"pickup": {"Pickup"}, "drop": {"Drop"}, "toggle": {"Open", "Close"}}


def names(numbers):
    """Subgoals without repetition, by name."""
    return [SUBGOALS[number] for number, _ in groupby(numbers.tolist())]


def test_names_are_those_of_minigrid():
    assert [action.name for action in Actions] == list(ACTIONS)
    wanted = {f"{name}Subgoal" for name in ("", *SUBGOALS)}
    classes = [name for name, _ in inspect.getmembers(baby_ai_bot, inspect.isclass)]
    assert {name for name in classes if name.endswith("Subgoal")} == wanted


@pytest.mark.parametrize("level", LEVELS)
def test_the_bot_solves_the_level_and_says_what_it_is_about(level):
    runs = [run_bot(level, seed) for seed in range(20)]
    solved = [run for run in runs if run is not None]
    assert len(solved) >= 18
    for run in solved:
        images, purposes = run.observations[AVATAR], run.truth["purpose"]
        assert images.shape == (len(run.actions), 56, 56, 3) and images.dtype == np.uint8
        assert np.all(run.rewards[:-1] == 0) and run.rewards[-1] > 0 and run.task
        for action, subgoal, purpose in zip(run.actions, run.truth["subgoal"], purposes, strict=True):
            assert SUBGOALS[subgoal] in DOES.get(ACTIONS[action], {"GoNextTo"})
            assert purpose == subgoal or SUBGOALS[subgoal] == "GoNextTo"
    several = [len(set(run.truth["purpose"])) > 1 for run in solved]
    assert np.mean(several) > 0.5
    assert 2 <= len(set(np.concatenate([run.truth["purpose"] for run in solved]))) <= 5


def test_frames_hold_the_observation_before_their_action():
    """The recorded actions, done again in a level of their own, show the recorded pictures."""
    run = run_bot(UNLOCK_PICKUP, 3, tile=4)
    env = RGBImgPartialObsWrapper(gym.make(UNLOCK_PICKUP), tile_size=4)
    observation, _ = env.reset(seed=3)
    assert run.task == observation["mission"]
    for t, (image, action) in enumerate(zip(run.observations[AVATAR], run.actions, strict=True)):
        assert image.shape == (28, 28, 3) and np.array_equal(image, observation["image"])
        observation, reward, ended, _, _ = env.step(int(action))
        assert ended == (t == len(run.actions) - 1) and np.float32(reward) == run.rewards[t]


def test_the_plans_are_what_the_missions_ask_for():
    put = run_bot(PUT_NEXT, 0)
    assert names(put.truth["subgoal"]) == ["GoNextTo", "Pickup", "GoNextTo", "Drop"]
    assert [name for name in names(put.truth["purpose"]) if name != "Explore"] == ["Pickup", "Drop"]
    unlock = run_bot(UNLOCK_PICKUP, 0)
    walks = ["Pickup", "Open", "Drop", "Pickup"]  # the key, the door, the key again, what is asked for
    assert [name for name in names(unlock.truth["subgoal"]) if name != "GoNextTo"] == walks
    assert [name for name in names(unlock.truth["purpose"]) if name != "Explore"] == walks


def test_a_seed_repeats_the_run_whatever_ran_before():
    first = run_bot(SYNTH, 1)
    run_bot(SYNTH, 2)
    recording._set.cache_clear()
    again = run_bot(SYNTH, 1)
    for name in ("actions", "rewards"):
        assert np.array_equal(getattr(first, name), getattr(again, name)), name
    for name in ("observations", "truth"):
        for key, values in getattr(first, name).items():
            assert np.array_equal(values, getattr(again, name)[key]), key
    assert first.task == again.task
    assert not np.array_equal(run_bot(SYNTH, 3).actions, first.actions)


def push_for_ever(bot):
    while True:
        bot.stack.append(baby_ai_bot.ExploreSubgoal(bot))


def fail(bot):
    raise baby_ai_bot.DisappearedBoxError("a box")


@pytest.mark.parametrize("replan", [fail, push_for_ever, lambda bot: Actions.left])
def test_a_run_that_fails_is_none(monkeypatch, replan):
    monkeypatch.setattr(baby_ai_bot.BabyAIBot, "replan", replan)
    assert run_bot(PUT_NEXT, 0) is None


def test_a_bot_that_takes_the_mission_for_accomplished_is_asked_no_more(monkeypatch):
    asked = []

    def give_up(bot):
        asked.append(bot.stack.clear())
        return Actions.done

    monkeypatch.setattr(baby_ai_bot.BabyAIBot, "replan", give_up)
    assert run_bot(PUT_NEXT, 0) is None and len(asked) == 1


def test_an_interrupt_is_no_failure(monkeypatch):
    def interrupt(bot):
        raise KeyboardInterrupt

    monkeypatch.setattr(baby_ai_bot.BabyAIBot, "replan", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_bot(PUT_NEXT, 0)


def test_a_bot_that_goes_round_in_circles_ends():
    assert run_bot("BabyAI-UnlockToUnlock-v0", 4) is None


def test_rejected_missions_are_not_printed(capfd):
    gym.make(LEVELS[0]).reset(seed=1)
    assert "rejected" in capfd.readouterr().out
    assert run_bot(LEVELS[0], 1) is not None
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("level", ["BabyAI-GoToSeqS5R3-v0", "CartPole-v1"])
def test_what_is_no_level_is_refused(level):
    with pytest.raises(ValueError, match=rf"level is '{level}': give the id .* like BabyAI-GoToSeqS5R2-v0"):
        make(level)


def test_a_tile_has_pixels():
    with pytest.raises(ValueError, match="BabyAI: tile is 0: give 1 to 32 pixels"):
        make(PUT_NEXT, tile=0)


def test_the_bot_teaches_no_other_world():
    with pytest.raises(ValueError, match="the teacher was given CartPoleEnv: it teaches BabyAI only"):
        Bot().reset(gym.make("CartPole-v1"))


def test_the_bot_runs_as_any_expert_and_its_reward_tells_success():
    [episode] = run_episodes(PlannerSource("teacher"), {"id": PUT_NEXT}, [0])
    run = run_bot(PUT_NEXT, 0)
    assert episode.actions.tolist() == run.actions.tolist() and episode.success
    assert episode.success_by == "a reward above 0 on the step that ends the run"


def test_without_minigrid_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "minigrid", None)
    with pytest.raises(ValueError, match=r"pip install -e '\.\[babyai\]'"):
        make(PUT_NEXT)
