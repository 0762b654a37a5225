"""A policy acts alike in any batch, switches only along observed changes, and survives its files."""

import itertools
import json
from dataclasses import replace

import cv2
import gymnasium as gym
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.features.base import frames_before
from dpmacro.features.kinds import FEATURES, make_features
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.planner import MacroPlanner
from dpmacro.policy.policy import MacroPolicy
from dpmacro.policy.recovery import RecoveringPlanner, Stretches

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
SHAPE = (12, 16)
KEY = "observation.image"


def seen(images, previous):
    return {0: {KEY: images}, 1: {KEY: previous}}


def random_policy(kind="rectangles", switches=((0, 1), (1, 2)), seed=0, starts=(0,)):
    """Random stumps over random images: enough for a policy that does something in every frame."""
    generator = torch.Generator().manual_seed(seed)
    images = torch.randint(0, 256, (50, *SHAPE, 3), dtype=torch.uint8, generator=generator)
    features = make_features(kind, *SHAPE, 200, generator)
    quantiser = Quantiser.fit(features.values(seen(images, images[frames_before(torch.tensor([50]))])))

    def stumps(problems, classes):
        return StumpClassifier(
            torch.randint(features.count, (20, problems), generator=generator),
            torch.randint(256, (20, problems), generator=generator).to(torch.uint8),
            torch.randn(20, problems, 2, classes, generator=generator),
        )

    config = PolicyConfig(
        type="dpboost",
        macros=3,
        starts=starts,
        inputs={KEY: InputConfig((*SHAPE, 3))},
        encoder=features.spec(),
        action_names=("a", "b", "c"),
        outputs=3,
        switches=switches,
        thresholds=(2.0,) * len(switches),
        world={"id": "TwoFlags-v0", "render_size": [128, 96]},
    )
    asked = len(switches) + (len(starts) if len(starts) > 1 else 0)
    switcher = stumps(asked, 1) if asked else None
    return MacroPolicy.compact(config, features, quantiser, stumps(3, 3), switcher), images


def change_config(folder, changes):
    """Other values in the config.json of a saved policy."""
    values = json.loads((folder / "config.json").read_text())
    values["planner"] |= changes
    (folder / "config.json").write_text(json.dumps(values))


def run(policy, images):
    """Actions and macro-actions of one environment that shows `images`."""
    planner, actions, macros = policy.planner(), [], []
    for image in images.numpy():
        actions.append(planner.act({"pixels": image}, {}))
        macros.append(planner.macro)
    return actions, macros


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("kind", FEATURES)
@pytest.mark.parametrize("starts", [(0,), (0, 1, 2)])
def test_a_batch_acts_as_its_environments_one_by_one(starts, kind, device):
    policy, images = random_policy(kind, starts=starts)
    policy = policy.to(device)
    orders = [torch.randperm(50, generator=torch.Generator().manual_seed(k)) for k in range(4)]
    state, together = policy.initial_state(4), []
    for t in range(50):
        batch = torch.stack([images[order[t]] for order in orders]).to(device)
        actions, state = policy.act({KEY: batch}, state)
        together.append((actions.tolist(), state.macro.tolist()))
    for row, order in enumerate(orders):
        actions, macros = run(policy, images[order])
        assert actions == [step[0][row] for step in together]
        assert macros == [step[1][row] for step in together]


def test_switches_only_along_observed_changes():
    policy, images = random_policy(switches=((0, 2), (2, 0)))
    macros = run(policy, images)[1]
    assert set(macros) == {0, 2}


def test_the_highest_switch_above_its_threshold_wins():
    policy, images = random_policy(switches=((0, 1), (0, 2)))
    previous = images[:1]
    levels = policy.quantiser.levels(policy.features.values(seen(images[:1], previous)))
    scores = policy.switcher.scores(Frames(levels))[0, :, 0]
    for thresholds, macro in (
        (scores + 1, 0),
        (scores - torch.tensor([1.0, 2.0]), 2),
        (scores - torch.tensor([2.0, 1.0]), 1),
        (scores - torch.tensor([1.0, -1.0]), 1),
    ):
        config = replace(policy.config, thresholds=tuple(thresholds.tolist()))
        changed = MacroPolicy(config, policy.features, policy.quantiser, policy.actor, policy.switcher)
        assert run(changed, images[:1])[1] == [macro]


