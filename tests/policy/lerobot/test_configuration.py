"""One folder for both: what train.py saves LeRobot loads, and what LeRobot saves eval.py loads."""

import json
from dataclasses import replace

import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.factory import make_policy, make_pre_post_processors

from dpmacro.policy.lerobot import DpmacroConfig
from dpmacro.policy.lerobot.modeling_dpmacro import DpmacroPolicy
from dpmacro.policy.policy import MacroPolicy
from dpmacro.worlds.two_flags.lerobot_env import TwoFlagsEnvConfig
from tests.policy.lerobot.conftest import TASKS, as_lerobot
from tests.policy.lerobot.walking import walking_policy
from tests.policy.test_policy import change_config, random_policy
from tests.policy.test_vectors import STATE, TOP, vector_policy

PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")


def test_lerobot_reads_what_a_policy_sees_and_does(tmp_path):
    vector_policy("all")[0].save(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    assert isinstance(config, DpmacroConfig) and (config.device, config.push_to_hub) == ("cpu", False)
    assert config.input_features[TOP] == PolicyFeature(FeatureType.VISUAL, (3, 8, 10))
    assert config.robot_state_feature == PolicyFeature(FeatureType.STATE, (3,))
    assert config.action_feature == PolicyFeature(FeatureType.ACTION, (3,))
    assert (
        set(config.image_features) == {TOP, TOP.replace("top", "wrist")} and len(config.input_features) == 3
    )


def test_lerobots_files_are_read_by_both(tmp_path):
    policy, shown = vector_policy()
    policy.save(tmp_path / "ours")
    found = DpmacroPolicy.from_pretrained(tmp_path / "ours")
    found.config.license = "mit"
    found.save_pretrained(tmp_path / "theirs")
    assert MacroPolicy.load(tmp_path / "theirs").config == policy.config
    again = DpmacroPolicy.from_pretrained(tmp_path / "theirs")
    assert again.config == found.config
    batch = as_lerobot(shown, range(9))
    assert torch.equal(again.select_action(batch), found.select_action(batch))


def test_the_pipelines_are_those_that_lerobot_would_write(tmp_path):
    vector_policy()[0].save(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    made = make_pre_post_processors(config)
    read = make_pre_post_processors(
        config,
        tmp_path,
        preprocessor_overrides={
            "device_processor": {"device": "cpu"},
            "rename_observations_processor": {"rename_map": {}},
        },
    )
    for folder, pipelines in (("made", made), ("read", read)):
        for name, pipeline in zip(PIPELINES, pipelines, strict=True):
            pipeline.save_pretrained(tmp_path / folder)
            assert json.loads((tmp_path / folder / name).read_text()) == json.loads(
                (tmp_path / name).read_text()
            )


def test_the_pipelines_rename_and_batch_what_a_robot_shows(tmp_path):
    policy, shown = vector_policy("all")
    replace(policy, config=replace(policy.config, tasks=TASKS)).save(tmp_path)
    found = DpmacroPolicy.from_pretrained(tmp_path)
    renamed = {"rename_observations_processor": {"rename_map": {"observation.images.front": TOP}}}
    before, after = make_pre_post_processors(found.config, tmp_path, preprocessor_overrides=renamed)
    batch = as_lerobot(shown, [7])
    one = {key: value[0] for key, value in batch.items()}
    one["observation.images.front"] = one.pop(TOP)
    action = after(found.select_action(before(one)))
    found.reset()
    assert torch.equal(action, found.select_action(batch))


def test_make_policy_takes_the_environments_action(tmp_path):
    walking_policy().save(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path = tmp_path
    assert isinstance(make_policy(config, env_cfg=TwoFlagsEnvConfig()), DpmacroPolicy)
    other = TwoFlagsEnvConfig()
    other.features["action"] = PolicyFeature(FeatureType.ACTION, (4,))
    with pytest.raises(ValueError, match=r"action has the shape \(4,\): the policy acts by \(3,\) or \(1,\)"):
        make_policy(config, env_cfg=other)


def test_a_policy_that_is_not_trained_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"not trained by LeRobot: train one by dpmacro's train\.py"):
        make_policy(DpmacroConfig(), env_cfg=TwoFlagsEnvConfig())
    vector_policy()[0].save(tmp_path)
    bare = DpmacroPolicy(PreTrainedConfig.from_pretrained(tmp_path))
    with pytest.raises(ValueError, match="a config and no numbers"):
        bare.select_action({STATE: torch.zeros(1, 3)})
    for call in (bare.get_optim_params, lambda: bare.forward({}), bare.config.get_optimizer_preset):
        with pytest.raises(ValueError, match="not trained by LeRobot"):
            call()


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (
            lambda folder: change_config(folder, {"macros": 0}),
            "none of this version of dpmacro .*train it again",
        ),
        (lambda folder: change_config(folder, {"later": 1}), "none of this version of dpmacro"),
        (lambda folder: (folder / "model.safetensors").unlink(), r"model\.safetensors cannot be read"),
        (
            lambda folder: (folder / "model.safetensors").write_bytes(b"no"),
            r"model\.safetensors cannot be read",
        ),
        (lambda folder: change_config(folder, {"recovery": True}), "holds no actions of demonstrators"),
    ],
)
def test_files_that_do_not_fit_are_named(tmp_path, harm, message):
    random_policy()[0].save(tmp_path)
    harm(tmp_path)
    with pytest.raises(ValueError, match=message):
        DpmacroPolicy.from_pretrained(tmp_path)
