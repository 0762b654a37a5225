"""The pictures of a segmentation: of the whole dataset, of the classifiers, and of single demonstrations."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from matplotlib.figure import Figure

from dpmacro import figures
from dpmacro.annotation.summary import Summary
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.features.base import input_name
from dpmacro.figures import Line
from dpmacro.policy.policy import MacroPolicy

__all__ = [
    "Picture",
    "chosen_columns",
    "chosen_pixels",
    "demonstration_timeline",
    "importances",
    "mean_images",
    "picture_count",
    "pictures",
    "pixels_name",
]

CAMERAS = 3  # with thumbnails in a timeline at most
LOOKED_AT = "What the classifiers look at"  # a heading
LINES = ". Lines are numbers of the action, in standard deviations; grey is the mean of all frames"
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
    """Made one at a time: those of the dataset, then the first `shown` demonstrations.

    One that fails is a warning, and the others are made.
    """
    for place, draw in enumerate(_drawings(summary, shown)):
        picture = None
        with figures.surviving(f"number {place}"):
            picture = draw()
        if picture is not None:
            yield picture


def picture_count(summary: Summary, shown: int) -> int:
    """How many `pictures` there are."""
    return len(_drawings(summary, shown))


def importances(policy: MacroPolicy) -> Float[np.ndarray, "macros columns"] | None:
    """How much the stumps of every macro-action's classifier rest on each column; None for networks.

    A stump counts with the step of its votes.
    """
    if not isinstance(policy.actor, StumpClassifier):
        return None
    return policy.actor.importances(policy.features.count).double().cpu().numpy()


def chosen_pixels(policy: MacroPolicy) -> dict[str, Float[np.ndarray, "macros height width"]]:
    """By camera, how much the stumps of every macro-action's classifier rest on each pixel; {} for networks.

    A stump counts with the step of its votes, spread evenly over the pixels that its column looks at. Cameras
    that no stump looks at are left out.
    """
    if (weights := importances(policy)) is None:
        return {}
    maps = policy.features.footprint(torch.from_numpy(weights))
    found = {camera: maps[camera].cpu().numpy() for camera in policy.config.cameras if camera in maps}
    return {camera: own for camera, own in found.items() if own.any()}


def chosen_columns(policy: MacroPolicy) -> list[dict[str, float]]:
    """For every macro-action what its classifier rests on: columns without pixels by name, cameras whole.

    [] for networks, and where no stump looks at a column without pixels: the cameras' maps then tell more.
    """
    weights, blind = importances(policy), ~policy.features.sees_pixels.cpu().numpy()
    if weights is None or not weights[:, blind].any():
        return []
    names = np.array(policy.features.names(), object)[blind]
    cameras = {f"camera {input_name(key)}": own.sum((1, 2)) for key, own in chosen_pixels(policy).items()}
    result = []
    for macro, own in enumerate(weights[:, blind].tolist()):
        found = {name: float(whole[macro]) for name, whole in cameras.items()}
        for name, weight in zip(names, own, strict=True):
            found[name] = found.get(name, 0.0) + weight
        result.append(found)
    return result


def pixels_name(policy: MacroPolicy, camera: str) -> str:
    """What the picture of a camera's pixels is called: "pixels", with its name where there are several."""
    return f"pixels_{input_name(camera)}" if len(policy.config.cameras) > 1 else "pixels"


def demonstration_timeline(
    demonstrations: Demonstrations,
    place: int,
    labels: Int[np.ndarray, " frames"],
    confidence: Float[np.ndarray, " frames"],
    lines: Sequence[Line],
    title: str,
) -> Figure:
    """The timeline of one demonstration; labels, confidence and `action_lines` are those of all."""
    frames, truth = demonstrations.trajectories[place], demonstrations.truth
    cameras = demonstrations.cameras[:CAMERAS]
    seen = {
        "seen" if len(cameras) == 1 else input_name(camera): demonstrations.observations[camera][frames]
        for camera in cameras
    }
    return figures.timeline(
        seen,
        labels[frames],
        [line.part(frames) for line in lines] if demonstrations.vector else demonstrations.actions[frames],
        None if truth is None else truth[frames],
        title,
        demonstrations.action_names,
        demonstrations.truth_name,
        demonstrations.truth_classes,
        confidence[frames],
    )


