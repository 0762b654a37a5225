"""Encoders side by side."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int64, Num
from torch import Tensor

from dpmacro.features.base import Encoder, Seen, input_name

__all__ = ["Concat"]


@dataclass(frozen=True)
class Concat:
    """The columns of several encoders, one encoder's after another's.

    Values are int32 where those of all parts are, else float64, which holds int32 and float32 exactly.
    """

    parts: tuple[Encoder, ...]  # 1 at least
    kind = "concat"

    @classmethod
    def of(cls, parts: Sequence[Encoder]) -> Encoder:
        """These side by side, without those that have no column; a single one as it is.

        Where no part has a column, the first stays: it still says how many frames there are.
        Raises ValueError where there is no part.
        """
        if not parts:
            raise ValueError("no encoder is given: give 1 at least")
        flat = [one for part in parts for one in (part.parts if isinstance(part, Concat) else (part,))]
        kept = [part for part in flat if part.count] or flat[:1]
        return kept[0] if len(kept) == 1 else cls(tuple(kept))

    @property
    def count(self) -> int:
        """The number of columns."""
        return sum(part.count for part in self.parts)

    @property
    def needs(self) -> dict[str, tuple[int, ...]]:
        """What the parts need together."""
        found: dict[str, set[int]] = {}
        for part in self.parts:
            for key, lags in part.needs.items():
                found.setdefault(key, set()).update(lags)
        return {key: tuple(sorted(lags)) for key, lags in found.items()}

    @property
    def keys(self) -> tuple[str, ...]:
        """Those of the parts, each once."""
        return tuple(self.needs)

    @property
    def lags(self) -> tuple[int, ...]:
        """Those of the parts, each once."""
        return tuple(sorted({lag for part in self.parts for lag in part.lags}))

    @property
    def dtype(self) -> torch.dtype:
        """int32 or float64."""
        return torch.int32 if all(part.dtype == torch.int32 for part in self.parts) else torch.float64

    @property
    def sees_pixels(self) -> Bool[Tensor, " columns"]:
        """Of every part's columns."""
        return torch.cat([part.sees_pixels for part in self.parts])

    def values(self, seen: Seen) -> Num[Tensor, "columns frames"]:
        """The values of every part, exact."""
        result, row = None, 0
        for part in self.parts:
            values = part.values(seen)
            if result is None:
                size = self.count, values.shape[1]
                result = torch.empty(size, dtype=self.dtype, device=values.device)
            result[row : row + part.count] = values
            row += part.count
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> Encoder:
        """Just these columns, in this order: for each run of columns of one part, what that selects."""
        columns = columns.cpu()
        sizes = torch.tensor([part.count for part in self.parts])
        ends = sizes.cumsum(0)
        owners, runs = torch.searchsorted(ends, columns, right=True).unique_consecutive(return_counts=True)
        chosen = [
            self.parts[owner].select(own - (ends - sizes)[owner])
            for owner, own in zip(owners.tolist(), columns.split(runs.tolist()), strict=True)
        ]
        return Concat.of(chosen or [self.parts[0].select(columns)])

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> dict[str, Float[Tensor, "rows _ _"]]:
        """The sum over the parts of a camera."""
        found: dict[str, Tensor] = {}
        own = weights.split([part.count for part in self.parts], 1)
        for part, weight in zip(self.parts, own, strict=True):
            for camera, added in part.footprint(weight).items():
                found[camera] = found[camera] + added if camera in found else added
        return found

    def names(self) -> list[str]:
        """Those of the parts, with the key where a name would mean columns of two."""
        by_part = [(part, set(part.names())) for part in self.parts]
        homes = Counter((name, key) for part, names in by_part for name in names for key in part.keys)
        shared = Counter(name for name, _ in homes)
        return [
            f"{name} of {input_name(part.keys[0])}" if shared[name] > 1 else name
            for part in self.parts
            for name in part.names()
        ]

    def spec(self) -> dict[str, Any]:
        """Those of the parts."""
        return {"kind": self.kind, "parts": [part.spec() for part in self.parts]}

    def tensors(self) -> dict[str, Tensor]:
        """Those of the parts, the number of the part before each name."""
        return {
            f"{number}.{name}": tensor
            for number, part in enumerate(self.parts)
            for name, tensor in part.tensors().items()
        }
