"""Stages that every demonstration goes through in the same order, each once: what SARM and MimicGen need."""

from dpmacro.annotation.exports.base import Labelled

__all__ = ["order_of", "unordered"]

SHOWN = 6  # stages of a demonstration that a line names


def order_of(labelled: Labelled) -> list[int]:
    """The stages of the first demonstration, in order."""
    return [label for label, _, _ in labelled.segments[0]]


def unordered(labelled: Labelled) -> str | None:
    """Why there is no order common to all demonstrations, with a remedy; None where there is one."""
    order = order_of(labelled)
    episodes = labelled.stages.episodes
    for episode, segments in zip(episodes, labelled.segments, strict=True):
        own = [label for label, _, _ in segments]
        if len(set(own)) < len(own):
            again = next(label for place, label in enumerate(own) if label in own[:place])
            return (
                f"stages come back ({labelled.name(again)!r} in episode {episode}), and it needs the same "
                "stages in the same order in every demonstration: leave it out, or segment with "
                "--planner.order=chain"
            )
        if own != order:
            return (
                f"episode {episodes[0]} has {_listed(labelled, order)} and episode {episode} "
                f"{_listed(labelled, own)}, and it needs the same stages in the same order in every "
                "demonstration: leave it out, or segment with --planner.order=chain"
            )
    return None


def _listed(labelled: Labelled, labels: list[int]) -> str:
    names = [labelled.name(label) for label in labels[:SHOWN]]
    return ", ".join([*names, "..."] if len(labels) > SHOWN else names)
