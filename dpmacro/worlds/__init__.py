"""Worlds to demonstrate and act in; importing this registers them with gymnasium."""

from pkgutil import resolve_name

import gymnasium as gym

from dpmacro.worlds.base import Diagnosis, SuccessOrFailure

# The environment truncates itself and guards the order of its calls, so it needs none of the wrappers.
gym.register(
    id="TwoFlags-v0",
    entry_point="dpmacro.worlds.two_flags.env:TwoFlagsEnv",
    order_enforce=False,
    disable_env_checker=True,
)

DIAGNOSES = {"TwoFlags-v0": "dpmacro.worlds.two_flags.diagnosis:TwoFlagsDiagnosis"}
"""From a world's gymnasium id to the class of its `Diagnosis`, as gymnasium writes entry points."""


def diagnosis_of(world: str) -> Diagnosis:
    """Return what names outcomes and causes in the world of this id; `SuccessOrFailure` for one without."""
    return resolve_name(DIAGNOSES[world])() if world in DIAGNOSES else SuccessOrFailure()
