"""Which pictures there are, and what the maps of chosen pixels add up to."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from segmented import IMAGE, SHAPE, random_policy, some_summary

from dpmacro.annotation.pictures import chosen_pixels, importances, mean_images, picture_count, pictures
from dpmacro.boosting.learners.convnet import ConvNetClassifier
from dpmacro.features.kinds import FEATURES


def network():
    """A classifier that looks at no column."""
    shapes = [(2, 6, 1, 1), (2,), (2, 2, 1, 1), (2,), (3, 2, 1, 1), (3,), ()]
    return ConvNetClassifier(*(torch.zeros(1, 3, *shape) for shape in shapes))


def test_every_picture_has_a_name_and_words():
    summary = some_summary()
    made = list(pictures(summary, 2))
    assert [picture.name for picture in made] == [
        "segmentation",
        "transitions",
        "elbow",
        "pixels",
        "demonstration_004",
        "demonstration_007",
    ]
    assert picture_count(summary, 2) == len(made)
    assert all(picture.alt and picture.heading for picture in made)
    assert made[4].alt == "Demonstration 4: macro-action 2 to frame 6, then macro-action 0 to frame 12"
    assert "start to 2 3 times" in made[1].alt
    assert made[5].caption == "7 frames, mean confidence 0.25, 100.0% of them agree with the truth"


def test_what_cannot_be_drawn_is_left_out():
    summary = some_summary(truth=False, bounds=1)
    networks = replace(summary.policy, actor=network())
    summary = replace(summary, policy=networks)
    assert chosen_pixels(networks) == {} and importances(networks) is None
    assert [picture.name for picture in pictures(summary, 1)] == [
        "segmentation",
        "transitions",
        "demonstration_004",
    ]
    assert picture_count(summary, 1) == 3


@pytest.mark.parametrize("kind", FEATURES)
def test_chosen_pixels_add_up_to_the_steps_of_the_votes(kind):
    policy = random_policy(kind)
    (weights,) = chosen_pixels(policy).values()
    steps = policy.actor.votes.diff(dim=2).abs().sum((0, 2, 3))
    assert weights.shape == (3, *SHAPE) and (weights >= 0).all()
    np.testing.assert_allclose(weights.sum((1, 2)), steps, rtol=1e-5)


def test_a_pixel_that_no_stump_looks_at_weighs_nothing():
    policy = random_policy("pixels")
    looked_at = torch.zeros(3, SHAPE[0] * SHAPE[1], dtype=torch.bool)
    for problem in range(3):
        places = policy.features.places[policy.actor.columns[:, problem]] % looked_at.shape[1]
        looked_at[problem, places] = True
    assert ((chosen_pixels(policy)[IMAGE] > 0).reshape(3, -1) == looked_at.numpy()).all()


def test_mean_images_are_those_of_the_frames_held():
    images = np.zeros((4, 2, 2, 3), np.uint8)
    images[:, 0, 0] = np.array([10, 20, 200, 250])[:, None]
    means = mean_images(images, np.array([0, 0, 2, 2]), 4)
    assert means[:, 0, 0, 0].tolist() == [15, 0, 225, 0] and not means[:, 1].any()
