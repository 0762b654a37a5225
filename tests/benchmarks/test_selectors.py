"""The selector's evidence: what a criterion's choice is worth, and a run that is written and resumed."""

import json
import re
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

from bench_selectors import SelectorOptions, criteria, main  # noqa: E402
from selector_scores import CRITERIA, choices, fit_table, picture, rule_ranks, table  # noqa: E402

from dpmacro.discovery.alternation import Alternated  # noqa: E402
from dpmacro.discovery.candidates import Judged, Task, Verdict, best_verdict  # noqa: E402
from dpmacro.discovery.result import Search  # noqa: E402
from dpmacro.figures import to_image  # noqa: E402
from dpmacro.switching.functions import SwitchFunctions  # noqa: E402
from dpmacro.utils import cli  # noqa: E402

CASE = {"group": "two_flags", "source": "two_flags", "case": "two_flags phase", "data": "ab", "seed": 0}
VERDICT = [field.name for field in fields(Verdict)]
UNSEEN = dict.fromkeys([*CRITERIA, *VERDICT], 1.0)


def rivals(**columns):
    """A row for every rival; criteria that are not given say the same of all."""
    count = len(next(iter(columns.values())))
    told = {"accuracy": [0.5] * count, "boundary_f1": [0.5] * count} | columns
    return [CASE | UNSEEN | {name: values[k] for name, values in told.items()} for k in range(count)]


def value(rows, criterion, metric):
    found = [row["value"] for row in rows if (row["criterion"], row["metric"]) == (criterion, metric)]
    assert len(found) <= 1
    return found[0] if found else None


def test_a_criterion_is_worth_the_rival_it_chooses():
    rows = choices(
        rivals(
            accuracy=[0.6, 0.9, 1.0],
            boundary_f1=[0.1, 0.7, 0.4],
            training_loss=[1.0, 2.0, 3.0],
            detected=[0.1, 0.8, 0.7],
        )
    )
    assert value(rows, "training_loss", "accuracy") == 0.6
    assert value(rows, "training_loss", "regret") == pytest.approx(0.4)
    assert value(rows, "training_loss", "boundary_f1_regret") == pytest.approx(0.6)
    assert value(rows, "training_loss", "spearman") == pytest.approx(-1)
    assert value(rows, "detected", "accuracy") == 0.9  # more is better
    assert value(rows, "detected", "spearman") == pytest.approx(0.5)
    assert value(rows, "best rival", "regret") == 0


def test_ties_are_shared_and_have_no_ranks():
    rows = choices(rivals(accuracy=[0.5, 1.0, 0.9], hindsight_loss=[2.0, 2.0, 3.0]))
    assert value(rows, "hindsight_loss", "accuracy") == 0.75
    assert value(rows, "unstable", "accuracy") == value(rows, "any rival", "accuracy") == pytest.approx(0.8)
    assert value(rows, "unstable", "spearman") is None


def test_a_criterion_without_a_say_has_no_choice():
    rows = choices(rivals(accuracy=[1.0, 0.5, 0.6], training_loss=[None, 2.0, 1.0], causal_loss=[None] * 3))
    assert value(rows, "training_loss", "accuracy") == 0.6
    assert value(rows, "training_loss", "regret") == pytest.approx(0.4)  # beside all of the rivals
    assert value(rows, "causal_loss", "accuracy") is None


def test_the_rule_is_that_of_dpboost():
    seen = {"accuracy": [0.6, 1.0], "hindsight_loss": [1.0, 2.0], "detected": [0.9, 0.9]}
    rows = rivals(**seen, gain=[-1.0, 0.1])
    assert value(choices(rows), "rule", "accuracy") == 1.0  # the first is not runnable
    rows = rivals(**seen, gain=[None, None], causal_loss=[None] * 2, causal_error=[None] * 2)
    assert value(choices(rows), "rule", "accuracy") == 0.6  # in hindsight


shares = st.floats(0, 1)
verdicts = st.builds(Verdict, **dict.fromkeys(VERDICT, shares) | {"gain": st.floats(-1, 1)})


@given(st.lists(verdicts, min_size=1, max_size=8))
def test_the_rule_ranks_all_and_its_choice_first(given_verdicts):
    ranks = rule_ranks(given_verdicts)
    assert sorted(ranks) == list(range(len(given_verdicts)))
    assert ranks[best_verdict(given_verdicts)] == 0