def test_a_switch_function_fires_only_right_after_its_cues():
    policy, images = random_policy(switches=((0, 1), (1, 0)))
    eager = replace(policy.config, thresholds=(-100.0, -100.0), cues=((2,), (0, 1)))
    policy = replace(policy, config=eager)
    for macro, action in itertools.product((0, 1), (-1, 0, 1, 2)):
        before = policy.act({KEY: images[:1]}, policy.initial_state(1))[1]
        state = replace(before, macro=torch.tensor([macro]), action=torch.tensor([action]))
        changes = action in ((2,), (0, 1))[macro]
        assert int(policy.act({KEY: images[1:2]}, state)[1].macro) == (1 - macro if changes else macro)


def test_what_was_done_instead_is_what_a_switch_function_follows():
    policy, images = random_policy(switches=((0, 1),))
    policy = replace(policy, config=replace(policy.config, thresholds=(-100.0,), cues=((2,),)))
    for instead in range(3):
        planner = policy.planner()
        planner.act({"pixels": images[0].numpy()}, {})
        planner.took(instead)
        planner.act({"pixels": images[1].numpy()}, {})
        assert planner.macro == int(instead == 2)


def test_a_planner_that_sees_the_same_again_leaves_its_circle(tmp_path):
    """The third time it has seen the same pair of images before, and takes the action that came second."""
    policy, images = random_policy(switches=((0, 1),))
    labels, actions = torch.zeros(9).long(), torch.arange(9) % 3
    stretches = Stretches.of(labels, actions, torch.tensor([9]))
    policy = replace(policy, config=replace(policy.config, thresholds=(100.0,)), stretches=stretches)
    policy.save(tmp_path)
    same = {"pixels": images[0].numpy()}
    first, second = (
        policy.decide({KEY: images[:1]}, policy.initial_state(1))[0][0].argsort(descending=True)[:2].tolist()
    )
    for found in (policy, MacroPolicy.load(tmp_path), policy.to("cpu")):
        planner = found.planner(recovery=True)
        for expected in ([first], [first, first], [first, first, second]):  # episodes
            planner.reset(gym.Env())
            assert [planner.act(same, {}) for _ in expected] == expected
            assert planner.planner.memory[1] == expected[-1]
        others = [planner.act({"pixels": image.numpy()}, {}) for image in images]
        alone = found.planner(recovery=False)
        assert others == [alone.act({"pixels": image.numpy()}, {}) for image in [images[0], *images]][1:]
        assert [alone.act(same, {}) for _ in range(4)][1:] == [first] * 3


def test_an_environment_that_begins_anew_has_done_nothing():
    policy, images = random_policy(switches=((0, 1),))
    policy = replace(policy, config=replace(policy.config, thresholds=(-100.0,), cues=((0, 1, 2),)))
    _, state = policy.act({KEY: images[:2]}, policy.initial_state(2))
    _, state = policy.act({KEY: images[2:4]}, policy.restart(state, torch.tensor([True, False])))
    assert state.macro.tolist() == [0, 1]


def test_without_switch_functions_the_first_macro_stays():
    policy, images = random_policy(switches=())
    assert set(run(policy, images)[1]) == {0}


@pytest.mark.parametrize("kind", FEATURES)
@pytest.mark.parametrize("switches", [(), ((0, 1), (1, 2))])
@pytest.mark.parametrize("starts", [(0,), (1, 2)])
def test_files_keep_every_decision(tmp_path, kind, switches, starts):
    policy, images = random_policy(kind, switches, starts=starts)
    policy.save(tmp_path / "model")
    read = MacroPolicy.load(tmp_path / "model")
    assert run(read, images) == run(policy, images)
    assert read.config == policy.config
    assert sorted(path.name for path in (tmp_path / "model").iterdir()) == [
        "config.json",
        "model.safetensors",
        "policy_postprocessor.json",
        "policy_preprocessor.json",
    ]


