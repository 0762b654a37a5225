"""Decision stumps with real confidences, searched exactly over every feature and level in one pass."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

from dpmacro.boosting.learners.base import HEAVIEST, Frames, overflow
from dpmacro.features.levels import LEVELS, SortedColumns, SortedLevels

__all__ = ["Search", "StumpClassifier", "StumpLearner", "Stumps", "sweep"]

CACHED = 2**18  # histogram entries of a chunk of columns that stay in a core's cache
ON_DEVICE = 2**24  # likewise where a large chunk keeps the device busy
REDRAWN = 10  # rounds that a draw serves at least where its columns are sorted when they are drawn
SHORTLIST = 64  # columns that every problem passes on to the rounds that re-use them


@dataclass(frozen=True)
class Stumps:
    """One stump per problem: h^m(x) = votes[0, m] where level(x) <= threshold, votes[1, m] above it."""

    columns: Int64[Tensor, " problems"]
    thresholds: UInt8[Tensor, " problems"]
    votes: Float[Tensor, "problems 2 classes"]


@dataclass(frozen=True)
class Search:
    """Columns that the next rounds search, too."""

    data: SortedLevels
    rounds: int  # how many more


@dataclass(frozen=True)
class StumpClassifier:
    """Strong classifiers made of stumps: f^m(x) = sum_t h_t^m(x)."""

    columns: Int64[Tensor, "rounds problems"]
    thresholds: UInt8[Tensor, "rounds problems"]
    votes: Float[Tensor, "rounds problems 2 classes"]
    kind = "stumps"

    def select(self, problems: Int64[Tensor, " selected"]) -> "StumpClassifier":
        """The strong classifiers of just these problems, in this order."""
        return StumpClassifier(
            self.columns[:, problems], self.thresholds[:, problems], self.votes[:, problems]
        )

    def scores(self, frames: Frames) -> Float[Tensor, "frames problems classes"]:
        """f^m(x) of every frame, problem and class."""
        columns, thresholds, base, steps = self._tables
        n_problems, n_rounds = steps.shape[:2]
        shape = n_problems, n_rounds, frames.levels.shape[1]
        levels = frames.levels.index_select(0, columns).view(shape)
        above = (levels > thresholds).to(steps.dtype)
        return base + torch.bmm(above.transpose(1, 2), steps).transpose(0, 1)

    @cached_property
    def _tables(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Columns and thresholds by problem, the sum of votes below, the step of the votes at each."""
        low, high = self.votes.unbind(2)
        thresholds = self.thresholds.T[..., None].contiguous()
        return self.columns.T.flatten(), thresholds, low.sum(0), (high - low).transpose(0, 1).contiguous()

    def used_columns(self) -> Int64[Tensor, " used"]:
        """The columns that any stump with a vote looks at, ascending."""
        return self.columns[(self.votes != 0).any(3).any(2)].unique()

    def importances(self, n_columns: int) -> Float[Tensor, "problems columns"]:
        """sum_t sum_m |step of h_t^m at its threshold| of the stumps on each of `n_columns` columns."""
        steps = (self.votes[:, :, 1] - self.votes[:, :, 0]).abs().sum(2)
        result = steps.new_zeros(steps.shape[1], n_columns)
        return result.scatter_add_(1, self.columns.T, steps.T)

    def renumbered(self, columns: Int64[Tensor, " kept"]) -> "StumpClassifier":
        """The same classifiers for levels that hold only `columns` (ascending)."""
        places = torch.searchsorted(columns, self.columns).clamp(max=max(len(columns) - 1, 0))
        return StumpClassifier(places, self.thresholds, self.votes)  # those without a vote may look anywhere

    def tensors(self) -> dict[str, Tensor]:
        """What defines the classifiers, for a file."""
        return {"columns": self.columns, "thresholds": self.thresholds, "votes": self.votes}


