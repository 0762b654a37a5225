"""Rows of Table I as markdown: what is pooled, what is paired, and where it goes in a text."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

from report import inserted  # noqa: E402
from table_cells import PLANNERS  # noqa: E402
from table_report import main_table, marks, report, write_report  # noqa: E402
from table_rows import curve_points, groups, paired, pooled  # noqa: E402

from dpmacro.metrics.success import mcnemar, wilson_interval  # noqa: E402


def row(planner, per_episode, seed=0, flags="random", demonstrations=20, size=(128, 96), first=10_000):
    teacher = planner == "teacher"
    outcomes = {"success": sum(per_episode), "red_first": len(per_episode) - sum(per_episode)}
    return {
        "flags": flags,
        "planner": planner,
        "demonstrations": 0 if teacher else demonstrations,
        "train_seed": None if teacher else seed,
        "render_size": [64, 48] if teacher else list(size),
        "successes": sum(per_episode),
        "n": len(per_episode),
        "outcomes": outcomes,
        "seeds": list(range(first, first + len(per_episode))),
        "per_episode": per_episode,
        "commits": ["abc"],
    }


MARKS = marks("test")
TEACHER = [True] * 8 + [False] * 2
GOOD = [True] * 7 + [False, True, True]
BAD = [False] * 9 + [True]
ROWS = [
    row("dpboost-2", GOOD, 1),
    row("dpboost-2", TEACHER, 0),
    row("teacher", TEACHER),
    row("baseline", BAD, 0),
    row("baseline", BAD, 1),
    row("baseline", GOOD, 0, "fixed"),
    row("baseline", [True], 0, demonstrations=5),
    row("dpboost-2", BAD, 0, size=(320, 240)),
]
FOUND = {
    "commit": "def",
    "date": "2000-01-01T00:00:00",
    "command": "python benchmarks/table1.py",
    "machine": "a machine",
    "versions": "Python 3",
    "rows": ROWS,
}


def cells(lines, *wanted):
    """The cells of the one line that begins with those wanted."""
    split = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    [found] = [line for line in split if line[: len(wanted)] == list(wanted)]
    return found[len(wanted) :]


def test_the_main_table_pools_training_seeds_and_shows_each():
    lines = main_table(ROWS, 20)
    assert len({len(line) for line in lines}) == 1  # columns align
    low, high = wilson_interval(17, 20)
    assert cells(lines, "random", PLANNERS["dpboost-2"].title) == [
        "17 of 20",
        "85.0%",
        f"{low:.1%} to {high:.1%}",
        "80.0%, 90.0%",  # in the order of training seeds
        "+5.0 points",
        "",
    ]
    assert cells(lines, "random", "teacher")[3:] == ["", "", "72%"]
    assert cells(lines, "random", PLANNERS["baseline"].title)[:2] == ["2 of 20", "10.0%"]
    assert cells(lines, "fixed", PLANNERS["baseline"].title)[4:] == ["", "92%"]  # no teacher there


def test_a_planner_stands_beside_the_teacher_in_the_worlds_of_both():
    failed_later = [*TEACHER, *[False] * 10]
    lines = main_table([row("teacher", failed_later), row("dpboost-2", GOOD)], 20)
    assert cells(lines, "random", PLANNERS["dpboost-2"].title)[4] == "+10.0 points"  # 9 and 8 of 10
    lines = main_table([row("teacher", [True], first=5), row("dpboost-2", GOOD)], 20)
    assert cells(lines, "random", PLANNERS["dpboost-2"].title)[4] == ""
    assert main_table([], 20) == []


def test_pairs_share_training_seed_and_world():
    of = groups(ROWS, "random", 20)
    found = paired(of["dpboost-2"], of["baseline"])
    assert found == mcnemar(TEACHER + GOOD, BAD + BAD)
    assert (found.only_first, found.only_second, found.pairs) == (16, 1, 20)
    assert paired(of["dpboost-2"], of["teacher"]) == mcnemar(TEACHER + GOOD, TEACHER + TEACHER)
    assert paired(of["dpboost-2"], of["teacher"], 8).pairs == 16
    assert paired([row("baseline", BAD, 0)], [row("dpboost-2", BAD, 1)]) is None
    moved = paired([row("baseline", GOOD, 0)], [row("dpboost-2", TEACHER, 0, first=10_007)])
    assert moved == mcnemar(GOOD[7:], TEACHER[:3])  # the worlds that both have
    assert pooled(of["baseline"]) == (2, 20)


def test_the_curve_has_the_first_hundred_worlds_of_one_training_seed():
    long = row("dpboost-2", [True] * 100 + [False] * 100)
    rows = [long, row("dpboost-2", BAD, demonstrations=5), row("dpboost-2", BAD, 1, demonstrations=50)]
    assert curve_points(rows, 0) == {"dpboost-2": {5: (1, 10), 20: (100, 100)}}
    assert curve_points([long, *rows[2:]], 0) == {}  # one point is no curve
    assert curve_points([*rows, row("dpboost-2-dagger", BAD)], 0).keys() == {"dpboost-2"}
    assert list(curve_points(ROWS, 0)["baseline"]) == [5, 20]


def test_a_report_has_every_table():
    text = report(FOUND, 20, "rows.json")
    lines = text.splitlines()
    two, one = PLANNERS["dpboost-2"].title, PLANNERS["baseline"].title
    assert cells(lines, "random", two, one) == ["20", "16", "1", "< 0.001"]
    assert cells(lines, "random", two, "teacher") == ["20", "2", "1", "1.000"]
    assert cells(lines, "random", two, "3") == ["3", "0", "0"]  # failures, all by red first
    assert cells(lines, one, "1 of 1") == ["1 of 10"]  # the curve's points, 5 and 20
    assert cells(lines, two, "1 of 10") == ["8 of 10", "10", "1", "8", "0.039"]  # 320x240, 128x96
    for part in (
        "commit abc",
        "worlds 10000 to 10009",
        "training seeds 0, 1",
        FOUND["date"],
        FOUND["command"],
    ):
        assert part in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "{0}\nnew\n{1}\n"),
        ("# Results\n", "# Results\n\n{0}\nnew\n{1}\n"),
        ("before\n{0}\nold\n{1}\nafter\n", "before\n{0}\nnew\n{1}\nafter\n"),
        ("{0}{1}", "{0}\nnew\n{1}"),
    ],
)
def test_a_report_leaves_the_text_around_it_alone(text, expected):
    done = inserted(text.format(*MARKS), "new", MARKS)
    assert done == expected.format(*MARKS)
    assert inserted(done, "new", MARKS) == done


@pytest.mark.parametrize("text", ["a {0}", "{1} b", "{1} {0}"])
def test_half_the_marks_are_an_error(text):
    with pytest.raises(ValueError, match=r"the report needs .*, or neither: correct the marks"):
        inserted(text.format(*MARKS), "new", MARKS)


def test_picture_and_rows_go_beside_the_report(tmp_path):
    path = tmp_path / "docs/results.md"
    write_report(FOUND, 20, path, "rows.json")
    told = (tmp_path / "docs/rows.json").read_text()
    assert json.loads(told) == FOUND
    assert sum(line.startswith('{"flags"') for line in told.splitlines()) == len(ROWS)
    assert "](rows.json)" in path.read_text()
    assert (tmp_path / "docs/learning_curve.png").stat().st_size > 1000
    assert "](learning_curve.png)" in path.read_text()
    write_report(FOUND | {"rows": ROWS[2:4]}, 20, path, "fresh.json", marks("fresh"))
    text = path.read_text()
    assert "17 of 20" in text and "](rows.json)" in text.split(MARKS[1])[0]  # the other section stays
    assert "](fresh.json)" in text.split("<!-- fresh -->")[1] and (tmp_path / "docs/fresh.json").exists()
    write_report(FOUND | {"rows": ROWS[:3]}, 20, path, "rows.json")
    assert "learning_curve.png" not in path.read_text() and "17 of 20" in path.read_text()
