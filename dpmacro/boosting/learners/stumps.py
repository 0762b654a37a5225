"""Decision stumps with real confidences, searched exactly over every feature and level in one pass."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int64, Shaped, UInt8
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, StrongClassifier
from dpmacro.boosting.learners.sweep import CLASSES, Best, lowest, sweep
from dpmacro.boosting.losses.base import Loss
from dpmacro.features.levels import LEVELS, SortedLevels
from dpmacro.utils.stages import storable

__all__ = ["Search", "StumpClassifier", "StumpLearner", "Stumps"]

REDRAWN = 10  # rounds that a draw serves at least where its columns are sorted when they are drawn
ROW = 48  # numbers in a row of the table, which is gathered by frame: with `BLOCK` rows a megabyte and a half
SHORTLIST = 64  # columns that every problem passes on to the rounds that re-use them


@storable
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


@storable
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
    """Exact search for the stump that leaves the least loss, of classes or of vectors.

    Of classes (Schapire and Singer 1999, AdaBoost.MH): with W+ and W- the weights of right and wrong class
    labels on one side of a threshold, the best votes are 1/2 ln((W+ + e) / (W- + e)), and the stump of least
    Z = 2 sum sqrt(W+ W-) over sides and classes wins. Of vectors: with G and H the sums of weighted residuals
    and of weights on one side, the votes are G / H, and the stump of largest sum |G|^2 / H wins
    (dpmacro/boosting/losses/vectors.py). Ties go to the first column, then to the lowest threshold. e is
    `smoothing` times the mean weight of a frame that has any, so votes stay finite and never overshoot the
    exact minimiser.

    Three options trade exactness for time:
        drawn: columns, drawn at random (`SortedLevels.drawn`), that are searched instead of all, where it is
            not 0.
        reuse: rounds that a search serves, 1 for just its own. Drawn columns stay for so many rounds; where
            all columns are searched, the best of every problem are searched alone in the rounds that follow.

        bins: levels side by side of a column that has more than so many are taken together, with one
            threshold for all.

    Where the data holds no sorted columns, those drawn are sorted when they are drawn, and stay for at least
    `REDRAWN` rounds.
    """

    data: SortedLevels
    drawn: int = 0
    reuse: int = 1
    smoothing: float = 0.5
    bins: int = LEVELS

    def __post_init__(self) -> None:
        if self.reuse < 1 or self.drawn < 0:
            raise ValueError(f"reuse is {self.reuse} and drawn {self.drawn}: give 1 or more, 0 or more")
        if self.drawn == 0 and not self.data.is_sorted:
            raise ValueError("drawn is 0 but no column is sorted: draw columns, or sort them all")

    @property
    def n_frames(self) -> int:
        """The number of training frames."""
        return self.data.n_frames

    @property
    def device(self) -> torch.device:
        """Where the columns are."""
        return self.data.levels.device

    def shown(
        self, strong: StrongClassifier, n_frames: int, size: int
    ) -> tuple[StrongClassifier, Iterator[Frames]]:
        """The classifiers, and the first training frames as they look at them, `size` at a time."""
        used = strong.used_columns()
        used = used if len(used) else torch.zeros(1, dtype=torch.int64, device=used.device)
        parts = (self.data.levels[:, k : min(k + size, n_frames)] for k in range(0, n_frames, size))
        return strong.renumbered(used), (Frames(self.data.shares.rows(part, used)) for part in parts)

    def fit(
        self,
        weights: Float[Tensor, "frames problems width"],
        responses: Shaped[Tensor, "frames #problems outputs"],
        generator: torch.Generator,
        memory: Search | None = None,
        loss: Loss = CLASSES,
    ) -> tuple[Stumps, Search | None]:
        """The best stump of every problem, and what the next round searches."""
        search = self._search(generator) if memory is None else memory
        shortlisting = self.reuse > 1 and self.drawn == 0 and memory is None
        held = (weights > 0).any(2).sum(0).clamp(min=1)
        slack = self.smoothing * weights.sum((0, 2)) / (held * weights.shape[2])
        found, minima = zip(
            *(
                self._best(search.data, weights[:, part], _own(responses, part), loss, slack[part])
                for part in _side_by_side(weights, responses, loss)
            ),
            strict=True,
        )
        best = Best.side_by_side(found).of_all(search.data.shares.ranks)
        stumps = Stumps(best.columns, best.thresholds, loss.votes(best.sides, slack))
        if shortlisting:
            return stumps, Search(self.data.take(self._shortlist(torch.cat(minima, 1))), self.reuse - 1)
        return stumps, Search(search.data, search.rounds - 1) if search.rounds > 1 else None

    def outputs(self, hypotheses: Stumps) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        above = self.data.above(hypotheses.columns, hypotheses.thresholds)
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
        if self.drawn == 0 or (self.drawn >= n_columns and self.data.is_sorted):
            return Search(self.data, 1)
        columns = self.data.drawn(self.drawn, generator)
        rounds = self.reuse if self.data.is_sorted else max(self.reuse, REDRAWN)
        return Search(self.data.take(columns), rounds)

    def _best(
        self,
        data: SortedLevels,
        weights: Float[Tensor, "frames problems width"],
        responses: Shaped[Tensor, "frames #problems outputs"],
        loss: Loss,
        slack: Float[Tensor, " problems"],
    ) -> tuple[Best, Float[Tensor, "sorted problems"]]:
        """The best stumps of this rank's sorted columns, and the least that each column leaves."""
        found, minima = [], [weights.new_zeros(0, weights.shape[1])]
        for chunk, below, left in sweep(data, weights, responses, loss, slack, self.bins):
            found.append(lowest(left, below, chunk))
            minima.append(left.amin(1))
        if not found:  # other ranks hold the columns
            found = [Best.none(loss.table(weights[:1], responses[:1])[0])]
        return Best.among(found), torch.cat(minima)

    def _shortlist(self, minima: Float[Tensor, "own problems"]) -> Int64[Tensor, " shortlisted"]:
        """The `SHORTLIST` columns that leave each problem least, the first of equals."""
        left = self.data.shares.whole(minima)
        return left.argsort(dim=0, stable=True)[:SHORTLIST].unique()


def _own(
    responses: Shaped[Tensor, "frames #problems outputs"], part: slice
) -> Shaped[Tensor, "frames #some outputs"]:
    """Responses of some problems; those that all have in common as they are."""
    return responses if responses.shape[1] == 1 else responses[:, part]


def _side_by_side(
    weights: Float[Tensor, "frames problems width"],
    responses: Shaped[Tensor, "frames #problems outputs"],
    loss: Loss,
) -> list[slice]:
    """Problems in so many at a time that a block of their table stays in a core's cache; all on a GPU."""
    count = weights.shape[1]
    each = loss.table(weights[:1, :1], responses[:1, :1])[0].numel()
    size = max(ROW // each, 1) if weights.device.type == "cpu" else count
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]
