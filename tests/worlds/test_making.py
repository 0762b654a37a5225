"""Worlds as options name them: made by id, with options of their own, or refused in one line."""

import sys

import gymnasium as gym
import numpy as np
import pytest

from dpmacro.worlds import DEFAULT, EXPERTS, RECORDINGS, entry_of, expert_of, recording_of
from dpmacro.worlds.base import Expert, WorldError
from dpmacro.worlds.making import WorldOptions, complete, make_world


class Plain(gym.Env):
    observation_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, length=3):
        if length < 0:
            raise RuntimeError(f"no\nroom for {length}")
        self.length = length


gym.register("dpmacro-tests/Plain-v0", Plain)


def test_a_world_is_made_without_wrappers_that_check_again():
    env = make_world({"id": "dpmacro-tests/Plain-v0", "length": 4, "success": "done", "observations": {}})
    assert env.unwrapped.length == 4


@pytest.mark.parametrize(
    ("world", "message"),
    [
        ({"id": "Nowhere-v0"}, "there is no world 'Nowhere-v0' .*: correct --world.id, or name the package"),
        ({"id": "dpmacro-tests/Plain-v7"}, "there is no world 'dpmacro-tests/Plain-v7'"),
        ({"id": "nowhere/Plain-v0"}, "there is no world 'nowhere/Plain-v0'"),
        ({"id": "no such id"}, "there is no world 'no such id'"),
        ({"id": "no_such_package:Plain-v0"}, "there is no world 'no_such_package:Plain-v0'"),
        ({"id": "dpmacro-tests/Plain-v0", "fog": 1}, "cannot be made with {'fog': 1} .TypeError.*'fog'"),
        ({"id": "dpmacro-tests/Plain-v0", "length": -1}, "RuntimeError: no room for -1.: correct its"),
        ({"id": DEFAULT, "fog": 1}, "^TwoFlags has no option 'fog': choose among flags, layout_seed"),
        ({"id": DEFAULT, "import": "no_such_package"}, "--world.import=no_such_package cannot be imported"),
    ],
)
def test_worlds_that_cannot_be_made_are_refused_in_one_line(world, message):
    with pytest.raises(ValueError, match=message) as refused:
        make_world(world)
    assert "\n" not in str(refused.value)


def test_a_package_registers_its_world_and_a_broken_one_is_named(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "brings_a_world.py").write_text(
        "import gymnasium\nfrom tests.worlds.test_making import Plain\n"
        "gymnasium.register('Brought-v0', Plain)\n"
    )
    (tmp_path / "breaks.py").write_text("1 / 0")
    env = make_world({"id": "Brought-v0", "import": "brings_a_world"})
    assert isinstance(env.unwrapped, Plain)
    with pytest.raises(WorldError, match=r"--world.import=breaks cannot be imported \(ZeroDivisionError"):
        make_world({"id": "Brought-v0", "import": "breaks"})
    sys.modules.pop("brings_a_world")


def test_what_a_world_tells_of_its_options_completes_them():
    world = {"id": DEFAULT, "flags": "fixed", "success": "is_success"}
    found = complete(world)
    assert found.items() >= world.items() and found["render_size"] == (128, 96)
    assert complete({"id": "dpmacro-tests/Plain-v0", "length": 2}) == {
        "id": "dpmacro-tests/Plain-v0",
        "length": 2,
    }


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"layout_seed": 1.5}, "TwoFlags: layout_seed is 1.5: give a value like 0"),
        ({"max_steps": "many"}, "TwoFlags: max_steps is 'many': give a value like 3000"),
        ({"max_steps": True}, "TwoFlags: max_steps is True"),
        ({"render_size": 64}, "TwoFlags: render_size is 64"),
        ({"flags": [1, 2]}, "TwoFlags: flags is .1, 2.: give a value like 'random'"),
        ({"flags": "none"}, "choose 'random' or 'fixed'"),
    ],
)
def test_options_of_another_type_are_refused(option, message):
    with pytest.raises(ValueError, match=message):
        complete({"id": DEFAULT, **option})


def test_options_are_laid_over_a_world_of_the_same_id_only():
    stored = {"id": "A-v0", "size": 3, "observations": {"observation.state": "arm"}}
    assert WorldOptions().over(stored) == stored
    assert WorldOptions(id="A-v0", options={"size": 4}).over(stored) == {**stored, "size": 4}
    assert WorldOptions(id="B-v0", import_="b", success=3.5).over(stored) == {
        "id": "B-v0",
        "import": "b",
        "success": 3.5,
    }
    named = WorldOptions(observations=["observation.state=robot.arm", "observation.image=a=b"])
    assert named.over(stored)["observations"] == {
        "observation.state": "robot.arm",
        "observation.image": "a=b",
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observations": ["arm"]}, "--world.observations has 'arm': give LeRobot's key"),
        ({"observations": ["=arm"]}, "--world.observations has '=arm'"),
        ({"options": {"success": 1}}, "--world.options has 'success': give it as --world.success="),
    ],
)
def test_options_check_themselves(options, message):
    with pytest.raises(ValueError, match=message):
        WorldOptions(**options)


def test_tables_know_ids_before_families():
    table = {"A-": "builtins:int", "A-B-": "builtins:float", "A-B-C": "builtins:str"}
    found = [entry_of(table, world) for world in ("A-x", "A-B-x", "A-B-C", "B-x", "A")]
    assert found == [int, float, str, None, None]


@pytest.mark.parametrize("table", [EXPERTS, RECORDINGS])
def test_who_has_an_expert_has_a_recording(table):
    assert set(EXPERTS) == set(RECORDINGS)
    for name in table:
        if name.endswith("Flags-v0"):
            assert isinstance(expert_of(name), Expert) and "phase" in recording_of(name).truth
    with pytest.raises(ValueError, match=r"world 'CartPole-v1' has no teacher: choose among TwoFlags-v0, "):
        expert_of("CartPole-v1")
