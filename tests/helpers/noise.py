"""Episodes of noise, for tests of what is stored rather than learned."""

import numpy as np

WORLD = {"id": "TwoFlags-v0", "flags": "fixed", "layout_seed": 3}
ACTIONS = ("forward", "turn_left", "turn_right")
PHASES = {"phase": ("before blue", "after blue")}
LENGTHS = (12, 7, 2, 9)


def random_episodes(lengths=LENGTHS, seed=0, shape=(48, 64, 3)):
    """Arguments of `DemonstrationWriter.add_episode`, noise all over."""
    rng = np.random.default_rng(seed)
    for length in lengths:
        yield {
            "images": rng.integers(0, 256, (length, *shape), np.uint8),
            "actions": rng.integers(0, len(ACTIONS), length),
            "truth": {"phase": np.arange(length) // (length // 2 + 1)},
            "rewards": rng.random(length, np.float32),
            "success": True,
            "task": "reach the blue flag, then the red flag",
        }
