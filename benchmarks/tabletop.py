"""A made tabletop: a hand visits four objects in any order, and which comes next can be read from nothing."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64

__all__ = ["Tabletop", "tabletop"]

OBJECTS = 4
SPEED, GAIN, NEAR, NOISE = 0.03, 0.15, 0.03, 0.004  # lengths in units of the table
HELD = 8  # frames at an object, the gripper closed


@dataclass(frozen=True)
class Tabletop:
    """Trajectories, concatenated frame by frame.

    Attributes:
        features: the hand and its last move, the four objects, every object less the hand; 2 numbers each.
        actions: the hand's next move, and 1 where the gripper is closed, else 0.
        lengths: frames per trajectory.
        truth: the object that the hand is after, 0..3.
        phase: 0 while it approaches, 1 while it grasps.
    """

    features: Float32[np.ndarray, "frames 20"]
    actions: Float32[np.ndarray, "frames 3"]
    lengths: Int64[np.ndarray, " trajectories"]
    truth: Int64[np.ndarray, " frames"]
    phase: Int64[np.ndarray, " frames"]


def tabletop(trajectories: int = 40, seed: int = 0) -> Tabletop:
    """Trajectories of a hand that goes to an object, closes its gripper there for a while, and goes on.

    Moves are proportional to the way that is left, up to a speed, with normal noise; objects lie anywhere on
    the table, a fifth of it apart at least. Raises ValueError for fewer than one trajectory.
    """
    if trajectories < 1:
        raise ValueError(f"trajectories is {trajectories}: give 1 or more")
    rng = np.random.default_rng(seed)
    parts = [_trajectory(rng) for _ in range(trajectories)]
    features, actions, truth, phase = (np.concatenate(each) for each in zip(*parts, strict=True))
    lengths = np.array([len(part[0]) for part in parts])
    return Tabletop(features.astype(np.float32), actions.astype(np.float32), lengths, truth, phase)


def _trajectory(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    objects, hand, move = _apart(rng), rng.random(2), np.zeros(2)
    rows, moves, truth, phases = [], [], [], []
    for target in rng.permutation(OBJECTS):
        held = 0
        while held < HELD:
            way = objects[target] - hand
            held += int(held > 0 or np.linalg.norm(way) < NEAR)
            rows.append(np.concatenate([hand, move, objects.ravel(), (objects - hand).ravel()]))
            move = GAIN * way * min(1.0, SPEED / max(GAIN * np.linalg.norm(way), 1e-9))
            move = move + NOISE * rng.standard_normal(2)
            moves.append([*move, held > 0])
            truth.append(target)
            phases.append(int(held > 0))
            hand = hand + move
    return np.stack(rows), np.array(moves, float), np.array(truth), np.array(phases)


def _apart(rng: np.random.Generator) -> np.ndarray:
    """Places of objects, a fifth of the table apart."""
    while True:
        places = rng.random((OBJECTS, 2))
        distances = np.linalg.norm(places[:, None] - places, axis=2)
        if distances[~np.eye(OBJECTS, dtype=bool)].min() > 0.2:
            return places
