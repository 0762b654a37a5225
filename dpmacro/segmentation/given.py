"""Labels that people gave to some frames, held exactly while the recursion labels the others.

The recursion sees costs alone, and so what is given becomes costs. Let g_n be the label given to frame n, L a
lower bound on the cost of any labelling of a trajectory that keeps to what is given, and U the cost of one
that does. With

    c'_n(q) = c_n(g_n) + B   for q != g_n,    B > U - L,

a labelling that departs from a given label, wherever it does, costs L + B > U or more: the cheapest labels
under c' keep to all that is given, and among those that do they are the cheapest under c. B is of the size of
what there is to gain and not a huge number: prefix sums of a huge one would lose the digits of the costs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64, Num
from torch import Tensor

from dpmacro.segmentation.arguments import ORDERS
from dpmacro.segmentation.padding import blocks_of, frames_inside, pad
from dpmacro.segmentation.recursion import segment
from dpmacro.segmentation.segments import transition_counts
from dpmacro.utils.checks import as_count, shown
from dpmacro.utils.tensors import ArrayLike, as_lengths, as_whole_vector

__all__ = ["FREE", "GivenLabels"]

FREE = -1  # the label of a frame for which none is given


@dataclass(frozen=True)
class GivenLabels:
    """Labels of some frames that every segmentation is to keep; made by `of`, which checks that it can.

    Attributes:
        labels: 0..Q-1, or `FREE` where none is given.
        filled: labels of all frames that keep to those, within the bound or in the order of the chain.
        lengths: frames of every trajectory.
        macros: Q.
        max_transitions: S.
        order: 'free' or 'chain', as for `segment`.
    """

    labels: Int64[Tensor, " frames"]
    filled: Int64[Tensor, " frames"]
    lengths: Int64[Tensor, " trajectories"]
    macros: int
    max_transitions: int
    order: str = "free"

    @classmethod
    def of(
        cls,
        labels: ArrayLike,
        lengths: ArrayLike,
        macros: int,
        max_transitions: int,
        order: str = "free",
        numbers: Sequence[int] | None = None,
    ) -> "GivenLabels":
        """The given labels, on the CPU, once it is clear that a segmentation can keep to them.

        Args:
            labels: of every frame 0..Q-1, or -1 where none is given.
            lengths: frames of every trajectory.
            macros: Q, at least 1.
            max_transitions: S, 0 or more; for a chain Q - 1.
            order: 'free' or 'chain', as for `segment`.
            numbers: of the trajectories, as messages name them; their places by default.

        Raises ValueError naming the demonstration whose given labels need more transitions than S, or are in
        no chain 0, 1, ..., S; and for labels out of range, or lengths that do not add up to their number.
        """
        if order not in ORDERS:
            raise ValueError(f"order is {shown(order)}: give {' or '.join(map(repr, ORDERS))}")
        as_count("macros", macros)
        as_count("max_transitions", max_transitions, 0)
        if order == "chain" and macros != max_transitions + 1:
            raise ValueError(
                f"max_transitions is {max_transitions}: give {macros - 1} for a chain of {macros}"
            )
        shape = "[frames], -1 where no label is given"
        found = as_whole_vector("given labels", labels, shape, least=FREE, most=macros - 1).cpu()
        frames = as_lengths(lengths, len(found), "given labels")
        called = range(len(frames)) if numbers is None else numbers
        if len(called) != len(frames):
            raise ValueError(f"numbers are {len(called)} for {len(frames)} trajectories: give one for each")
        if order == "chain":
            filled = _filled_chain(found, frames, macros)
            _check_chain(found, filled, frames, macros, called)
        else:
            filled = _filled(found, frames)
            _check_bound(transition_counts(filled, frames), max_transitions, called)
        return cls(found, filled, frames, int(macros), int(max_transitions), order)

    @property
    def held(self) -> Bool[Tensor, " frames"]:
        """Where a label is given."""
        return self.labels != FREE

    def costs(
        self,
        costs: Num[Tensor, "frames macros"],
        transition_costs: Num[Tensor, "frames macros macros"] | None = None,
    ) -> Float[Tensor, "frames macros"]:
        """Costs under which `segment` keeps to the given labels, and cuts the other frames as under `costs`.

        Float64, on the device of `costs`. The frames may be those of these trajectories several times over,
        as where restarts lie side by side. What `segment` says of the cost of its labels stays right; its
        best cost under a bound that is too small for the given labels is larger than any that is not. What
        is not finite passes, for `segment` to refuse.

        Args:
            costs: c_n(q), as for `segment`.
            transition_costs: those that `segment` gets with these costs; they count in how large B is.

        Raises ValueError where there are not as many frames, once or several times, or macro-actions.
        """
        times, rest = divmod(len(costs), len(self.labels))
        if rest or not times or costs.shape[1] != self.macros:
            raise ValueError(
                f"costs have shape {list(costs.shape)}: give {[len(self.labels), self.macros]}, the frames "
                "and macro-actions of the given labels, or so many frames several times over"
            )
        known = costs.double()
        labels, filled = (one.repeat(times).to(costs.device) for one in (self.labels, self.filled))
        held = labels != FREE
        own = known.gather(1, labels.clamp(min=0)[:, None])
        least = torch.where(held, own[:, 0], known.amin(1))
        gain = known.gather(1, filled[:, None])[:, 0] - least
        of_frame = torch.arange(len(self.lengths) * times).repeat_interleave(self.lengths.repeat(times))
        of_frame = of_frame.to(costs.device)
        gain = gain.new_zeros(len(self.lengths) * times).index_add(0, of_frame, gain)
        size = known.abs().amax(1)
        size = torch.zeros_like(gain).scatter_reduce(0, of_frame, size, "amax")
        if transition_costs is not None:
            spent, largest = self._transitions(transition_costs, filled, of_frame, len(gain))
            gain, size = gain + spent, torch.maximum(size, largest)
        barrier = 2 * gain + torch.where(size > 0, size, 1.0)
        other = torch.ones_like(known, dtype=torch.bool).scatter(1, labels.clamp(min=0)[:, None], False)
        return torch.where(held[:, None] & other, own + barrier[of_frame, None], known)

    def nearest(
        self, labels: Int64[Tensor, "labellings frames"], rename: bool = False
    ) -> Int64[Tensor, "labellings frames"]:
        """Of every labelling the one that keeps to what is given and differs from it on the fewest frames.

        It is within the bound, or in the order of the chain: what an alternation may begin with. With
        `rename` the macro-actions of every labelling, 0..Q-1, are first numbered such that they agree with
        the given labels on as many frames as can be, since a search that knew of none numbers them at will.
        """
        own = torch.stack([self._renamed(one) for one in labels]) if rename else labels
        differs = 1 - torch.nn.functional.one_hot(own.flatten(), self.macros).double()
        lengths = self.lengths.repeat(len(labels))
        found = segment(self.costs(differs), lengths, self.max_transitions, order=self.order).labels
        return found.view(labels.shape)

    def _renamed(self, labels: Int64[Tensor, " frames"]) -> Int64[Tensor, " frames"]:
        from scipy.optimize import linear_sum_assignment  # late: its import takes longer than ours

        held = self.held.to(labels.device)
        pairs = labels[held] * self.macros + self.labels.to(labels.device)[held]
        agreeing = pairs.bincount(minlength=self.macros**2).view(self.macros, self.macros)
        names = linear_sum_assignment(agreeing.cpu().numpy(), maximize=True)[1]
        return torch.from_numpy(names).to(labels)[labels]

    def _transitions(
        self, costs: Tensor, filled: Tensor, of_frame: Tensor, n_trajectories: int
    ) -> tuple[Float[Tensor, " trajectories"], Float[Tensor, " trajectories"]]:
        """For every trajectory what the transitions of `filled` cost beyond the least that any S can.

        And the largest size of a transition cost; both of those alone that a segmentation reads.
        """
        costs = costs.double()
        read = torch.ones(costs.shape[1:], dtype=torch.bool, device=costs.device).fill_diagonal_(False)
        if self.order == "chain":
            read = read.triu(1).tril(1)
        follows = of_frame == of_frame.roll(1)
        follows[0] = False
        known = costs.masked_fill(~(read & follows[:, None, None]), 0)
        zeros = known.new_zeros(n_trajectories)
        least = zeros.scatter_reduce(0, of_frame, known.amin((1, 2)), "amin")
        largest = zeros.scatter_reduce(0, of_frame, known.abs().amax((1, 2)), "amax")
        paid = known[torch.arange(len(filled), device=filled.device), filled.roll(1), filled]
        return zeros.index_add(0, of_frame, paid) - self.max_transitions * least, largest


def _filled(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, " frames"]:
    """Every frame with the label given last before it, else with the next one in its trajectory, else 0.

    There are as many transitions as there are changes from one given label to the next: no fewer can be.
    """
    parts = []
    for _, padded, inside in _padded(labels, lengths):
        known = padded != FREE
        time = torch.arange(padded.shape[1])
        last = torch.where(known, time, -1).cummax(1).values
        first = torch.where(known.any(1), known.int().argmax(1), 0)[:, None]
        filled = padded.gather(1, torch.where(last >= 0, last, first))
        parts.append(filled.clamp(min=0)[inside])
    return torch.cat(parts)


def _filled_chain(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"], macros: int
) -> Int64[Tensor, " frames"]:
    """The chain whose changes are as late as what is given allows; where none does it departs from that.

    Frame n holds the largest label given up to n, or more where a label given at a later frame m wants it:
    one change a frame leaves no less than that label less m - n. The first frame counts as given 0, the last
    as S.
    """
    parts = []
    for part, padded, inside in _padded(labels, lengths):
        time, rows = torch.arange(padded.shape[1]), torch.arange(len(padded))
        before, after = padded.clone(), padded.clone()
        before[:, 0] = before[:, 0].clamp(min=0)
        after[rows, part - 1] = macros - 1
        wanted = torch.where(after != FREE, after - time, -len(time) - macros)
        wanted = wanted.flip(1).cummax(1).values.flip(1) + time
        parts.append(torch.maximum(before.cummax(1).values, wanted)[inside])
    return torch.cat(parts)


def _padded(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]
) -> Iterator[tuple[Int64[Tensor, " part"], Int64[Tensor, "part time"], Bool[Tensor, "part time"]]]:
    """Trajectories in portions: lengths, labels, `FREE` after the end of each, and where frames are."""
    for frames, part in blocks_of(labels[:, None], lengths):
        inside = frames_inside(part)
        yield part, pad(labels[frames], inside).masked_fill(~inside, FREE), inside


def _check_bound(needed: Int64[Tensor, " trajectories"], max_transitions: int, called: Sequence[int]) -> None:
    """Raise ValueError for the first trajectory whose given labels change more often than is allowed."""
    wrong = (needed > max_transitions).nonzero()
    if len(wrong):
        place = int(wrong[0])
        raise ValueError(
            f"demonstration {called[place]}: the labels given to it have {int(needed[place])} transitions, "
            f"max_transitions is {max_transitions}: allow {int(needed.max())}, or correct the labels"
        )


def _check_chain(
    labels: Int64[Tensor, " frames"],
    filled: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    macros: int,
    called: Sequence[int],
) -> None:
    """Raise ValueError for the first frame at which no chain has the label that is given."""
    ends = lengths.cumsum(0)
    starts = ends - lengths
    wanted = labels.clone()
    for places, label in ((starts, 0), (ends - 1, macros - 1)):
        wanted[places] = torch.where(wanted[places] == FREE, label, wanted[places])
    wrong = (wanted != FREE) & (wanted != filled)
    for places, label in ((starts, 0), (ends - 1, macros - 1)):
        wrong[places] |= wanted[places] != label
    if bool(wrong.any()):
        frame = int(wrong.nonzero()[0])
        place = int((ends <= frame).sum())
        raise ValueError(
            f"demonstration {called[place]}: near its frame {frame - int(starts[place])} the labels given "
            f"to it are in no chain 0, 1, ..., {macros - 1} of {int(lengths[place])} frames, each label once "
            "and in this order: correct them, or give order 'free'"
        )
