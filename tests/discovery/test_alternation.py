"""The alternation: an objective that never rises, under the bound, and what the labels cost."""

import sys
import types
import warnings
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.discovery import alternation
from dpmacro.discovery.alternation import Alternated, ObjectiveWarning, alternate, pooled
from dpmacro.discovery.starts import random_cuts
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import transition_counts
from dpmacro.switching.costs import SwitchCosts

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
LENGTHS = torch.tensor([30, 1, 25, 18])
FRAMES = int(LENGTHS.sum())
STARTS = [0, 30, 31, 56]


def run(
    seed=0,
    restarts=1,
    macros=3,
    bound=2,
    rounds=14,
    warmup=4,
    extra=None,
    on_round=lambda _: None,
    device="cpu",
):
    generator = torch.Generator().manual_seed(seed)
    levels = torch.randint(0, 256, (8, FRAMES), dtype=torch.uint8, generator=generator)
    actions = torch.randint(0, 3, (FRAMES,), generator=generator)
    starts = random_cuts(LENGTHS, restarts, macros, bound, generator)
    learner = StumpLearner(SortedLevels.build(levels.to(device)))
    boosting = Boosting(learner, class_targets(actions, 3), restarts * macros, 0.3, generator)
    given = actions, LENGTHS, starts, macros, bound, rounds, warmup, "fit", on_round, extra
    return alternate(boosting, *given), starts, boosting


def charges(macros=3, seed=0, size=1.0):
    """Switch costs that may be negative: a change is sometimes cheaper than to stay."""
    generator = torch.Generator().manual_seed(seed)
    staying = size * torch.rand(FRAMES, macros, generator=generator, dtype=torch.float64)
    changing = size * torch.randn(FRAMES, macros, macros, generator=generator, dtype=torch.float64)
    return SwitchCosts(staying, changing)


def by_hand(labels, costs, extra=None):
    """The objective by a plain loop over frames."""
    total = 0.0
    for n, q in enumerate(labels.tolist()):
        total += float(costs[n, q])
        if extra is not None:
            total += float(extra.staying[n, q])
            if n not in STARTS and q != int(labels[n - 1]):
                total += float(extra.changing[n, labels[n - 1], q])
    return total


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**16), st.integers(1, 4), st.integers(0, 4), st.booleans())
def test_the_objective_never_rises_and_labels_keep_the_bound(seed, macros, bound, with_switches):
    extra = charges(macros, seed) if with_switches else None
    reports = []
    ended, starts, _ = run(seed, 1, macros, bound, extra=extra, on_round=reports.append)
    loss = ended.loss[:, 0]
    assert bool((loss.diff() <= 1e-4 * loss[:-1].abs()).all())
    for labels in (starts[0], ended.labels[0], *(report.labels for report in reports)):
        assert bool((transition_counts(labels, LENGTHS) <= bound).all())


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("extra", [None, charges()], ids=["actions alone", "with switch costs"])
def test_the_loss_is_what_labels_cost(extra, device):
    reports = []
    ended, _, boosting = run(extra=extra, on_round=reports.append, device=device)
    costs = boosting.losses().cpu()
    assert float(ended.loss[-1, 0]) == pytest.approx(by_hand(ended.labels[0], costs, extra) / FRAMES)
    assert [report.loss for report in reports] == pytest.approx(ended.loss[:, 0].tolist())
    assert torch.equal(reports[-1].labels.cpu(), ended.labels[0])
    frames = torch.arange(FRAMES)
    right = boosting.scores.cpu()[frames, ended.labels[0]].argmax(1) == boosting.targets.cpu()[
        :, 0
    ].int().argmax(1)
    assert reports[-1].accuracy == pytest.approx(float(right.float().mean()))


def test_every_restart_has_its_own_loss_and_the_least_is_reported():
    reports = []
    ended, starts, boosting = run(2, restarts=4, on_round=reports.append)
    assert ended.labels.shape == starts.shape and ended.loss.shape == (14, 4)
    costs = boosting.losses().unflatten(1, (4, 3))
    for k in range(4):
        assert float(ended.loss[-1, k]) == pytest.approx(by_hand(ended.labels[k], costs[:, k]) / FRAMES)
    assert [report.loss for report in reports] == pytest.approx(ended.loss.amin(1).tolist())
    best = int(ended.loss[-1].argmin())
    assert best != 0 and torch.equal(reports[-1].labels, ended.labels[best])
    chosen = boosting.scores.unflatten(1, (4, 3))[torch.arange(FRAMES), best, ended.labels[best]].argmax(1)
    right = chosen == boosting.targets[:, 0].int().argmax(1)
    assert reports[-1].accuracy == pytest.approx(float(right.float().mean()))


def test_a_start_comes_to_the_same_end_alone_and_among_others():
    together, starts, boosting = run(restarts=3)
    again = Boosting(boosting.learner, boosting.targets, 3, 0.3, torch.Generator())
    actions = boosting.targets[:, 0].int().argmax(1)
    alone = alternate(again, actions, LENGTHS, starts[1:2], 3, 2, 14, 4, "fit")
    assert torch.equal(alone.labels[0], together.labels[1])
    torch.testing.assert_close(alone.loss[:, 0], together.loss[:, 1])


@pytest.mark.parametrize("warmup", [0, 1, 5, 14])
@pytest.mark.parametrize("extra", [None, charges(size=5.0)], ids=["actions alone", "with switch costs"])
def test_a_warmup_holds_the_labels(warmup, extra):
    reports = []
    _, starts, _ = run(warmup=warmup, extra=extra, on_round=reports.append)
    held = [torch.equal(report.labels, starts[0]) for report in reports]
    assert held[:warmup] == [True] * warmup
    assert all(report.label_changes == 0 for report in reports[:warmup])
    if warmup < 14:
        assert not held[warmup]
        moved = float((reports[warmup].labels != starts[0]).float().mean())
        assert reports[warmup].label_changes == pytest.approx(moved) != 0


