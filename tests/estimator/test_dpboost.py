"""DPBoost on data whose macro-actions are known."""

import numpy as np
import pytest
import torch

from dpmacro.boosting.crossfit import CLASSES
from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.data.synthetic import digits, two_rules
from dpmacro.discovery.candidates import FINALISTS, LEADERS
from dpmacro.estimator.dpboost import DPBoost
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.metrics import frame_accuracy
from dpmacro.segmentation.segments import starting_macros, transition_counts

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
QUICK = {"rounds": 8, "restarts": 2, "switch_rounds": 5}


def hidden_rule(seed, n=6, length=120):
    """Two features decide the action, one before a hidden change and the other after it; nothing shows it."""
    rng = np.random.default_rng(seed)
    features, actions, truth = [], [], []
    for _ in range(n):
        x = rng.normal(size=(length, 5))
        rule = (np.arange(length) >= rng.integers(30, 90)).astype(int)
        features.append(x)
        actions.append((x[np.arange(length), rule] > 0).astype(int))
        truth.append(rule)
    return np.concatenate(features), np.concatenate(actions), np.full(n, length), np.concatenate(truth)


@pytest.fixture(scope="module")
def fitted():
    features, actions, lengths, truth = hidden_rule(0)
    reports = []
    options = {"macros": 2, "rounds": 60, "restarts": 8, "shrinkage": 0.3, "switch_rounds": 20}
    model = DPBoost(**options).fit(features, actions, lengths, reports.append)
    return features, actions, lengths, truth, model, reports


@pytest.fixture(scope="module")
def signalled():
    """Changes that show themselves when they come."""
    data = two_rules(trajectories=8, length=60)
    options = {"rounds": 40, "restarts": 4, "shrinkage": 0.3, "switch_rounds": 20}
    return data, DPBoost(**options).fit(data.features, data.actions, data.lengths)


def test_finds_the_hidden_rule(fitted):
    features, actions, _, truth, model, _ = fitted
    assert frame_accuracy(model.labels_.numpy(), truth) > 0.95
    result = model.result_
    levels = result.quantiser.levels(torch.tensor(features.T).contiguous())
    scores = result.classifiers.scores(Frames(levels))
    chosen = scores[torch.arange(len(actions)), model.labels_].argmax(1)
    assert float((chosen.numpy() == actions).mean()) > 0.95


def test_keeps_the_bound_and_never_lets_the_objective_rise(fitted):
    _, _, lengths, _, model, _ = fitted
    lengths, alternated = torch.tensor(lengths), model.result_.discovery.alternated
    for labels in (model.labels_, *alternated.labels):
        assert (transition_counts(labels, lengths) <= 1).all()
    for loss in (model.result_.loss, *alternated.loss.T):
        assert (loss.diff() <= 1e-4 * loss[:-1]).all()


def test_reports_every_round(fitted):
    """The search; classifiers and switch functions of what it found; and what left-out data says of those."""
    *_, model, reports = fitted
    stages = [report.stage for report in reports]
    assert stages[:80] == ["discover"] * 80
    scoring = CLASSES.shared + CLASSES.own
    first_fit = stages.index("fit")
    between = stages[80:first_fit]
    screened = between.count("recognise")
    assert between[:screened] == ["recognise"] * screened and screened > FINALISTS + LEADERS
    assert set(between[screened:]) <= {"score", "switch"} and between.count("score") % scoring == 0
    assert stages[-scoring:] == ["score"] * scoring, "the labels that were settled on"
    fits = [report for report in reports if report.stage == "fit"][-60:]
    assert [report.number for report in fits] == list(range(1, 61))
    assert [report.loss for report in fits] == pytest.approx(model.result_.loss.tolist())
    assert fits[-1].accuracy > 0.95 and "switch" in stages[first_fit:]


def test_what_is_found_ends_in_an_underscore_and_fit_returns_the_estimator(fitted):
    features, actions, lengths, _, model, _ = fitted
    result = model.result_
    assert isinstance(model, DPBoost)
    assert torch.equal(model.labels_, result.labels) and torch.equal(model.confidence_, result.confidence)
    assert bool(((model.confidence_ >= 0) & (model.confidence_ <= 1)).all())
    for ask in (DPBoost().predict, DPBoost().segment, DPBoost().score):
        with pytest.raises(ValueError, match="call fit first"):
            ask(features, *([actions] if ask.__name__ != "predict" else []), lengths)


def test_changes_that_nothing_shows_are_cut_in_hindsight(fitted):
    """They cannot be run: switch functions have no say, and are not asked to move the changes."""
    *_, model, _ = fitted
    result = model.result_
    assert not result.discovery.kept.scores.runnable
    assert result.terms is None and result.switch_weight == 0.0


