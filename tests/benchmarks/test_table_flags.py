"""The table of rooms with flags: its plan, its options, its lines, and one cell from end to end."""

import json
import sys
from pathlib import Path

import pytest
from table_jobs import Job

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

import table_flags  # noqa: E402
from flags_cells import WORLDS, title  # noqa: E402
from table_flags import Cell, FlagsOptions, Runs, tables  # noqa: E402


def row(world, planner, seed, successes, found=None):
    training = None if found is None else {"macro_actions": found, "recognised": 1.0}
    per_episode = [True] * successes + [False] * (10 - successes)
    return {
        "world": world,
        "planner": planner,
        "train_seed": seed,
        "per_episode": per_episode,
        "training": training,
    }


def test_the_plan_has_every_planner_of_a_world_and_the_teacher_once():
    plan = FlagsOptions(worlds=["still-3", "searching"], train_seeds=[0, 2]).plan
    assert plan[0] == Cell("still-3", "teacher", 0)
    assert [one.planner for one in plan if (one.world, one.seed) == ("searching", 2)] == [
        "baseline",
        "two",
        "two-recovery",
        "dagger",
    ]
    assert sum(one.planner == "teacher" for one in plan) == 2
    only = FlagsOptions(worlds=["flags-0", "four"], planners=["auto"]).plan
    assert only == [Cell("four", "auto", 0)]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"worlds": ["flags-9"]}, "worlds has 'flags-9': choose from flags-0, flags-1"),
        ({"planners": ["best"]}, "planners has 'best': choose from auto"),
        ({"train_seeds": []}, "train_seeds is empty"),
        ({"train_seeds": [5]}, "train_seeds has 5: give 0 to 4"),
        ({"episodes": 0}, "episodes is 0: give 1 to 1000"),
    ],
)
def test_bad_options_are_named(options, said):
    with pytest.raises(ValueError, match=said):
        FlagsOptions(**options)


def test_lines_have_a_column_for_every_world_and_what_was_found():
    rows = [
        row("flags-0", "teacher", None, 9),
        row("flags-0", "two", 0, 8, 2.0),
        row("flags-1", "two", 0, 6, 2.0),
        row("flags-1", "baseline", 0, 1),
        row("four", "auto-recovery", 0, 7, 4.0),
    ]
    fixed, four = tables(rows)
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in fixed]
    assert cells[0] == ["successes", "layout 0, flags fixed", "layout 1, flags fixed", "in all"]
    cells = cells[2:]
    assert cells[0][:3] == ["teacher", "9", ""]
    assert cells[1][:3] == ["one classifier", "", "1"]
    assert cells[2] == ["2 macro-actions", "8 (Q=2)", "6 (Q=2)", "14 of 20 (48.1% to 85.5%)"]
    assert title("auto-recovery") == "macro-actions by the data, up to 6, recovery" in four[2]


def test_a_cell_is_recorded_trained_and_run_once(tmp_path, monkeypatch):
    done: list[Job] = []

    def run(job, commit, threads, moved):
        done.append(job)
        job.folder.mkdir(parents=True)
        stamp = {"options": list(job.options), "command": job.script, "commit": commit, "seconds": 1.0}
        job.folder.with_name(job.folder.name + ".json").write_text(json.dumps(stamp))
        if job.script == "eval.py":
            found = {"outcomes": ["success", "red_first"], "seeds": [1, 2], "causes": {}}
            (job.folder / "eval_info.json").write_text(json.dumps({"dpmacro": found}))
        return stamp

    class Bar:
        def set_description(self, text):
            pass

    monkeypatch.setattr(table_flags, "run", run)
    runs = Runs(FlagsOptions(output_dir=tmp_path), "abc", Bar())
    made = [runs.row(Cell("four", name, 1)) for name in ("baseline", "two", "two-recovery", "teacher")]
    assert [job.script for job in done] == [
        "datasets/record.py",
        *["train.py", "eval.py"] * 2,
        "eval.py",
        "eval.py",
    ]
    recorded, baseline, _, two, _, recovered, teacher = (job.options for job in done)
    assert recorded == ("--seed=1000", "--episodes=20", *WORLDS["four"].options)
    assert baseline == ("--planner.type=baseline", "--seed=1"), "it has no changes to bound"
    assert two == ("--planner.macros=2", "--planner.max_transitions=3", "--seed=1")
    assert recovered[-1] == "--policy.recovery=true"
    assert teacher[2:] == ("--policy.type=teacher", *WORLDS["four"].options)
    assert made[0]["per_episode"] == [True, False] and made[3]["train_seed"] is None
    runs.row(Cell("four", "two", 1))
    assert len(done) == 7, "nothing is made twice"
