"""Cuts by what roboticists cut by: grippers that close, moments of rest, waypoints. Actions are vectors.

Each finds cuts alone; `named` gives the parts between them macro-labels. All but the gripper's changes are
told the true number of changes of every trajectory.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from segmentation_grid import Found, chosen_by_truth, named, settings, sliding_means
from segmentation_sources import NotApplicableError, Source, standardised

__all__ = ["gripper_changes", "gripper_or_slow", "slow_moments", "waypoints"]

SMOOTHING, QUICK_SMOOTHING = (1, 5, 9), (5,)  # frames that a speed is averaged over
APART, QUICK_APART = (3, 10, 20), (10,)  # frames between two cuts, and before the first
QUANTILES = (0.05, 0.95)  # of a gripper's action: closed is above the middle between them
LONGEST = 1500  # frames of a trajectory; the time for waypoints grows with its cube

Cuts = list[np.ndarray]  # of every trajectory the frames that begin a new part, ascending, none of them 0


def gripper_changes(source: Source, seed: int, quick: bool) -> Found:
    """Cuts where the gripper's action crosses the middle of its range."""
    found = named(source, _parts(source, _crossings(source)), seed, settings(source, quick), "gripper")
    return chosen_by_truth(source, found)


def slow_moments(source: Source, seed: int, quick: bool) -> Found:
    """Cuts at the slowest moments, the true number of them. Grid: see `_slowest_of`."""
    nothing = [np.zeros(0, np.int64) for _ in source.trajectories]
    return chosen_by_truth(source, _slowest_of(source, nothing, seed, quick))


def gripper_or_slow(source: Source, seed: int, quick: bool) -> Found:
    """The gripper's changes, and the slowest moments apart from them up to the true number of changes.

    The key frames of James and Davison (2022), to which Shi et al. (2023) compare their waypoints.
    """
    return chosen_by_truth(source, _slowest_of(source, _crossings(source), seed, quick))


def waypoints(source: Source, seed: int, quick: bool) -> Found:
    """AWE, the dynamic program of Shi et al. (2023), section 4.1: states that straight lines between tell.

    The paper takes the fewest waypoints whose largest reconstruction error is below a threshold. Here the
    threshold of every trajectory is the one that leads to the true number of changes. Grid: the robot's own
    state as it is or standardised, or all of the state standardised.
    """
    _check_vectors(source)
    if source.lengths.max() > LONGEST:
        raise NotApplicableError(f"a trajectory of more than {LONGEST} frames takes too long")
    body = source.frames[:, : source.body].astype(np.float64)
    choices = {"robot": body, "robot standardised": standardised(body)}
    if source.body is not None:
        choices["state standardised"] = standardised(source.frames)

    def found() -> Iterator[Found]:
        for how, states in choices.items():
            cuts = [
                fewest_lines(states[frames], changes)
                for frames, changes in zip(source.trajectories, source.changes, strict=True)
            ]
            yield from named(source, _parts(source, cuts), seed, settings(source, quick), how)

    return chosen_by_truth(source, found())


def fewest_lines(states: np.ndarray, count: int) -> np.ndarray:
    """The `count` waypoints between first and last state that leave the smallest largest error, ascending.

    With e(i, j) the largest distance of a state of i..j from the line between the states i and j,

        E_0(j) = e(0, j),    E_k(j) = min_{i<j} max(E_{k-1}(i), e(i, j)).

    Args:
        states: [frames, columns].
        count: below the number of frames less 1.
    """
    errors = line_errors(states)
    last = len(states) - 1
    best, before = errors[0], []
    for _ in range(count):
        through = np.maximum(best[:, None], errors)  # [i, j]
        through[np.tril_indices(last + 1)] = np.inf
        before.append(through.argmin(0))
        best = through.min(0)
    found = [last]
    for chosen in reversed(before):
        found.append(int(chosen[found[-1]]))
    return np.array(sorted(found[1:]), np.int64)


def line_errors(states: np.ndarray) -> np.ndarray:
    """e(i, j) of `fewest_lines`, [frames, frames]; 0 where i >= j."""
    frames = len(states)
    errors = np.zeros((frames, frames))
    for i in range(frames - 1):
        steps = states[i:] - states[i]  # of a state in between, and of the end of a line
        dots, squares = steps @ steps.T, (steps**2).sum(1)
        along = np.clip(dots / np.maximum(squares, 1e-300)[:, None], 0, 1)  # [end, state]
        distances = squares[None] - 2 * along * dots + along**2 * squares[:, None]
        errors[i, i:] = np.sqrt(np.maximum(np.tril(distances), 0).max(1))
    return errors


def slowest(speed: np.ndarray, count: int, apart: int, taken: Sequence[int] = ()) -> np.ndarray:
    """`taken` and the slowest frames besides, up to `count` in all, ascending; never frame 0.

    They are `apart` frames from one another, from the first frame and from the end; where the trajectory is
    too short for that, half as far, and so on.
    """
    found = list(taken)
    while len(found) < count and apart > 0:
        found = list(taken)
        for frame in np.argsort(speed[apart : len(speed) - apart + 1], kind="stable") + apart:
            if len(found) >= count:
                break
            if all(abs(frame - other) >= apart for other in found):
                found.append(int(frame))
        apart //= 2
    return np.array(sorted(found), np.int64)


def _slowest_of(source: Source, taken: Cuts, seed: int, quick: bool) -> Iterator[Found]:
    """Grid: speed of the robot or size of the action; averaged over 1, 5 or 9 frames; 3, 10 or 20 apart."""
    _check_vectors(source)
    body = standardised(source.frames[:, : source.body])
    moved = np.zeros_like(body)
    for frames in source.trajectories:
        moved[frames][1:] = np.diff(body[frames], axis=0)
        moved[frames][:1] = moved[frames][1:2]
    unmoving = [] if source.gripper is None else [source.gripper]
    scale = np.sqrt((source.actions.astype(np.float64) ** 2).mean(0))
    pushed = np.delete(source.actions / np.maximum(scale, 1e-12), unmoving, axis=1)
    speeds = {"speed": moved, "size of the action": pushed}
    for how, vectors in speeds.items():
        bare = np.linalg.norm(vectors, axis=1, keepdims=True)
        for window in QUICK_SMOOTHING if quick else SMOOTHING:
            speed = sliding_means(bare, source.trajectories, window)[:, 0]
            for apart in QUICK_APART if quick else APART:
                cuts = [
                    slowest(speed[frames], changes, apart, tuple(fixed))
                    for frames, changes, fixed in zip(source.trajectories, source.changes, taken, strict=True)
                ]
                means = f"{how} over {window}, {apart} apart"
                yield from named(source, _parts(source, cuts), seed, settings(source, quick), means)


def _crossings(source: Source) -> Cuts:
    _check_vectors(source)
    if source.gripper is None:
        raise NotApplicableError("no gripper is seen")
    values = source.actions[:, source.gripper]
    closed = values > np.quantile(values, QUANTILES).mean()
    return [np.flatnonzero(np.diff(closed[frames])) + 1 for frames in source.trajectories]


def _parts(source: Source, cuts: Cuts) -> np.ndarray:
    """Parts between cuts, numbered over the whole dataset, int64 [frames]."""
    begins = np.zeros(len(source.truth), np.int64)
    for frames, of_trajectory in zip(source.trajectories, cuts, strict=True):
        begins[frames.start + of_trajectory] = 1
        begins[frames.start] = 1
    return begins.cumsum() - 1


def _check_vectors(source: Source) -> None:
    if not source.vectors:
        raise NotApplicableError("actions are classes")
