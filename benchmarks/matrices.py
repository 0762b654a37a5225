"""The matrices that ours and every peer train on, in files that each process maps; peers need no torch.

<folder>/<kind>/features.npy  uint8 [frames, columns], C order      held_features.npy  likewise, held out
<folder>/<kind>/actions.npy   int64 [frames], the class, 0..2       held_actions.npy
<folder>/<kind>/lengths.npy   int64 [trajectories], of the training frames
"""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

__all__ = ["KINDS", "SIZES", "Matrix", "planted"]

KINDS = ("pixels", "rectangles", "random")
SIZES = {  # (training frames, columns): whole, quick
    "pixels": ((17_000, 18_432), (3_000, 1_024)),
    "rectangles": ((17_000, 18_432), (3_000, 1_024)),
    "random": ((100_000, 2_000), (5_000, 200)),
}
PLANTED = 12  # columns that the random matrix's classes depend on
NOISE = 0.1  # share of its classes that are drawn anew


@dataclass(frozen=True)
class Matrix:
    """Training and held-out frames with their classes."""

    features: np.ndarray  # uint8 [frames, columns], mapped
    actions: np.ndarray  # int64 [frames]
    lengths: np.ndarray  # int64 [trajectories]
    held_features: np.ndarray  # uint8 [held-out frames, columns], mapped
    held_actions: np.ndarray  # int64 [held-out frames]

    @classmethod
    def load(cls, folder: str | Path) -> "Matrix":
        """The matrix in `folder`, mapped read-only."""
        names = [field.name for field in fields(cls)]
        return cls(*(np.load(Path(folder) / f"{name}.npy", mmap_mode="r") for name in names))

    def save(self, folder: str | Path) -> None:
        """Write `folder`."""
        Path(folder).mkdir(parents=True)
        for field in fields(self):
            np.save(Path(folder) / f"{field.name}.npy", np.ascontiguousarray(getattr(self, field.name)))

    @property
    def n_classes(self) -> int:
        """The number of classes."""
        return int(self.actions.max()) + 1


def planted(n_frames: int, n_held: int, n_columns: int, random: np.random.Generator) -> Matrix:
    """Uniform random levels; the class with the largest sum of planted stumps, a tenth of them drawn anew."""
    total = n_frames + n_held
    features = random.integers(0, 256, (total, n_columns), dtype=np.uint8)
    columns = random.choice(n_columns, PLANTED, replace=False)
    thresholds = random.integers(64, 192, PLANTED)
    votes = random.normal(size=(PLANTED, 3))
    actions = ((features[:, columns] > thresholds) @ votes - votes.sum(0) / 2).argmax(1)
    noisy = random.random(total) < NOISE
    actions[noisy] = random.integers(0, 3, noisy.sum())
    parts = features[:n_frames], actions[:n_frames], np.array([n_frames])
    return Matrix(*parts, features[n_frames:], actions[n_frames:])
