"""Table I from its options to its files, once with real demonstrations, training and runs."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

import table_cells  # noqa: E402
import table_runs  # noqa: E402
from table1 import TableOptions, main, read_rows  # noqa: E402
from table_jobs import read_stamp  # noqa: E402
from table_runs import Runs  # noqa: E402

from dpmacro.utils import cli  # noqa: E402

TINY = ("--planner.type=baseline", "--planner.rounds=3", "--planner.rectangles=60")
ROW = {"flags", "planner", "demonstrations", "train_seed", "successes", "n"}


def options(folder, **more):
    few = {"parts": ["main"], "flags": ["random"], "train_seeds": [3], "demonstrations": 2, "episodes": 1}
    few |= {"planners": ["teacher", "baseline"], "workers": 1, "output_dir": folder / "table"}
    return TableOptions(**few | more)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a tiny table, and the rows of another cell that were there before."""
    folder = tmp_path_factory.mktemp("table1")
    other = {"flags": "fixed", "planner": "dpboost-4", "demonstrations": 2, "train_seed": 3}
    other |= {"render_size": [128, 96], "successes": 1, "n": 1, "outcomes": {"success": 1}}
    other |= {"seeds": [10_000], "per_episode": [True], "commits": ["before"]}
    (folder / "table.json").write_text(json.dumps({"rows": [other]}))
    with pytest.MonkeyPatch.context() as patch:
        tiny = replace(table_cells.PLANNERS["baseline"], options=TINY)
        patch.setitem(table_cells.PLANNERS, "baseline", tiny)
        main(options(folder, report=folder / "docs/results.md"))
    return folder


@pytest.mark.benchmark
def test_a_table_is_recorded_trained_and_run(made):
    found = json.loads((made / "table.json").read_text())
    assert found.keys() >= {"commit", "date", "command", "rows"}
    other, teacher, baseline = found["rows"]
    assert other["commits"] == ["before"]
    for row, name, demonstrations, seed in ((teacher, "teacher", 0, None), (baseline, "baseline", 2, 3)):
        assert row.keys() >= ROW
        assert (row["flags"], row["planner"]) == ("random", name)
        assert (row["demonstrations"], row["train_seed"]) == (demonstrations, seed)
        assert row["seeds"] == [10_000] and row["n"] == 1 == sum(row["outcomes"].values())
        assert row["successes"] == sum(row["per_episode"]) == row["outcomes"].get("success", 0)
        assert row["commits"] == [found["commit"]]
    assert "--planner.rounds=3" in baseline["training"] and baseline["training_seconds"] > 0
    recorded = json.loads((made / "table/data/random_3/meta/info.json").read_text())
    assert recorded["total_episodes"] == 2
    [run] = (made / "table/eval").glob("random_3_baseline_2/*/eval_info.json")
    assert json.loads(run.read_text())["dpmacro"]["world"]["render_size"] == [128, 96]
    assert read_stamp(run.parent)["commit"] == found["commit"]
    assert "before" in (made / "docs/results.md").read_text()


@pytest.mark.benchmark
def test_a_second_run_finds_everything_there(made, monkeypatch, capsys):
    tiny = replace(table_cells.PLANNERS["baseline"], options=TINY)
    monkeypatch.setitem(table_cells.PLANNERS, "baseline", tiny)
    monkeypatch.setattr(table_runs, "run", None)
    before = json.loads((made / "table.json").read_text())["rows"]
    main(options(made))
    assert json.loads((made / "table.json").read_text())["rows"] == before
    printed = capsys.readouterr().out
    assert printed.startswith("commit ") and f"rows     {made / 'table.json'}" in printed
    assert printed.count("| random | ") == 2 and printed.count("| fixed ") == 1


def test_a_row_keeps_its_runs_where_fewer_are_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(Runs, "outcomes", lambda self, cell: (dict.fromkeys(cell.worlds, "success"), []))
    for asked, held in ((3, 3), (1, 3), (5, 5)):
        main(options(tmp_path, planners=["teacher"], episodes=asked))
        [row] = read_rows(tmp_path / "table.json").values()
        assert row["seeds"] == list(range(10_000, 10_000 + held)) and row["successes"] == row["n"] == held


