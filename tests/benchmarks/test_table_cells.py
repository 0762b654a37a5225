"""The plan of Table I: every cell once, and no world in two roles."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

from table_cells import (  # noqa: E402
    FLAGS,
    PARTS,
    PLANNERS,
    TEACHER,
    TRAIN_SEEDS,
    WORLDS,
    Cell,
    cells,
    demonstrations_needed,
)

from dpmacro.training.dagger_options import DaggerOptions  # noqa: E402
from dpmacro.training.options import TrainOptions  # noqa: E402
from dpmacro.utils import cli  # noqa: E402

CURVE = [5, 20, 100]


def plan(parts=PARTS, flags=FLAGS, planners=tuple(PLANNERS), seeds=(0, 1, 2), episodes=200):
    return cells(parts, flags, planners, seeds, 20, CURVE, episodes)


def of(found, **wanted):
    return [cell for cell in found if all(getattr(cell, name) == value for name, value in wanted.items())]


def test_the_main_table_has_every_planner_flags_and_training_seed():
    found = plan(["main"])
    assert len(of(found, planner=TEACHER)) == 2  # one for each kind of flags, whatever the seeds
    for name in ("baseline", "dpboost-2", "dpboost-2-recovery", "dpboost-4", "paper"):
        assert {(cell.flags, cell.train_seed) for cell in of(found, planner=name)} == {
            (flags, seed) for flags in FLAGS for seed in (0, 1, 2)
        }
    [slow] = of(found, planner="dpboost-2-dagger")
    assert (slow.flags, slow.train_seed) == ("random", 0)
    assert {cell.episodes for cell in found} == {200}
    assert {cell.demonstrations for cell in found} == {0, 20}


def test_curve_and_rendering_share_cells_with_the_main_table():
    found = plan()
    assert len({cell.key for cell in found}) == len({cell.name for cell in found}) == len(found)
    swept = of(found, planner="dpboost-2", flags="random", train_seed=0)
    assert {(cell.demonstrations, cell.render_size, cell.episodes) for cell in swept} == {
        (5, (128, 96), 100),
        (20, (128, 96), 200),
        (100, (128, 96), 100),
        (20, (320, 240), 100),
    }
    assert {cell.planner for cell in of(found, demonstrations=5)} == {"baseline", "dpboost-2"}
    alone = plan(["curve"])
    assert {cell.episodes for cell in alone} == {100} and len(of(alone, planner=TEACHER)) == 1
    assert {cell.episodes for cell in plan(["paper"], episodes=30)} == {30}


def test_datasets_hold_the_most_that_a_cell_learns_from():
    assert demonstrations_needed(plan(flags=["random"])) == {
        "random_0": 100,
        "random_1": 20,
        "random_2": 20,
        "random_0_320x240": 20,
    }
    assert demonstrations_needed(plan(["main"], planners=[TEACHER])) == {}


def option(options, name):
    [value] = [given.split("=", 1)[1] for given in options if given.startswith(f"--{name}=")]
    return value


def test_no_world_is_learned_from_and_tested():
    dagger = DaggerOptions()
    assert 5000 <= dagger.validation_seed <= 6000 - dagger.validation_episodes
    roles = {role: set(worlds) for role, worlds in WORLDS.items()} | {"validation": set(range(5000, 6000))}
    for seed in TRAIN_SEEDS:
        cell = Cell("random", "dpboost-2-dagger", 100, seed, 200)
        first = int(option(cell.record_options, "seed"))
        gathered = int(option(cell.train_options, "dagger.seed"))
        roles[f"demonstrations {seed}"] = set(range(first, first + 1000))
        roles[f"DAgger {seed}"] = set(range(gathered, gathered + 1000))
    assert sum(map(len, roles.values())) == len(set().union(*roles.values()))


@pytest.mark.parametrize("name", [name for name in PLANNERS if name != TEACHER])
def test_train_py_knows_the_options(name):
    options = cli.parse(TrainOptions, ["--dataset.root=here", *Cell("fixed", name, 3, 2, 1).train_options])
    assert options.dataset.episodes == [0, 1, 2] and options.seed == 2
    assert (options.planner.type == "baseline") == (name == "baseline")
    assert (options.dagger.iterations > 0) == name.endswith("-dagger")
    assert options.planner.recipe == ("paper" if name == "paper" else "dpmacro")


def test_worlds_are_the_first_of_their_role():
    assert list(Cell("random", "baseline", 20, 0, 2).worlds) == [10_000, 10_001]
    assert list(Cell("random", "baseline", 20, 0, 2, role="fresh").worlds) == [40_000, 40_001]


def test_recovery_is_a_way_to_run_a_policy_not_to_train_one():
    plain, recovering = (Cell("random", name, 20, 1, 9) for name in ("dpboost-2", "dpboost-2-recovery"))
    assert recovering.policy == plain.policy == plain.name == "random_1_dpboost-2_20"
    assert recovering.train_options == plain.train_options
    assert recovering.name != plain.name and recovering.key != plain.key
