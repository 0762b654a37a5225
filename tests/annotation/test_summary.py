"""Numbers of a segmentation, against what is known of it by construction."""

import json

import numpy as np
import pytest
from segmented import LENGTHS, VECTOR, random_demonstrations, some_summary

from dpmacro.annotation.summary import SCORES


def test_a_right_segmentation_scores_1_and_chance_less():
    summary = some_summary()
    assert set(summary.scores) == {"policy", "uniform cuts", "random cuts"}
    for scores in summary.scores.values():
        assert list(scores) == list(SCORES)
        assert scores["true_segments"] == scores["segments"] == 6
    assert all(summary.scores["policy"][name] == 1 for name in SCORES if "segments" not in name)
    assert summary.scores["random cuts"]["accuracy"] < 1
    assert summary.agreement == [1, 1, 1]


def test_agreement_is_that_of_every_demonstration_under_one_matching():
    labels = np.array([2, 0])[random_demonstrations().truth]
    labels[12:19] = 2 - labels[12:19]  # the second one the other way round
    summary = some_summary(labels=labels)
    assert summary.agreement == [1, 0, 1]
    assert summary.scores["policy"]["accuracy"] == pytest.approx(21 / 28)
    numbers = summary.as_json()
    assert [row["agreement"] for row in numbers["demonstrations"]] == [1, 0, 1]


def test_segments_confidence_and_macros():
    summary = some_summary()
    assert summary.segments == [[[2, 0, 6], [0, 6, 12]], [[2, 0, 3], [0, 3, 7]], [[2, 0, 4], [0, 4, 9]]]
    assert summary.confidence == [1, 0.25, 1]
    shares = [macro["share"] for macro in summary.macros]
    assert shares == pytest.approx([15 / 28, 0, 13 / 28])
    assert [macro["segments"] for macro in summary.macros] == [3, 0, 3]
    assert summary.macros[0]["frames_per_segment"] == 5
    assert summary.macros[0]["confidence"] == pytest.approx((11 + 4 * 0.25) / 15)
    assert summary.macros[1] == {
        "macro": 1,
        "share": 0,
        "segments": 0,
        "frames_per_segment": 0,
        "confidence": 0,
        "actions": dict.fromkeys(summary.demonstrations.action_names, 0),
    }
    assert sum(summary.macros[2]["actions"].values()) == pytest.approx(1)


def test_the_dimensions_of_vectors_have_means_and_deviations():
    summary = some_summary(vector=True)
    actions = summary.demonstrations.actions.astype(np.float64)
    one = summary.macros[0]
    assert "actions" not in one and [row["name"] for row in one["dimensions"]] == list(VECTOR)
    held = summary.labels == 0
    means, off = np.array([[row["mean"], row["deviations"]] for row in one["dimensions"]]).T
    np.testing.assert_allclose(means, actions[held].mean(0), rtol=1e-5)
    wanted = (actions[held].mean(0) - actions.mean(0))[:3] / actions.std(0)[:3]
    np.testing.assert_allclose(off, [*wanted, 0], atol=1e-5)
    assert means[2] == pytest.approx(10) and off[2] == pytest.approx(-((13 / 15) ** 0.5), abs=1e-5)
    assert summary.macros[1]["dimensions"] == []
    assert json.loads(json.dumps(summary.as_json()))["macros"] == summary.macros
    assert [line.name for line in summary.action_lines] == ["gripper", "dx", "dy"]
    assert some_summary().action_lines == []


def test_the_cost_is_that_of_a_frame():
    assert some_summary(bounds=3).cost_by_bound == pytest.approx([3, 2, 1])


def test_without_truth_there_is_nothing_to_score():
    summary = some_summary(truth=False)
    assert summary.scores == {} and summary.agreement is None
    numbers = json.loads(json.dumps(summary.as_json()))
    assert numbers["truth"] is None and len(numbers["demonstrations"]) == len(LENGTHS)
    assert numbers["demonstrations"][1]["episode"] == 7
