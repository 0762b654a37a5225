"""Convnets behind the learners' protocol: what stumps cannot see, seeds, sums, files, switch functions."""

import pytest
import torch
from safetensors.torch import load, save

from dpmacro.boosting.learners.base import Frames, StrongClassifier, WeakLearner
from dpmacro.boosting.learners.convnet import BOUND, ConvNetClassifier, ConvNetLearner, reduced
from dpmacro.boosting.learners.kinds import classifier_from, classifier_tensors
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.features.encoders.pixels import Pixels
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.switching.settings import SwitchSettings
from dpmacro.switching.training import fit_switches

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
SIDE = 12


def blobs(n_frames, seed=0):
    """Noise with 16 bright pixels: a square anywhere, round the edges too, in odd frames, strewn in others.

    A pixel is as often bright in the one as in the other.
    """
    generator = torch.Generator().manual_seed(seed)
    images = torch.randint(0, 60, (n_frames, SIDE, SIDE, 3), dtype=torch.uint8, generator=generator)
    for k in range(n_frames):
        bright = torch.zeros(SIDE * SIDE, dtype=torch.uint8)
        bright[torch.randperm(SIDE * SIDE, generator=generator)[:16]] = 150
        if k % 2:
            bright = torch.zeros(SIDE, SIDE, dtype=torch.uint8)
            bright[:4, :4] = 150
            bright = bright.roll(torch.randint(0, SIDE, (2,), generator=generator).tolist(), (0, 1))
        images[k] += bright.view(SIDE, SIDE, 1)
    return images, torch.arange(n_frames) % 2


def convnets(images, device="cpu", **options):
    previous = (torch.arange(len(images), device=device) - 1).clamp(min=0)
    return ConvNetLearner(images.to(device), previous, **options)


def stumps(images):
    previous = images[(torch.arange(len(images)) - 1).clamp(min=0)]
    values = Pixels.all("image", SIDE, SIDE).values({0: {"image": images}, 1: {"image": previous}})
    return StumpLearner(SortedLevels.build(Quantiser.fit(values).levels(values)))


def frames_of(learner):
    levels = torch.zeros(0, learner.n_frames, dtype=torch.uint8, device=learner.device)
    return Frames(levels, learner.images, learner.images[learner.previous])


def boosted(learner, labels, base, rounds=3, seed=1):
    generator = torch.Generator().manual_seed(seed)
    boosting = Boosting(learner, class_targets(labels, 2), base.shape[1], 0.5, generator)
    for _ in range(rounds):
        boosting.round(base.to(learner.device))
    return boosting


