"""Episodes of noise, for tests of what is stored rather than learned, and how tests write datasets."""

import numpy as np

AVATAR = "observation.images.avatar"
WORLD = {"id": "TwoFlags-v0", "flags": "fixed", "layout_seed": 3}
ACTIONS = ("forward", "turn_left", "turn_right")
PHASES = {"phase": ("before blue", "after blue")}
LENGTHS = (12, 7, 2, 9)


def random_episodes(lengths=LENGTHS, seed=0, shape=(48, 64, 3)):
    """Arguments of `as_run`, noise all over."""
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


# The package is imported where it is used: pytest_configure and the checks of shapes come first.
def as_run(images, actions, truth, rewards, success, task, views=None):
    """The `Run` of an episode of one camera."""
    from dpmacro.evaluation.recording import Run

    return Run({AVATAR: images}, actions, truth, rewards, task, views, success)


def told(fps=30, truth=PHASES, actions=ACTIONS):
    """The `Recording` of a dataset of classes."""
    from dpmacro.worlds.base import Recording

    return Recording("", truth, actions, fps)


def write(root, episodes, world=WORLD, **recording):
    """Write episodes, each the arguments of `as_run`, as a dataset; `recording` are arguments of `told`."""
    from dpmacro.evaluation.run_writer import writing_runs

    with writing_runs(root, world, told(**recording)) as writer:
        for episode in episodes:
            writer.add(as_run(**episode))
    return root