def test_a_policy_saved_before_lerobot_could_load_it_is_read(tmp_path):
    """Its config.json held what now is under `planner` alone."""
    policy, images = random_policy()
    policy.save(tmp_path)
    flat = json.loads((tmp_path / "config.json").read_text())["planner"]
    (tmp_path / "config.json").write_text(json.dumps(flat))
    read = MacroPolicy.load(tmp_path)
    assert read.config == policy.config and run(read, images) == run(policy, images)


def test_a_reset_planner_starts_afresh():
    policy, images = random_policy()
    planner = policy.planner()
    first = [planner.act({"pixels": image}, {}) for image in images.numpy()]
    planner.reset(gym.Env())
    assert [planner.act({"pixels": image}, {}) for image in images.numpy()] == first


def test_memory_and_two_frames_decide_what_follows():
    """What `rollouts.Planner` asks of a memory: where a run meets all three again, it goes on alike."""
    policy, images = random_policy(switches=((0, 1), (1, 2), (2, 0)))
    policy = replace(policy, config=replace(policy.config, thresholds=(-3.0,) * 3))
    shown = torch.randint(4, (300,), generator=torch.Generator().manual_seed(0)).tolist()
    planner, followed, met = policy.planner(), {}, 0
    planner.reset(gym.Env())
    for before, now in zip([None, *shown], shown, strict=False):
        situation = before, now, planner.memory
        action = planner.act({"pixels": images[now].numpy()}, {})
        met += situation in followed
        assert followed.setdefault(situation, (action, planner.memory)) == (action, planner.memory)
    assert met > 200 and len({memory for _, _, memory in followed}) == 8  # macro-action and action


def test_a_planner_shrinks_what_demonstrations_were_shrunk_from(tmp_path):
    policy, images = random_policy()
    policy = replace(policy, config=replace(policy.config, inputs={KEY: InputConfig((*SHAPE, 3), (36, 32))}))
    policy.save(tmp_path)
    large = torch.randint(0, 256, (30, 36, 32, 3), dtype=torch.uint8)
    shrunk = [cv2.resize(image, SHAPE[::-1], interpolation=cv2.INTER_AREA) for image in large.numpy()]
    loaded = MacroPolicy.load(tmp_path)
    assert loaded.config == policy.config
    with pytest.raises(
        ValueError, match="the observation: images are 16x12, the policy was trained on 32x36"
    ):
        loaded.planner().act({"pixels": images[0].numpy()}, {})
    plain = {KEY: InputConfig((*SHAPE, 3))}
    as_shrunk = replace(policy, config=replace(policy.config, inputs=plain))
    assert run(loaded, large) == run(as_shrunk, torch.from_numpy(np.stack(shrunk)))