def test_segmenting_the_data_of_fit_gives_its_labels(fitted, signalled):
    features, actions, lengths, _, hidden, _ = fitted
    data, shown = signalled
    assert torch.equal(hidden.segment(features, actions, lengths), hidden.labels_)
    assert shown.result_.switch_weight == 1.0 and shown.result_.unsettled == 0
    assert torch.equal(shown.segment(data.features, data.actions, data.lengths), shown.labels_)
    assert frame_accuracy(shown.labels_.numpy(), data.truth) > 0.99


def test_new_sequences_are_segmented_and_run(signalled):
    _, model = signalled
    new = two_rules(trajectories=8, length=60, seed=1)
    told = model.segment(new.features, new.actions, new.lengths)
    assert frame_accuracy(told.numpy(), new.truth) > 0.97
    run = model.predict(new.features, new.lengths)
    assert frame_accuracy(run.numpy(), new.truth) > 0.7  # a change that is missed once is missed for good
    assert model.score(new.features, new.actions, new.lengths) > 0.8
    once = torch.tensor(new.lengths)
    assert bool((transition_counts(told, once) <= 1).all())
    # Never looking ahead: what comes later changes no label before it.
    spoiled = new.features.copy().reshape(8, 60, -1)
    spoiled[:, 30:] = 0
    again = model.predict(spoiled.reshape(480, -1), new.lengths)
    assert torch.equal(again.view(8, 60)[:, :30], run.view(8, 60)[:, :30])


def both_starts(seed, n=16, length=50):
    """Every other trajectory begins with the second rule, and shows it by column 5 of its first frames."""
    data = two_rules(n, length, seed)
    features, second = data.features.reshape(n, length, -1).copy(), np.arange(n) % 2 == 1
    features[second] = features[second][:, :, [0, 2, 1, 3, 4, 5]]
    features[second, :3, 5] += 6
    truth = data.truth.reshape(n, length) ^ second[:, None]
    return features.reshape(n * length, -1), data.actions, data.lengths, truth.reshape(-1)


def test_the_first_frame_tells_where_a_run_starts():
    features, actions, lengths, truth = both_starts(0)
    model = DPBoost(rounds=30, restarts=2, shrinkage=0.3, switch_rounds=20).fit(features, actions, lengths)
    assert frame_accuracy(model.labels_.numpy(), truth) > 0.95
    assert model.result_.switches.starts == (0, 1)
    firsts = starting_macros(model.labels_, torch.tensor(lengths))
    left_out = model.result_.switches.first
    assert float((left_out == firsts).float().mean()) > 0.8
    new, _, _, _ = both_starts(1)
    run = starting_macros(model.predict(new, lengths), torch.tensor(lengths))
    assert torch.equal(run, firsts), "every other one, as in the data of fit"


def test_a_single_start_asks_nothing_of_the_first_frame(signalled):
    data, model = signalled
    switches = model.result_.switches
    levels = torch.zeros(data.features.shape[1], 3, dtype=torch.uint8)
    assert switches.starts == (0,)
    assert switches.classifier.scores(Frames(levels)).shape[1] == len(switches.pairs)
    other = two_rules(trajectories=8, length=60, seed=2)
    assert not starting_macros(
        model.predict(other.features, other.lengths), torch.tensor(other.lengths)
    ).any()


@pytest.mark.parametrize("device", DEVICES)
def test_a_seed_repeats_and_leaves_the_global_generator_alone(device):
    features, actions, lengths, _ = hidden_rule(1, n=3, length=40)
    before = torch.random.get_rng_state()
    given = torch.tensor(features, device=device), actions, lengths
    fits = [DPBoost(**QUICK, seed=5, device=device).fit(*given).result_ for _ in range(2)]
    assert torch.equal(fits[0].labels, fits[1].labels)
    assert torch.equal(fits[0].loss, fits[1].loss)
    assert torch.equal(before, torch.random.get_rng_state())


def test_one_macro_action_is_the_baseline():
    features, actions, lengths, _ = hidden_rule(2, n=2, length=40)
    model = DPBoost(macros=1, rounds=10).fit(features, actions, lengths)
    result = model.result_
    assert result.discovery is None and result.final is None
    assert (result.labels == 0).all() and (result.confidence == 1).all()
    assert float(result.loss[-1]) < float(result.loss[0])
    assert not model.predict(features, lengths).any() and not model.segment(features, actions, lengths).any()


def test_levels_can_be_given_sorted_already():
    features, actions, lengths, _ = hidden_rule(3, n=2, length=40)
    columns = torch.tensor(features.T).contiguous()
    data = SortedLevels.build(Quantiser.fit(columns).levels(columns))
    given = DPBoost(**QUICK).fit_levels(data, actions, lengths)
    raw = DPBoost(**QUICK).fit(features, actions, lengths).result_
    assert torch.equal(given.labels, raw.labels)
    assert given.quantiser is None and raw.quantiser is not None


