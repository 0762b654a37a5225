"""Switch functions: when a running policy changes its macro-action, and which one it starts with.

For every observed change q -> q' a binary strong classifier H_q^q' tells, frame by frame, whether it is due
(Section IV of the paper). Two things are not the paper's. A policy knows which action it has just taken, so a
switch function may be restricted to the frames after its cues: the actions that come right before its changes
in the demonstrations. And where demonstrations start with different macro-actions, one more classifier for
each of those tells from the first frame which one it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier
from dpmacro.utils.stages import storable

__all__ = ["SwitchFunctions", "causal_labels", "cued", "predicted_labels"]


@storable
@dataclass(frozen=True)
class SwitchFunctions:
    """One switch function for every observed change, the same order throughout.

    Scores and margins called left-out are those of functions that were fitted without the frame's
    trajectory, or its fold. A margin is the score less the threshold which the other folds chose, -inf where
    the cues that the other folds chose do not allow a change: the frame itself had no say in it.

    Attributes:
        pairs: (from, to) macro-actions.
        starts: macro-actions that trajectories start with, ascending.
        thresholds: a switch function fires where its score is above; infinite for a change that is never
            made, since it is rare and left-out trajectories would be worse for it.
        cues: actions that each may follow; none stands for any.
        recognised: share, 0 to 1, of the changes of each pair at whose first frame, and not before it in the
            same segment, the left-out margin is above 0.
        scores: left-out score of every frame, -18 where the function may not fire.
        margins: left-out margin of every frame.
        first: macro-action that left-out classifiers of the start give every trajectory.
        classifier: one binary problem per switch function, then one per start where there are several; None
            where nothing ever changes and all trajectories start alike.
        left_out: False where there was one trajectory alone: scores and margins are then of functions that
            were fitted to it.
    """

    pairs: tuple[tuple[int, int], ...]
    starts: tuple[int, ...]
    thresholds: Float[Tensor, " switches"]
    cues: tuple[tuple[int, ...], ...]
    recognised: Float[Tensor, " switches"]
    scores: Float[Tensor, "frames switches"]
    margins: Float[Tensor, "frames switches"]
    first: Int64[Tensor, " trajectories"]
    classifier: StrongClassifier | None
    left_out: bool = True

    @property
    def mean_recognised(self) -> float:
        """Mean of `recognised` over the switch functions; 0 where there is none."""
        return float(self.recognised.mean()) if self.pairs else 0.0


def cued(
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    cues: Sequence[Sequence[int]],
) -> Bool[Tensor, "frames switches"]:
    """Whether the action before each frame is a cue of each switch function; never at a first frame."""
    actions = actions.cpu()
    before = torch.nn.functional.pad(actions[:-1], (1, 0), value=-1)
    before[(lengths.cumsum(0) - lengths).cpu()] = -1
    return torch.stack([torch.isin(before, torch.tensor(own)) for own in cues], 1)


def causal_labels(
    margins: Float[Tensor, "frames switches"],
    pairs: Sequence[tuple[int, int]],
    lengths: Int64[Tensor, " trajectories"],
    first: Int64[Tensor, " trajectories"],
) -> Int64[Tensor, " frames"]:
    """The macro-labels that switch functions choose frame by frame, never looking ahead.

    Args:
        margins: score less threshold; the highest above 0 of the current macro-action fires.
        pairs: (from, to) of every switch function.
        lengths: frames of every trajectory.
        first: macro-action that each trajectory starts with.
    """
    labels = first.repeat_interleave(lengths)
    for start, length, begun in zip(
        (lengths.cumsum(0) - lengths).tolist(), lengths.tolist(), first.tolist(), strict=True
    ):
        stop, frame, macro = start + length, start, begun
        while True:
            own = [place for place, (source, _) in enumerate(pairs) if source == macro]
            ahead = margins[frame:stop, own]
            firing = (ahead > 0).any(1).nonzero()
            if not len(firing):
                break
            frame += int(firing[0])
            macro = pairs[own[int(margins[frame, own].argmax())]][1]
            labels[frame:stop] = macro
            frame += 1
    return labels


def predicted_labels(
    scores: Float[Tensor, "frames macros outputs"],
    margins: Float[Tensor, "frames switches"],
    pairs: Sequence[tuple[int, int]],
    cues: Sequence[Sequence[int]],
    lengths: Int64[Tensor, " trajectories"],
    first: Int64[Tensor, " trajectories"],
) -> tuple[Int64[Tensor, " frames"], Float[Tensor, "frames outputs"]]:
    """Macro-labels, and scores under them, of a policy that sees frames and takes its own actions.

    Args:
        scores: f_q(x) of every frame; where cues are given, the class of the highest is the action taken.
        margins: as for `causal_labels`, without regard to cues.
        cues: actions that each switch function may follow, of those that the policy took; none for any.
        pairs, lengths, first: as for `causal_labels`.
    """
    n_actions = scores.shape[2]
    allowed = torch.full((n_actions + 1, len(pairs)), not cues)  # the last row: no action so far
    for place, own in enumerate(cues):
        allowed[torch.tensor(own), place] = True
    sources, targets = torch.tensor(list(pairs), dtype=torch.int64).reshape(-1, 2).unbind(1)
    starts = lengths.cumsum(0) - lengths
    macro, action = first.clone(), torch.full_like(first, n_actions)
    labels, chosen = torch.empty(len(scores), dtype=torch.int64), torch.empty_like(scores[:, 0])
    for time in range(int(lengths.max())):
        rows = (lengths > time).nonzero()[:, 0]
        frames = starts[rows] + time
        if len(sources):
            wanted = margins[frames].masked_fill(
                (sources != macro[rows, None]) | ~allowed[action[rows]], -torch.inf
            )
            highest = wanted.max(1)
            macro[rows] = torch.where(highest.values > 0, targets[highest.indices], macro[rows])
        labels[frames], chosen[frames] = macro[rows], scores[frames, macro[rows]]
        action[rows] = chosen[frames].argmax(1)
    return labels, chosen