def test_criteria_of_classifiers_that_are_right():
    """Two trajectories; one macro-action of each, and each right about its own and wrong about the other."""
    truth, actions = torch.tensor([0, 0, 0, 1, 1, 1]), torch.tensor([0, 1, 0, 1, 0, 1])
    lengths = torch.tensor([3, 3])
    right = torch.where(torch.nn.functional.one_hot(actions, 2).bool(), 2.0, -2.0)
    scores = torch.where(truth[:, None] == torch.arange(2), 1.0, -1.0)[:, :, None] * right[:, None]
    verdict = Verdict(**dict.fromkeys(VERDICT, 0.25))
    switches = SwitchFunctions([], torch.zeros(0), torch.zeros(0), torch.zeros(6, 0), None)
    moved = torch.tensor([0, 0, 0, 0, 1, 1])
    outcomes = Alternated(torch.stack([truth, truth, moved]), torch.tensor([[9.0, 9, 9], [0.3, 0.2, 0.4]]))
    task = Task(actions, lengths, torch.arange(2), 2, 2, 1, 0)
    search = Search(task, outcomes, (), 0)
    found = {
        name: criteria(Judged(labels, verdict, scores, switches), search, actions, lengths)
        for name, labels in (("true", truth), ("moved", moved), ("unknown", 1 - truth))
    }
    assert [found[name]["unstable"] for name in found] == pytest.approx([0, 1 / 6, 1])
    assert found["true"]["training_loss"] == pytest.approx(0.2)  # the better of two outcomes alike
    assert np.isnan(found["unknown"]["training_loss"])
    small, large = 2 * np.exp(-2), 2 * np.exp(2)
    assert found["true"]["exponential_loss"] == pytest.approx(small, rel=1e-5)
    assert found["moved"]["exponential_loss"] == pytest.approx((5 * small + large) / 6, rel=1e-5)
    bounded = 2 * np.log1p(np.exp(-2))  # margins cut off at 1
    assert [found[name]["refitted_loss"] for name in found] == pytest.approx([bounded] * 3, rel=1e-5)
    assert found["true"]["causal_error"] == 0.25
    alone = criteria(Judged(truth, verdict, scores, switches), search, actions, torch.tensor([6]))
    assert np.isnan(alone["causal_error"]) and np.isnan(alone["gain"])


def test_tables_and_picture_have_every_group_and_criterion():
    columns = {"accuracy": [0.6, 0.9, 1.0], "training_loss": [1.0, 2.0, 3.0]}
    rows = choices([*rivals(**columns), *({**row, "group": "babyai"} for row in rivals(**columns))])
    lines = table(rows)
    assert "two_flags: boundaries within 10 frames" in lines and "babyai: boundaries within 1 frames" in lines
    [line, _] = [line.split() for line in lines if line.startswith("training_loss")]
    assert line[1:5] == ["1", "0.600", "0.400", "0.400"]
    assert to_image(picture(rows)).std() > 0
    fits = [
        CASE | {"seed": seed, "switch_weight": weight, "accuracy": 0.5 + weight / 4 + seed / 4}
        | dict.fromkeys(("precision", "recall", "boundary_f1"), 1.0)
        for seed in (0, 1)
        for weight in (0.0, 1.0)
    ]  # fmt: skip
    assert [line.split()[3:6] for line in fit_table(fits)[1:]] == [["1", "2", "0.875"], ["0", "2", "0.625"]]


@pytest.mark.benchmark
def test_a_run_is_written_and_resumed(tmp_path, capsys):
    options = {"sources": ["digits"], "seeds": [0], "quick": True, "output": tmp_path / "rows.json"}
    main(SelectorOptions(**options))
    printed = capsys.readouterr().out
    written = tmp_path / "rows_quick.json"
    stored = json.loads(written.read_text())
    assert {row["group"] for row in stored["rivals"]} == {"digits, whole", "digits, 6 parts"}
    assert {(row["group"], row["switch_weight"]) for row in stored["fits"]} == {
        (group, weight) for group in ("digits, whole", "digits, 6 parts") for weight in (0, 1)
    }
    whole = [row for row in stored["choices"] if row["group"] == "digits, whole"]
    assert not any(row["criterion"].startswith("causal") for row in whole)
    assert value(whole, "rule", "accuracy") is not None
    assert written.with_suffix(".png").stat().st_size > 1000
    for row in stored["rivals"]:
        row["accuracy"] = 0.125
    written.write_text(json.dumps(stored))
    main(SelectorOptions(**options))
    assert re.search(r"^rule +1 +0.125 ", capsys.readouterr().out, re.MULTILINE)
    assert not re.search(r"^rule +1 +0.125 ", printed, re.MULTILINE)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--sources=[chess]", "sources has 'chess': choose from digits"),
        ("--seeds=[-1]", "seeds has -1: give 0 or more"),
        ("--rounds=0", "rounds is 0: give 1 or more"),
    ],
)
def test_a_wrong_option_is_one_line(option, message):
    with pytest.raises(ValueError, match=message):
        cli.parse(SelectorOptions, [option])


@pytest.mark.parametrize("text", ['[{"benchmark": "round"}]', '{"rivals": [{}], "fits": []}', "no json"])
def test_a_file_of_other_rows_is_one_line(tmp_path, text):
    other = tmp_path / "other.json"
    other.write_text(text)
    with pytest.raises(ValueError, match=r"other\.json holds no rows of this benchmark: give another"):
        main(SelectorOptions(sources=["digits"], output=other))
    assert other.read_text() == text
