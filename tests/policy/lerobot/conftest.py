"""Policies as LeRobot loads them, and observations as it hands them on."""

import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.factory import get_policy_class

import dpmacro.policy.lerobot  # noqa: F401  registers the policy

TASKS = ("stack the blocks", "sort the blocks")
PIXELS = "observation.images."


@pytest.fixture
def loaded(tmp_path):
    """From a policy to what LeRobot makes of its files, with options of its config changed."""

    def load(policy, **options):
        folder = tmp_path / "pretrained_model"
        policy.save(folder)
        config = PreTrainedConfig.from_pretrained(folder)
        for name, value in options.items():
            setattr(config, name, value)
        return get_policy_class("dpmacro").from_pretrained(folder, config=config)

    return load


def as_lerobot(shown, rows):
    """The observations that `shown` holds at `rows`, one an environment, after LeRobot's own conversion."""
    rows = torch.as_tensor(rows)
    raw = {"pixels": {}}
    for key, values in shown.items():
        if key.startswith(PIXELS):
            raw["pixels"][key.removeprefix(PIXELS)] = values[rows].numpy()
        elif key == "observation.state":
            raw["agent_pos"] = values[rows].numpy()
    if "observation.image" in shown:
        raw["pixels"] = shown["observation.image"][rows].numpy()
    batch = preprocess_observation({name: value for name, value in raw.items() if len(value)})
    return {
        **batch,
        "task": [TASKS[int(shown["task_index"][row])] if "task_index" in shown else "" for row in rows],
    }