def test_switch_costs_move_the_labels():
    """A change into macro-action 1 that is dear everywhere but at one frame comes at that frame."""
    staying, changing = torch.zeros(FRAMES, 2).double(), torch.full((FRAMES, 2, 2), 1e3).double()
    changing[[12, 40], 0, 1] = -1e3
    ended = run(macros=2, bound=1, warmup=0, extra=SwitchCosts(staying, changing))[0]
    moved = (ended.labels[0].diff() != 0).nonzero()[:, 0] + 1
    assert [n for n in moved.tolist() if n not in STARTS] == [12, 40]
    staying[:, 1] = 1e4
    ended = run(macros=2, bound=1, warmup=0, extra=SwitchCosts(staying, changing.abs()))[0]
    assert not ended.labels.any()


def test_one_macro_action_and_nothing_to_learn_end_early():
    learner = StumpLearner(SortedLevels.build(torch.zeros(2, FRAMES, dtype=torch.uint8)))
    actions = torch.arange(FRAMES) % 2
    boosting = Boosting(learner, class_targets(actions, 2), 1, 0.3, torch.Generator())
    reports = []
    zeros = torch.zeros(1, FRAMES, dtype=torch.int64)
    ended = alternate(boosting, actions, LENGTHS, zeros, 1, 3, 50, 0, "fit", reports.append)
    assert len(ended.loss) == len(reports) < 50
    assert not ended.labels.any() and reports[-1].ended == (0,)


def test_switch_costs_are_those_of_one_segmentation():
    with pytest.raises(ValueError, match="2 starts: they belong to one segmentation"):
        run(restarts=2, extra=charges())


class Scripted(Boosting):
    """Boosting whose losses are given round by round, and whose problems ended long ago or never do."""

    def __init__(self, losses, ended):
        learner = StumpLearner(SortedLevels.build(torch.zeros(1, losses.shape[1], dtype=torch.uint8)))
        targets = class_targets(torch.arange(losses.shape[1]) % 2, 2)
        super().__init__(learner, targets, losses.shape[2], 0.3, torch.Generator())
        self.given, self.number = losses, 0
        self.ended = torch.full((losses.shape[2],), ended)

    def round(self, base):
        self.number += 1
        return torch.zeros(0, dtype=torch.int64)

    def losses(self):
        return self.given[self.number - 1]


def scripted(losses, restarts=1, ended=False, alternate=alternate, **options):
    """The alternation over one trajectory of those losses, with two macro-actions."""
    n_frames = losses.shape[1]
    given = torch.arange(n_frames) % 2, torch.tensor([n_frames]), torch.zeros(restarts, n_frames).long()
    return alternate(Scripted(losses, ended), *given, 2, 1, len(losses), 0, "fit", **options)


def test_it_goes_on_while_labels_change_though_no_problem_finds_anything():
    """For five rounds the change moves, then it stays."""
    cuts = torch.tensor([3, 4, 5, 6, 7, 7, 7, 7])
    second = torch.arange(10) >= cuts[:, None]
    right = torch.stack([~second, second], 2)
    losses = torch.where(right, 1.0 - torch.arange(8)[:, None, None] / 100, 2.0)
    reports = []
    ended = scripted(losses, ended=True, on_round=reports.append)
    assert [report.label_changes > 0 for report in reports] == [True] * 5 + [False]
    assert len(ended.loss) == 6 and torch.equal(ended.labels[0], second[-1].long())


RISING = torch.tensor([1.0, 0.9, 1.2, 1.1, 1.1])[:, None, None].expand(-1, 10, 2) + torch.eye(10, 2)


def test_a_rising_objective_is_warned_of_and_training_goes_on():
    reports = []
    with pytest.warns(ObjectiveWarning, match=r"stage 'fit' rose in round 3, by 0\.\d+ of itself") as told:
        ended = scripted(RISING, on_round=reports.append)
    assert len(told) == 1 and len(reports) == len(ended.loss) == 5
    assert float(ended.loss[2, 0]) > float(ended.loss[1, 0])


def test_one_of_several_starts_that_rises_is_enough_for_a_warning():
    both = torch.cat([torch.ones_like(RISING), RISING], 2)
    with pytest.warns(ObjectiveWarning, match="rose in round 3"):
        scripted(both, restarts=2)


def test_what_rounding_explains_is_no_reason_to_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scripted(torch.tensor([1.0, 1.00005])[:, None, None].expand(-1, 10, 2) + torch.zeros(2, 10, 2))


def test_the_warning_does_not_hang_on_assertions(monkeypatch):
    """Python leaves those out under -O."""
    optimised = types.ModuleType("optimised")
    monkeypatch.setitem(sys.modules, "optimised", optimised)
    path = alternation.__file__
    exec(compile(Path(path).read_text(), path, "exec", optimize=2), vars(optimised))
    with pytest.warns(optimised.ObjectiveWarning, match="rose in round 3"):
        assert len(scripted(RISING, alternate=optimised.alternate).loss) == 5


def test_alternations_that_ended_early_are_pooled_as_they_ended():
    long, short = (
        Alternated(
            torch.full((restarts, 3), rounds), torch.arange(1.0, rounds + 1)[:, None].repeat(1, restarts)
        )
        for rounds, restarts in ((4, 2), (2, 1))
    )
    both = pooled([long, short])
    assert both.labels[:, 0].tolist() == [4, 4, 2]
    assert both.loss.tolist() == [[1, 1, 1], [2, 2, 2], [3, 3, 2], [4, 4, 2]]
