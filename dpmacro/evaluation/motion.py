"""Whether what a run observes at its end still changes, and whether it repeats itself."""

import hashlib
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

__all__ = ["END", "Motion"]

END = 50  # steps
ROUNDING = 1e-5  # share of its size, up to which a number does not count as moving
STILL = 0.01  # share of the range in a run, up to which a number that moves does not count as moving
ALIKE = 0.1  # share of its range at the end, up to which a number that moves has come back
WHOLE = 0.5  # share of that range that a number must cover within one period
LARGEST = 10_000  # numbers; beyond, vectors are compared as pictures are


class Motion:
    """The observations of a run, the last `END` kept: vectors as they are, pictures as digests."""

    def __init__(self) -> None:
        self._vectors: deque[np.ndarray] = deque(maxlen=END)
        self._digests: deque[bytes] = deque(maxlen=END)
        self._low: np.ndarray = np.zeros(0)
        self._high: np.ndarray = np.zeros(0)

    def see(self, observation: Mapping[str, np.ndarray]) -> None:
        """Note an observation, a picture or a vector by every key."""
        vectors: list[np.ndarray] = [np.zeros(0)]
        pictures = hashlib.blake2b(digest_size=16)
        for value in observation.values():
            if value.ndim == 1 and value.size <= LARGEST:
                vectors.append(value.astype(np.float64))
            else:
                pictures.update(np.ascontiguousarray(value).tobytes())
        vector = np.concatenate(vectors)
        if not self._vectors:
            self._low, self._high = vector, vector
        self._low, self._high = np.minimum(self._low, vector), np.maximum(self._high, vector)
        self._vectors.append(vector)
        self._digests.append(pictures.digest())

    def period(self) -> int:
        """Steps after which the last `END` observations repeat themselves, up to half of `END`.

        1 where nothing moves, 0 where they do not repeat themselves or there are fewer.

        A picture has to come back exactly. A number moves where it covers more than the share `STILL` of its
        range in the whole run, and more than the share `ROUNDING` of its size. It comes back where it is off
        by no more than the share `ALIKE` of what it covers at the end, and covers at least the share `WHOLE`
        of that in one period.
        """
        if len(self._vectors) < END:
            return 0
        values, digests = np.stack(self._vectors), list(self._digests)
        covered = np.ptp(values, axis=0)
        size = np.maximum(np.abs(self._low), np.abs(self._high))
        moving = covered > np.maximum(STILL * (self._high - self._low), ROUNDING * size)
        values, covered = values[:, moving], covered[moving]
        if not moving.any() and len(set(digests)) == 1:
            return 1
        for period in range(2, END // 2 + 1):
            if digests[period:] == digests[:-period] and _repeats(values, covered, period):
                return period
        return 0


def _repeats(
    values: Float[np.ndarray, "steps numbers"], covered: Float[np.ndarray, " numbers"], period: int
) -> bool:
    back: Any = np.abs(values[period:] - values[:-period]) <= ALIKE * covered
    return bool(back.all() and (np.ptp(values[-period - 1 :], axis=0) >= WHOLE * covered).all())
