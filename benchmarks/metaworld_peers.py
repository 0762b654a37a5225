"""Other learners of the same demonstrations: fitted, saved, and read back as planners of Meta-World.

Each learns the action of a frame from its state alone, as dpmacro's classifiers do, and remembers nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from jaxtyping import Float, Float32
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from dpmacro.data.demonstrations import Demonstrations

__all__ = ["PEERS", "Peer"]

STATE = "observation.state"
FILE = "peer.joblib"


@dataclass(frozen=True)
class Peer:
    """A fitted regression of actions on states, as a planner.

    Attributes:
        model: of scikit-learn.
        columns: the numbers of the state that vary in the demonstrations.
        pairs: whether the model sees every difference of two of them, too, as dpmacro does.
        numbers: how many numbers the model stores.
    """

    model: Any
    columns: list[int]
    pairs: bool
    numbers: int

    @classmethod
    def fit(cls, name: str, demonstrations: Demonstrations, seed: int) -> "Peer":
        """Fit one of `PEERS`."""
        recipe = PEERS[name]
        states, actions = demonstrations.observations[STATE], demonstrations.actions
        columns = np.flatnonzero(np.ptp(states, axis=0) > 0).tolist()
        model = recipe.make(seed)
        model.fit(_inputs(states, columns, recipe.pairs), actions)
        return cls(model, columns, recipe.pairs, recipe.numbers(model))

    def save(self, folder: Path) -> None:
        """Write it into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        joblib.dump(self, folder / FILE)

    @staticmethod
    def load(folder: Path) -> "Peer":
        """Read what `save` wrote here."""
        return joblib.load(folder / FILE)

    def reset(self, env: Any) -> None:
        """Begin an episode: nothing is remembered."""

    def act(self, observation: dict[str, Any], info: dict[str, Any]) -> Float32[np.ndarray, " dims"]:
        """The action for this state."""
        state = np.asarray(observation[STATE])[None]
        return np.asarray(self.model.predict(_inputs(state, self.columns, self.pairs))[0], np.float32)


@dataclass(frozen=True)
class Recipe:
    """How a peer is made.

    Attributes:
        title: for the table.
        make: a model for a seed.
        numbers: how many numbers a fitted model stores.
        pairs: as `Peer` has it.
    """

    title: str
    make: Callable[[int], Any]
    numbers: Callable[[Any], int]
    pairs: bool = False


def _trees(seed: int) -> Any:
    return MultiOutputRegressor(
        HistGradientBoostingRegressor(max_iter=300, max_leaf_nodes=31, random_state=seed)
    )


def _trees_numbers(model: Any) -> int:
    """Two a split, one a leaf."""
    nodes = [tree.nodes["is_leaf"] for one in model.estimators_ for step in one._predictors for tree in step]
    return int(sum(len(leaf) + (leaf == 0).sum() for leaf in nodes))


def _neighbours(_: int) -> Any:
    return make_pipeline(StandardScaler(), KNeighborsRegressor(5, weights="distance"))


def _neighbours_numbers(model: Any) -> int:
    return model[-1]._fit_X.size + model[-1]._y.size


def _network(seed: int) -> Any:
    # Its own defaults end after a second of training.
    patience = {"max_iter": 2000, "n_iter_no_change": 100, "tol": 1e-5}
    network = MLPRegressor(hidden_layer_sizes=(256, 256), random_state=seed, **patience)
    return make_pipeline(StandardScaler(), network)


def _network_numbers(model: Any) -> int:
    return sum(array.size for array in (*model[-1].coefs_, *model[-1].intercepts_))


PEERS = {
    "trees": Recipe("boosted trees, 31 leaves, 300 for every number", _trees, _trees_numbers, pairs=True),
    "neighbours": Recipe("5 nearest neighbours", _neighbours, _neighbours_numbers),
    "network": Recipe("network, 2 x 256", _network, _network_numbers),
}


def _inputs(
    states: Float[np.ndarray, "frames dims"], columns: list[int], pairs: bool
) -> Float[np.ndarray, "frames columns"]:
    kept = states[:, columns]
    if not pairs:
        return kept
    first, second = np.array(list(combinations(range(len(columns)), 2)), int).reshape(-1, 2).T
    return np.concatenate([kept, kept[:, first] - kept[:, second]], 1)
