"""The table of policies in Meta-World: its plan, its peers, its files, and a small one from end to end."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from dpmacro.data.demonstrations import Demonstrations

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from metaworld_peers import PEERS, Peer  # noqa: E402
from metaworld_report import main_table, seeds_table, tables, write_report  # noqa: E402
from metaworld_run import RESULT, RunOptions, world_of  # noqa: E402
from metaworld_timelines import SEGMENTATION, TimelinesOptions, drawn, found_in, main  # noqa: E402
from table_metaworld import TableOptions, bound, write_stages  # noqa: E402
from table_rows import stored  # noqa: E402

SCRIPT = ROOT / "benchmarks/table_metaworld.py"
STATE = "observation.state"


def demonstrations(states, actions, truth=None, lengths=None):
    lengths = np.array([len(actions)] if lengths is None else lengths)
    names = tuple("abcd"[: actions.shape[1]])
    classes = () if truth is None else ("go", "come", "stay")
    parts = actions.astype(np.float32), lengths, names, 30, truth, {}, Path("some set")
    return Demonstrations(
        {STATE: states.astype(np.float32)}, *parts, truth_name="stage", truth_classes=classes
    )


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_learns_a_rule_and_comes_back_from_its_file(name, tmp_path):
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, (400, 3))
    states[:, 1] = 0.5  # a number that never varies
    actions = np.stack([states[:, 0] - states[:, 2], np.sign(states[:, 0])], 1)
    peer = Peer.fit(name, demonstrations(states, actions), seed=0)
    assert peer.columns == [0, 2] and peer.numbers > 100
    peer.save(tmp_path / "peer")
    again = Peer.load(tmp_path / "peer")
    again.reset(None)
    seen = {STATE: np.array([0.8, 0.5, -0.4], np.float32)}
    action = again.act(seen, {})
    assert action.dtype == np.float32 and np.array_equal(action, peer.act(seen, {}))
    assert np.abs(action - [1.2, 1.0]).max() < 0.35


def test_the_plan_has_every_seed_of_ours_and_acts_last():
    options = TableOptions(tasks=["hammer-v3", "TwoGoals-v0"], train_seeds=[0, 1])
    names = [cell.name for cell in options.plan]
    assert len(names) == len(set(names)) == 2 * (9 + 3)
    assert names[0] == "hammer-v3_expert" and names[7:10] == [
        "hammer-v3_act_0",
        "TwoGoals-v0_expert",
        "TwoGoals-v0_one_0",
    ]
    assert names[16:19] == ["hammer-v3_one_1", "hammer-v3_dpmacro_1", "hammer-v3_stages_1"]
    assert names[-2:] == ["hammer-v3_act-10_0", "TwoGoals-v0_act-10_0"]
    assert world_of("hammer-v3") == "Meta-World/hammer-v3" and world_of("TwoGoals-v0") == "TwoGoals-v0"


def test_true_stages_become_labels_with_a_bound(tmp_path, monkeypatch):
    truth = np.array([0, 0, 1, 2, 2, 0, 1, 0, 1])
    some = demonstrations(np.zeros((9, 2)), np.zeros((9, 2)), truth, [5, 4])
    monkeypatch.setattr(Demonstrations, "load", lambda root: some)
    write_stages(Path("some set"), tmp_path / "stages.csv")
    with (tmp_path / "stages.csv").open() as file:
        rows = [tuple(row.values()) for row in csv.DictReader(file)]
    assert rows == [
        ("0", "0", "2", "go"),
        ("0", "2", "3", "come"),
        ("0", "3", "5", "stay"),
        ("1", "0", "1", "go"),
        ("1", "1", "2", "come"),
        ("1", "2", "3", "go"),
        ("1", "3", "4", "come"),
    ]
    assert bound(tmp_path / "stages.csv") == ("--planner.max_transitions=3",)


def test_timelines_say_how_well_macro_actions_agree_with_stages(tmp_path, monkeypatch, capsys):
    truth = np.repeat([0, 1, 2, 0, 1], [20, 20, 20, 30, 30])
    some = demonstrations(np.zeros((120, 2)), np.zeros((120, 2)), truth, [60, 60])
    monkeypatch.setattr(Demonstrations, "load", lambda root: some)
    options = TimelinesOptions(table=tmp_path, tasks=["hammer-v3"], output=tmp_path / "lines.png")
    with pytest.raises(ValueError, match="is not there: make it by"):
        found_in("hammer-v3", options)
    (tmp_path / "data/hammer-v3_0").mkdir(parents=True)
    file = tmp_path / "train/hammer-v3_dpmacro_0" / SEGMENTATION
    file.parent.mkdir(parents=True)
    save_file({"labels": np.repeat([2, 0, 2, 0], [20, 40, 30, 30])}, file)
    found = found_in("hammer-v3", options)
    assert found.labels.tolist() == [0] * 20 + [1] * 40, "by the names of the stages that they agree with"
    assert (found.macros, found.stages) == (2, 3)
    assert found.scores.accuracy == pytest.approx(100 / 120)
    [strip] = [axis for axis in drawn([found]).axes if axis.get_ylabel() == "hammer"]
    assert {text.get_text() for text in strip.texts} >= {"0", "1", "60 frames\n83% agree\nF1@50 0.89"}
    main(options)
    assert "| hammer | 2 | 3 | 0.83 | 0.89 | 0.80 |" in capsys.readouterr().out
    assert (tmp_path / "lines.png").stat().st_size > 1000


def row(task, name, seed, successes, runs=10, **more):
    found = {
        "task": task,
        "row": name,
        "train_seed": seed,
        "successes": successes,
        "n": runs,
        "training_cpu_seconds": None if name == "expert" else 20.0,
        "milliseconds": {"mean": 0.5, "p95": 1.0},
        "numbers": None if name == "expert" else 1234,
        "macro_actions": 3 if name == "dpmacro" else None,
        "commits": ["abc"],
    }
    return found | more


ROWS = [
    row("hammer-v3", "expert", None, 10),
    row("hammer-v3", "dpmacro", 0, 8),
    row("hammer-v3", "dpmacro", 1, 6),
    row("assembly-v3", "expert", None, 9),
    row("assembly-v3", "dpmacro", 0, 5),
    row("TwoGoals-v0", "one", 0, 0, macro_actions=1),
]


def test_a_line_has_every_task_the_mean_of_tasks_and_the_costs():
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in main_table(ROWS[:5])]
    assert lines[0][:3] == ["success, %", "hammer", "assembly"]
    assert lines[2][1:4] == ["100", "90", "95.0%"]
    assert lines[3][1:4] == ["70", "50", "60.0%"], "seeds are pooled, tasks count alike"
    assert lines[3][5:] == ["20", "0.50", "1,234"]
    assert [len(part) for part in tables(ROWS)] == [4, 3], "worlds with a hidden phase have their own"
    seeds = [[cell.strip() for cell in line.split("|")[1:-1]] for line in seeds_table(ROWS)]
    assert seeds[2:] == [
        ["one learner, 1,200 rounds", "", "", "0"],
        [seeds[3][0], "8 (3), 6 (3)", "5 (3)", ""],
    ]


def test_the_report_goes_between_its_marks(tmp_path):
    path = tmp_path / "metaworld.md"
    path.write_text("# Before\n\n<!-- table -->\nold\n<!-- /table -->\n\nafter\n")
    write_report({"rows": ROWS, "date": "today", "machine": "m", "versions": "v", "command": "c"}, path)
    text = path.read_text()
    assert text.startswith("# Before") and text.endswith("after\n") and "old" not in text
    assert "commit abc" in text and "| expert" in text
    assert json.loads((tmp_path / "metaworld.json").read_text())["rows"] == ROWS


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tasks": ["fly-v3"]}, "tasks has 'fly-v3': choose from "),
        ({"rows": ["nobody"]}, "rows has 'nobody': choose from expert, "),
        ({"rows": []}, "rows is empty"),
        ({"train_seeds": [5]}, "train_seeds has 5: give 0 to 4, beyond lie validation worlds"),
        ({"worlds": "moon"}, "worlds is 'moon': choose from test, validation"),
        ({"episodes": 0}, "episodes is 0: give 1 to 1000"),
    ],
)
def test_bad_options_are_named(options, said):
    with pytest.raises(ValueError, match=said):
        TableOptions(**options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"task": "fly"}, "task is 'fly': choose from "),
        ({"planner": "nobody"}, "planner is 'nobody': choose from expert, "),
        ({"planner": "trees"}, "planner=trees needs --dataset"),
        ({"planner": "policy"}, "planner=policy needs --policy"),
        ({"workers": 0}, "workers is 0: give 1 or more"),
        ({"seconds": 0.0}, "seconds is 0.0: give more than 0"),
    ],
)
def test_bad_options_of_a_run_are_named(options, said, tmp_path):
    with pytest.raises(ValueError, match=said):
        RunOptions(**{"task": "hammer-v3", "planner": "expert", "output_dir": tmp_path, **options})


def test_a_file_of_something_else_is_refused(tmp_path):
    (tmp_path / "rows.json").write_text('{"rows": [{"task": "x"}]}')
    with pytest.raises(ValueError, match="holds no rows of this table"):
        stored(tmp_path / "rows.json", lambda row: row["row"])
    assert stored(tmp_path / "none.json", lambda row: row["row"]) == {}


@pytest.mark.benchmark
def test_a_small_table_from_end_to_end_goes_on_where_it_was(tmp_path):
    options = ["--tasks=[TwoGoals-v0]", "--rows=[expert, one, stages, neighbours, network, trees]"]
    options += ["--train_seeds=[0]", "--episodes=2", f"--output_dir={tmp_path / 'out'}"]
    options += [f"--report={tmp_path / 'table.md'}"]

    def call():
        done = subprocess.run([sys.executable, str(SCRIPT), *options], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    printed = call()
    assert "| expert " in printed and "| 5 nearest neighbours" in printed
    result = tmp_path / f"out/runs_test/TwoGoals-v0_neighbours_0/{RESULT}"
    before = result.stat().st_mtime_ns
    assert json.loads(result.read_text())["seeds"] == [40000, 40001]
    call()
    assert result.stat().st_mtime_ns == before, "nothing is made twice"
    assert "TwoGoals-v0" in (tmp_path / "table.md").read_text()