@pytest.mark.benchmark
def test_an_interrupt_keeps_the_cells_that_are_done_and_prints_them(made, monkeypatch, capsys, tmp_path):
    (tmp_path / "table").symlink_to(made / "table")
    outcomes = Runs.outcomes

    def interrupted(self, cell):
        if cell.planner == "baseline":
            raise KeyboardInterrupt
        return outcomes(self, cell)

    monkeypatch.setattr(Runs, "outcomes", interrupted)
    with pytest.raises(KeyboardInterrupt):
        main(options(tmp_path))
    [row] = read_rows(tmp_path / "table.json").values()
    assert row["planner"] == "teacher"
    assert "| random | teacher" in capsys.readouterr().out


@pytest.mark.benchmark
def test_rows_that_another_call_writes_meanwhile_stay(made, monkeypatch, tmp_path):
    (tmp_path / "table").symlink_to(made / "table")
    other, *_ = json.loads((made / "table.json").read_text())["rows"]
    outcomes = Runs.outcomes

    def meanwhile(self, cell):
        (tmp_path / "table.json").write_text(json.dumps({"rows": [other]}))
        return outcomes(self, cell)

    monkeypatch.setattr(Runs, "outcomes", meanwhile)
    main(options(tmp_path, planners=["teacher"]))
    assert [row["planner"] for row in read_rows(tmp_path / "table.json").values()] == ["dpboost-4", "teacher"]


@pytest.mark.benchmark
def test_a_cell_that_fails_is_one_line_and_the_others_stay(made, monkeypatch, capsys):
    wrong = replace(table_cells.PLANNERS["dpboost-2"], options=("--planner.macros=0",))
    monkeypatch.setitem(table_cells.PLANNERS, "dpboost-2", wrong)
    asked = ["table1.py", f"--output_dir={made / 'table'}", "--parts=[main]", "--flags=[random]"]
    asked += ["--planners=[teacher, dpboost-2]", "--train_seeds=[3]", "--demonstrations=2", "--episodes=1"]
    monkeypatch.setattr(sys, "argv", asked)
    before = read_rows(made / "table.json")
    with pytest.raises(SystemExit) as ended:
        cli.run(main, TableOptions)
    assert ended.value.code == 2
    *_, line = capsys.readouterr().err.replace("\r", "\n").splitlines()
    log = made / "table/train/random_3_dpboost-2_2.log"
    assert line.startswith(
        "error: training random_3_dpboost-2_2 failed with exit status 2: error: planner.macros"
    )
    assert line.endswith(f"(all of it in {log})")
    assert read_rows(made / "table.json") == before


