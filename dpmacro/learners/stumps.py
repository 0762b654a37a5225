"""Decision stumps with real confidences, searched exactly over every feature and level in one pass."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int32, Int64, UInt8
from torch import Tensor

__all__ = ["SortedLevels", "StumpClassifier", "StumpLearner", "Stumps"]

LEVELS = 256  # a level is a byte
CHUNK_COLUMNS = 256  # columns whose histograms are in memory at a time


@dataclass(frozen=True)
class SortedLevels:
    """Quantised feature columns with, for every column, the frames sorted by level."""

    levels: UInt8[Tensor, "columns frames"]
    frames: Int32[Tensor, "columns frames"]  # frame numbers, by ascending level
    starts: Int32[Tensor, "columns levels"]  # where each level starts in a column's sorted frames

    @classmethod
    def build(cls, levels: UInt8[Tensor, "columns frames"]) -> "SortedLevels":
        """Sort every column once; all rounds of all problems share the result."""
        frames = torch.empty(levels.shape, dtype=torch.int32, device=levels.device)
        starts = torch.empty(len(levels), LEVELS, dtype=torch.int32, device=levels.device)
        marks = torch.arange(LEVELS, device=levels.device, dtype=torch.uint8)
        for first in range(0, len(levels), CHUNK_COLUMNS):
            chunk = slice(first, first + CHUNK_COLUMNS)
            ordered, order = levels[chunk].sort(dim=1, stable=True)
            frames[chunk] = order.to(torch.int32)
            starts[chunk] = torch.searchsorted(
                ordered, marks.expand(len(ordered), -1).contiguous(), out_int32=True
            )
        return cls(levels, frames, starts)

    @property
    def n_columns(self) -> int:
        """The number of feature columns."""
        return self.levels.shape[0]

    @property
    def n_frames(self) -> int:
        """The number of frames."""
        return self.levels.shape[1]


@dataclass(frozen=True)
class Stumps:
    """One stump per problem: h^m(x) = votes[0, m] where level(x) <= threshold, votes[1, m] above it."""

    columns: Int64[Tensor, " problems"]
    thresholds: UInt8[Tensor, " problems"]
    votes: Float[Tensor, "problems 2 classes"]


@dataclass(frozen=True)
class StumpClassifier:
    """Strong classifiers made of stumps: f^m(x) = sum_t h_t^m(x)."""

    columns: Int64[Tensor, "rounds problems"]
    thresholds: UInt8[Tensor, "rounds problems"]
    votes: Float[Tensor, "rounds problems 2 classes"]

    def select(self, problems: Int64[Tensor, " selected"]) -> "StumpClassifier":
        """The strong classifiers of just these problems, in this order."""
        return StumpClassifier(
            self.columns[:, problems], self.thresholds[:, problems], self.votes[:, problems]
        )

    def scores(self, levels: UInt8[Tensor, "columns frames"]) -> Float[Tensor, "frames problems classes"]:
        """f^m(x) of every frame, problem and class."""
        above = (levels[self.columns] > self.thresholds[..., None]).to(self.votes.dtype)
        steps = self.votes[:, :, 1] - self.votes[:, :, 0]
        return self.votes[:, :, 0].sum(0) + torch.einsum("tpn,tpm->npm", above, steps)

    def scaled(self, factor: float) -> "StumpClassifier":
        """Every vote multiplied by `factor`."""
        return StumpClassifier(self.columns, self.thresholds, factor * self.votes)

    def used_columns(self) -> Int64[Tensor, " used"]:
        """The columns that any stump looks at, ascending."""
        return self.columns.unique()

    def renumbered(self, columns: Int64[Tensor, " kept"]) -> "StumpClassifier":
        """The same classifiers for levels that hold only `columns` (ascending)."""
        return StumpClassifier(torch.searchsorted(columns, self.columns), self.thresholds, self.votes)

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

    `drawn` columns, drawn anew each round, are searched instead of all where it is not 0.
    """

    data: SortedLevels
    drawn: int = 0
    smoothing: float = 0.5

    @property
    def n_frames(self) -> int:
        """The number of training frames."""
        return self.data.n_frames

    @property
    def device(self) -> torch.device:
        """Where the columns are."""
        return self.data.levels.device

    def fit(
        self,
        weights: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
        generator: torch.Generator,
    ) -> Stumps:
        """The best stump of every problem."""
        columns = self._columns(generator)
        table = torch.stack([weights * targets, weights * ~targets], 1).flatten(1)
        shape = (2, *weights.shape[1:])
        best: Tensor | None = None
        for chunk in columns.split(CHUNK_COLUMNS):
            below = self._histograms(table, chunk).cumsum_(1)
            loss = _loss(below.unflatten(2, shape)).flatten(0, 1)  # [columns * levels, problems]
            place = loss.argmin(0)
            found = loss.gather(0, place[None])[0]
            column, threshold = chunk[place // LEVELS], place % LEVELS
            sums = below.flatten(0, 1)[place].unflatten(1, shape)
            here = torch.arange(len(place), device=self.device)
            sides = torch.stack([sums[here, :, here], below[0, -1].unflatten(0, shape).transpose(0, 1)], 1)
            if best is None:
                best, best_column, best_threshold, best_sides = found, column, threshold, sides
                continue
            better = found < best
            best = torch.where(better, found, best)
            best_column = torch.where(better, column, best_column)
            best_threshold = torch.where(better, threshold, best_threshold)
            best_sides = torch.where(better[:, None, None, None], sides, best_sides)
        held = (weights > 0).any(2).sum(0).clamp(min=1)
        slack = self.smoothing * weights.sum((0, 2)) / (held * weights.shape[2])
        return Stumps(best_column, best_threshold.to(torch.uint8), _votes(best_sides, slack))

    def outputs(self, hypotheses: Stumps) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        above = self.data.levels[hypotheses.columns] > hypotheses.thresholds[:, None]
        low, high = hypotheses.votes.unbind(1)
        return torch.where(above.T[:, :, None], high, low)

    def strong(self, rounds: list[Stumps]) -> StumpClassifier:
        """The sum of the rounds' stumps."""
        return StumpClassifier(
            torch.stack([stumps.columns for stumps in rounds]),
            torch.stack([stumps.thresholds for stumps in rounds]),
            torch.stack([stumps.votes for stumps in rounds]),
        )

    def _columns(self, generator: torch.Generator) -> Int64[Tensor, " searched"]:
        n_columns = self.data.n_columns
        if not 0 < self.drawn < n_columns:
            return torch.arange(n_columns, device=self.device)
        columns = torch.randperm(n_columns, generator=generator)[: self.drawn]
        return columns.sort().values.to(self.device)

    def _histograms(self, table: Tensor, columns: Tensor) -> Float[Tensor, "columns levels entries"]:
        """Weights per column and level: sorted frames are the bags' indices, level starts their offsets."""
        rows: Tensor | slice = columns
        if len(columns) == int(columns[-1]) - int(columns[0]) + 1:
            rows = slice(int(columns[0]), int(columns[-1]) + 1)  # a view where indexing would copy
        shift = torch.arange(len(columns), device=self.device, dtype=torch.int32) * self.n_frames
        sums = torch.nn.functional.embedding_bag(
            self.data.frames[rows].flatten(),
            table,
            (self.data.starts[rows] + shift[:, None]).flatten(),
            mode="sum",
        )
        return sums.unflatten(0, (len(columns), LEVELS))


def _loss(
    below: Float[Tensor, "columns levels 2 problems classes"],
) -> Float[Tensor, "columns levels problems"]:
    """Z / 2 of every threshold: sqrt(W+ W-) summed over the two sides and the classes."""
    above = below[:, -1:] - below
    products = below[:, :, 0] * below[:, :, 1], above[:, :, 0] * above[:, :, 1]
    return sum(product.clamp_(min=0).sqrt_().sum(3) for product in products)


def _votes(
    sides: Float[Tensor, "problems 2 2 classes"], slack: Float[Tensor, " problems"]
) -> Float[Tensor, "problems 2 classes"]:
    """1/2 ln((W+ + e) / (W- + e)) for both sides, from [below, total] weights of [right, wrong] labels."""
    below, total = sides.unbind(1)
    weights = torch.stack([below, (total - below).clamp(min=0)], 1)
    right, wrong = (weights + slack[:, None, None, None].clamp(min=torch.finfo(slack.dtype).tiny)).unbind(2)
    return (right / wrong).log() / 2