def test_a_known_segmentation_takes_the_place_of_the_search(signalled):
    data, model = signalled
    columns = torch.tensor(data.features.T).contiguous()
    levels = SortedLevels.build(model.result_.quantiser.levels(columns))
    known = torch.tensor(data.truth)
    given = levels, data.actions, data.lengths
    estimator = DPBoost(rounds=20, shrinkage=0.3, switch_rounds=20)
    discovery = estimator.discover_levels(*given, known=known)
    assert len(discovery.candidates) == 1 and torch.equal(discovery.kept.labels, known)
    found = estimator.fit_levels(*given, discovery=discovery)
    assert found.discovery is discovery and torch.equal(found.labels, known)


def test_the_papers_recipe_from_end_to_end(signalled):
    data, _ = signalled
    reports = []
    model = DPBoost(recipe="paper", rounds=30, restarts=4, switch_rounds=20)
    model.fit(data.features, data.actions, data.lengths, reports.append)
    result = model.result_
    assert len(result.discovery.candidates) == 1, "the training loss alone decides"
    assert result.terms is None and result.switch_weight == 0.0 and result.unsettled == 0
    assert result.switches.cues == () and not result.switches.thresholds.any()
    assert {report.stage for report in reports} == {"discover", "score", "fit", "switch"}
    assert frame_accuracy(model.labels_.numpy(), data.truth) > 0.9
    assert torch.equal(model.segment(data.features, data.actions, data.lengths), model.labels_)
    assert model.predict(data.features, data.lengths).shape == model.labels_.shape


def test_options_are_read_and_changed_by_name():
    model = DPBoost(macros=3, recipe="paper")
    options = model.get_params()
    assert options["macros"] == 3 and options["recipe"] == "paper" and options["switch_rounds"] == 400
    assert DPBoost(**options).get_params() == options
    assert model.set_params(macros=4, seed=2) is model
    assert (model.macros, model.seed, model.recipe) == (4, 2, "paper")
    for wrong, message in (({"macro": 2}, "macro is no option of DPBoost"), ({"seed": -1}, "seed is -1")):
        with pytest.raises(ValueError, match=message):
            model.set_params(shrinkage=0.5, **wrong)
        assert model.shrinkage == 0.1, "nothing changes"
    with pytest.raises(TypeError):
        DPBoost(2)


def test_a_learner_of_the_callers_own_is_asked(signalled):
    data, _ = signalled
    columns = torch.tensor(data.features.T).contiguous()
    levels = SortedLevels.build(Quantiser.fit(columns).levels(columns))
    asked = []

    class Noted(StumpLearner):
        def fit(self, *given):
            asked.append(self)
            return super().fit(*given)

    learner, switch_learner = Noted(levels), Noted(levels, 4)
    own = {"learner": learner, "switch_learner": switch_learner}
    DPBoost(rounds=5, restarts=2, switch_rounds=3).fit_levels(levels, data.actions, data.lengths, **own)
    assert {id(one) for one in asked} == {id(learner), id(switch_learner)}


@pytest.mark.parametrize("seed", [1, 2])
def test_recovers_the_rules_of_a_sequence_of_digits(seed):
    """Odd, or 5 or more: the rule changes at 19 hidden points of one sequence."""
    data = digits(2, seed, segments=20)
    options = {"macros": 2, "max_transitions": 19, "restarts": 16, "rounds": 100, "switch_rounds": 20}
    model = DPBoost(**options).fit(data.features, data.actions, data.lengths)
    assert frame_accuracy(model.labels_.numpy(), data.truth) >= 0.97
    assert torch.equal(model.segment(data.features, data.actions, data.lengths), model.labels_)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"macros": 0}, "macros is 0"),
        ({"macros": 2, "max_transitions": -1}, "max_transitions is -1"),
        ({"macros": 2, "rounds": 0}, "rounds is 0"),
        ({"macros": 2, "restarts": 0}, "restarts is 0"),
        ({"macros": 2, "shrinkage": 2.0}, "shrinkage is 2.0"),
        ({"recipe": "mine"}, "recipe is 'mine'"),
        ({"macros": 99}, "macros is 99 but there are only 20 frames"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        DPBoost(**arguments).fit(np.zeros((20, 2)), np.zeros(20, np.int64), [10, 10])


@pytest.mark.parametrize(
    ("features", "actions", "lengths", "message"),
    [
        (np.array([[0.0], [np.nan]]), [0, 1], [2], r"^features\[1, 0\] is nan"),
        (np.zeros((3, 1)), [0, 1], [3], "^actions are 2 but there are 3 frames"),
        (np.zeros((2, 1)), [0, -1], [2], r"^actions\[1\] is -1"),
        (np.zeros((2, 1)), [0, 1], [1], "^lengths add up to 1"),
    ],
)
def test_bad_data_is_named(features, actions, lengths, message):
    with pytest.raises(ValueError, match=message):
        DPBoost(macros=1, rounds=1).fit(features, np.array(actions), lengths)
