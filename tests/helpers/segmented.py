"""A policy of random stumps and a segmentation of noise, for tests of what is shown rather than found."""

from pathlib import Path

import numpy as np
import torch

from dpmacro.annotation.annotate import Annotation
from dpmacro.annotation.summary import Summary
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.vectors import ActionTransform
from dpmacro.features.kinds import CameraSpec, StateSpec, TaskSpec, make_encoder
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy

SHAPE = (12, 16)
LENGTHS = np.array([12, 7, 9])
NAMES = ("forward", "turn <left>", "turn right")
IMAGE, FRONT, TOP = "observation.image", "observation.images.front", "observation.images.top"
STATE, TASK = "observation.state", "task_index"
CAMERAS = {IMAGE: SHAPE, FRONT: SHAPE, TOP: (10, 8)}
JOINTS = ("shoulder", "elbow", "wrist", "gripper.pos")
VECTOR = ("dx", "dy", "gripper", "never moves")


def random_policy(kind="rectangles", macros=3, shape=SHAPE, names=NAMES, keys=(IMAGE,), vector=False):
    """Five random stumps for every macro-action; `shape` is that of a camera that has none in `CAMERAS`."""
    generator = torch.Generator().manual_seed(0)
    specs = {key: CameraSpec(*CAMERAS.get(key, shape)) for key in keys if key.startswith(IMAGE)}
    specs |= {key: StateSpec(JOINTS) for key in keys if key == STATE}
    specs |= {key: TaskSpec(2) for key in keys if key == TASK}
    features = make_encoder(specs, kind, 40, 5, 6, generator)
    transform, outputs = None, len(names)
    if vector:
        actions = random_demonstrations(keys=keys, vector=True).actions
        names, transform = VECTOR, ActionTransform.fit(actions, LENGTHS, names=VECTOR)
        outputs = len(transform.kept)
    actor = StumpClassifier(
        torch.randint(features.count, (5, macros), generator=generator),
        torch.randint(256, (5, macros), generator=generator).to(torch.uint8),
        torch.randn(5, macros, 2, outputs, generator=generator),
    )
    config = PolicyConfig(
        type="dpboost",
        macros=macros,
        starts=(0,),
        inputs={key: InputConfig(_shape(specs[key])) for key in keys},
        encoder=features.spec(),
        action_names=names,
        outputs=outputs,
        loss="huber" if vector else "exponential",
        action_transform=transform.to_dict() if transform else None,
    )
    quantiser = Quantiser(torch.arange(255, dtype=features.dtype).repeat(features.count, 1))
    return MacroPolicy.compact(config, features, quantiser, actor, None)


def random_demonstrations(truth=True, keys=(IMAGE,), vector=False):
    """Noise of 28 frames in three demonstrations; half of each is of class 0, the rest of class 1.

    Vectors are noise beside a gripper, which is closed in class 1 alone, and a number that never moves.
    """
    rng = np.random.default_rng(0)
    phase = np.concatenate([(np.arange(length) >= length // 2).astype(np.int64) for length in LENGTHS])
    actions = rng.integers(0, 3, 28)
    if vector:
        still = np.full(28, 0.5)
        actions = np.column_stack([rng.normal(size=(28, 2)), 90 - 80 * phase, still]).astype(np.float32)
    return Demonstrations(
        {key: _noise(key, rng) for key in keys},
        actions=actions,
        lengths=LENGTHS,
        action_names=VECTOR if vector else NAMES,
        fps=30.0,
        truth=phase if truth else None,
        truth_name="phase" if truth else None,
        truth_classes=("before", "after") if truth else (),
        world={},
        root=Path("data/noise & more"),
        state_names={STATE: JOINTS} if STATE in keys else {},
        tasks=("pick", "place") if TASK in keys else (),
    )


def some_summary(truth=True, labels=None, bounds=3, policy=None, keys=(IMAGE,), vector=False):
    """The true phases as macro-actions 2 and 0 of three, unless others are given; unsure in the second."""
    demonstrations = random_demonstrations(truth, keys, vector)
    if labels is None:
        labels = np.array([2, 0])[random_demonstrations().truth]
    confidence = np.ones(28, np.float32)
    confidence[12:19] = 0.25
    cost = np.linspace(3, 1, bounds) * LENGTHS[:, None].astype(float)
    sources = {"dataset": "data/noise & more", "policy": "runs/<one>"}
    annotation = Annotation(*map(torch.from_numpy, (labels, confidence, cost)))
    policy = policy or random_policy(keys=keys, vector=vector)
    return Summary(policy, demonstrations, annotation, (4, 7, 5), sources)


def _noise(key, rng):
    if key in CAMERAS:
        return rng.integers(0, 256, (28, *CAMERAS[key], 3), np.uint8)
    return rng.normal(size=(28, 4)).astype(np.float32) if key == STATE else rng.integers(0, 2, 28)


def _shape(spec):
    if isinstance(spec, CameraSpec):
        return spec.height, spec.width, 3
    return (len(spec.dimensions),) if isinstance(spec, StateSpec) else ()
