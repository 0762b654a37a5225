"""What was found in demonstrations, in lines for people."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from dpmacro.annotation.naming import StageName
from dpmacro.annotation.stages import Stages

__all__ = ["found_text"]


def found_text(stages: Stages, named: Sequence[StageName]) -> list[str]:
    """The stages, their order and what stands still, a line each."""
    frames = np.bincount(stages.labels, minlength=len(stages.names))
    reasons = {one.name: one.reason for one in named}
    lines = []
    for k, name in enumerate(stages.names):
        told = f"{name}, {frames[k] / frames.sum():.0%} of the frames. {reasons.get(name, '')}"
        lines.append(f"{f'stage {k}':<11} {told.rstrip()}")
    orders = Counter(tuple(label for label, _, _ in one) for one in stages.segments)
    order, count = orders.most_common(1)[0]
    listed = ", ".join(stages.names[label] for label in order[:8]) + ", ..." * (len(order) > 8)
    once = len(set(order)) == len(order)
    if count == len(stages.lengths):
        each = ", each stage once" if once else ""
        lines.append(f"{'order':<11} the same in all {count} demonstrations{each}: {listed}")
    else:
        lines.append(f"{'order':<11} {len(orders)} orders; {count} of {len(stages.lengths)} have {listed}")
    if count < len(stages.lengths) or not once:
        lines.append(f"{'':<11} (--planner.order=chain finds stages in one order, each once)")
    lines.append(f"{'idle':<11} {stages.idle.mean():.1%} of the frames: nothing moves for a second or more")
    if stages.corrected.any():
        parts = sum(bool(stages.corrected[part].any()) for part in stages.trajectories)
        lines.append(f"{'corrected':<11} {parts} demonstration{'s' * (parts != 1)} by a person")
    return lines
