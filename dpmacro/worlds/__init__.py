"""Worlds to demonstrate and act in; importing this registers them with gymnasium.

Any world that is registered with gymnasium can be run. What the package knows of a world beside that stands
in the tables below, under the world's id, or under a family of ids that begins alike: its name then ends in
"/" or "-". A package that brings a world with an expert of its own adds to these tables when it is imported.
"""

from collections.abc import Mapping
from pkgutil import resolve_name
from typing import Any

import gymnasium as gym

from dpmacro.worlds.base import Diagnosis, Expert, GenericDiagnosis, Recording, WorldError
from dpmacro.worlds.metaworld import FAMILY, TASKS

__all__ = [
    "DEFAULT",
    "DIAGNOSES",
    "EXPERTS",
    "LEROBOT_ENVS",
    "MAKERS",
    "OPTIONS",
    "RECORDINGS",
    "diagnosis_of",
    "entry_of",
    "expert_of",
    "recording_of",
]

DEFAULT = "TwoFlags-v0"
"""The world that runs where nothing names one."""

# The environments truncate themselves and guard the order of their calls, so they need none of the wrappers.
for _count in ("Two", "Four", "Six"):
    gym.register(
        id=f"{_count}Flags-v0",
        entry_point=f"dpmacro.worlds.two_flags.env:{_count}FlagsEnv",
        order_enforce=False,
        disable_env_checker=True,
    )
for _task in TASKS:
    gym.register(
        id=FAMILY + _task,
        entry_point="dpmacro.worlds.metaworld:MetaWorld",
        kwargs={"task": _task},
        order_enforce=False,
        disable_env_checker=True,
    )

for _world, _buttons in (("TwoButtons-v0", True), ("TwoGoals-v0", False)):
    gym.register(
        id=_world,
        entry_point="dpmacro.worlds.two_places:TwoPlaces",
        kwargs={"buttons": _buttons},
        order_enforce=False,
        disable_env_checker=True,
    )

DIAGNOSES = {
    DEFAULT: "dpmacro.worlds.two_flags.diagnosis:TwoFlagsDiagnosis",
    "FourFlags-v0": "dpmacro.worlds.two_flags.diagnosis:FourFlagsDiagnosis",
    "SixFlags-v0": "dpmacro.worlds.two_flags.diagnosis:SixFlagsDiagnosis",
    "TwoButtons-v0": "dpmacro.worlds.two_places:TwoPlacesDiagnosis",
    "TwoGoals-v0": "dpmacro.worlds.two_places:TwoPlacesDiagnosis",
}
"""From a world's gymnasium id to the class of its `Diagnosis`, as gymnasium writes entry points."""

EXPERTS = {
    DEFAULT: "dpmacro.worlds.two_flags.experts:FlagsExpert",
    "FourFlags-v0": "dpmacro.worlds.two_flags.experts:FlagsExpert",
    "SixFlags-v0": "dpmacro.worlds.two_flags.experts:FlagsExpert",
    FAMILY: "dpmacro.worlds.metaworld:ScriptedExpert",
    "BabyAI-": "dpmacro.worlds.babyai:Bot",
    "TwoButtons-v0": "dpmacro.worlds.two_places:Expert",
    "TwoGoals-v0": "dpmacro.worlds.two_places:Expert",
}
"""Likewise to the class of its `Expert`, in worlds that have one."""

RECORDINGS = {
    DEFAULT: "dpmacro.worlds.two_flags.recording:recording",
    "FourFlags-v0": "dpmacro.worlds.two_flags.recording:recording",
    "SixFlags-v0": "dpmacro.worlds.two_flags.recording:recording",
    FAMILY: "dpmacro.worlds.metaworld:recording",
    "BabyAI-": "dpmacro.worlds.babyai:recording",
    "TwoButtons-v0": "dpmacro.worlds.two_places:recording",
    "TwoGoals-v0": "dpmacro.worlds.two_places:recording",
}
"""Likewise to a function from the id to its `Recording`, in worlds that have an expert."""

MAKERS = {"BabyAI-": "dpmacro.worlds.babyai:make"}
"""Likewise to what makes the environment in place of `gymnasium.make`, called as that is."""

OPTIONS = {
    DEFAULT: "dpmacro.worlds.two_flags.options:TwoFlagsConfig.complete",
    "FourFlags-v0": "dpmacro.worlds.two_flags.options:FourFlagsConfig.complete",
    "SixFlags-v0": "dpmacro.worlds.two_flags.options:SixFlagsConfig.complete",
    FAMILY: "dpmacro.worlds.metaworld:complete_options",
}
"""Likewise to a function from some of the world's options, by name, to all of them, checked."""

LEROBOT_ENVS = {DEFAULT: "dpmacro.worlds.two_flags.lerobot_env"}
"""Likewise to the module that registers it as an environment of LeRobot's own programs."""


def entry_of(table: Mapping[str, str], world: str) -> Any:
    """Return what a table holds for the world of this id or, failing that, its family; None for neither."""
    families = sorted((name for name in table if name[-1] in "/-" and world.startswith(name)), key=len)
    known = [name for name in (*families, world) if name in table]
    if not known:
        return None
    try:
        return resolve_name(table[known[-1]])
    except (ImportError, AttributeError, ValueError) as error:
        raise WorldError(
            f"what the tables of dpmacro.worlds hold for {known[-1]}, {table[known[-1]]}, is not there "
            f"({' '.join(str(error).split())}): correct what the package of that world adds to them"
        ) from error


def diagnosis_of(world: str) -> Diagnosis:
    """Return what names outcomes and causes in the world of this id; `GenericDiagnosis` for one without."""
    return (entry_of(DIAGNOSES, world) or GenericDiagnosis)()


def expert_of(world: str) -> Expert:
    """Return a new expert of the world of this id. Raises ValueError for a world without."""
    return _known(EXPERTS, world)()


def recording_of(world: str) -> Recording:
    """Return what recordings of the world of this id say beside what was seen and done; errors likewise."""
    return _known(RECORDINGS, world)(world)


def _known(table: Mapping[str, str], world: str) -> Any:
    found = entry_of(table, world)
    if found is None:
        have = ", ".join(name + "..." * (name[-1] in "/-") for name in table)
        raise ValueError(f"world {world!r} has no teacher: choose among {have}")
    return found
