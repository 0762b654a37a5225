"""Trainings on datasets of vectors: files in, one segmentation everywhere, a policy that acts."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot_files import CAMERA, build
from safetensors.torch import load_file

from dpmacro import Demonstrations, MacroPolicy, annotate
from dpmacro.segmentation.segments import follows_chain
from dpmacro.utils import cli

SCRIPT = Path(__file__).parents[2] / "train.py"
LENGTHS = (24, 30, 26, 22)
TINY = ["--planner.rounds=6", "--planner.restarts=4", "--planner.switch_rounds=10", "--planner.rectangles=30"]


def train(*options):
    spec = importlib.util.spec_from_file_location("train_script", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["train.py", *map(str, options)])
        cli.run(module.main, module.TrainOptions)


def dataset(root, images):
    """An arm that goes one way, then the other; the third number of the action never changes."""
    rng = np.random.default_rng(0)
    state, action = [], []
    for length in LENGTHS:
        late = np.arange(length) >= length // 2
        place = np.cumsum(np.where(late, -1, 1) + 0.1 * rng.standard_normal(length))
        state.append(np.stack([place, rng.standard_normal(length)], 1))
        action.append(
            np.stack([np.where(late, -1, 1) * (1 + 0.1 * place), 0.1 * place, np.full(length, 4.0)], 1)
        )
    columns = {
        "observation.state": np.concatenate(state).astype(np.float32),
        "action": np.concatenate(action).astype(np.float32),
    }
    return build(root, columns, lengths=LENGTHS, images=images)


@pytest.mark.parametrize(("images", "order"), [(False, "chain"), (True, "free")])
def test_a_dataset_of_vectors_from_files_to_a_policy(tmp_path, capsys, images, order):
    root = dataset(tmp_path / "data", images)
    run = tmp_path / "run"
    train(f"--dataset.root={root}", f"--output_dir={run}", f"--planner.order={order}", *TINY)
    printed = capsys.readouterr().out
    assert "constant and left out of the actions: z (4)" in printed
    assert (
        "sees" in printed or "inputs" in printed or "observation.state" in printed
    ) and "policy" in printed
    policy = MacroPolicy.load(run / "checkpoints/last/pretrained_model")
    keys = {"observation.state", CAMERA} if images else {"observation.state"}
    assert set(policy.config.inputs) == keys and policy.config.outputs == 2 and policy.config.vector
    inputs, transform = list(policy.config.inputs), policy.config.image_transform
    demonstrations = Demonstrations.load(root, inputs=inputs, transform=transform)
    saved = load_file(run / "checkpoints/last/training_state/segmentation.safetensors")
    assert torch.equal(annotate(policy, demonstrations).labels, saved["labels"])
    if order == "chain":
        assert follows_chain(saved["labels"], torch.tensor(LENGTHS), 2)
    planner = policy.planner()
    planner.reset()
    seen = {key: values[0] for key, values in demonstrations.observations.items()}
    action = planner.act(seen, {})
    assert action.shape == (3,) and action[2] == pytest.approx(4.0)


def test_the_order_of_stages_is_asked_of_the_data(tmp_path, capsys):
    root, run = dataset(tmp_path / "data", False), tmp_path / "run"
    auto = ["--planner.order=auto", "--planner.macros=auto", "--planner.max_macros=2"]
    train(f"--dataset.root={root}", f"--output_dir={run}", *auto, *TINY)
    printed = capsys.readouterr().out
    assert "order chain: with 2 stages in one order for all demonstrations linear models leave" in printed
    assert "Q=2 S=1" in printed and "S=2" not in printed, "a chain has one number of changes"
    assert MacroPolicy.load(run / "checkpoints/last/pretrained_model").config.order == "chain"
    bound = ["--planner.order=auto", "--planner.max_transitions=2", *TINY]
    train(f"--dataset.root={root}", f"--output_dir={tmp_path / 'bound'}", *bound)
    policy = MacroPolicy.load(tmp_path / "bound/checkpoints/last/pretrained_model")
    assert policy.config.order == "free", "a number of changes that a chain has not was asked for"


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--planner.recovery=true", "planner.recovery replays discrete actions"),
        ("--planner.learner=convnet", "networks look at one camera"),
        ("--dataset.symmetric=true", "observation.state has no mirror image"),
        ("--dataset.action_relative=true", "action_relative is true, but beside actions of 3 numbers"),
        (
            "--dataset.action_relative=often",
            "dataset.action_relative is 'often': choose one of auto, true, false",
        ),
        ("--planner.order=line", "planner.order is 'line': choose one of free, chain, auto"),
        ("--dataset.inputs=[observation.pose]", "no input 'observation.pose'"),
        ("--dataset.action=[torque]", "torque"),
        ("--planner.macros=23", "frames"),
    ],
)
def test_what_vectors_do_not_allow_is_one_line(tmp_path, capsys, option, message):
    root = dataset(tmp_path / "data", False)
    chain = ["--planner.order=chain"] if "macros" in option else []
    with pytest.raises(SystemExit) as caught:
        train(f"--dataset.root={root}", f"--output_dir={tmp_path / 'run'}", option, *chain, *TINY)
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert caught.value.code == 2 and said.startswith("error: ") and message in said
    assert not (tmp_path / "run/checkpoints").exists()
