"""A trained policy finds its own labels again, and says how sure it is of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from segmented import IMAGE, STATE, random_demonstrations, random_policy

from dpmacro.annotation import annotate as annotation
from dpmacro.annotation.annotate import annotate
from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.vectors import ActionTransform
from dpmacro.estimator.dpboost import DPBoost
from dpmacro.features.base import frames_before
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import CameraSpec, StateSpec, make_encoder, make_features
from dpmacro.features.memory import Plan
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.segmentation.segments import transition_counts
from dpmacro.switching.costs import change_log_odds

SHAPE = (6, 8)
LENGTHS = np.array([40, 25, 35])
NAMES = ("forward", "left", "right", "never seen")


def noise_with_a_rule(seed=0):
    """The left half of an image decides before a hidden change, the right half after it."""
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 256, (LENGTHS.sum(), *SHAPE, 3), np.uint8)
    bright = rng.integers(0, 2, (LENGTHS.sum(), 2))
    images[:, :, :4] = images[:, :, :4] // 2 + 128 * bright[:, :1, None, None].astype(np.uint8)
    images[:, :, 4:] = images[:, :, 4:] // 2 + 128 * bright[:, 1:, None, None].astype(np.uint8)
    rule = np.concatenate([np.arange(length) >= length // 2 for length in LENGTHS]).astype(int)
    actions = bright[np.arange(len(rule)), rule] + rule
    return Demonstrations.of_images(images, actions, LENGTHS, NAMES, 10.0, None, {}, Path("data/some"))


def train(demonstrations, macros=2, truth=None, **options):
    """A policy and what it was trained with; the `truth` takes the place of a search where it is given."""
    generator = torch.Generator().manual_seed(0)
    specs = {}
    for key, values in demonstrations.observations.items():
        specs[key] = CameraSpec(*SHAPE) if values.ndim == 4 else StateSpec(demonstrations.state_names[key])
    features = make_encoder(specs, "rectangles", 60, 5, 0, generator)
    seen = {key: torch.from_numpy(values) for key, values in demonstrations.observations.items()}
    lengths = torch.from_numpy(demonstrations.lengths)
    plan = Plan(features.count, features.count, 0, 0.0)
    features, quantiser, data = prepare(seen, lengths, features, plan, generator)
    actions, transform = demonstrations.actions, None
    if demonstrations.vector:
        transform = ActionTransform.fit(actions, demonstrations.lengths, names=demonstrations.action_names)
        actions = transform.targets(actions)
    given = data, torch.from_numpy(actions), lengths
    chosen = {"rounds": 15, "restarts": 4, "shrinkage": 0.3, "switch_rounds": 20, **options}
    dpboost = DPBoost(macros=macros, **chosen)
    found = dpboost.fit_levels(*given, discovery=dpboost.discover_levels(*given, known=truth))
    switches, odds = found.switches, [] if found.terms is None else found.terms.log_odds.tolist()
    config = PolicyConfig(
        type="dpboost",
        macros=found.macros,
        starts=switches.starts,
        inputs={key: InputConfig(values.shape[1:]) for key, values in demonstrations.observations.items()},
        encoder=features.spec(),
        action_names=demonstrations.action_names,
        outputs=found.action_loss.outputs,
        loss="huber" if transform else "exponential",
        action_transform=transform.to_dict() if transform else None,
        switches=switches.pairs,
        thresholds=tuple(switches.thresholds.tolist()),
        cues=switches.cues,
        order=found.order,
        max_transitions=found.max_transitions,
        switch_weight=found.switch_weight,
        change_log_odds=tuple(map(tuple, odds)),
    )
    return MacroPolicy.compact(config, features, quantiser, found.classifiers, switches.classifier), found


@pytest.fixture(scope="module")
def trained():
    """From the actions alone."""
    demonstrations = noise_with_a_rule()
    policy, found = train(demonstrations, switch_weight=0.0)
    return policy, demonstrations, found


def test_the_labels_are_those_of_the_training(trained):
    policy, demonstrations, found = trained
    seen = annotate(policy, demonstrations)
    assert found.macros == 2 and torch.equal(seen.labels, found.labels)
    assert float(seen.cost_by_bound[:, -1].sum()) / len(found.labels) == pytest.approx(
        float(found.loss[-1]), rel=1e-4
    )
    assert seen.cost_by_bound.shape == (3, 2)


def test_the_labels_are_those_of_the_training_where_switch_costs_joined():
    """Frames are lit from above for three frames from the change on; one action in five is wrong."""
    rng = np.random.default_rng(0)
    n, length = 10, 60
    since = np.tile(np.arange(length), n) - rng.integers(20, 40, n).repeat(length)
    rule, lit = (since >= 0).astype(np.int64), (since >= 0) & (since < 3)
    bright = rng.integers(0, 2, (n * length, 2))
    images = rng.integers(0, 64, (n * length, *SHAPE, 3), np.uint8)
    images += 96 * bright.repeat(4, axis=1)[:, None, :, None].astype(np.uint8)
    images[lit, :2] = 255
    wrong = rng.random(n * length) < 0.2
    actions = np.where(wrong, 1 - bright[:, 0], bright[np.arange(n * length), rule])
    demonstrations = Demonstrations.of_images(
        images, actions, np.full(n, length), NAMES, 10.0, None, {}, Path("data/some")
    )
    policy, found = train(demonstrations, truth=torch.from_numpy(rule), rounds=60)
    if not (found.discovery.kept.scores.runnable and np.array_equal(found.labels, rule)):
        raise RuntimeError("the switch costs should have kept the truth")
    assert found.switch_weight == 1.0 and found.switches.cues
    assert torch.equal(annotate(policy, demonstrations).labels, found.labels)
    by_actions = replace(policy, config=replace(policy.config, switch_weight=0.0))
    assert not torch.equal(annotate(by_actions, demonstrations).labels, found.labels)


def vectors_with_a_rule(seed=0):
    """The first number of the state decides before a hidden change, the second one after it."""
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(LENGTHS.sum(), 2)).astype(np.float32)
    rule = np.concatenate([np.arange(length) >= length // 2 for length in LENGTHS]).astype(int)
    told = np.sign(state[np.arange(len(rule)), rule])
    actions = np.column_stack([told, -2 * told + rule, np.full(len(rule), 7)]).astype(np.float32)
    return Demonstrations(
        {STATE: state},
        actions,
        LENGTHS,
        ("dx", "gripper", "never moves"),
        10.0,
        rule,
        {},
        Path("data/some"),
        state_names={STATE: ("x", "y")},
    )


@pytest.mark.parametrize("order", ["free", "chain"])
def test_the_labels_of_vectors_are_those_of_the_training(order):
    demonstrations = vectors_with_a_rule()
    policy, found = train(demonstrations, switch_weight=0.0, order=order)
    seen = annotate(policy, demonstrations)
    assert found.macros == 2 and torch.equal(seen.labels, found.labels)
    assert float(seen.cost_by_bound[:, -1].sum()) / len(found.labels) == pytest.approx(
        float(found.loss[-1]), rel=1e-4
    )
    agrees = (seen.labels.numpy() == demonstrations.truth).mean()
    assert max(agrees, 1 - agrees) > 0.9


def lit_after_an_action(n=10, length=60):
    """Demonstrations that change where a picture lights up right after action 1; others light up in vain.

    The policy's classifiers have no vote, its switch function fires wherever a picture is lit.
    """
    rng = np.random.default_rng(0)
    cuts = rng.integers(25, 35, n)
    truth = (np.arange(length) >= cuts[:, None]).astype(np.int64)
    actions, lit = np.zeros((n, length), np.int64), np.zeros((n, length), bool)
    for row, cut in enumerate(cuts):
        actions[row, cut - 1] = 1
        lit[row, [cut, *rng.choice(np.arange(3, 22), 4, False), *rng.choice(np.arange(38, 58), 4, False)]] = (
            True
        )
    images = np.where(lit.reshape(-1, 1, 1, 1), 200, 50).astype(np.uint8)
    images = np.broadcast_to(images, (n * length, *SHAPE, 3)).copy()
    lengths = np.full(n, length)
    demonstrations = Demonstrations.of_images(
        images, actions.reshape(-1), lengths, NAMES, 10.0, None, {}, Path("lit")
    )
    labels = torch.from_numpy(truth.reshape(-1))
    features = make_features("pixels", *SHAPE, 0, torch.Generator()).select(torch.tensor([0]))
    none = torch.zeros(0, 2, dtype=torch.int64)
    actor = StumpClassifier(none, none.byte(), torch.zeros(0, 2, 2, len(NAMES)))
    first = torch.zeros(1, 1, dtype=torch.int64)
    switcher = StumpClassifier(
        first, torch.full((1, 1), 100).byte(), torch.tensor([-3.0, 3]).view(1, 1, 2, 1)
    )
    odds = change_log_odds(labels, torch.from_numpy(lengths), 2).tolist()
    config = PolicyConfig(
        type="dpboost",
        macros=2,
        starts=(0,),
        inputs={IMAGE: InputConfig((*SHAPE, 3))},
        encoder=features.spec(),
        action_names=NAMES,
        outputs=len(NAMES),
        switches=((0, 1),),
        thresholds=(0.0,),
        cues=((1,),),
        switch_weight=1.0,
        change_log_odds=tuple(map(tuple, odds)),
    )
    quantiser = Quantiser(torch.arange(255, dtype=torch.int32)[None])
    return MacroPolicy(config, features, quantiser, actor, switcher), demonstrations, labels


def run_beside(policy, demonstrations):
    """The macro-actions of a policy that sees demonstrations and is told the actions that were taken."""
    planner, macros = policy.planner(), []
    for trajectory in demonstrations.trajectories:
        planner.reset()
        for frame in range(trajectory.start, trajectory.stop):
            planner.scores({"pixels": demonstrations.images[frame]})
            macros.append(planner.macro)
            planner.took(int(demonstrations.actions[frame]))
    return torch.tensor(macros)


def test_switch_functions_are_charged_where_they_may_fire_and_nowhere_else():
    """Nothing but them tells the change: a policy that minds its cues makes it, and so does `annotate`."""
    policy, demonstrations, truth = lit_after_an_action()
    agreement = float((run_beside(policy, demonstrations) == truth).float().mean())
    assert agreement > 0.98
    assert float((annotate(policy, demonstrations).labels == truth).float().mean()) > 0.98
    heedless = replace(policy, config=replace(policy.config, cues=()))
    assert float((run_beside(heedless, demonstrations) == truth).float().mean()) < 0.8
    assert float((annotate(heedless, demonstrations).labels == truth).float().mean()) < 0.8


def test_an_annotation_survives_files_and_does_not_depend_on_the_portion(trained, tmp_path, monkeypatch):
    policy, demonstrations, _ = trained
    seen = annotate(policy, demonstrations)
    policy.save(tmp_path)
    monkeypatch.setattr(annotation, "CHUNK", 7)  # the first frame of a portion has one before it
    again = annotate(MacroPolicy.load(tmp_path), demonstrations)
    assert torch.equal(again.labels, seen.labels)
    torch.testing.assert_close(again.confidence, seen.confidence)
    torch.testing.assert_close(again.cost_by_bound, seen.cost_by_bound)


def test_costs_are_those_of_the_classifiers_at_every_image_and_the_one_before(monkeypatch):
    """Under a bound of 0 a trajectory has the macro-action that is cheapest throughout."""
    monkeypatch.setattr(annotation, "CHUNK", 5)
    policy, demonstrations = random_policy(), random_demonstrations()
    images, lengths = torch.from_numpy(demonstrations.images), torch.from_numpy(demonstrations.lengths)
    seen = {0: {IMAGE: images}, 1: {IMAGE: images[frames_before(lengths)]}}
    levels = policy.quantiser.levels(policy.features.values(seen))
    right = torch.nn.functional.one_hot(torch.from_numpy(demonstrations.actions), 3) == 1
    scores = policy.actor.scores(Frames(levels)).double()
    costs = torch.where(right[:, None], -scores, scores).exp().sum(2)
    wanted = torch.stack([part.sum(0) for part in costs.split(lengths.tolist())])
    seen = annotate(policy, demonstrations, 0)
    torch.testing.assert_close(seen.cost_by_bound[:, 0], wanted.amin(1), rtol=1e-5, atol=1e-5)
    assert torch.equal(seen.labels, wanted.argmin(1).repeat_interleave(lengths))


def test_trajectories_do_not_see_one_another(trained):
    policy, demonstrations, _ = trained
    together = annotate(policy, demonstrations)
    alone = annotate(policy, demonstrations.select([1]))
    assert torch.equal(alone.labels, together.labels[40:65])
    torch.testing.assert_close(alone.confidence, together.confidence[40:65])


def test_confidence_is_in_range_and_least_where_the_label_could_be_another(trained):
    policy, demonstrations, _ = trained
    seen = annotate(policy, demonstrations)
    assert seen.confidence.dtype == torch.float32 and seen.confidence.shape == seen.labels.shape
    assert bool((seen.confidence >= 0).all()) and bool((seen.confidence <= 1).all())
    changes = seen.labels.diff().nonzero()[:, 0]
    beside = torch.cat([changes, changes + 1])
    assert float(seen.confidence[beside].mean()) < float(seen.confidence.mean())


@pytest.mark.parametrize("bound", [0, 1, 5])
def test_a_bound_of_ones_own(trained, bound):
    policy, demonstrations, _ = trained
    seen = annotate(policy, demonstrations, bound)
    lengths = torch.from_numpy(LENGTHS)
    assert bool((transition_counts(seen.labels, lengths) <= bound).all())
    assert seen.cost_by_bound.shape == (3, bound + 1)
    default = annotate(policy, demonstrations).cost_by_bound
    shared = min(bound, 1) + 1
    torch.testing.assert_close(seen.cost_by_bound[:, :shared], default[:, :shared])


@pytest.mark.parametrize(("macros", "given", "bound"), [(2, None, 1), (2, 0, 0), (2, 4, 4)])
def test_the_default_bound_is_that_of_the_policy(trained, macros, given, bound):
    policy, demonstrations, _ = trained
    changed = replace(policy, config=replace(policy.config, macros=macros, max_transitions=given))
    assert annotate(changed, demonstrations).cost_by_bound.shape == (3, bound + 1)


@pytest.mark.parametrize("names", [("0", "1", "2"), ("0", "1", "2", "3")])
def test_actions_without_names_are_the_first_of_the_policys(trained, names):
    policy, demonstrations, _ = trained
    alike = annotate(policy, replace(demonstrations, action_names=names))
    assert torch.equal(alike.labels, annotate(policy, demonstrations).labels)


def test_a_baseline_is_sure_of_its_only_label():
    demonstrations = noise_with_a_rule()
    policy, _ = train(demonstrations, macros=1)
    seen = annotate(policy, demonstrations)
    assert not seen.labels.any() and bool((seen.confidence == 1).all())


@pytest.mark.parametrize(
    ("change", "bound", "message"),
    [
        (
            {"observations": {IMAGE: np.zeros((100, 48, 64, 3), np.uint8)}},
            None,
            r"data/some has observation.image with images of 64x48: the policy was trained on images of 8x6",
        ),
        (
            {"action_names": ("up", "down")},
            None,
            r"data/some has the actions up, down: the policy knows forward, left, right, never seen",
        ),
        (
            {"action_names": (*NAMES[1:], NAMES[0])},
            None,
            r"data/some has the actions left, right, never seen, forward: the policy knows forward, ",
        ),
        (
            {"action_names": ("0", "1", "2", "3", "4")},
            None,
            r"data/some has the actions 0, 1, 2, 3, 4: the policy knows forward",
        ),
        ({}, -1, "max_transitions is -1"),
        (
            {"observations": {STATE: np.zeros((100, 2), np.float32)}},
            None,
            r"data/some has no observation.image, which the policy sees: it has observation.state",
        ),
        (
            {"actions": np.zeros((100, 4), np.float32)},
            None,
            r"data/some has actions that are vectors: those of the policy are classes",
        ),
    ],
)
def test_what_does_not_fit_is_named_in_a_line(trained, change, bound, message):
    policy, demonstrations, _ = trained
    with pytest.raises(ValueError, match=message) as error:
        annotate(policy, replace(demonstrations, **change), bound)
    assert "\n" not in str(error.value)
