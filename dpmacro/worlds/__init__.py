"""Worlds to demonstrate and act in; importing this registers them with gymnasium."""

import gymnasium as gym

# The environment truncates itself and guards the order of its calls, so it needs none of the wrappers.
gym.register(
    id="TwoFlags-v0",
    entry_point="dpmacro.worlds.two_flags.env:TwoFlagsEnv",
    order_enforce=False,
    disable_env_checker=True,
)
