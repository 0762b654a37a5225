"""Why planners fail: what is counted, which moments are shown, and that runs shown are the runs counted."""

import json
import subprocess
import sys
from collections import Counter
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

from failure_runs import AT_ONCE, PICTURES, Run, by_cause, example, key_steps, read_runs, stills  # noqa: E402
from failures import MARKS, MEANINGS, lost_worlds, text, with_results  # noqa: E402

from dpmacro.evaluation.rollouts import PlannerSource, replay  # noqa: E402
from dpmacro.metrics.success import wilson_interval  # noqa: E402
from dpmacro.worlds.two_flags.diagnosis import CAUSES  # noqa: E402
from dpmacro.worlds.two_flags.scene import FLAGS  # noqa: E402

WORLD = {"id": "TwoFlags-v0", "flags": "random", "yaw_noise": 0.5, "render_size": (64, 48), "max_steps": 40}


def run(cause="", seed=0, steps=100, blue=None, change=None, policy="p", recovery=True, **world):
    source = PlannerSource("teacher") if policy is None else PlannerSource("policy", Path(policy), recovery)
    outcome = "red_first" if cause else "success"
    return Run(Path("i.json"), source, WORLD | world, seed, outcome, cause, steps, blue, change)


def write(folder, runs):
    section = {
        "policy_path": runs[0].source.path and str(runs[0].source.path),
        "recovery": runs[0].source.recovery,
        "world": runs[0].world,
        "seeds": [run.seed for run in runs],
        "outcomes": [run.outcome for run in runs],
        "causes": [run.cause for run in runs],
        "steps": [run.steps for run in runs],
        "blue_steps": [run.blue_step for run in runs],
        "first_changes": [run.first_change for run in runs],
    }
    folder.mkdir(parents=True)
    (folder / "eval_info.json").write_text(json.dumps({"dpmacro": section}))


def cells(line):
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_every_cause_has_a_meaning_of_one_sentence():
    others = {f"{flag}_in_the_way" for flag in FLAGS[2:]}
    assert set(MEANINGS) == {*CAUSES, *others}
    assert all(meaning.endswith(".") and "." not in meaning[:-1] for meaning in MEANINGS.values())


@settings(deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["", *CAUSES]), st.booleans()), min_size=1, max_size=40))
def test_the_table_counts_runs_by_cause_and_those_where_the_teacher_fails(drawn):
    runs = [run(cause, seed, 10 * seed) for seed, (cause, _) in enumerate(drawn)]
    teacher = [run("spins" * lost, seed, policy=None) for seed, (_, lost) in enumerate(drawn)]
    lost = lost_worlds(teacher, runs)
    first, *rest = text(runs, lost)
    failures = [(seed, *pair) for seed, pair in enumerate(drawn) if pair[0]]
    assert first.startswith(f"{len(failures)} of {len(drawn)} runs fail")
    assert f" {sum(lost for *_, lost in failures)} of them where the teacher fails" in first
    assert f" in {sum(lost for _, lost in drawn)} of {len(drawn)} worlds" in first
    counts = Counter(cause for _, cause, _ in failures)
    lines = [cells(line) for line in rest[3:]]
    assert [int(line[1]) for line in lines] == sorted(counts.values(), reverse=True)
    for line in lines:
        cause = line[0].replace(" ", "_")
        own = [(seed, lost) for seed, other, lost in failures if other == cause]
        low, high = wilson_interval(len(own), len(failures))
        assert line[1:5] == [
            str(counts[cause]),
            f"{len(own) / len(failures):.0%}",
            f"{low:.0%} to {high:.0%}",
            str(sum(lost for _, lost in own)),
        ]
        assert line[5:] == [f"{np.median([10 * seed for seed, _ in own]):.0f}", MEANINGS[cause]]


def test_without_a_teacher_its_column_is_left_out():
    headings = [cells(text([run("spins")], lost)[2]) for lost in (None, [])]
    assert headings[0] == [name for name in headings[1] if "teacher" not in name] != headings[1]
    assert text([run(), run(seed=7)]) == ["0 of 2 runs fail (random flags, seeds 0 to 7)."]


