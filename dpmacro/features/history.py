"""What was seen before a frame: in recorded trajectories, and while a policy runs.

Both say the same: before a trajectory's first frame there is that frame again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from dpmacro.features.base import Encoder, Observation, Seen, frames_lagged

__all__ = ["History", "Recording"]

ALL = slice(None)


class Recording:
    """Observations of whole trajectories, concatenated frame by frame.

    Args:
        observations: by key, frames first.
        lengths: frames per trajectory, 1 at least.

    Raises ValueError where a key has another number of frames.
    """

    def __init__(self, observations: Observation, lengths: Int64[Tensor, " trajectories"]) -> None:
        self.n_frames = int(lengths.sum())
        for key, value in observations.items():
            if len(value) != self.n_frames:
                raise ValueError(f"{key} has {len(value)} frames, the trajectories have {self.n_frames}")
        self._observations = observations
        self._lengths = lengths
        self._frames: dict[tuple[int, torch.device], Tensor] = {}

    def seen(self, encoder: Encoder, frames: slice | Int64[Tensor, " chosen"] = ALL) -> Seen:
        """What `encoder` looks at in these frames: copies, but for a slice of the frames themselves."""
        seen: dict[int, dict[str, Tensor]] = {lag: {} for lag in encoder.lags}
        for key, lags in encoder.needs.items():
            if key not in self._observations:
                raise ValueError(f"no {key} was recorded, only {', '.join(self._observations)}")
            value = self._observations[key]
            for lag in lags:
                seen[lag][key] = value[frames if lag == 0 else self._lagged(lag, value.device)[frames]]
        return seen

    def _lagged(self, lag: int, device: torch.device) -> Int64[Tensor, " frames"]:
        """The frame `lag` before each frame, computed once."""
        if (lag, device) not in self._frames:
            self._frames[lag, device] = frames_lagged(self._lengths.to(device), lag)
        return self._frames[lag, device]


@dataclass(frozen=True)
class History:
    """What a running policy remembers between frames, for every row of a batch.

    Attributes:
        needs: how many frames back each key is looked at, as an encoder's `needs` say.
        batch: number of rows.
        past: by key, the last observations of all rows, the latest first, as many as the key's largest lag;
            empty before the first frame.
        begins: the rows that begin anew with the next frame; None for none.
    """

    needs: Mapping[str, tuple[int, ...]]
    batch: int
    past: Mapping[str, tuple[Tensor, ...]] = field(default_factory=dict)
    begins: Bool[Tensor, " batch"] | None = None

    @classmethod
    def start(cls, encoder: Encoder, batch: int) -> "History":
        """Before the first frame of `batch` rows."""
        return cls(encoder.needs, batch)

    def restart(self, which: Bool[Tensor, " batch"]) -> "History":
        """The rows of `which` begin anew with the next frame while the others run on."""
        if not self.past:
            return self
        begins = which.clone() if self.begins is None else self.begins | which.to(self.begins.device)
        return replace(self, begins=begins)

    def push(self, observation: Observation) -> tuple[Seen, "History"]:
        """What an encoder looks at in these frames, one a row, and the history after them.

        Nothing is lost where the caller writes to its tensors later: what is remembered is a copy.

        Raises ValueError where a key is missing or has another number of rows.
        """
        seen: dict[int, dict[str, Tensor]] = {lag: {} for lags in self.needs.values() for lag in lags}
        remembered = {}
        for key, lags in self.needs.items():
            now = self._now(observation, key)
            past = self._past(key, now, lags[-1])
            for lag in lags:
                seen[lag][key] = past[lag - 1] if lag else now
            if past:
                remembered[key] = (now.clone(), *past[:-1])
        return seen, replace(self, past=remembered, begins=None)

    def _now(self, observation: Observation, key: str) -> Tensor:
        """The rows of a key."""
        if key not in observation:
            raise ValueError(f"the observation has no {key}, only {', '.join(observation) or 'nothing'}")
        now = observation[key]
        if len(now) != self.batch:
            raise ValueError(f"{key} has {len(now)} rows: the policy was started with {self.batch}")
        return now

    def _past(self, key: str, now: Tensor, size: int) -> tuple[Tensor, ...]:
        """The last `size` observations of a key, where rows that begin have seen this frame alone."""
        if key not in self.past:
            return (now.clone(),) * size if size else ()
        if self.begins is None:
            return self.past[key]
        begins = self.begins.to(now.device).view(-1, *[1] * (now.ndim - 1))
        return tuple(torch.where(begins, now, one) for one in self.past[key])
