"""Numbers of a segmentation, against what is known of it by construction."""

import json

import numpy as np
import pytest
from segmented import LENGTHS, random_demonstrations, some_findings

from dpmacro.annotation.summary import SCORES


def test_a_right_segmentation_scores_1_and_chance_less():
    findings = some_findings()
    assert set(findings.scores) == {"policy", "uniform cuts", "random cuts"}
    for scores in findings.scores.values():
        assert list(scores) == list(SCORES)
        assert scores["true_segments"] == scores["segments"] == 6
    assert all(findings.scores["policy"][name] == 1 for name in SCORES if "segments" not in name)
    assert findings.scores["random cuts"]["accuracy"] < 1
    assert findings.agreement == [1, 1, 1]


def test_agreement_is_that_of_every_demonstration_under_one_matching():
    labels = np.array([2, 0])[random_demonstrations().truth]
    labels[12:19] = 2 - labels[12:19]  # the second one the other way round
    findings = some_findings(labels=labels)
    assert findings.agreement == [1, 0, 1]
    assert findings.scores["policy"]["accuracy"] == pytest.approx(21 / 28)
    summary = findings.summary()
    assert [row["agreement"] for row in summary["demonstrations"]] == [1, 0, 1]


def test_segments_confidence_and_macros():
    findings = some_findings()
    assert findings.segments == [[[2, 0, 6], [0, 6, 12]], [[2, 0, 3], [0, 3, 7]], [[2, 0, 4], [0, 4, 9]]]
    assert findings.confidence == [1, 0.25, 1]
    shares = [macro["share"] for macro in findings.macros]
    assert shares == pytest.approx([15 / 28, 0, 13 / 28])
    assert [macro["segments"] for macro in findings.macros] == [3, 0, 3]
    assert findings.macros[0]["frames_per_segment"] == 5
    assert findings.macros[0]["confidence"] == pytest.approx((11 + 4 * 0.25) / 15)
    assert findings.macros[1] == {
        "macro": 1,
        "share": 0,
        "segments": 0,
        "frames_per_segment": 0,
        "confidence": 0,
        "actions": dict.fromkeys(findings.demonstrations.action_names, 0),
    }
    assert sum(findings.macros[2]["actions"].values()) == pytest.approx(1)


def test_the_cost_is_that_of_a_frame():
    assert some_findings(bounds=3).cost_by_bound == pytest.approx([3, 2, 1])


def test_without_truth_there_is_nothing_to_score():
    findings = some_findings(truth=False)
    assert findings.scores == {} and findings.agreement is None
    summary = json.loads(json.dumps(findings.summary()))
    assert summary["truth"] is None and len(summary["demonstrations"]) == len(LENGTHS)
    assert summary["demonstrations"][1]["episode"] == 7