def test_runs_come_from_a_folder_or_its_chunks(tmp_path):
    write(tmp_path / "a/0-1", [run("spins", 0), run(seed=1)])
    write(tmp_path / "a/2-2", [run("dithers", 2, blue=3, change=5)])
    write(tmp_path / "b", [run(seed=0, policy="q", recovery=False, max_steps=50)])
    found = read_runs(f"{tmp_path / 'a'} {tmp_path / 'b'}")
    assert [(str(one.source.path), one.seed, one.cause) for one in found] == [
        ("p", 0, "spins"),
        ("p", 1, ""),
        ("p", 2, "dithers"),
        ("q", 0, ""),
    ]
    assert [one.source.recovery for one in found] == [True, True, True, False]
    assert (found[2].blue_step, found[2].first_change) == (3, 5) and found[3].world == WORLD | {
        "max_steps": 50
    }
    assert found[0].where != found[3].where and found[0].info == tmp_path / "a/0-1/eval_info.json"


def test_what_cannot_be_counted_is_named(tmp_path):
    for folders, message in (
        (f"{tmp_path}/none", f"no eval_info.json in {tmp_path}/none"),
        (" ", "no folders"),
    ):
        with pytest.raises(ValueError, match=message):
            read_runs(folders)
    write(tmp_path / "a", [run("spins", 4)])
    with pytest.raises(ValueError, match=r"^2 runs of p with seed 4: "):
        read_runs(f"{tmp_path / 'a'} {tmp_path / 'a'}")
    info = tmp_path / "a/eval_info.json"
    section = json.loads(info.read_text())["dpmacro"]
    less = {name: value for name, value in section.items() if name != "causes"}
    for written, message in (
        ({"dpmacro": less}, "'causes'"),
        ({"dpmacro": section | {"seeds": [1, 2]}}, "shorter"),
        ({}, "'dpmacro'"),
        ({"dpmacro": section | {"causes": [""]}}, "seed 4 has outcome red_first and cause ''"),
        ({"dpmacro": section | {"causes": ["bored"]}}, "seed 4 has outcome red_first and cause 'bored'"),
    ):
        info.write_text(json.dumps(written))
        with pytest.raises(ValueError, match=message) as caught:
            read_runs(str(tmp_path / "a"))
        assert str(info) in str(caught.value)


def test_a_teacher_is_compared_in_the_same_worlds_only():
    runs = [run("spins", 3), run(seed=3, policy="q"), run("dithers", 4)]
    teacher = [run("spins", 3, policy=None, render_size=(320, 240)), run(seed=4, policy=None)]
    assert lost_worlds(teacher, runs) == [runs[0].where]
    assert text(runs, [runs[0].where])[0] == (
        "2 of 3 runs fail (random flags, seeds 3 to 4), 1 of them where the teacher fails, too; "
        "it does in 1 of 2 worlds."
    )
    for other in ([run(seed=3, policy=None)], [run(seed=n, policy=None, flags="fixed") for n in (3, 4)]):
        with pytest.raises(ValueError, match=r"^the teacher has no run with seed \d in the world of i.json"):
            lost_worlds(other, runs)
    with pytest.raises(ValueError, match="has runs of p: --teacher needs the teacher's"):
        lost_worlds(runs, runs)


def test_the_example_is_a_usual_run_that_the_teacher_would_have_won():
    group = [run("spins", seed, steps) for seed, steps in enumerate([10, 800, 30, 600, 640])]
    assert example(group).steps == 600
    assert example(group, [group[3].where, group[4].where]).steps == 30
    assert example(group, [one.where for one in group]).steps == 600


def test_causes_come_by_their_number_then_in_their_order():
    runs = [run("spins", 1), run("out_of_time", 2), run("spins", 3), run("pressed", 4), run(seed=5)]
    assert [(c, len(g)) for c, g in by_cause(runs).items()] == [
        ("spins", 2),
        ("pressed", 1),
        ("out_of_time", 1),
    ]


@pytest.mark.parametrize(
    ("blue", "change", "expected"),
    [
        (
            None,
            None,
            {0: "start", 250: "on the way", 500: "on the way", 750: "on the way", 1000: "last frame"},
        ),
        (None, 400, {0: "start", 400: "change", 600: "on the way", 800: "on the way", 1000: "last frame"}),
        (
            200,
            None,
            {0: "start", 200: "blue touched", 466: "on the way", 733: "on the way", 1000: "last frame"},
        ),
        (200, 400, {0: "start", 200: "blue touched", 400: "change", 700: "on the way", 1000: "last frame"}),
        (400, 200, {0: "start", 200: "change", 400: "blue touched", 700: "on the way", 1000: "last frame"}),
        (
            399,
            400,
            {0: "start", 400: "blue, change", 600: "on the way", 800: "on the way", 1000: "last frame"},
        ),
    ],
)
def test_key_steps(blue, change, expected):
    found = key_steps(run("spins", steps=1001, blue=blue, change=change))
    assert list(found.items()) == list(expected.items())


