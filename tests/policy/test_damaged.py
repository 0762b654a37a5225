"""A policy's files are a stranger's: what cannot be is refused at load in one line, before it takes memory.

tests/fuzz damages every field and every tensor; here stand the kinds of damage that once went unnoticed.
Where tests run with checks of shapes, these speak first of some tensors ("Type-check").
"""

import json

import pytest
import torch
from safetensors.torch import load_file, save_file

from dpmacro.policy.policy import MacroPolicy
from tests.fuzz.limits import limited
from tests.fuzz.test_policies import networks, rectangles, vectors
from tests.policy.test_policy import KEY, change_config

STATE = "features.2.table"  # of `vectors`


def refused(folder, message):
    """Loading ends in one line that names the folder, in time and in little memory."""
    with pytest.raises(ValueError, match=message) as caught, limited():
        MacroPolicy.load(folder)
    line = str(caught.value)
    assert str(folder) in line and "\n" not in line and len(line) < 600


@pytest.mark.parametrize(
    "content",
    ["[]", "null", '"x"', "1", "[" * 2000 + "]" * 2000, '{"planner": []}', '{"planner": {"macros": null}}'],
)
def test_a_config_that_is_no_object_of_a_policy(tmp_path, content):
    rectangles().save(tmp_path)
    (tmp_path / "config.json").write_text(content)
    refused(tmp_path, r"config\.json is no policy of dpmacro")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"type": "x/../../.."}, r"type is 'x/\.\./\.\./\.\.': give one of dpboost, baseline"),
        ({"type": 7}, r"type is 7: give one of dpboost, baseline"),
        ({"macros": 10**9}, r"macros is 1000000000: give 1000 or less"),
        ({"macros": 10**400}, r"macros is 1000*\.\.\.: give 1000 or less"),
        ({"macros": True}, r"macros is True: give a whole number"),
        ({"max_transitions": 10**9}, r"max_transitions is 1000000000: give 1048576 or less"),
        ({"max_transitions": 1.5}, r"max_transitions is 1\.5: give a whole number"),
        (
            {"inputs": {KEY: {"shape": [20000, 20000, 3], "stored_shape": None}}},
            r"give 2097152 pixels",
        ),
        (
            {"inputs": {KEY: {"shape": [10**9], "stored_shape": None}}},
            r"is 1000000000: give",
        ),
        ({"inputs": {KEY: {"shape": [12, 16, 4], "stored_shape": None}}}, r"give \[height, width, 3\]"),
        ({"inputs": [KEY]}, r"inputs is \['observation\.image'\]: give names with a value each"),
        ({"encoder": None}, r"encoder is None: give names with a value each"),
        ({"thresholds": ["x", 1.0]}, r"thresholds\[0\] is 'x': give a finite number"),
        ({"cues": [[0], [99]]}, r"an action in cues\[1\] is 99: give 2 or less"),
        ({"switch_weight": float("nan")}, r"switch_weight is nan: give a finite number of 0 or more"),
        ({"action_names": [1, 2, 3]}, r"action_names\[0\] is 1: give a text"),
        ({"outputs": 4}, r"outputs is 4: give 3 or less"),
        ({"world": {"id": 5}}, r"world\.id is 5: give a text"),
        ({"surprise": 1}, r"'surprise' is no field of a policy: leave it out"),
    ],
)
def test_a_field_that_cannot_be_is_named_with_its_value(tmp_path, changes, message):
    rectangles().save(tmp_path)
    change_config(tmp_path, changes)
    refused(tmp_path, rf"config\.json is no policy of dpmacro.*{message}")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": [0.0]}, r"mean|scale has 3 entries"),
        ({"scale": [1.0, float("inf"), 1.0]}, r"scale\[1\] is inf: give a finite number above 0"),
        ({"kept": [0, 0]}, r"kept is \[0, 0\]: give each number once"),
        ({"names": [1, 2, 3]}, r"names\[0\] is 1: give a text"),
        ({"relative": "no"}, r"relative is 'no': give True or False"),
    ],
)
def test_a_transform_of_actions_that_cannot_be_is_named(tmp_path, change, message):
    policy = vectors()
    policy.save(tmp_path)
    change_config(tmp_path, {"action_transform": {**policy.config.action_transform, **change}})
    refused(tmp_path, rf"no transform of actions, .*({message})")


