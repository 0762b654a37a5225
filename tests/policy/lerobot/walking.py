"""A policy made by hand that walks to the blue flag and then to the red one where nothing is in its way."""

import torch

from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.features.encoders.rectangles import CHANNEL_NAMES, Rectangles
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.worlds.two_flags.env import ACTIONS

KEY = "observation.images.avatar"
# A small room, where one of the runs of seeds 60 to 69 succeeds in 198 steps, and another fails after 47.
WORLD = {"flags": "fixed", "layout_seed": 1004, "yaw_noise": 0.0, "render_size": [64, 48], "max_steps": 200}
BLUE, RED = (CHANNEL_NAMES.index(name) for name in ("2B - R - G", "R - G"))
# Channel, top, left, height and width of a box, and its sum above which there is a flag.
COLUMNS = (
    (BLUE, 12, 30, 20, 4, 5000),
    (RED, 12, 30, 20, 4, 5000),
    (BLUE, 0, 0, 48, 64, 300_000),
    (BLUE, 12, 16, 20, 4, 5000),
)
NEVER = 2**30


def stumps(rows):
    """(column, level that is not above, vote below, vote above) of every round and problem."""
    columns, levels, low, high = zip(*(zip(*row, strict=True) for row in rows), strict=True)
    votes = torch.stack([torch.tensor(low), torch.tensor(high)], 2).float()
    return StumpClassifier(torch.tensor(columns), torch.tensor(levels).to(torch.uint8), votes)


def walking_policy(walks=True):
    """The policy; one that does not walk turns left for ever."""
    boxes = torch.tensor([column[:5] for column in COLUMNS], dtype=torch.int32)
    nothing = boxes.clone()
    nothing[:, 3:] = 0
    features = Rectangles(KEY, 48, 64, boxes, nothing)
    cuts = torch.full((len(COLUMNS), 255), NEVER, dtype=torch.int32)
    for row, column in zip(cuts, COLUMNS, strict=True):
        row[0] = column[5]
    forward, left, neither = [float(walks), 0.0, -1.0], [0.0, 0.5, -1.0], [0.0, 0.0, 0.0]
    # To the blue flag; past its left side as long as it is close, which touches it; then to the red one.
    past = [3.0, 0.0, 0.0]
    rounds = [
        [(0, 0, left, forward), (1, 0, left, forward)],
        [(0, 0, neither, neither), (2, 0, neither, past)],
        [(0, 0, neither, neither), (3, 0, neither, [0.0, 9.0, 0.0])],
    ]
    actor = stumps(rounds)
    switcher = stumps([[(2, 0, [0.0], [1.0])]])
    config = PolicyConfig(
        type="dpboost",
        macros=2,
        starts=(0,),
        inputs={KEY: InputConfig((48, 64, 3))},
        encoder=features.spec(),
        action_names=ACTIONS,
        outputs=3,
        switches=((0, 1),),
        thresholds=(0.5,),
        world={"id": "TwoFlags-v0", **WORLD},
    )
    return MacroPolicy(config, features, Quantiser(cuts), actor, switcher)
