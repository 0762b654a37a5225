"""The map of what a classifier does on seeing red: two that always do the same, drawn; and wrong policies."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from dpmacro import figures
from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT
from tests.training.test_collection import stubborn

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

import avenue_map  # noqa: E402
from avenue_map import MapOptions  # noqa: E402

WORLD = {"id": "TwoFlags-v0", "flags": "fixed", "layout_seed": 0, "render_size": [64, 48], "max_steps": 40}


def trained(folder, action, world):
    """The folder of a training whose policy always does the same, told that it learned in this world."""
    policy = folder / avenue_map.POLICY
    stubborn(policy, action)
    config = json.loads((policy / "config.json").read_text())
    config["planner"]["world"] = world
    (policy / "config.json").write_text(json.dumps(config))
    return folder


@pytest.mark.parametrize(("action", "share"), [(FORWARD, 1.0), (TURN_LEFT, 0.0)])
def test_it_asks_at_every_free_place_from_which_red_is_seen(tmp_path, action, share):
    folder = trained(tmp_path, action, WORLD)
    found = avenue_map.map_of(folder, MapOptions([str(folder)], cells=5, textures=1, paths=1))
    looked = ~np.isnan(found.forward)
    assert 10 <= looked.sum() < 25, "walls and blue hide some"
    assert (found.forward[looked] == share).all()
    assert found.paths[0].shape == (40, 2) and set(found.flags) == {"blue", "red"}
    picture = figures.to_image(avenue_map.drawn([found], ["always"]))
    reddish = (picture[..., 0].astype(int) - picture[..., 1]) > 100  # of 235, 115, 107
    assert (reddish.mean() > 0.1) == (share == 1.0)


@pytest.mark.parametrize(
    ("world", "told"),
    [
        ({"id": "FourFlags-v0", "flags": "fixed"}, "FourFlags-v0"),
        ({"id": "TwoFlags-v0", "flags": "random"}, "'random'"),
        ({}, "no known world"),
    ],
)
def test_a_policy_of_another_world_is_refused(tmp_path, world, told):
    folder = trained(tmp_path, FORWARD, world)
    with pytest.raises(ValueError, match=f"{told}.*: give one of TwoFlags, flags fixed"):
        avenue_map.map_of(folder, MapOptions([str(folder)]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"policies": []}, "policies is empty"),
        ({"policies": ["a"], "titles": ["b", "c"]}, "titles has 2 and policies 1"),
        ({"policies": ["a"], "cells": 0}, "cells is 0: give 1 to 200"),
    ],
)
def test_options_are_checked(options, message):
    with pytest.raises(ValueError, match=message):
        MapOptions(**options)