def test_an_encoder_that_cannot_be_is_named(tmp_path):
    policy = vectors()
    policy.save(tmp_path)
    for spec, message in (
        (1.5, "encoder is 1.5"),
        ({"kind": "concat", "parts": 3}, "the parts of an encoder is 3"),
        ({"kind": "x"}, "the kind of an encoder is 'x'"),
        ({**policy.config.encoder, "parts": [policy.config.encoder] * 3}, "list the parts of that"),
        (
            {**policy.config.encoder, "parts": [policy.config.encoder["parts"][0]] * 4},
            "twice|no part|cannot be",
        ),
    ):
        change_config(tmp_path, {"encoder": spec})
        refused(tmp_path, message)


def put(place, value):
    def change(tensor):
        tensor[place] = value
        return tensor

    return change


@pytest.mark.parametrize(
    ("make", "name", "change", "message"),
    [
        (
            rectangles,
            "actor.stumps.votes",
            put((0, 0, 0, 0), float("nan")),
            "votes of actor holds",
        ),
        (rectangles, "actor.stumps.votes", put((0, 0, 0, 0), 1e38), r"votes of actor add up to 1e\+38"),
        (rectangles, "actor.stumps.votes", lambda one: one[:, :2], "votes of actor is .*: give|Type-check"),
        (
            rectangles,
            "actor.stumps.votes",
            lambda one: one[:0, :1].expand(0, 10**9, 2, 3),
            "votes of actor is|Type-check",
        ),
        (rectangles, "actor.stumps.columns", put((0, 0), -1), "columns of actor holds -1"),
        (rectangles, "quantiser.cuts", lambda one: one.flip(1), "cuts do not ascend"),
        (rectangles, "features.first", put((0, 4), 17), "the end of a width|a width in first holds 17"),
        (rectangles, "stretches.actions", put(0, 200), "actions of stretches holds 200: give 0 to 2"),
        (rectangles, "stretches.macros", put(0, 9), "macros of stretches holds 9: give 0 to 2"),
        (
            rectangles,
            "stretches.lengths",
            lambda one: one.float(),
            "lengths of stretches is torch.float32|Type-check",
        ),
        (
            rectangles,
            "switcher.stumps.thresholds",
            lambda one: one.int(),
            "thresholds of switcher is torch.int32|Type-check",
        ),
        (rectangles, "surprise.x", lambda one: one, "it has tensors of surprise"),
        (vectors, STATE, put((0, 2), 2**31 - 1), "frames back in table holds 2147483647: give 0 to 10000"),
        (vectors, "quantiser.cuts", lambda one: one.long(), "cuts is torch.int64"),
        (networks, "actor.convnet.steps", put((0, 0), float("inf")), "steps of actor holds a number that"),
        (networks, "actor.convnet.first", lambda one: one * 1e38, "first of actor holds"),
        (networks, "features.places", put(0, -5), "places holds -5"),
    ],
)
def test_tensors_that_would_act_wrongly_are_refused(tmp_path, make, name, change, message):
    policy = make()
    policy.save(tmp_path)
    tensors = load_file(tmp_path / "model.safetensors")
    tensors[name] = change(tensors.get(name, torch.zeros(1)).clone()).clone().contiguous()
    save_file(tensors, tmp_path / "model.safetensors")
    refused(tmp_path, rf"model\.safetensors cannot be read \(.*({message})")


@pytest.mark.parametrize("field", ["macros", "switches", "starts"])
def test_counts_of_the_config_are_those_of_the_tensors(tmp_path, field):
    rectangles().save(tmp_path)
    values = json.loads((tmp_path / "config.json").read_text())["planner"]
    fewer = {
        "macros": {"macros": 4, "change_log_odds": [[0.0] * 4] * 4},
        "switches": {name: values[name][:1] for name in ("switches", "thresholds", "cues")},
        "starts": {"starts": [0], "switches": [], "thresholds": [], "cues": []},
    }
    change_config(tmp_path, fewer[field])
    refused(tmp_path, r"model\.safetensors cannot be read")
