"""Worlds to demonstrate and act in; importing this registers them with gymnasium."""

from pkgutil import resolve_name

import gymnasium as gym

from dpmacro.worlds.base import Diagnosis, Expert, Recording, SuccessOrFailure

# The environment truncates itself and guards the order of its calls, so it needs none of the wrappers.
gym.register(
    id="TwoFlags-v0",
    entry_point="dpmacro.worlds.two_flags.env:TwoFlagsEnv",
    order_enforce=False,
    disable_env_checker=True,
)

DIAGNOSES = {"TwoFlags-v0": "dpmacro.worlds.two_flags.diagnosis:TwoFlagsDiagnosis"}
"""From a world's gymnasium id to the class of its `Diagnosis`, as gymnasium writes entry points."""

EXPERTS = {"TwoFlags-v0": "dpmacro.worlds.two_flags.teacher:Teacher"}
"""Likewise to the class of its `Expert`, in worlds that have one."""

RECORDINGS = {"TwoFlags-v0": "dpmacro.worlds.two_flags.recording:RECORDING"}
"""Likewise to its `Recording`, in worlds that have an expert."""


def diagnosis_of(world: str) -> Diagnosis:
    """Return what names outcomes and causes in the world of this id; `SuccessOrFailure` for one without."""
    return resolve_name(DIAGNOSES[world])() if world in DIAGNOSES else SuccessOrFailure()


def expert_of(world: str) -> Expert:
    """Return a new expert of the world of this id. Raises ValueError for a world without."""
    if world not in EXPERTS:
        raise ValueError(f"world {world!r} has no teacher: choose among {', '.join(EXPERTS)}")
    return resolve_name(EXPERTS[world])()


def recording_of(world: str) -> Recording:
    """Return what recordings of the world of this id say beside what was seen and done; errors likewise."""
    if world not in RECORDINGS:
        raise ValueError(f"world {world!r} has no teacher: choose among {', '.join(RECORDINGS)}")
    return resolve_name(RECORDINGS[world])
