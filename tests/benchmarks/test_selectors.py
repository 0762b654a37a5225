"""The selector's evidence: what a criterion's choice is worth, and a run that is written and resumed."""

import json
import re
import sys
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

from dpmacro.boosting.losses.classes import ExponentialLoss  # noqa: E402
from dpmacro.discovery.alternation import Alternated  # noqa: E402
from dpmacro.discovery.candidates import Candidate, Task  # noqa: E402
from dpmacro.discovery.criteria import CandidateScores, best_candidate  # noqa: E402
from dpmacro.discovery.result import Discovery  # noqa: E402
from dpmacro.figures import to_image  # noqa: E402
from dpmacro.switching.functions import SwitchFunctions  # noqa: E402
from dpmacro.utils import cli  # noqa: E402

CASE = {"group": "two_flags", "source": "two_flags", "case": "two_flags phase", "data": "ab", "seed": 0}
UNSEEN = dict.fromkeys(CRITERIA, 1.0)


def candidates(**columns):
    """A row for every candidate; criteria that are not given say the same of all."""
    count = len(next(iter(columns.values())))
    told = {"accuracy": [0.5] * count, "boundary_f1": [0.5] * count} | columns
    return [CASE | UNSEEN | {name: values[k] for name, values in told.items()} for k in range(count)]


def value(rows, criterion, metric):
    found = [row["value"] for row in rows if (row["criterion"], row["metric"]) == (criterion, metric)]
    assert len(found) <= 1
    return found[0] if found else None


def test_a_criterion_is_worth_the_candidate_it_chooses():
    rows = choices(
        candidates(
            accuracy=[0.6, 0.9, 1.0],
            boundary_f1=[0.1, 0.7, 0.4],
            training_loss=[1.0, 2.0, 3.0],
            recognised=[0.1, 0.8, 0.7],
        )
    )
    assert value(rows, "training_loss", "accuracy") == 0.6
    assert value(rows, "training_loss", "regret") == pytest.approx(0.4)
    assert value(rows, "training_loss", "boundary_f1_regret") == pytest.approx(0.6)
    assert value(rows, "training_loss", "spearman") == pytest.approx(-1)
    assert value(rows, "recognised", "accuracy") == 0.9  # more is better
    assert value(rows, "recognised", "spearman") == pytest.approx(0.5)
    assert value(rows, "best candidate", "regret") == 0


def test_ties_are_shared_and_have_no_ranks():
    rows = choices(candidates(accuracy=[0.5, 1.0, 0.9], hindsight_loss=[2.0, 2.0, 3.0]))
    assert value(rows, "hindsight_loss", "accuracy") == 0.75
    assert (
        value(rows, "unstable", "accuracy") == value(rows, "any candidate", "accuracy") == pytest.approx(0.8)
    )
    assert value(rows, "unstable", "spearman") is None


def test_a_criterion_without_a_say_has_no_choice():
    rows = choices(
        candidates(accuracy=[1.0, 0.5, 0.6], training_loss=[None, 2.0, 1.0], causal_loss=[None] * 3)
    )
    assert value(rows, "training_loss", "accuracy") == 0.6
    assert value(rows, "training_loss", "regret") == pytest.approx(0.4)  # beside all of the candidates
    assert value(rows, "causal_loss", "accuracy") is None


shares = st.floats(0, 1)
losses = st.lists(shares, min_size=3, max_size=3).map(torch.tensor)
scores = st.builds(
    CandidateScores,
    recognised=shares,
    causal=losses,
    causal_error=shares,
    hindsight=losses,
    context=losses,
    alone=losses,
)


@given(st.lists(scores, min_size=1, max_size=8))
def test_the_rule_ranks_all_and_its_choice_first(given_scores):
    ranks = rule_ranks(given_scores)
    assert sorted(ranks) == list(range(len(given_scores)))
    best = ranks.index(0)
    assert best == best_candidate(given_scores)
    rest = given_scores[:best] + given_scores[best + 1 :]
    if rest:
        second = [rank for place, rank in enumerate(ranks) if place != best].index(1)
        assert second == best_candidate(rest)