@dataclass(frozen=True)
class StumpLearner:
    """Exact search for the stump of least exponential loss (Schapire and Singer 1999, AdaBoost.MH).

    With W+ and W- the weights of right and wrong class labels on one side of a threshold, the best
    votes are 1/2 ln((W+ + e) / (W- + e)), and the stump of least Z = 2 sum sqrt(W+ W-) over sides and classes
    wins; ties go to the first column, then to the lowest threshold. e is `smoothing` times the mean
    weight of a frame that has any, so votes stay finite and never overshoot the exact minimiser.

    Two options trade exactness for time:
        drawn: columns, drawn at random, that are searched instead of all, where it is not 0.
        reuse: rounds that a search serves, 1 for just its own. Drawn columns stay for so many rounds; where
            all columns are searched, the best of every problem are searched alone in the rounds that follow.

    Where the data holds no sorted columns, those drawn are sorted when they are drawn, and stay for at least
    `REDRAWN` rounds.
    """

    data: SortedLevels
    drawn: int = 0
    reuse: int = 1
    smoothing: float = 0.5

    def __post_init__(self) -> None:
        if self.reuse < 1 or self.drawn < 0:
            raise ValueError(f"reuse is {self.reuse} and drawn {self.drawn}: give 1 or more, 0 or more")
        if self.drawn == 0 and len(self.data.columns) < self.data.n_columns:
            raise ValueError("drawn is 0 but no column is sorted: draw columns, or sort them all")

    @property
    def n_frames(self) -> int:
        """The number of training frames."""
        return self.data.n_frames

    @property
    def device(self) -> torch.device:
        """Where the columns are."""
        return self.data.levels.device

    def frames(self, part: slice) -> Frames:
        """Some of the training frames, by their levels alone."""
        return Frames(self.data.levels[:, part])

    def fit(
        self,
        weights: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
        generator: torch.Generator,
        memory: Search | None = None,
    ) -> tuple[Stumps, Search | None]:
        """The best stump of every problem, and what the next round searches."""
        search = self._search(generator) if memory is None else memory
        shortlisting = self.reuse > 1 and self.drawn == 0 and memory is None
        found, minima = [], []
        for chunk, below, loss in sweep(search.data, weights, targets):
            found.append(_lowest(loss, below, chunk.thresholds))
            if shortlisting:
                minima.append(loss.amin(1))
        values, places, thresholds, sides = (torch.stack(part) for part in zip(*found, strict=True))
        chunk_of = values.argmin(0)
        problems = torch.arange(len(chunk_of), device=self.device)
        column = places[chunk_of, problems] + chunk_of * _columns_at_a_time(weights)
        held = (weights > 0).any(2).sum(0).clamp(min=1)
        slack = self.smoothing * weights.sum((0, 2)) / (held * weights.shape[2])
        votes = _votes(sides[chunk_of, problems], slack)
        stumps = Stumps(search.data.columns[column], thresholds[chunk_of, problems], votes)
        if shortlisting:
            best = torch.cat(minima).topk(min(SHORTLIST, self.data.n_columns), dim=0, largest=False).indices
            return stumps, Search(self.data.take(best.unique()), self.reuse - 1)
        return stumps, Search(search.data, search.rounds - 1) if search.rounds > 1 else None

    def outputs(self, hypotheses: Stumps) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        above = self.data.levels[hypotheses.columns] > hypotheses.thresholds[:, None]
        low, high = hypotheses.votes.unbind(1)
        return torch.where(above.T[:, :, None], high, low)

    def strong(self, rounds: list[Stumps], steps: Float[Tensor, "rounds problems"]) -> StumpClassifier:
        """sum_t step_t h_t of the rounds' stumps; rounds in which no problem takes a step are left out."""
        steps = steps.to(self.device)
        taken = (steps != 0).any(1)
        return StumpClassifier(
            torch.stack([stumps.columns for stumps in rounds])[taken],
            torch.stack([stumps.thresholds for stumps in rounds])[taken],
            (torch.stack([stumps.votes for stumps in rounds]) * steps[:, :, None, None])[taken],
        )

    def _search(self, generator: torch.Generator) -> Search:
        n_columns = self.data.n_columns
        if self.drawn == 0 or (self.drawn >= n_columns and len(self.data.columns)):
            return Search(self.data, 1)
        columns = torch.randperm(n_columns, generator=generator)[: self.drawn].sort().values
        rounds = self.reuse if len(self.data.columns) else max(self.reuse, REDRAWN)
        return Search(self.data.take(columns), rounds)


