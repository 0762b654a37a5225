"""A policy of random stumps and a segmentation of noise, for tests of what is shown rather than found."""

from pathlib import Path

import numpy as np
import torch

from dpmacro.annotation.annotate import Annotation
from dpmacro.annotation.summary import Summary
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.features.kinds import make_features
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import PolicyConfig
from dpmacro.policy.policy import MacroPolicy

SHAPE = (12, 16)
LENGTHS = np.array([12, 7, 9])
NAMES = ("forward", "turn <left>", "turn right")


def random_policy(kind="rectangles", macros=3, shape=SHAPE, names=NAMES):
    """Five random stumps for every macro-action."""
    generator = torch.Generator().manual_seed(0)
    features = make_features(kind, *shape, 40, generator)
    actor = StumpClassifier(
        torch.randint(features.count, (5, macros), generator=generator),
        torch.randint(256, (5, macros), generator=generator).to(torch.uint8),
        torch.randn(5, macros, 2, len(names), generator=generator),
    )
    config = PolicyConfig("dpboost", macros, (0,), names, shape, kind)
    quantiser = Quantiser(torch.arange(255, dtype=torch.int32).repeat(features.count, 1))
    return MacroPolicy.compact(config, features, quantiser, actor, None)


def random_demonstrations(truth=True):
    """Noise of 28 frames in three demonstrations; half of each is of class 0, the rest of class 1."""
    rng = np.random.default_rng(0)
    phase = np.concatenate([(np.arange(length) >= length // 2).astype(np.int64) for length in LENGTHS])
    return Demonstrations(
        images=rng.integers(0, 256, (28, *SHAPE, 3), np.uint8),
        actions=rng.integers(0, 3, 28),
        lengths=LENGTHS,
        action_names=NAMES,
        fps=30,
        truth=phase if truth else None,
        truth_name="phase" if truth else None,
        truth_classes=("before", "after") if truth else (),
        world={},
        root=Path("data/noise & more"),
    )


def some_summary(truth=True, labels=None, bounds=3, policy=None):
    """The true phases as macro-actions 2 and 0 of three, unless others are given; unsure in the second."""
    demonstrations = random_demonstrations(truth)
    if labels is None:
        labels = np.array([2, 0])[random_demonstrations().truth]
    confidence = np.ones(28, np.float32)
    confidence[12:19] = 0.25
    cost = np.linspace(3, 1, bounds) * LENGTHS[:, None].astype(float)
    sources = {"dataset": "data/noise & more", "policy": "runs/<one>"}
    annotation = Annotation(*map(torch.from_numpy, (labels, confidence, cost)))
    return Summary(policy or random_policy(), demonstrations, annotation, (4, 7, 5), sources)