def mean_images(
    images: UInt8[np.ndarray, "frames height width 3"], labels: Int[np.ndarray, " frames"], n_macros: int
) -> UInt8[np.ndarray, "macros height width 3"]:
    """The mean image of the frames that each macro-action holds, black where it holds none."""
    result = np.zeros((n_macros, *images.shape[1:]), np.uint8)
    for macro in np.unique(labels).tolist():
        result[macro] = images[labels == macro].mean(0).round()
    return result


def _drawings(summary: Summary, shown: int) -> list[Callable[[], Picture]]:
    """What draws each picture, in their order."""
    drawings: list[Callable[[], Picture]] = [partial(_timelines, summary), partial(_graph, summary)]
    if len(summary.cost_by_bound) > 1:
        drawings.append(partial(_elbow, summary))
    if columns := chosen_columns(summary.policy):
        drawings.append(partial(_columns, summary, columns))
    for camera, weights in chosen_pixels(summary.policy).items():
        drawings.append(partial(_heat_maps, summary, camera, weights))
    drawings += [partial(_timeline, summary, place) for place in range(min(shown, len(summary.episodes)))]
    return drawings


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


def _heat_maps(summary: Summary, camera: str, weights: Float[np.ndarray, "macros height width"]) -> Picture:
    macros, several = summary.macros, len(summary.policy.config.cameras) > 1
    means = mean_images(summary.demonstrations.observations[camera], summary.labels, len(macros))
    of = f" of camera {input_name(camera)}" if several else ""
    alt = f"For every macro-action its mean image{of}, and in grey with the pixels its classifier weighs"
    caption = (
        f"Above, the mean image{of} over a macro-action's frames. Below, the weight of every stump spread "
        "over the pixels that it looks at. The classifier decides by those of most weight."
    )
    figure = figures.heat_maps(means, weights, _named(summary))
    return Picture(pixels_name(summary.policy, camera), LOOKED_AT, figure, alt, caption)


def _columns(summary: Summary, weights: list[dict[str, float]]) -> Picture:
    figure = figures.column_bars(weights, _named(summary))
    first = [max(own, key=own.__getitem__) for own in weights]
    alt = "What weighs most: " + ", ".join(f"{name} for macro-action {q}" for q, name in enumerate(first))
    caption = (
        "What the stumps of each macro-action look at most, as shares of all their votes' steps: numbers of "
        "the state and their changes one by one, a camera with all its pixels together."
    )
    return Picture("columns", LOOKED_AT, figure, alt, caption)


def _named(summary: Summary) -> list[str]:
    return [f"macro-action {macro['macro']}, {macro['share']:.0%} of frames" for macro in summary.macros]


def _timeline(summary: Summary, place: int) -> Picture:
    episode = summary.episodes[place]
    figure = demonstration_timeline(
        summary.demonstrations,
        place,
        summary.labels,
        summary.frame_confidence,
        summary.action_lines,
        f"Demonstration {episode}",
    )
    found = summary.segments[place]
    told = ", then ".join(f"macro-action {macro} to frame {end}" for macro, _, end in found[:TOLD])
    rest = f", and {len(found) - TOLD} more segments" if len(found) > TOLD else ""
    caption = f"{summary.lengths[place]} frames, mean confidence {summary.confidence[place]:.2f}"
    if summary.agreement is not None:
        caption += f", {summary.agreement[place]:.1%} of them agree with the truth"
    if summary.action_lines:
        caption += LINES
    alt = f"Demonstration {episode}: {told}{rest}"
    return Picture(f"demonstration_{episode:03d}", "Demonstrations", figure, alt, caption)
