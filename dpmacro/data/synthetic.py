"""Sequences whose hidden macro-actions are known by construction: an unseen rule for the actions changes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64, UInt8

__all__ = ["RULES", "Digits", "TwoRules", "digits", "two_rules"]

COLUMNS = 6  # of `two_rules`: the signal, one for each rule, and noise
SIGNAL_FRAMES = 3  # that show a change

# What action 1 says of a digit.
RULES: dict[str, Callable[[Int64[np.ndarray, " frames"]], np.ndarray]] = {
    "odd": lambda digit: digit % 2 == 1,
    "5 or more": lambda digit: digit >= 5,
    "multiple of 3": lambda digit: digit % 3 == 0,
    "mod 4 below 2": lambda digit: digit % 4 < 2,
}


@dataclass(frozen=True)
class TwoRules:
    """Trajectories, concatenated frame by frame; `lengths` says where each ends.

    Attributes:
        features: column 0 signals the change, columns 1 and 2 decide the actions, the others decide nothing.
        actions: 0 or 1.
        lengths: frames per trajectory.
        truth: the macro-label, 0 while column 1 decides, 1 while column 2 does.
    """

    features: Float32[np.ndarray, "frames columns"]
    actions: Int64[np.ndarray, " frames"]
    lengths: Int64[np.ndarray, " trajectories"]
    truth: Int64[np.ndarray, " frames"]


def two_rules(trajectories: int = 20, length: int = 80, seed: int = 0) -> TwoRules:
    """Trajectories whose actions follow one rule, then another, from a hidden frame on.

    Features are independent and standard normal. The action is 1 where column 1 is above 0, and from the
    change on where column 2 is. The change comes at a random frame of the middle half of the trajectory, and
    adds 6 to column 0 of that frame and the two after it, as if something came into sight.

    Args:
        trajectories: 1 or more.
        length: frames of every trajectory, 8 or more.
        seed: 0 or more; the same seed gives the same trajectories.

    Raises ValueError for anything else.
    """
    for name, value, least in (("trajectories", trajectories, 1), ("length", length, 8), ("seed", seed, 0)):
        if value < least:
            raise ValueError(f"{name} is {value}: give {least} or more")
    rng = np.random.default_rng(seed)
    changes = rng.integers(length // 4, length - length // 4, trajectories)[:, None]
    features = rng.standard_normal((trajectories, length, COLUMNS), np.float32)
    frames = np.arange(length)
    truth = (frames >= changes).astype(np.int64)
    features[:, :, 0] += 6 * ((frames >= changes) & (frames < changes + SIGNAL_FRAMES))
    actions = np.where(truth == 0, features[:, :, 1] > 0, features[:, :, 2] > 0)
    return TwoRules(
        features=features.reshape(-1, COLUMNS),
        actions=actions.reshape(-1).astype(np.int64),
        lengths=np.full(trajectories, length, np.int64),
        truth=truth.reshape(-1),
    )


@dataclass(frozen=True)
class Digits:
    """Trajectories, concatenated frame by frame; `lengths` says where each ends.

    Attributes:
        features: the 8x8 pixels of a digit, 0..16.
        actions: 1 where the frame's rule holds for its digit, else 0.
        lengths: frames per trajectory.
        truth: number of the frame's rule, in the order of RULES.
        digits: the digit itself, 0..9.
    """

    features: UInt8[np.ndarray, "frames 64"]
    actions: Int64[np.ndarray, " frames"]
    lengths: Int64[np.ndarray, " trajectories"]
    truth: Int64[np.ndarray, " frames"]
    digits: Int64[np.ndarray, " frames"]


def digits(
    rule_count: int,
    seed: int,
    *,
    segments: int | None = None,
    min_segment: int = 45,
    trajectories: int = 1,
) -> Digits:
    """scikit-learn's 1,797 digits in random order, labelled by a hidden rule that changes at hidden points.

    The order of the digits, the rules of the segments and the change points are drawn by `seed`, in that
    order. The rules are uniform among all sequences of the first `rule_count` of RULES in which neighbours
    differ and every rule occurs. The change points are uniform among all sets that leave every segment at
    least `min_segment` frames: two close ones are hardly identifiable, as two rules agree on about half of
    the digits. Trajectories cut the whole into parts of equal length, give or take one frame, wherever that
    falls; a segment may go on in the next.

    Args:
        rule_count: 2..4, number of macro-actions Q.
        seed: 0 or more.
        segments: `rule_count` or more; 2Q by default.
        min_segment: 1 or more frames.
        trajectories: 1 or more, of two or more frames each.

    Raises ValueError for anything else, for segments that do not fit into the frames, and where
    scikit-learn is missing.
    """
    try:
        from sklearn.datasets import load_digits
    except ImportError as error:
        raise ValueError("the digits come with scikit-learn: pip install scikit-learn") from error
    segments = 2 * rule_count if segments is None else segments
    data = load_digits()
    n = len(data.target)
    _check(n, rule_count, seed, segments, min_segment, trajectories)
    rng = np.random.default_rng(seed)
    order = rng.permutation(n)
    rules = _draw_rules(rule_count, segments, rng)
    # Stars and bars: sorted draws from what the minima leave over, each shifted by the minima before it.
    spare = n - segments * min_segment
    bars = np.sort(rng.choice(spare + segments - 1, segments - 1, replace=False)) - np.arange(segments - 1)
    changes = bars + min_segment * np.arange(1, segments)
    truth = np.repeat(rules, np.diff(changes, prepend=0, append=n))
    shown = data.target[order].astype(np.int64)
    held = np.stack([rule(shown) for rule in RULES.values()])
    ends = np.arange(1, trajectories + 1) * n // trajectories
    return Digits(
        features=data.data[order].astype(np.uint8),
        actions=held[truth, np.arange(n)].astype(np.int64),
        lengths=np.diff(ends, prepend=0),
        truth=truth,
        digits=shown,
    )


def _draw_rules(count: int, segments: int, rng: np.random.Generator) -> Int64[np.ndarray, " segments"]:
    """Numbers below `count`, neighbours different, all of them used."""
    while True:
        steps = rng.integers(1, count, segments)
        steps[0] = rng.integers(count)
        rules = np.cumsum(steps) % count
        if len(np.unique(rules)) == count:
            return rules


def _check(n: int, rule_count: int, seed: int, segments: int, min_segment: int, trajectories: int) -> None:
    """Raise ValueError that names the argument out of its range."""
    for name, value, least, most in (
        ("rule_count", rule_count, 2, len(RULES)),
        ("seed", seed, 0, None),
        ("segments", segments, rule_count, n),
        ("min_segment", min_segment, 1, n // max(segments, 1)),
        ("trajectories", trajectories, 1, n // 2),
    ):
        if value < least or (most is not None and value > most):
            bounds = f"{least} or more" if most is None else f"{least} to {most}"
            raise ValueError(f"{name} is {value}: give {bounds}")
