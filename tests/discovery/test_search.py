"""The search: what it proposes, what it keeps, in both recipes."""

from dataclasses import replace

import pytest
import torch
from visible import task_of, visible_change

from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.discovery import candidates, search
from dpmacro.discovery.candidates import score_candidates
from dpmacro.discovery.criteria import best_candidate
from dpmacro.discovery.search import adopt, discover
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts import initial_segmentations, random_cuts
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.metrics.frames import named_after_truth
from dpmacro.segmentation.given import FREE
from dpmacro.segmentation.segments import transition_counts

QUICK = {"rounds": 10, "warmup": 4, "drawn": 6}


@pytest.fixture(scope="module")
def toy():
    return visible_change(n=8, length=60)


@pytest.fixture(scope="module", params=["dpmacro", "paper"])
def found(request, toy):
    data, actions, lengths, _ = toy
    settings = SearchSettings(**QUICK, **({} if request.param == "dpmacro" else PAPER))
    reports = []
    task = task_of(actions, lengths, 3, 2)
    return request.param, task, discover(data, task, settings, 4, 0.3, reports.append), reports


PAPER = {"starts": "random", "criterion": "loss", "switch_weight": 0.0, "held": 0.0}


def test_a_search_finds_the_hidden_change(toy):
    data, actions, lengths, truth = toy
    kept = discover(data, task_of(actions, lengths), SearchSettings(**QUICK), 8, 0.3).kept
    assert kept.scores.runnable
    assert float((kept.labels == truth).float().mean()) > 0.97


def test_left_out_data_or_the_training_loss_decides(found):
    recipe, _, discovery, _ = found
    if recipe == "paper":
        [kept] = discovery.candidates
        least = discovery.alternated.loss[-1].argmin()
        assert discovery.best == 0 and torch.equal(kept.labels, discovery.alternated.labels[least])
    else:
        assert discovery.best == best_candidate(discovery.scores) and len(discovery.candidates) > 4
    assert discovery.kept is discovery.candidates[discovery.best]


def test_every_candidate_keeps_the_bound(found):
    _, task, discovery, _ = found
    for labels in (*discovery.alternated.labels, *(one.labels for one in discovery.candidates)):
        assert bool((transition_counts(labels, task.lengths) <= 2).all())
        assert int(labels.max()) < 3
    assert discovery.changes <= 2


def test_the_papers_recipe_starts_from_random_cuts_of_q_macro_actions(toy, monkeypatch):
    """The other recipe starts from several kinds of cuts, of fewer macro-actions as well."""
    data, actions, lengths, _ = toy
    task, asked = task_of(actions, lengths, 3, 2), []
    for name, starts in (("random_cuts", random_cuts), ("initial_segmentations", initial_segmentations)):
        monkeypatch.setattr(
            search, name, lambda *given, name=name, own=starts: asked.append((name, given[-3])) or own(*given)
        )
    for settings in (SearchSettings(**QUICK, **PAPER), SearchSettings(**QUICK, switch_weight=0.0)):
        discover(data, task, settings, 2, 0.3)
    paper, *ours = asked
    assert paper == ("random_cuts", 3)
    assert [one for one in ours if one[0] == "initial_segmentations"] == [
        ("initial_segmentations", 2),
        ("initial_segmentations", 3),
    ]


def test_without_weight_nothing_is_cut_again_by_switch_functions(toy, monkeypatch):
    data, actions, lengths, _ = toy
    cut = []
    monkeypatch.setattr(search, "recut", lambda scored, *given: cut.append(given[2]) or scored)
    for weight in (0.0, 0.5):
        discover(data, task_of(actions, lengths), SearchSettings(**QUICK, switch_weight=weight), 2, 0.3)
    assert cut == [0.5]


def test_a_known_segmentation_is_scored_in_place_of_a_search(toy):
    data, actions, lengths, truth = toy
    task = task_of(actions, lengths)
    adopted = adopt(data, task, truth)
    [scored] = score_candidates(data, task, truth[None])
    assert torch.equal(adopted.kept.labels, truth) and len(adopted.candidates) == 1
    assert adopted.kept.scores.scalars() == scored.scores.scalars()
    assert float(adopted.alternated.loss[-1, 0]) == pytest.approx(float(scored.scores.hindsight.sum()))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": "clever"}, "starts is 'clever': choose one of all, random"),
        ({"criterion": "luck"}, "criterion is 'luck'"),
        ({"rounds": 0}, "rounds is 0"),
        ({"drawn": 0}, "drawn is 0"),
        ({"warmup": -1}, "warmup is -1"),
        ({"switch_weight": -0.5}, "switch_weight is -0.5"),
        ({"switch_weight": float("inf")}, "switch_weight is inf"),
        ({"held": 1.5}, "held is 1.5"),
    ],
)
def test_bad_settings_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        SearchSettings(**options)


@pytest.mark.parametrize(
    ("macros", "sizes"), [(2, [2]), (3, [2, 3]), (4, [2, 3, 4]), (5, [2, 3, 4, 5]), (12, [2, 4, 6, 12])]
)
def test_of_many_macro_actions_a_few_smaller_numbers_are_searched(macros, sizes):
    actions = torch.arange(24) % 2
    task = replace(task_of(actions, torch.tensor([24])), macros=macros, max_transitions=20)
    assert [one.macros for one in search._smaller(task)] == sizes
    assert all(one.max_transitions == min(one.macros - 1, 20) for one in search._smaller(task)[:-1])


def vectors(n=10, length=60):
    """Three stages; in each another column decides both numbers of the action. And the true labels."""
    generator = torch.Generator().manual_seed(1)
    levels = torch.randint(0, 256, (6, n * length), dtype=torch.uint8, generator=generator)
    truth = (torch.arange(length) * 3 // length).repeat(n)
    seen = levels.float()[truth, torch.arange(n * length)] / 128 - 1
    actions = torch.stack([seen, seen.sign() * (truth + 1)], 1)
    lengths = torch.full((n,), length)
    loss = HuberLoss(2)
    return SortedLevels.build(levels), Task(actions, lengths, torch.arange(n), loss, 3, 2, seed=0), truth


def test_of_vectors_with_given_labels_all_go_on_that_agree_with_them():
    data, task, truth = vectors()
    some = torch.stack([truth, *(truth.roll(7 * k) for k in range(1, 7))])
    assert len(score_candidates(data, task, some)) < len(some)  # those that explain worse do not
    known = torch.full_like(truth, FREE)
    known[:1] = truth[:1]
    assert len(score_candidates(data, replace(task, given=known), some)) == len(some)


def test_of_vectors_what_explains_left_out_actions_best_goes_on_and_is_kept(monkeypatch):
    data, task, truth = vectors()
    monkeypatch.setattr(candidates, "FINALISTS", 0)
    monkeypatch.setattr(candidates, "LEADERS", 2)
    halves, shifted = (truth > 0).long(), truth.roll(9)
    scored = score_candidates(data, task, torch.stack([halves, truth, shifted, torch.zeros_like(truth)]))
    assert len(scored) == 2 and any(torch.equal(one.labels, truth) for one in scored)
    assert not any(torch.equal(one.labels, torch.zeros_like(truth)) for one in scored)
    found = discover(data, task, SearchSettings(rounds=20, warmup=8), 8, 0.3)
    assert (
        float((named_after_truth(found.kept.labels.numpy(), truth.numpy())[0] == truth.numpy()).mean()) > 0.95
    )
    least = min(float(one.hindsight.sum()) for one in found.scores)
    assert float(found.kept.scores.hindsight.sum()) <= least + 0.05
