"""The benchmark of starts: its scene, its rows, what it refuses."""

import numpy as np
import pytest
import starts
from starts import StartOptions, cases
from tabletop import tabletop

from dpmacro.discovery.race import RACE
from dpmacro.utils.tensors import as_lengths


def test_a_hand_visits_every_object_once():
    made = tabletop(5, seed=1)
    as_lengths(made.lengths, len(made.truth), "features")
    assert made.features.shape == (len(made.truth), 20) and made.actions.shape == (len(made.truth), 3)
    for part in np.split(made.truth, np.cumsum(made.lengths)[:-1]):
        visited = part[np.flatnonzero(np.diff(part, prepend=-1))]
        assert sorted(visited) == [0, 1, 2, 3]
    assert np.array_equal(made.actions[:, 2], made.phase)
    again, other = tabletop(5, seed=1), tabletop(5, seed=2)
    assert np.array_equal(made.features, again.features) and len(other.truth) != len(made.truth)
    with pytest.raises(ValueError, match="trajectories is 0"):
        tabletop(0)


def test_the_hand_is_at_its_object_where_it_grasps():
    made = tabletop(3)
    away = made.features[:, 12:].reshape(-1, 4, 2)[np.arange(len(made.truth)), made.truth]
    assert np.linalg.norm(away[made.phase == 1], axis=1).max() < 0.06


def test_a_row_for_every_kind_and_the_search(monkeypatch):
    monkeypatch.setattr(starts, "SearchSettings", lambda: RACE)
    monkeypatch.setattr(starts, "tabletop", lambda seed: tabletop(4, seed))
    options = StartOptions(sources=["tabletop"], seeds=[0], starts=1, restarts=2)
    [case] = cases("tabletop", 0, options.data)
    rows = list(starts.rows(case, options))
    names = [row[30:46].strip() for row in rows]
    assert names == [*starts.KINDS, *(f"linear {kind}" for kind in starts.KINDS), "truth", "search"]
    reached = [float(row.split()[-4]) for row in rows]
    assert max(reached) > 0


def test_what_is_missing_is_named(tmp_path):
    with pytest.raises(ValueError, match="holds no data"):
        next(cases("cr5", 0, tmp_path))
    with pytest.raises(ValueError, match="sources has 'cr6'"):
        StartOptions(sources=["cr6"])
    with pytest.raises(ValueError, match="starts is 0"):
        StartOptions(starts=0)
