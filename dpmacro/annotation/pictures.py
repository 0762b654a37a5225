"""The pictures of a segmentation: of the whole dataset, of the classifiers, and of single demonstrations."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.figure import Figure

from dpmacro import figures
from dpmacro.annotation.summary import Summary
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.policy.policy import MacroPolicy

__all__ = ["Picture", "chosen_pixels", "mean_images", "picture_count", "pictures"]

TOLD = 6  # segments or transitions listed in a picture's text at most


@dataclass(frozen=True)
class Picture:
    """A figure and what to know about it.

    Attributes:
        name: of its file, without suffix.
        heading: of the page's section that it stands in.
        figure: itself.
        alt: what it shows, in words.
        caption: how to read it.
    """

    name: str
    heading: str
    figure: Figure
    alt: str
    caption: str = ""


def pictures(summary: Summary, shown: int) -> Iterator[Picture]:
    """Made one at a time: those of the dataset, then the first `shown` demonstrations."""
    yield _timelines(summary)
    yield _graph(summary)
    if len(summary.cost_by_bound) > 1:
        yield _elbow(summary)
    if (weights := chosen_pixels(summary.policy)) is not None:
        yield _heat_maps(summary, weights)
    for place in range(min(shown, len(summary.episodes))):
        yield _timeline(summary, place)


def picture_count(summary: Summary, shown: int) -> int:
    """How many `pictures` there are."""
    optional = (len(summary.cost_by_bound) > 1) + (chosen_pixels(summary.policy) is not None)
    return 2 + optional + min(shown, len(summary.episodes))


def chosen_pixels(policy: MacroPolicy) -> Float[np.ndarray, "macros height width"] | None:
    """How much the stumps of every macro-action's classifier rest on each pixel of the first camera.

    None where it has no stumps, or none looks at a camera.

    A stump counts with the step of its votes, spread evenly over the pixels that its column looks at.
    """
    if not isinstance(policy.actor, StumpClassifier):
        return None
    maps = policy.features.footprint(policy.actor.importances(policy.features.count))
    found = next((maps[camera] for camera in policy.config.cameras if camera in maps), None)
    return None if found is None else found.cpu().numpy()


def mean_images(
    images: UInt8[np.ndarray, "frames height width 3"], labels: Int[np.ndarray, " frames"], n_macros: int
) -> UInt8[np.ndarray, "macros height width 3"]:
    """The mean image of the frames that each macro-action holds, black where it holds none."""
    result = np.zeros((n_macros, *images.shape[1:]), np.uint8)
    for macro in np.unique(labels).tolist():
        result[macro] = images[labels == macro].mean(0).round()
    return result


def _timelines(summary: Summary) -> Picture:
    demonstrations = summary.demonstrations
    figure = figures.timelines(
        summary.labels,
        summary.lengths,
        demonstrations.truth,
        truth_name=demonstrations.truth_name,
        truth_classes=demonstrations.truth_classes,
        confidence=summary.frame_confidence,
        numbers=summary.episodes,
    )
    below = "" if demonstrations.truth is None else ", the true classes below them in grey"
    caption = f"Macro-actions in colour{below}. Another label explains pale frames almost as well."
    alt = f"{len(summary.episodes)} demonstrations as bars along time, a colour for every macro-action"
    return Picture("segmentation", "All demonstrations", figure, alt, caption)


def _graph(summary: Summary) -> Picture:
    figure = figures.transition_graph(summary.labels, summary.lengths)
    counts = figures.edge_counts(summary.labels, summary.lengths)
    edges = sorted(counts.items(), key=lambda edge: -edge[1])[:TOLD]
    alt = "Most frequent: " + ", ".join(f"{a} to {b} {count} times" for (a, b), count in edges)
    caption = "Percentages are shares of frames, numbers how often one macro-action follows another."
    return Picture("transitions", "Transitions", figure, alt, caption)


def _elbow(summary: Summary) -> Picture:
    cost = summary.cost_by_bound
    figure = figures.elbow(cost, len(cost) - 1)
    alt = "Cost per frame: " + ", ".join(f"{value:.3f} at S = {s}" for s, value in enumerate(cost))
    caption = "What each further transition saves. Beyond the bend, cuts fall where nothing changes."
    return Picture("elbow", "Cost by bound", figure, alt, caption)


def _heat_maps(summary: Summary, weights: Float[np.ndarray, "macros height width"]) -> Picture:
    macros = summary.macros
    means = mean_images(summary.demonstrations.images, summary.labels, len(macros))
    names = [f"macro-action {macro['macro']}, {macro['share']:.0%} of frames" for macro in macros]
    alt = "For every macro-action its mean image, and in grey with the pixels its classifier weighs"
    caption = (
        "Above, the mean image of a macro-action's frames. Below, the weight of every stump spread over the "
        "pixels that it looks at. The classifier decides by those of most weight."
    )
    return Picture(
        "pixels", "What the classifiers look at", figures.heat_maps(means, weights, names), alt, caption
    )


def _timeline(summary: Summary, place: int) -> Picture:
    demonstrations = summary.demonstrations
    frames, episode = demonstrations.trajectories[place], summary.episodes[place]
    figure = figures.timeline(
        demonstrations.images[frames],
        summary.labels[frames],
        demonstrations.actions[frames],
        None if demonstrations.truth is None else demonstrations.truth[frames],
        f"Demonstration {episode}",
        demonstrations.action_names,
        demonstrations.truth_name,
        demonstrations.truth_classes,
        summary.frame_confidence[frames],
    )
    found = summary.segments[place]
    told = ", then ".join(f"macro-action {macro} to frame {end}" for macro, _, end in found[:TOLD])
    rest = f", and {len(found) - TOLD} more segments" if len(found) > TOLD else ""
    caption = f"{summary.lengths[place]} frames, mean confidence {summary.confidence[place]:.2f}"
    if summary.agreement is not None:
        caption += f", {summary.agreement[place]:.1%} of them agree with the truth"
    alt = f"Demonstration {episode}: {told}{rest}"
    return Picture(f"demonstration_{episode:03d}", "Demonstrations", figure, alt, caption)