def test_an_image_of_another_size_is_refused():
    policy, _ = random_policy()
    with pytest.raises(
        ValueError, match="the observation: images are 64x48, the policy was trained on 16x12"
    ):
        policy.planner().act({"pixels": np.zeros((48, 64, 3), np.uint8)}, {})


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda folder: (folder / "config.json").unlink(), "holds no config.json"),
        (lambda folder: (folder / "model.safetensors").unlink(), "holds no model.safetensors"),
        (lambda folder: (folder / "config.json").write_text("{"), "is no policy of dpmacro"),
        (
            lambda folder: (folder / "config.json").write_text('{"type": "act"}'),
            "is no policy of dpmacro",
        ),
        (
            lambda folder: (folder / "config.json").write_bytes(b"\xff\xfe\x00"),
            "is no policy of dpmacro",
        ),
        (lambda folder: (folder / "model.safetensors").write_bytes(b"no tensors"), "cannot be read"),
        (
            lambda folder: (folder / "model.safetensors").write_bytes(
                (folder / "model.safetensors").read_bytes()[:-100]
            ),
            "cannot be read",
        ),
    ],
)
def test_files_that_cannot_be_read_are_named(tmp_path, harm, message):
    policy, _ = random_policy()
    policy.save(tmp_path)
    harm(tmp_path)
    with pytest.raises(ValueError, match=message):
        MacroPolicy.load(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"starts": ["x"]}, "starts"),
        ({"starts": [3]}, "starts"),
        ({"switches": [[0, 1], [1, 9]]}, "switches"),
        ({"thresholds": [0.0]}, "thresholds"),
        ({"thresholds": [0.0, float("nan")]}, "thresholds"),
        ({"inputs": {KEY: {"shape": [12, 16], "stored_shape": None}}}, "inputs"),
        ({"inputs": {KEY: {"shape": [12, 16, 3], "stored_shape": [1]}}}, "stored_shape"),
        ({"inputs": {}}, "inputs"),
        ({"outputs": 0}, "outputs"),
        ({"loss": "huber"}, "loss"),
        ({"order": "any"}, "order"),
        ({"action_transform": {"mean": [0.0]}}, "no transform of actions"),
        ({"world": None}, "world"),
        ({"macros": 0}, "macros"),
        ({"starts": []}, "starts"),
        ({"starts": [0, 3]}, "starts"),
    ],
)
def test_a_config_that_cannot_be_is_named(tmp_path, changes, message):
    random_policy()[0].save(tmp_path)
    change_config(tmp_path, changes)
    with pytest.raises(ValueError, match=rf"(?s)config\.json is no policy of dpmacro.*\(.*{message}"):
        MacroPolicy.load(tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors: tensors.update({"actor.stumps.votes": tensors["actor.stumps.votes"][:3]}),
        lambda tensors: tensors["actor.stumps.columns"].add_(10_000),
        lambda tensors: tensors.update({"quantiser.cuts": tensors["quantiser.cuts"][:5]}),
        lambda tensors: tensors.update({"features.first": tensors["features.first"][:, :3].contiguous()}),
        lambda tensors: tensors.pop("switcher.stumps.votes"),
    ],
)
def test_tensors_that_do_not_fit_one_another_are_named(tmp_path, change):
    random_policy()[0].save(tmp_path)
    tensors = load_file(tmp_path / "model.safetensors")
    change(tensors)
    save_file(tensors, tmp_path / "model.safetensors")
    with pytest.raises(ValueError, match=r"model\.safetensors cannot be read"):
        MacroPolicy.load(tmp_path)


def test_tensors_that_do_not_belong_to_the_config_are_named(tmp_path):
    policy, _ = random_policy(switches=())
    policy.save(tmp_path)
    change_config(tmp_path, {"switches": [[0, 1]], "thresholds": [0.0]})
    with pytest.raises(ValueError, match="cannot be read"):
        MacroPolicy.load(tmp_path)


def test_one_environment_of_a_batch_starts_anew():
    policy, images = random_policy()
    state, seen = policy.initial_state(2), []
    for t in range(30):
        if t == 10:
            state = policy.restart(state, torch.tensor([False, True]))
        actions, state = policy.act({KEY: images[[t, t % 10 + 20 * (t >= 10)]]}, state)
        seen.append((actions.tolist(), state.macro.tolist()))
    for row, parts in enumerate([[range(30)], [range(10), range(20, 30)]]):
        alone = [pair for part in parts for pair in zip(*run(policy, images[list(part)]), strict=True)]
        assert [(a[row], m[row]) for a, m in seen][: len(alone)] == alone


def test_a_policy_without_a_stump_takes_its_first_action(tmp_path):
    policy, images = random_policy(switches=())
    none = torch.zeros(0, 3, dtype=torch.int64)
    empty = StumpClassifier(none, none.byte(), torch.zeros(0, 3, 2, 3))
    nothing = MacroPolicy.compact(policy.config, policy.features, policy.quantiser, empty, None)
    nothing.save(tmp_path)
    assert nothing.features.count == 0
    assert set(run(MacroPolicy.load(tmp_path), images)[0]) == {0}


def test_recovery_is_off_unless_asked_for_and_needs_demonstrators():
    policy, _ = random_policy()
    assert isinstance(policy.planner(), MacroPlanner) and policy.stretches is None
    with pytest.raises(ValueError, match="holds no actions of demonstrators"):
        policy.planner(recovery=True)
    stretches = Stretches.of(torch.zeros(2).long(), torch.tensor([0, 1]), torch.tensor([2]))
    policy = replace(policy, stretches=stretches)
    assert isinstance(policy.planner(), MacroPlanner)
    assert isinstance(policy.planner(recovery=True), RecoveringPlanner)
