"""Which pictures there are, and what the maps of chosen pixels add up to."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from segmented import FRONT, IMAGE, SHAPE, STATE, TASK, TOP, random_policy, some_summary

from dpmacro.annotation.pictures import (
    chosen_columns,
    chosen_pixels,
    importances,
    mean_images,
    picture_count,
    pictures,
)
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


@pytest.mark.parametrize(
    ("keys", "looked_at", "rows"),
    [
        ((STATE,), ["columns"], ["true phase", "macro-action"]),
        ((TASK, STATE), ["columns"], ["true phase", "macro-action"]),
        ((FRONT, TOP), ["pixels_images.front", "pixels_images.top"], ["front", "top", "true phase"]),
        ((STATE, TOP), ["columns", "pixels"], ["seen", "true phase", "macro-action"]),
    ],
)
@pytest.mark.parametrize("vector", [False, True])
def test_pictures_of_any_inputs_and_actions(keys, looked_at, rows, vector):
    summary = some_summary(keys=keys, vector=vector)
    made = list(pictures(summary, 1))
    wanted = [name.replace("images.", "") for name in looked_at]
    names = ["segmentation", "transitions", "elbow", *wanted, "demonstration_004"]
    assert [picture.name for picture in made] == names and picture_count(summary, 1) == len(made)
    shown = [axis.get_ylabel() for axis in made[-1].figure.axes]
    assert shown[: len(rows)] == rows
    assert shown[-1] == ("dy" if vector else "action") and ("gripper" in shown) == vector
    assert ("standard deviations" in made[-1].caption) == vector
    assert {picture.heading for picture in made[3:-1]} == {"What the classifiers look at"}


def test_columns_and_cameras_share_the_steps_of_the_votes():
    policy = random_policy(keys=(TOP, STATE))
    steps = policy.actor.votes.diff(dim=2).abs().sum((0, 2, 3))
    told = chosen_columns(policy)
    assert [sum(own.values()) for own in told] == pytest.approx(steps.tolist(), rel=1e-5)
    (maps,) = chosen_pixels(policy).values()
    assert [own["camera top"] for own in told] == pytest.approx(maps.sum((1, 2)).tolist())
    names, weights = policy.features.names(), importances(policy)
    for macro, own in enumerate(told):
        for name, weight in own.items():
            assert name == "camera top" or weight == pytest.approx(weights[macro, names.index(name)])
    assert {name for own in told for name in own} == {"camera top", *names[-len(told[0]) + 1 :]}


def test_columns_are_told_only_where_some_have_no_pixels():
    assert chosen_columns(random_policy(keys=(FRONT, TOP))) == []
    assert chosen_columns(replace(random_policy(keys=(STATE,)), actor=network())) == []
    assert chosen_pixels(random_policy(keys=(STATE,))) == {}


def test_a_camera_that_no_stump_looks_at_has_no_map():
    policy = random_policy(keys=(STATE, TOP))
    blind = (~policy.features.sees_pixels).nonzero()[:, 0]
    away = replace(policy.actor, columns=blind[policy.actor.columns % len(blind)])
    assert chosen_pixels(replace(policy, actor=away)) == {}


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
