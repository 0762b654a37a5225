"""Worlds as options name them, and how they are made.

A world is a mapping {"id": of a world registered with gymnasium, **its own options}, as datasets and policies
keep it. Four more names in it are no options of the world: see `OURS`.
"""

import importlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar

import gymnasium as gym

from dpmacro.worlds import MAKERS, OPTIONS, entry_of
from dpmacro.worlds.base import GaveUp, WorldError

__all__ = ["OURS", "WorldOptions", "blamed", "brief", "complete", "import_package", "make_world"]

OURS = ("id", "import", "observations", "success")
"""What a world's mapping may hold beside its own options.

`import` is a package that registers it, `observations` holds the world's names by LeRobot's keys, and
`success` says what tells success, as `dpmacro.worlds.success.SuccessRule` reads it.
"""


@dataclass(frozen=True)
class WorldOptions:
    """The world; what is not listed below, like --world.max_steps=300, is an option of the world's own."""

    OTHERS: ClassVar[str] = "options"  # of `utils.cli`: the field for options that are not listed

    id: str | None = None
    """Gymnasium id of the world; by default that of the policy's demonstrations, or the package's own."""
    import_: str | None = None
    """Package that registers the world with gymnasium when it is imported."""
    observations: list[str] | None = None
    """The world's own names of what is seen, by LeRobot's keys, like '[observation.state=arm]'."""
    success: str | float | None = None
    """What tells success, a key of the world's info or a sum of rewards; by default what the world has."""
    options: dict[str, Any] = field(default_factory=dict)
    """Keyword arguments of the world, each by its own name, like --world.max_steps=300."""

    def __post_init__(self) -> None:
        for pair in self.observations or ():
            key, _, name = str(pair).partition("=")
            if not key or not name:
                raise ValueError(
                    f"--world.observations has {pair!r}: give LeRobot's key and the world's name, like "
                    "'[observation.state=arm]'"
                )
        taken = sorted(set(self.options) & set(OURS))
        if taken:
            raise ValueError(f"--world.options has {taken[0]!r}: give it as --world.{taken[0]}=")

    def over(self, world: Mapping[str, Any]) -> dict[str, Any]:
        """The world that these options make of another: its own where they name no other, else theirs."""
        if self.id is not None and self.id != world.get("id"):
            world = {"id": self.id}
        given = {
            "import": self.import_,
            "observations": None
            if self.observations is None
            else dict(pair.split("=", 1) for pair in self.observations),
            "success": self.success,
        }
        ours = {name: value for name, value in given.items() if value is not None}
        return {**world, **ours, **self.options}


def import_package(world: Mapping[str, Any]) -> None:
    """Import the package that registers the world, where it names one. Raises WorldError where it cannot."""
    package = world.get("import")
    if package is None:
        return
    if not isinstance(package, str) or not all(part.isidentifier() for part in package.split(".")):
        raise WorldError(f"--world.import={package} is no package's name: give one, like gym_pusht")
    try:
        importlib.import_module(package)
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # a stranger's package may raise anything, and end the process
        raise WorldError(
            f"--world.import={package} cannot be imported ({brief(error)}): install it, or correct its name"
        ) from error


def complete(world: Mapping[str, Any]) -> dict[str, Any]:
    """The world with all of its options, checked, where it tells them. Raises ValueError for unfit ones."""
    import_package(world)
    of_world = entry_of(OPTIONS, world["id"])
    if of_world is None:
        return dict(world)
    ours = {name: value for name, value in world.items() if name in OURS}
    return ours | of_world({name: value for name, value in world.items() if name not in OURS})


def make_world(world: Mapping[str, Any], render_mode: str | None = None) -> gym.Env:
    """The environment. Raises ValueError where there is none of this id, or it takes other options."""
    import_package(world)
    name = world["id"]
    options = {key: value for key, value in world.items() if key not in OURS}
    if render_mode is not None:
        options["render_mode"] = render_mode
    maker = entry_of(MAKERS, name)
    try:
        # What is seen and done is checked in every step anyway.
        return maker(name, **options) if maker else gym.make(name, disable_env_checker=True, **options)
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # a stranger's world may raise anything, and end the process
        if isinstance(error, ValueError) and (maker or entry_of(OPTIONS, name)):  # ours, which name a remedy
            raise
        if name.rpartition(":")[2] not in gym.registry:
            remedy = "or name the package that registers it by --world.import="
            if world.get("import"):
                remedy = f"since --world.import={world['import']} registers none of this name"
            raise WorldError(
                f"there is no world {name!r} ({brief(error)}): correct --world.id, {remedy}"
            ) from error
        raise WorldError(
            f"the world {name} cannot be made with {options} ({brief(error)}): correct its options, "
            "--world.<option>="
        ) from error


@contextmanager
def blamed(world: str, when: str, who: str = "the world") -> Iterator[None]:
    """What a world raises within becomes a WorldError: its code is not ours, and may raise anything.

    Args:
        world: its id.
        when: at which step of which run, in words.
        who: what of it is run.

    `GaveUp`, Ctrl-C and signals pass.
    """
    try:
        yield
    except (GaveUp, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # `sys.exit`, too, ends the run alone
        raise WorldError(
            f"{who} {world} raised {brief(error)}, {when}: correct the world or its options"
        ) from error


def brief(error: BaseException) -> str:
    """The error in a line: its kind, and what it says."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # its text is a stranger's code, too
        text = ""
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
