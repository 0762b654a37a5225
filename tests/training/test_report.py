"""What train.py says of what it found, beside the numbers: what cannot be run, what is unsettled."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

import train
from dpmacro.data.synthetic import two_rules
from dpmacro.estimator.dpboost import DPBoost
from dpmacro.parallel import ALONE
from dpmacro.training.run_folder import RunFolder

WARNING = "warning      no segmentation was found whose changes can be recognised as they come."


@pytest.fixture(scope="module")
def shown():
    """What DPBoost finds where a column shows the change."""
    data = two_rules(trajectories=8, length=60)
    model = DPBoost(rounds=20, restarts=2, shrinkage=0.3, switch_rounds=20)
    return model.fit(data.features, data.actions, data.lengths).result_


@pytest.fixture(scope="module")
def hidden(shown):
    """The same, had left-out data recognised no change."""
    scores = replace(shown.discovery.kept.scores, recognised=0.0)
    kept = replace(shown.discovery.kept, scores=scores)
    return replace(shown, terms=None, discovery=replace(shown.discovery, candidates=(kept,), best=0))


def said(result):
    return train.switch_report(SimpleNamespace(found=result))


def test_what_can_be_run_is_told_with_the_share_that_other_demonstrations_vouch_for(shown):
    assert shown.discovery.kept.scores.runnable and shown.unsettled == 0
    [share] = shown.switches.recognised.tolist()
    line, note = said(shown)
    assert line == f"switch 0->1  recognises {share:.0%} of the changes in left-out demonstrations"
    assert "threshold" in note and "other demonstrations" in note


def test_where_no_segmentation_can_be_run_a_warning_says_so_and_what_it_means(hidden):
    assert not hidden.discovery.kept.scores.runnable and hidden.switch_weight == 0
    [warning] = [line for line in said(hidden) if line.startswith("warning")]
    assert warning.startswith(WARNING)
    assert "hindsight" in warning.lower() and "switch_weight is 0" in warning


@pytest.mark.parametrize("frames", [0, 7])
def test_a_fit_that_did_not_settle_is_said_with_the_frames(shown, frames):
    lines = [line for line in said(replace(shown, unsettled=frames)) if line.startswith("unsettled")]
    told = f"unsettled    switch functions were fitted to other labels on {frames} of 480 frames"
    assert lines == [told] * (frames > 0)


def test_the_whole_report_has_those_lines(hidden):
    plan = SimpleNamespace(columns=6, of=6, drawn=0, gibibytes=0.7)
    policy = SimpleNamespace(config=SimpleNamespace(macros=2))
    unsettled = replace(hidden, unsettled=3)
    parts = {
        "ranks": ALONE,
        "plan": plan,
        "policy": policy,
        "pretrained": Path("run/pretrained_model"),
        "choice": None,
    }
    result = SimpleNamespace(found=unsettled, notes=("one thing", "another"), **parts)
    data, more, *lines = train.report(result, RunFolder(Path("nowhere")), 1.0).splitlines()
    assert [data, more] == ["data         one thing", "             another"]
    for line in said(unsettled):
        assert line in lines
    assert [line.split()[0] for line in lines[:3]] == ["objective", "macro", "macro"]
    assert torch.equal(hidden.labels.bincount(), torch.tensor([int(line.split()[2]) for line in lines[1:3]]))