def two_problems(n_frames):
    """Base weights of a problem that holds all frames, and of one that holds the first half."""
    base = torch.ones(n_frames, 2)
    base[n_frames // 2 :, 1] = 0
    return base


@pytest.mark.parametrize("device", DEVICES)
def test_strong_scores_are_the_sum_of_the_rounds(device):
    images, labels = blobs(60)
    learner = convnets(images, device)
    boosting = boosted(learner, labels, two_problems(60))
    classifier = boosting.strong()
    assert isinstance(learner, WeakLearner) and isinstance(classifier, StrongClassifier)
    scores = classifier.scores(frames_of(learner))
    torch.testing.assert_close(scores, boosting.scores, atol=1e-4, rtol=1e-4)
    chosen = torch.tensor([1], device=device)
    torch.testing.assert_close(classifier.select(chosen).scores(frames_of(learner)), scores[:, 1:])
    assert not len(classifier.used_columns())
    assert classifier.renumbered(classifier.used_columns()) is classifier


@pytest.mark.parametrize("device", DEVICES)
def test_the_seed_decides_and_the_global_generator_is_left_alone(device):
    images, labels = blobs(40)
    state = torch.get_rng_state()
    first, again, other = (
        boosted(convnets(images, device), labels, two_problems(40), seed=seed).scores for seed in (1, 1, 2)
    )
    assert torch.equal(state, torch.get_rng_state())
    assert (first - other).abs().max() > 0.01
    if device == "cpu":
        assert torch.equal(first, again)


def test_sees_what_stumps_on_pixels_cannot():
    images, labels = blobs(500)
    base = (torch.arange(500) < 350).float()[:, None]
    accuracies = []
    for learner, rounds in ((convnets(images, epochs=8), 2), (stumps(images), 20)):
        chosen = boosted(learner, labels, base, rounds).scores[350:, 0].argmax(1)
        accuracies.append(float((chosen == labels[350:]).float().mean()))
    assert accuracies[0] > 0.9 > 0.65 > accuracies[1], accuracies


def test_outputs_are_bounded_and_a_round_lowers_the_loss():
    images, labels = blobs(60)
    learner = convnets(images, epochs=20, rate=0.03)
    boosting = boosted(learner, labels, torch.ones(60, 1), rounds=1)
    assert boosting.losses().mean() < 1.8
    assert boosting.scores.abs().max() <= BOUND / 2


def test_a_few_frames_with_half_the_weight_are_learnt():
    images, _ = blobs(300)
    rare = torch.arange(300) % 100 == 50
    images[rare, :6] = 200
    base = torch.where(rare, 0.5 / rare.sum(), 0.5 / (~rare).sum())[:, None]
    generator = torch.Generator().manual_seed(0)
    boosting = Boosting(convnets(images, epochs=4), rare[:, None, None], 1, 1.0, generator)
    boosting.round(base)
    assert ((boosting.scores[:, 0, 0] > 0) == rare).all()


def test_a_problem_without_frames_gets_no_votes():
    images, labels = blobs(30)
    base = torch.ones(30, 2)
    base[:, 1] = 0
    boosting = boosted(convnets(images), labels, base, rounds=2)
    assert (boosting.scores[:, 1] == 0).all() and (boosting.scores[:, 0] != 0).any()
    assert not boosting.ended.any()


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_must_be_finite(value):
    images, labels = blobs(10)
    weights = torch.ones(10, 1, 2)
    weights[3] = value
    with pytest.raises(ValueError, match="weights of problem 0 sum to"):
        convnets(images).fit(weights, class_targets(labels, 2), torch.Generator())


@pytest.mark.parametrize(
    "options", [{"epochs": 0}, {"batch": 0}, {"rate": 0.0}, {"channels": (0, 4)}, {"rate": float("nan")}]
)
def test_options_that_cannot_be_are_refused(options):
    with pytest.raises(ValueError, match="give"):
        convnets(blobs(4)[0], **options)


def test_images_that_cannot_be_are_refused():
    images, _ = blobs(4)
    with pytest.raises(ValueError, match="2 x 2 pixels"):
        ConvNetLearner(images[:, :1], torch.arange(4))


def test_frames_without_images_are_refused():
    images, labels = blobs(10)
    classifier = boosted(convnets(images), labels, torch.ones(10, 1), 1).strong()
    with pytest.raises(ValueError, match="without images"):
        classifier.scores(Frames(torch.zeros(0, 10, dtype=torch.uint8)))


def test_images_are_halved_by_rounded_means():
    images = torch.randint(
        0, 256, (300, 5, 7, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    )
    means = torch.nn.functional.avg_pool2d(images.permute(0, 3, 1, 2).float(), 2).permute(0, 2, 3, 1)
    assert torch.equal(reduced(images).float(), (means + 0.5).floor())


def test_rounds_that_early_stopping_drops_are_not_kept():
    images, labels = blobs(30)
    boosting = boosted(convnets(images), labels, torch.ones(30, 2))
    assert len(boosting.strong(torch.tensor([1, 2])).steps) == 2
    assert len(boosting.strong(torch.tensor([0, 0])).steps) == 1


def test_a_file_brings_back_the_scores():
    images, labels = blobs(40)
    learner = convnets(images)
    boosting = boosted(learner, labels, two_problems(40), rounds=4)
    classifier = classifier_from(load(save(classifier_tensors(boosting.strong()))))
    assert isinstance(classifier, ConvNetClassifier)
    scores = classifier.scores(frames_of(learner))
    torch.testing.assert_close(scores, boosting.scores, atol=1e-4, rtol=1e-4)


def test_switch_functions_of_convnets_detect_a_change():
    lengths = torch.tensor([30, 30, 30, 30])
    images, _ = blobs(120)
    labels = torch.arange(120) % 30 // 15
    images[labels == 1, : SIDE // 2] = 220
    learner = convnets(images, epochs=4)
    generator = torch.Generator().manual_seed(0)
    settings = SwitchSettings(rounds=2, shrinkage=0.5, folds=2)
    [switches] = fit_switches(learner, labels[None], lengths, generator, settings)
    assert switches.pairs == ((0, 1),) and float(switches.recognised[0]) == 1
    scores = switches.classifier.scores(frames_of(learner))
    assert scores.shape == (120, 1, 1)
