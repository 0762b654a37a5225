"""Milliseconds that a policy takes for the frames of a batch, against the goal."""

import itertools
import time
from collections.abc import Iterator
from typing import Any

from plan import Plan, settled
from report import Row

__all__ = ["act", "rows"]

MACROS, ROUNDS, SWITCH_ROUNDS = 4, 300, 400
GOALS = {1: 1.0, 64: 5.0}  # milliseconds by batch
CAMERA = "observation.image"
CALLS = 50


def rows(plan: Plan) -> Iterator[Row]:
    """4 macro-actions of 300 random stumps and the 12 switch functions between them."""
    for features in ("rectangles", "pixels"):
        for batch, goal in GOALS.items():
            threads = 1 if batch == 1 else plan.threads
            found = plan.attempt(
                "acting.act",
                dataset=str(plan.dataset),
                features=features,
                batch=batch,
                threads=threads,
                repeats=plan.repeats,
            )
            if found is not None:
                case = f"{found['columns']:,} {features}, batch {batch}, {threads} threads"
                yield Row("acting", case, settled(found["milliseconds"]), "goal", goal, "ms")


def act(dataset: str, features: str, batch: int, threads: int, repeats: int) -> dict[str, Any]:
    """Milliseconds of a call, means over `CALLS`, and the number of columns that the policy computes."""
    import torch

    from dpmacro.data.demonstrations import Demonstrations

    torch.set_num_threads(threads)
    images = torch.from_numpy(Demonstrations.load(dataset, [0]).images)
    policy = _policy(features, images)
    state = policy.initial_state(batch)
    milliseconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        for call in range(CALLS):
            _, state = policy.act({CAMERA: images[call : call + batch]}, state)
        milliseconds.append(1e3 * (time.perf_counter() - start) / CALLS)
    return {"milliseconds": milliseconds, "columns": policy.features.count}


def _policy(kind: str, images: Any) -> Any:
    import torch

    from dpmacro.boosting.learners.stumps import StumpClassifier
    from dpmacro.features.kinds import make_features
    from dpmacro.features.quantising import Quantiser
    from dpmacro.policy.config import InputConfig, PolicyConfig
    from dpmacro.policy.policy import MacroPolicy

    generator = torch.Generator().manual_seed(0)
    height, width = images.shape[1:3]
    features = make_features(kind, height, width, 4096, generator)
    seen = {0: {CAMERA: images[1:]}, 1: {CAMERA: images[:-1]}}
    quantiser = Quantiser.fit(features.values(seen))

    def stumps(rounds: int, problems: int, classes: int) -> StumpClassifier:
        return StumpClassifier(
            torch.randint(features.count, (rounds, problems), generator=generator),
            torch.randint(256, (rounds, problems), generator=generator).to(torch.uint8),
            torch.randn(rounds, problems, 2, classes, generator=generator),
        )

    pairs = tuple(itertools.permutations(range(MACROS), 2))
    config = PolicyConfig(
        "dpboost",
        MACROS,
        (0,),
        {CAMERA: InputConfig(tuple(images.shape[1:]))},
        features.spec(),
        ("a", "b", "c"),
        3,
        switches=pairs,
        thresholds=(0.0,) * len(pairs),
    )
    parts = stumps(ROUNDS, MACROS, 3), stumps(SWITCH_ROUNDS, len(pairs), 1)
    return MacroPolicy.compact(config, features, quantiser, *parts)
