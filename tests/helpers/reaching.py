"""A small world of vectors with everything that may go wrong, and a policy for it.

The world's id names this module, so that processes find it: `reaching:Reach-v0`.
"""

import os

import gymnasium as gym
import numpy as np
import torch

from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.data.vectors import ActionTransform
from dpmacro.features.encoders.state import State
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy

WORLD = "reaching:Reach-v0"
STATE = "observation.state"


class Reach(gym.Env):
    """The first number of the state grows by that of the action; beyond `goal` the world is successful.

    What goes wrong does so in the run of every seed from `bad_seed` on, at the step of its number.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012
    observation_space = gym.spaces.Dict({"agent_pos": gym.spaces.Box(-np.inf, np.inf, (3,), np.float64)})
    action_space = gym.spaces.Box(-1, 1, (3,), np.float32)

    def __init__(
        self,
        render_mode=None,
        goal=3.0,
        steps=60,
        key="success",
        ends=True,
        loses_at=None,
        bad_seed=0,
        raise_at=None,
        nan_at=None,
        shape_at=None,
        exit_at=None,
    ):
        self.render_mode, self.goal, self.steps, self.key, self.ends = render_mode, goal, steps, key, ends
        self.loses_at, self.bad_seed = loses_at, bad_seed
        self.raise_at, self.nan_at, self.shape_at, self.exit_at = raise_at, nan_at, shape_at, exit_at

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.bad = seed >= self.bad_seed
        self.place = np.array([self.np_random.uniform(0, 1), 0.0, 1.0])
        self.step_number = 0
        return self._see(), {}

    def step(self, action):
        assert self.action_space.contains(action)
        self.step_number += 1
        if self.bad and self.step_number == self.raise_at:
            raise RuntimeError("the arm\nfell off")
        if self.bad and self.step_number == self.exit_at:
            os._exit(3)
        self.place[0] += action[0]
        success = self.place[0] >= self.goal and not (self.loses_at and self.step_number >= self.loses_at)
        info = {self.key: success} if self.key else {}
        return self._see(), float(success), bool(success and self.ends), self.step_number >= self.steps, info

    def render(self):
        return np.full((24, 32, 3), int(self.place[0]), np.uint8)

    def _see(self):
        place = self.place.copy()
        if self.bad and self.step_number == self.nan_at:
            place[1] = np.nan
        return {"agent_pos": place[:2] if self.bad and self.step_number == self.shape_at else place}


gym.register("Reach-v0", Reach, disable_env_checker=True, order_enforce=False)


def constant_policy(folder, action=(0.5, 0.0, 2.0), size=3, world=None):
    """Save a policy that sees a state of `size` numbers and always gives this vector."""
    encoder = State.make(STATE, tuple("abcdefg"[:size]), 3, 0, torch.Generator())
    stumps = StumpClassifier(
        torch.zeros(1, 1, dtype=torch.int64),
        torch.zeros(1, 1, dtype=torch.uint8),
        torch.full((1, 1, 2, 1), 1e-9),
    )
    names = tuple(f"motor {number}" for number in range(len(action)))
    transform = ActionTransform(
        tuple(action), (1.0,) * len(action), (0,), False, tuple(range(1, len(action))), names
    )
    config = PolicyConfig(
        type="dpboost",
        macros=1,
        starts=(0,),
        inputs={STATE: InputConfig((size,))},
        encoder=encoder.spec(),
        action_names=names,
        outputs=1,
        loss="huber",
        action_transform=transform.to_dict(),
        world={"id": WORLD} if world is None else world,
    )
    quantiser = Quantiser(torch.arange(255).float()[None].repeat(encoder.count, 1))
    MacroPolicy.compact(config, encoder, quantiser, stumps, None).save(folder)
    return folder