def test_criteria_of_classifiers_that_are_right():
    """Two trajectories; one macro-action of each, and each right about its own and wrong about the other."""
    truth, actions = torch.tensor([0, 0, 0, 1, 1, 1]), torch.tensor([0, 1, 0, 1, 0, 1])
    lengths = torch.tensor([3, 3])
    right = torch.where(torch.nn.functional.one_hot(actions, 2).bool(), 2.0, -2.0)
    left_out = torch.where(truth[:, None] == torch.arange(2), 1.0, -1.0)[:, :, None] * right[:, None]
    part = torch.tensor([0.125, 0.125])
    said = CandidateScores(0.5, part, 0.25, part, part, part)
    nothing = torch.zeros(0)
    switches = SwitchFunctions(
        (), (0, 1), nothing, (), nothing, torch.zeros(6, 0), torch.zeros(6, 0), torch.tensor([0, 1]), None
    )
    moved = torch.tensor([0, 0, 0, 0, 1, 1])
    found = [
        Candidate(labels, said, left_out, torch.ones(2), switches) for labels in (truth, moved, 1 - truth)
    ]
    ends = Alternated(torch.stack([truth, truth, moved]), torch.tensor([[9.0, 9, 9], [0.3, 0.2, 0.4]]))
    task = Task(actions, lengths, torch.arange(2), ExponentialLoss(2), 2, 1, 0)
    true, other, unknown = (criteria(one, Discovery(task, ends, tuple(found), 0)) for one in found)
    assert [one["unstable"] for one in (true, other, unknown)] == pytest.approx([0, 1 / 6, 1])
    assert true["training_loss"] == pytest.approx(0.2)  # the better of two outcomes alike
    assert np.isnan(unknown["training_loss"])
    small, large = 2 * np.exp(-2), 2 * np.exp(2)
    assert true["exponential_loss"] == pytest.approx(small, rel=1e-5)
    assert other["exponential_loss"] == pytest.approx((5 * small + large) / 6, rel=1e-5)
    bounded = 2 * np.log1p(np.exp(-2))  # margins cut off at 1
    assert [one["refitted_loss"] for one in (true, other, unknown)] == pytest.approx([bounded] * 3, rel=1e-5)
    assert true["causal_error"] == 0.25 and true["causal_loss"] == 0.25
    whole = Task(actions, torch.tensor([6]), torch.zeros(1, dtype=torch.int64), ExponentialLoss(2), 2, 1, 0)
    assert np.isnan(criteria(found[0], Discovery(whole, ends, tuple(found), 0))["causal_error"])


def test_tables_and_picture_have_every_group_and_criterion():
    columns = {"accuracy": [0.6, 0.9, 1.0], "training_loss": [1.0, 2.0, 3.0]}
    rows = choices([*candidates(**columns), *({**row, "group": "babyai"} for row in candidates(**columns))])
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
    assert {row["group"] for row in stored["candidates"]} == {"digits, whole", "digits, 6 parts"}
    assert {(row["group"], row["switch_weight"]) for row in stored["fits"]} == {
        (group, weight) for group in ("digits, whole", "digits, 6 parts") for weight in (0, 1)
    }
    whole = [row for row in stored["choices"] if row["group"] == "digits, whole"]
    assert not any(row["criterion"].startswith("causal") for row in whole)
    assert value(whole, "rule", "accuracy") is not None
    assert written.with_suffix(".png").stat().st_size > 1000
    for row in stored["candidates"]:
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


@pytest.mark.parametrize("text", ['[{"benchmark": "round"}]', '{"candidates": [{}], "fits": []}', "no json"])
def test_a_file_of_other_rows_is_one_line(tmp_path, text):
    other = tmp_path / "other.json"
    other.write_text(text)
    with pytest.raises(ValueError, match=r"other\.json holds no rows of this benchmark: give another"):
        main(SelectorOptions(sources=["digits"], output=other))
    assert other.read_text() == text