@given(st.data())
def test_key_steps_are_in_the_run_and_show_its_events(data):
    steps = data.draw(st.integers(1, 60))
    blue, change = (data.draw(st.none() | st.integers(1, steps - 1)) if steps > 1 else None for _ in range(2))
    found = key_steps(run("spins", steps=steps, blue=blue, change=change))
    assert list(found) == sorted(found) and list(found)[-1] == steps - 1 and 0 in found
    assert len(found) <= PICTURES
    if change is not None:
        assert change in found
    if blue is not None:
        assert blue in found or (change is not None and 0 <= change - blue <= AT_ONCE)
    if steps - max(blue or 0, change or 0) > PICTURES:
        assert len(found) == PICTURES


def test_stills_are_what_was_seen_and_the_run_must_end_as_it_did():
    source = PlannerSource("teacher")
    with closing(replay(source, WORLD, 0)) as moments:
        seen = list(moments)
    counted = Run(
        Path("i.json"),
        PlannerSource("teacher"),
        WORLD,
        0,
        seen[-1].outcome,
        "out_of_time",
        len(seen),
        None,
        None,
    )
    with tqdm(disable=True) as bar:
        found = stills(counted, bar)
        assert [still.when for still in found] == ["step 0", "step 9", "step 19", "step 29", "step 39"]
        for still, step in zip(found, (0, 9, 19, 29, 39), strict=True):
            near = [
                np.array_equal(still.view, seen[earlier].view)
                for earlier in range(max(step - 3, 0), step + 1)
            ]
            assert any(near)
            assert (still.macro, still.state) == (-1, f"phase {seen[step].phase}")
        for outcome, steps in (("red_first", 40), (counted.outcome, 39), (counted.outcome, 41)):
            other = Run(
                Path("i.json"), PlannerSource("teacher"), WORLD, 0, outcome, "out_of_time", steps, None, None
            )
            with pytest.raises(ValueError, match=r"^seed 0 ends with blue_never_reached after 40 steps, not"):
                stills(other, bar)


def test_results_go_between_their_marks(tmp_path):
    report = tmp_path / "docs/results.md"
    assert with_results(report, ["8 of 9"], None).startswith(f"{MARKS[0]}\n8 of 9\n")
    report.parent.mkdir()
    report.write_text(f"before\n\n{MARKS[0]}\nold\n{MARKS[1]}\nafter\n")
    found = with_results(report, ["8 of 9"], tmp_path / "pictures/failures.png")
    assert found.startswith(f"before\n\n{MARKS[0]}\n8 of 9\n") and found.endswith(f"\n{MARKS[1]}\nafter\n")
    assert "](../pictures/failures.png)" in found and "old" not in found


def script(*arguments):
    return subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, timeout=300
    )


@pytest.mark.benchmark
def test_from_runs_of_eval_to_a_report_with_stills(tmp_path):
    given = ("--world.max_steps=40", "--world.render_size=[64,48]", "--seed=0", "--episodes=2")
    done = script("eval.py", "--policy.type=teacher", *given, f"--output_dir={tmp_path / 'runs'}")
    assert done.returncode == 0, done.stderr
    report, picture = tmp_path / "results.md", tmp_path / "failures.png"
    options = (f"--runs={tmp_path / 'runs'}", f"--stills={picture}", f"--report={report}")
    done = script("benchmarks/failures.py", *options, f"--teacher={tmp_path / 'runs'}")
    assert done.returncode == 0, done.stderr
    assert "| out of time | 2 | 100% | 34% to 100% | 2 | 40 |" in done.stdout
    assert "| out of time | 2 | 100% |" in report.read_text() and "](failures.png)" in report.read_text()
    assert picture.read_bytes().startswith(b"\x89PNG")

    info = tmp_path / "runs/eval_info.json"
    info.write_text(info.read_text().replace("blue_never_reached", "red_first"))
    before = picture.read_bytes(), report.read_text()
    done = script("benchmarks/failures.py", *options)
    assert done.returncode == 2 and done.stderr.splitlines()[-1].startswith("error: seed 0 ends with blue")
    assert (picture.read_bytes(), report.read_text()) == before
    done = script("benchmarks/failures.py", f"--runs={tmp_path / 'runs'}", "--stills=failures.jpg")
    assert (
        done.returncode == 2
        and done.stderr == "error: --stills=failures.jpg: give a file that ends in .png\n"
    )