def test_quick_is_coarse_and_has_rows_of_its_own(tmp_path):
    quick = TableOptions(quick=True, output_dir=tmp_path / "table")
    assert {(cell.flags, cell.planner, cell.demonstrations, cell.episodes) for cell in quick.plan} == {
        ("random", "teacher", 0, 30),
        *(("random", name, 20, 30) for name in ("baseline", "dpboost-2", "dpboost-2-recovery", "dpboost-4")),
    }
    assert len(quick.plan) == 5
    assert quick.rows == tmp_path / "table_quick.json"
    assert {cell.name for cell in quick.plan} <= {cell.name for cell in TableOptions().plan}
    [only] = TableOptions(quick=True, planners=["baseline"], train_seeds=[2]).plan
    assert only.name == "random_2_baseline_20"


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--worlds=old", "worlds is 'old': choose from test, fresh"),
        ("--parts=[table]", "parts has 'table': choose from main, curve, paper"),
        ("--flags=[none]", "flags has 'none': choose from random, fixed"),
        ("--planners=[dpboost]", "planners has 'dpboost': choose from teacher, baseline"),
        ("--planners=[]", "planners is empty: give one at least"),
        ("--train_seeds=[5]", "train_seeds has 5: give 0 to 4, beyond lie validation worlds"),
        ("--curve=[0]", "curve has 0: give 1 or more"),
        ("--curve=[5, 1001]", "curve has 1001: give 1 or more, 1000 at most"),
        ("--episodes=0", "episodes is 0: give 1 or more"),
        ("--episodes=10001", "episodes is 10001: give 1 or more, 10000 at most"),
        ("--demonstrations=1001", "demonstrations is 1001: give 1 or more, 1000 at most"),
        ("--workers=0", "workers is 0: give 1 or more"),
        ("--threads=0", "threads is 0: give 1 or more"),
        ("--episode=3", "unknown option --episode: did you mean --episodes?"),
    ],
)
def test_a_wrong_option_is_one_line(option, message):
    with pytest.raises(ValueError) as refused:
        cli.parse(TableOptions, [option])
    assert str(refused.value).startswith(message)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            ["--flags=[fixed]", "--planners=[dpboost-2-dagger]"],
            "there is no cell of dpboost-2-dagger in main, curve, paper with fixed flags: ask for others",
        ),
        (["--parts=[paper]", "--planners=[teacher]"], "there is no cell of teacher in paper"),
        (["--worlds=fresh", "--parts=[curve]"], "there is no cell of teacher"),
        (["--quick=true", "--planners=[dpboost-2-dagger]"], "there is no cell of dpboost-2-dagger in quick"),
    ],
)
def test_a_table_without_cells_is_one_line(asked, message):
    with pytest.raises(ValueError) as refused:
        cli.parse(TableOptions, asked)
    assert str(refused.value).startswith(message)


def test_fresh_worlds_have_a_main_table_a_folder_and_rows_of_their_own():
    fresh = TableOptions(worlds="fresh", train_seeds=[0, 1, 2])
    assert {(cell.worlds.start, cell.worlds.stop) for cell in fresh.plan} == {(40_000, 40_100)}
    assert {cell.demonstrations for cell in fresh.plan} == {0, 20}
    assert {cell.render_size for cell in fresh.plan} == {(64, 48), (128, 96)}
    tests = TableOptions()
    assert (fresh.folder, fresh.rows) == (Path("outputs/table1_fresh"), Path("outputs/table1_fresh.json"))
    assert (tests.folder, tests.rows) == (Path("outputs/table1"), Path("outputs/table1.json"))
    assert TableOptions(worlds="fresh", output_dir=Path("here")).rows == Path("here.json")


def test_rows_of_other_worlds_are_not_written_over(tmp_path, monkeypatch):
    monkeypatch.setattr(Runs, "outcomes", lambda self, cell: (dict.fromkeys(cell.worlds, "success"), []))
    main(options(tmp_path, planners=["teacher"]))
    before = (tmp_path / "table.json").read_text()
    with pytest.raises(ValueError, match=r"a row of teacher in others than fresh worlds\): give another"):
        main(options(tmp_path, planners=["teacher"], worlds="fresh"))
    assert (tmp_path / "table.json").read_text() == before


OTHER = '{"rows": [{"flags": "fixed", "planner": "%s", "n": %d, "per_episode": [true]}]}'


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"rows": [{"benchmark": "round"}]}', OTHER % ("gone", 1), OTHER % ("baseline", 2)]
)
def test_a_file_of_other_rows_is_one_line(tmp_path, text):
    (tmp_path / "table.json").write_text(text)
    with pytest.raises(
        ValueError, match=r"table\.json holds no rows of this table \(.+\): give another --output_dir$"
    ):
        main(options(tmp_path))
    assert (tmp_path / "table.json").read_text() == text


def test_the_makefile_calls_it():
    text = (ROOT / "Makefile").read_text()
    assert (
        "benchmarks/table1.py --workers=$(WORKERS) $(if $(QUICK),--quick=true,--report=docs/results.md)"
        in text
    )
