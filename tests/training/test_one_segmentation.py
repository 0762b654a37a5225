"""One set of labels: what a training reports, saves, and what its policy says of the same demonstrations."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from noise import write
from safetensors.torch import load_file

import dpmacro.worlds  # noqa: F401  registers the world
from dpmacro.annotation.annotate import annotate
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.synthetic import digits
from dpmacro.evaluation.recording import run_expert
from dpmacro.policy.policy import MacroPolicy
from dpmacro.segmentation.segments import transition_counts
from dpmacro.training import trainer as training
from dpmacro.training.options import DatasetOptions, PlannerOptions, TrainOptions
from dpmacro.training.run_folder import RunFolder
from dpmacro.worlds.babyai import ACTIONS as MOVES
from dpmacro.worlds.two_flags.teacher import Teacher

SMALL = {"rounds": 20, "restarts": 1, "rectangles": 150, "switch_rounds": 20, "shrinkage": 0.3}


def lit_digits(folder):
    """Pictures of digits; a corner is lit where the rule changes by which action 1 is said of them.

    Another is lit where a sequence starts with the second rule.
    """
    data = digits(2, 0, segments=24, trajectories=18)
    images = np.repeat((data.features * 15).reshape(-1, 8, 8, 1), 3, axis=3)
    for change in np.flatnonzero(np.diff(data.truth)) + 1:
        images[change : change + 3, :2, :2] = 255
    for start in np.cumsum(data.lengths) - data.lengths:
        images[start : start + 3, -2:, -2:] = 255 * data.truth[start]
    names = ("no", "yes")
    return Demonstrations.of_images(
        images, data.actions, data.lengths, names, 10, data.truth, {}, folder, "rule"
    )


def two_flags(folder):
    """Two of the teacher's runs, every eighth frame, recorded and read."""
    world = {"id": "TwoFlags-v0", "render_size": (64, 48)}
    env, teacher = gym.make(**world), Teacher()

    def runs():
        for seed in (2, 3):
            observation, info = env.reset(seed=seed)
            teacher.reset(env)
            rows, ended = [], False
            while not ended:
                action, seen, phase = teacher.act(observation, info), observation["pixels"], info["phase"]
                observation, reward, terminated, truncated, info = env.step(action)
                rows.append((seen, action, phase, reward))
                ended = terminated or truncated
            images, actions, phases, rewards = (np.array(part) for part in zip(*rows[::8], strict=True))
            yield {
                "images": images,
                "actions": actions.astype(np.int64),
                "truth": {"phase": phases.astype(np.int64)},
                "rewards": rewards.astype(np.float32),
                "success": True,
                "task": "",
            }

    return Demonstrations.load(write(folder, runs(), world, fps=10))


def babyai(folder):
    """Runs of the bot that opens a door: walking to the door, and what comes with the key."""
    pytest.importorskip("minigrid")
    world = {"id": "BabyAI-UnlockLocal-v0", "tile": 4}
    runs = [run for run in (run_expert(world, seed) for seed in range(10)) if run]
    images = np.concatenate([run.observations["observation.images.avatar"] for run in runs])
    actions = np.concatenate([run.actions for run in runs])
    return Demonstrations.of_images(
        images, actions, np.array([len(run.actions) for run in runs]), MOVES, 10, None, {}, folder
    )


@pytest.mark.parametrize(
    ("make", "options", "known"),
    [
        (lit_digits, {"max_transitions": 4}, True),
        (lit_digits, {"max_transitions": 4, "recipe": "paper", "shrinkage": 0.1}, False),
        (two_flags, {}, False),
        (babyai, {}, False),
    ],
    ids=["digits", "digits, paper", "two flags", "babyai"],
)
def test_reported_saved_and_annotated_labels_are_the_same(make, options, known, tmp_path, monkeypatch):
    monkeypatch.setattr(training.TrainingPictures, "show", lambda *given: None)
    demonstrations = make(Path(tmp_path / "data"))
    start = torch.from_numpy(demonstrations.truth) if known else None
    given = TrainOptions(DatasetOptions(root=demonstrations.root), PlannerOptions(**{**SMALL, **options}))
    result = training.Trainer(demonstrations, given, RunFolder(tmp_path / "run")).train(start)
    labels, config = result.found.labels, result.policy.config
    lengths = torch.from_numpy(demonstrations.lengths)
    assert labels.unique().tolist() == [0, 1]
    assert 0 < int(transition_counts(labels, lengths).max()) <= config.max_transitions
    saved = load_file(tmp_path / "run/checkpoints/last/training_state/segmentation.safetensors")
    assert torch.equal(saved["labels"], labels)
    for policy in (result.policy, MacroPolicy.load(result.pretrained)):
        assert torch.equal(annotate(policy, demonstrations).labels, labels)
    if known:
        assert config.switch_weight == 1.0 and config.starts == (0, 1), "switch functions have their say"
