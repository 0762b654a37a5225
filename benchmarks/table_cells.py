"""The cells of Table I: what each planner is, the demonstrations it learns from, the worlds it is tested in.

Worlds by seed: training seed k learns from 1000 k on, validation has 5000 on, test 10000 on, DAgger
20000 + 1000 k on, and 40000 to 40099 are fresh: no decision on the method was taken by them. One rule for
every planner: nothing is chosen by planner, cell or test world.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

from dpmacro.worlds.two_flags.env import PIXELS, TwoFlagsConfig

__all__ = [
    "DAGGER_WORLDS",
    "DEFAULT_SIZE",
    "FLAGS",
    "FRESH",
    "PAPER_SIZE",
    "PARTS",
    "PLANNERS",
    "SEED_WORLDS",
    "SWEEP",
    "TEACHER",
    "TEST",
    "TRAIN_SEEDS",
    "WORLDS",
    "Cell",
    "Key",
    "cells",
    "demonstrations_needed",
]

FLAGS = ("random", "fixed")
TEACHER = "teacher"
PARTS = ("main", "curve", "paper")
TEST = "test"
FRESH = "fresh"
DAGGER_WORLDS = 20_000
WORLDS = {TEST: range(10_000, DAGGER_WORLDS), FRESH: range(40_000, 40_100)}  # those that planners run in
SEED_WORLDS = 1_000  # of a training seed
TRAIN_SEEDS = range(5)  # beyond them lie the validation worlds
DEFAULT_SIZE: tuple[int, int] = TwoFlagsConfig().render_size
PAPER_SIZE = (320, 240)
SWEEP = 100  # runs of a point of the learning curve, and of the paper's rendering

Key = tuple[str, str, int, int | None, tuple[int, int]]


@dataclass(frozen=True)
class Planner:
    """A row of the table.

    Attributes:
        title: for people.
        options: of train.py; "{worlds}" stands for the first of DAgger's worlds. The teacher has none.
        policy: the planner whose trained policy it runs, where that is another's; it has no `options` then.
        run_options: of eval.py, beside the policy.
        flags: of its cells in the main table.
        slow: to train, so that it has no cell in a quick table.
        once: whether it has a cell of the first training seed alone.
        swept: whether it is on the learning curve and in the paper's rendering, too.
        paper: flags -> the paper's success rate in percent, where known.
    """

    title: str
    options: tuple[str, ...]
    policy: str | None = None
    run_options: tuple[str, ...] = ()
    flags: tuple[str, ...] = FLAGS
    slow: bool = False
    once: bool = False
    swept: bool = True
    paper: Mapping[str, int] = field(default_factory=dict)


FAST = ("--planner.reuse=5",)  # several times faster, as accurate (docs/speed.md)
TWO = (*FAST, "--planner.macros=2")
DAGGER = ("--dagger.iterations=5", "--dagger.seed={worlds}")
PLANNERS = {
    TEACHER: Planner("teacher", (), swept=False, paper={"random": 72}),
    "baseline": Planner("baseline, one classifier", (*FAST, "--planner.type=baseline"), paper={"fixed": 92}),
    "dpboost-2": Planner("DPBoost, 2 macro-actions", TWO, paper={"fixed": 92}),
    "dpboost-2-recovery": Planner(
        "DPBoost, 2 macro-actions, recovery",
        (),
        policy="dpboost-2",
        run_options=("--policy.recovery=true",),
        swept=False,
    ),
    # Not swept: most of its policies are those of dpboost-2.
    "dpboost-4": Planner(
        "DPBoost, 4 macro-actions", (*FAST, "--planner.macros=4"), swept=False, paper={"fixed": 68}
    ),
    "dpboost-2-dagger": Planner(
        "DPBoost, 2 macro-actions, DAgger",
        (*TWO, *DAGGER),
        flags=("random",),
        slow=True,
        once=True,
        swept=False,
    ),
    # Without FAST: it searches in every round, as the paper does.
    "paper": Planner(
        "the paper's recipe, 2 macro-actions",
        ("--planner.recipe=paper", "--planner.macros=2"),
        slow=True,
        swept=False,
    ),
}


@dataclass(frozen=True)
class Cell:
    """One planner, trained once, in worlds of one role, the first of them.

    The teacher has 0 demonstrations and no training seed.
    """

    flags: str
    planner: str
    demonstrations: int
    train_seed: int | None
    episodes: int
    render_size: tuple[int, int] = DEFAULT_SIZE
    role: str = TEST

    @property
    def key(self) -> Key:
        """What tells the cells of a table apart: all but its worlds."""
        return self.flags, self.planner, self.demonstrations, self.train_seed, self.render_size

    @property
    def name(self) -> str:
        """For people, such as random_0_dpboost-2_20."""
        if self.train_seed is None:
            return f"{self.flags}_{self.planner}"
        return f"{self.flags}_{self.train_seed}_{self.planner}_{self.demonstrations}{self._size}"

    @property
    def policy(self) -> str:
        """The name of the cell that trains what it runs, most often its own; of folders, too."""
        return replace(self, planner=self._trained).name

    @property
    def data(self) -> str:
        """Of its dataset, which planners share, such as random_0."""
        return f"{self.flags}_{self.train_seed}{self._size}"

    @property
    def _trained(self) -> str:
        return PLANNERS[self.planner].policy or self.planner

    @property
    def _size(self) -> str:
        return "" if self.render_size == DEFAULT_SIZE else "_{}x{}".format(*self.render_size)

    @property
    def worlds(self) -> range:
        """Seeds of the worlds it is tested in."""
        return WORLDS[self.role][: self.episodes]

    @property
    def record_options(self) -> list[str]:
        """Of datasets/record.py, without folder and number of demonstrations."""
        assert self.train_seed is not None, "the teacher learns from nothing"
        width, height = self.render_size
        return [
            f"--seed={SEED_WORLDS * self.train_seed}",
            f"--world.flags={self.flags}",
            f"--world.render_size=[{width},{height}]",
        ]

    @property
    def train_options(self) -> list[str]:
        """Of train.py, without folders."""
        assert self.train_seed is not None, "the teacher is not trained"
        worlds = DAGGER_WORLDS + SEED_WORLDS * self.train_seed
        return [
            *(option.format(worlds=worlds) for option in PLANNERS[self._trained].options),
            f"--dataset.episodes=[{','.join(map(str, range(self.demonstrations)))}]",
            f"--seed={self.train_seed}",
        ]


def cells(
    parts: Iterable[str],
    flags: Sequence[str],
    planners: Sequence[str],
    train_seeds: Sequence[int],
    demonstrations: int,
    curve: Sequence[int],
    episodes: int,
) -> list[Cell]:
    """The cells of the parts asked for, each once: the teacher's, the main table's by seed, the others.

    Args:
        parts: of `PARTS`. "curve" and "paper", with random flags and the first training seed, have at most
            100 episodes and share cells with "main".
        flags, planners, train_seeds: which there are.
        demonstrations: of every planner in "main" and "paper".
        curve: numbers of demonstrations in "curve".
        episodes: of every cell.
    """
    learned = [name for name in planners if name != TEACHER]
    swept = [name for name in learned if PLANNERS[name].swept]
    few, first = min(episodes, SWEEP), train_seeds[0]
    found: list[Cell] = []
    if TEACHER in planners:
        # It sees positions, not pixels: the smallest picture gives the same runs sooner.
        found += [Cell(where, TEACHER, 0, None, episodes, PIXELS) for where in flags if "main" in parts]
        found += [Cell("random", TEACHER, 0, None, few, PIXELS)] if "curve" in parts else []
    if "main" in parts:
        found += [
            Cell(where, name, demonstrations, seed, episodes)
            for seed, where, name in product(train_seeds, flags, learned)
            if where in PLANNERS[name].flags and (seed == first or not PLANNERS[name].once)
        ]
    if "curve" in parts:
        found += [Cell("random", name, count, first, few) for count, name in product(curve, swept)]
    if "paper" in parts:
        found += [
            Cell("random", name, demonstrations, first, few, size)
            for name, size in product(swept, (DEFAULT_SIZE, PAPER_SIZE))
        ]
    unique: dict[Key, Cell] = {}
    for cell in found:  # the main table's, which have the most episodes, come first
        unique.setdefault(cell.key, cell)
    return list(unique.values())


def demonstrations_needed(plan: Iterable[Cell]) -> dict[str, int]:
    """Dataset -> the most demonstrations that a cell learns from."""
    needed: dict[str, int] = {}
    for cell in plan:
        if cell.train_seed is not None:
            needed[cell.data] = max(needed.get(cell.data, 0), cell.demonstrations)
    return needed
