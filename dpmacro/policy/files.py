"""The JSON files beside a policy's numbers, in the form that LeRobot saves its own policies in.

`config.json` holds what LeRobot must know to load a policy of the type `dpmacro`, and under `planner` what
`PolicyConfig` holds. Two more files are LeRobot's pipelines, for what is done before and after a policy acts.
Ours rename observations, make a batch of a single one and move tensors to the policy's device, and no more: a
policy of dpmacro shrinks images and restores the units of actions itself.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dpmacro.policy.config import PolicyConfig, parsed_config
from dpmacro.utils.checks import as_entries, in_a_line, shown
from dpmacro.utils.files import replacing

__all__ = ["ACTION", "CONFIG_NAME", "TYPE", "features_of", "read_config", "write_config", "write_json"]

CONFIG_NAME = "config.json"
TYPE = "dpmacro"  # by which LeRobot finds its classes for a policy
ACTION, ENVIRONMENT_STATE = "action", "observation.environment_state"  # as LeRobot names them
LARGEST = 2**26  # bytes of a config.json: more is none


def features_of(config: PolicyConfig) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, Any]]]:
    """What a policy sees and what it answers with, by key, as LeRobot's `type` and `shape`.

    Images have the size that they have before they are shrunk, channels first. An action of classes is one
    number a class, of which the highest is taken. The task is no feature: LeRobot hands it on in words.
    """
    dims = config.outputs if config.actions is None else len(config.actions.mean)
    inputs: dict[str, dict[str, Any]] = {}
    for key, one in config.inputs.items():
        if one.is_camera:
            height, width = one.stored_shape or one.shape[:2]
            inputs[key] = {"type": "VISUAL", "shape": [3, height, width]}
        elif one.shape:
            inputs[key] = {"type": "ENV" if key == ENVIRONMENT_STATE else "STATE", "shape": list(one.shape)}
    return inputs, {ACTION: {"type": "ACTION", "shape": [dims]}}


def write_config(config: PolicyConfig, folder: Path) -> None:
    """Write config.json and LeRobot's two pipelines into `folder`, each under a temporary name first."""
    inputs, outputs = features_of(config)
    write_json(folder / "policy_preprocessor.json", _pipeline("policy_preprocessor", _BEFORE))
    write_json(folder / "policy_postprocessor.json", _pipeline("policy_postprocessor", _AFTER))
    write_json(
        folder / CONFIG_NAME,
        {
            "type": TYPE,
            "input_features": inputs,
            "output_features": outputs,
            "device": "cpu",
            "push_to_hub": False,
            "planner": asdict(config),
        },
    )


def read_config(path: Path) -> PolicyConfig:
    """The config in a config.json that `write_config` or LeRobot wrote.

    Raises ValueError naming the file where it is none.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError(f"it has more than {LARGEST} bytes")
        values = as_entries("its content", json.loads(path.read_text()), kind=dict)
        # Before LeRobot could load policies, the file held nothing but what now is under `planner`.
        if values.get("type", TYPE) != TYPE and "planner" in values:
            raise ValueError(f"its type is {shown(values['type'])}: give {TYPE}")
        return parsed_config(values.get("planner", values))
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"{path} is no policy of dpmacro, or of an earlier version ({in_a_line(error)}): give a folder "
            "that train.py wrote, or train it again"
        ) from error


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write `values` under a temporary name first."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n")


_DEVICE = {"registry_name": "device_processor", "config": {"device": "cpu", "float_dtype": None}}
_BEFORE = [
    {"registry_name": "rename_observations_processor", "config": {"rename_map": {}}},
    {"registry_name": "to_batch_processor", "config": {}},
    _DEVICE,
]
_AFTER = [_DEVICE]


def _pipeline(name: str, steps: list[dict[str, Any]]) -> dict[str, Any]:
    return {"name": name, "steps": steps}