def sweep(
    data: SortedLevels,
    weights: Float[Tensor, "frames problems classes"],
    targets: Bool[Tensor, "frames #problems classes"],
) -> Iterator[
    tuple[
        SortedColumns,
        Float[Tensor, "columns bins 2 classes problems"],
        Float[Tensor, "columns bins problems"],
    ]
]:
    """Every sorted column, a chunk at a time: the chunk, the weights up to each threshold, and Z / 2 of each.

    Weights are those of [right, wrong] class labels. Raises ValueError where they sum to `HEAVIEST` or to no
    number.
    """
    weights, targets = weights.transpose(1, 2), targets.transpose(1, 2)
    table = torch.stack([weights * targets, weights * ~targets], 1).flatten(1)
    total = table.sum(0, dtype=torch.float64).to(table.dtype)
    if not bool((total < HEAVIEST).all()):  # nor where one is NaN
        raise ValueError(overflow(weights.transpose(1, 2)))
    for chunk in data.chunks(_columns_at_a_time(weights)):
        below = _histograms(chunk, table, total).cumsum_(1).unflatten(2, (2, *weights.shape[1:]))
        yield chunk, below, _loss(below)


def _columns_at_a_time(weights: Tensor) -> int:
    """Columns whose histograms are in memory together."""
    room = CACHED if weights.device.type == "cpu" else ON_DEVICE
    return min(max(room // (LEVELS * 2 * weights[0].numel()), 1), 128)


def _histograms(
    chunk: SortedColumns, table: Float[Tensor, "frames entries"], total: Float[Tensor, " entries"]
) -> Float[Tensor, "columns bins entries"]:
    """Weights in every bin: sorted frames are the bags' indices; the fullest bin gets what they leave."""
    sums = torch.nn.functional.embedding_bag(chunk.order, table, chunk.starts.flatten(), mode="sum")
    sums = sums.unflatten(0, chunk.starts.shape)
    rest = (total - sums.sum(1)).clamp_(min=0)
    sums[torch.arange(len(sums), device=sums.device), chunk.fullest] = rest
    return sums


def _loss(
    below: Float[Tensor, "columns bins 2 classes problems"],
) -> Float[Tensor, "columns bins problems"]:
    """Z / 2 of every threshold: sqrt(W+ W-) summed over the two sides and the classes."""
    above = below[:, -1:] - below
    low = (below[:, :, 0] * below[:, :, 1]).sqrt_()
    high = (above[:, :, 0] * above[:, :, 1]).clamp_(min=0).sqrt_()
    return reduce(add, low.add_(high).unbind(2))


def _lowest(
    loss: Float[Tensor, "columns bins problems"],
    below: Float[Tensor, "columns bins 2 classes problems"],
    thresholds: UInt8[Tensor, "columns bins"],
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Loss, column, threshold and weights [below, in all][right, wrong] of every problem's best stump."""
    place = loss.flatten(0, 1).argmin(0)
    bins, problems = loss.shape[1], torch.arange(len(place), device=place.device)
    column, bin_ = place // bins, place % bins
    pairs = below[column, bin_, :, :, problems], below[column, -1, :, :, problems]
    return loss[column, bin_, problems], column, thresholds[column, bin_], torch.stack(pairs, 1)


def _votes(
    sides: Float[Tensor, "problems 2 2 classes"], slack: Float[Tensor, " problems"]
) -> Float[Tensor, "problems 2 classes"]:
    """1/2 ln((W+ + e) / (W- + e)) for both sides, from [below, total] weights of [right, wrong] labels."""
    below, total = sides.unbind(1)
    weights = torch.stack([below, (total - below).clamp(min=0)], 1)
    right, wrong = (weights + slack[:, None, None, None].clamp(min=torch.finfo(slack.dtype).tiny)).unbind(2)
    return (right / wrong).log() / 2
