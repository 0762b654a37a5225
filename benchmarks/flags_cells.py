"""The worlds and planners of `table_flags.py`."""

from dataclasses import dataclass

__all__ = ["PLANNERS", "RECOVERY", "TEACHER", "WORLDS", "World", "title"]

DAGGER_SEED = 20_000
LAYOUTS = 5
TEACHER = "teacher"

PLANNERS = {
    TEACHER: ("teacher", ()),
    "baseline": ("one classifier", ("--planner.type=baseline",)),
    "two": ("2 macro-actions", ("--planner.macros=2",)),
    "four": ("4 macro-actions", ("--planner.macros=4",)),
    "six": ("6 macro-actions", ("--planner.macros=6",)),
    "auto": ("macro-actions by the data, up to 6", ("--planner.macros=auto", "--planner.max_macros=6")),
    "dagger": (
        "2 macro-actions, DAgger",
        ("--planner.macros=2", "--dagger.iterations=5", f"--dagger.seed={DAGGER_SEED}"),
    ),
    "paper-1": ("the paper's recipe, one classifier", ("--planner.recipe=paper", "--planner.macros=1")),
    "paper-2": ("the paper's recipe, 2 macro-actions", ("--planner.recipe=paper", "--planner.macros=2")),
    "paper-4": ("the paper's recipe, 4 macro-actions", ("--planner.recipe=paper", "--planner.macros=4")),
}
SMALL = "--world.render_size=[64,48]"  # as good as larger pictures made smaller, and a third of their time
RECOVERY = "-recovery"  # after a planner's name: the same policy, which breaks out of loops


@dataclass(frozen=True)
class World:
    """A room and its teacher, and who runs there."""

    title: str
    options: tuple[str, ...]
    planners: tuple[str, ...]
    more: tuple[str, ...] = ()  # options of every training


AVENUE = (TEACHER, "baseline", "two", "four", "paper-1", "paper-2", "paper-4")
SEARCHING = (TEACHER, "baseline", "two", "two-recovery", "dagger")
MANY = (TEACHER, "baseline", "two", "four", "four-recovery", "auto", "auto-recovery")
WORLDS = {
    **{
        f"flags-{k}": World(
            f"layout {k}, flags fixed", ("--world.flags=fixed", f"--world.layout_seed={k}"), AVENUE
        )
        for k in range(LAYOUTS)
    },
    **{
        f"still-{k}": World(
            f"layout {k}, textures and start fixed, too",
            (
                "--world.flags=fixed",
                f"--world.layout_seed={k}",
                "--world.textures=fixed",
                "--world.start=fixed",
            ),
            AVENUE,
        )
        for k in range(LAYOUTS)
    },
    "searching": World("the searching teacher, 2 flags", ("--world.teacher=searching",), SEARCHING),
    "four": World(
        "4 flags, clear ways",
        ("--world.id=FourFlags-v0", SMALL),
        MANY,
        ("--planner.max_transitions=3",),
    ),
    "six": World(
        "6 flags, clear ways",
        ("--world.id=SixFlags-v0", SMALL),
        (*MANY, "six", "six-recovery"),
        ("--planner.max_transitions=5",),
    ),
}


def title(planner: str) -> str:
    """A planner's name for people."""
    return PLANNERS[planner.removesuffix(RECOVERY)][0] + ", recovery" * planner.endswith(RECOVERY)
