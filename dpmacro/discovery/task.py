"""What a search is asked: the actions to explain, within which bounds, and what is left out together."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Int64, Num
from torch import Tensor

from dpmacro.boosting.losses.base import Loss
from dpmacro.segmentation.given import FREE, GivenLabels

__all__ = ["Task"]

TOLERANCE = 5  # frames, of vectors


@dataclass(frozen=True)
class Task:
    """What is to be explained, and what is left out together."""

    actions: Num[Tensor, "frames *dims"]  # classes 0.., or standardised vectors
    lengths: Int64[Tensor, " trajectories"]
    groups: Int64[Tensor, " trajectories"]  # trajectories of a group are left out together
    loss: Loss  # of the actions
    macros: int
    max_transitions: int
    seed: int
    order: str = "free"  # of macro-actions: "free", or "chain" for 0, 1, ..., S in every trajectory
    given: Int64[Tensor, " frames"] | None = None  # labels that are kept, `FREE` elsewhere; None for none

    @cached_property
    def known(self) -> GivenLabels:
        """The labels that are given, where some are; ValueError where no segmentation keeps to them."""
        assert self.given is not None, "the callers asked"
        return GivenLabels.of(self.given, self.lengths, self.macros, self.max_transitions, self.order)

    def held(
        self, costs: Num[Tensor, "frames macros"], changing: Num[Tensor, "..."] | None = None
    ) -> Num[Tensor, "frames macros"]:
        """Costs under which `segment` keeps to the given labels, once or several times the frames."""
        return costs if self.given is None else self.known.costs(costs, changing)

    def kept_to(self, labellings: Int64[Tensor, "labellings frames"]) -> Int64[Tensor, "labellings frames"]:
        """Labellings with the given labels, numbered to agree with them where the order is free."""
        if self.given is None or not len(labellings):
            return labellings
        return self.known.nearest(labellings, rename=self.order == "free")

    def numbered_as(self, labels: Int64[Tensor, " frames"]) -> "Task":
        """The task whose macro-actions are those of `labels`, 0..Q-1 anew, which keep to what is given."""
        given = None if self.given is None else torch.where(self.given == FREE, FREE, labels)
        return replace(self, macros=int(labels.max()) + 1, given=given)

    @property
    def tolerance(self) -> int:
        """Frames by which a change may be recognised early or late.

        Of classes none: the next action may lead to where the change is not seen any more. Vectors change
        little from frame to frame, and so does what is seen.
        """
        return TOLERANCE if self.vectors else 0

    @property
    def vectors(self) -> bool:
        """Whether actions are vectors."""
        return self.actions.ndim == 2

    @property
    def n_groups(self) -> int:
        """How many groups of trajectories there are to leave out."""
        return len(self.groups.unique())
