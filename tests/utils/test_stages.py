"""Stages: results that are kept, boosting rounds that are not searched for twice, files that are refused."""

import os
from contextlib import suppress
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.learners.stumps import StumpClassifier, StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.features.levels import SortedLevels
from dpmacro.utils.stages import Stages, stage
from tests.helpers.limited import limited

LENGTHS = 9, 6  # rounds of the two series of boosting that the computation has


class StoppedError(Exception):
    """What ends a computation on the way."""


class Counted(StumpLearner):
    """A learner that counts its searches, and ends the computation after so many."""

    searches = 0
    most = 10**6

    def fit(self, *given):
        if Counted.searches == Counted.most:
            raise StoppedError
        Counted.searches += 1
        return super().fit(*given)


@stage
def grown(seed: int, drawn: int) -> tuple[torch.Tensor, StumpClassifier]:
    """Two series of rounds with one generator, as left-out scores have them."""
    generator = torch.Generator().manual_seed(seed)
    levels = torch.randint(0, 256, (12, 60), dtype=torch.uint8, generator=generator)
    labels = torch.randint(0, 3, (60,), generator=generator)
    data = SortedLevels.build(levels)
    learner = Counted(data.take(torch.zeros(0, dtype=torch.int64)) if drawn else data, drawn)
    start, weights = None, torch.rand(60, 2, generator=generator)
    for rounds in LENGTHS:
        boosting = Boosting(learner, class_targets(labels, 3), 2, 0.3, generator, start)
        for _ in range(rounds):
            boosting.round(weights)
        start = boosting.scores
    return boosting.scores, boosting.strong()


@stage
def told(seed: int) -> dict:
    """A stage that has one within."""
    return {"seed": seed, "scores": grown(seed, 3)[0]}


def equal(one, other) -> bool:
    scores, classifier = one
    parts = zip(classifier.tensors().values(), other[1].tensors().values(), strict=True)
    return torch.equal(scores, other[0]) and all(torch.equal(*pair) for pair in parts)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([0, 3]), st.integers(0, 5), st.lists(st.integers(0, sum(LENGTHS)), max_size=4))
def test_a_computation_that_was_stopped_ends_as_if_nothing_had(tmp_path_factory, drawn, every, stops):
    Counted.most = 10**6
    wanted, folder = grown(5, drawn), tmp_path_factory.mktemp("stages")
    for most in stops:
        Counted.searches, Counted.most = 0, most
        with suppress(StoppedError), Stages(folder, every):
            grown(5, drawn)
    Counted.most = 10**6
    with Stages(folder, every):
        assert equal(grown(5, drawn), wanted)
    assert [path.name for path in folder.iterdir()] == ["00001.pt"]
    Counted.searches, Counted.most = 0, 0
    with Stages(folder, every):
        assert equal(grown(5, drawn), wanted)  # without a search


def test_rounds_that_are_kept_are_not_searched_for_again(tmp_path):
    Counted.searches, Counted.most = 0, 11
    with pytest.raises(StoppedError), Stages(tmp_path, 4):
        grown(1, 0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["00001.0000.pt", "00001.0001.pt"]
    Counted.searches, Counted.most = 0, 10**6
    with Stages(tmp_path, 4):
        grown(1, 0)
    assert Counted.searches == sum(LENGTHS) - 8


def test_a_stage_within_another_has_no_file_of_its_own(tmp_path):
    Counted.most = 10**6
    with Stages(tmp_path, 0):
        first = told(3)
        grown(3, 0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["00001.pt", "00002.pt"]
    with Stages(tmp_path, 0):
        again = told(3)
    assert again["seed"] == 3 and torch.equal(again["scores"], first["scores"])


def test_outside_stages_nothing_is_kept(tmp_path):
    Counted.most = 10**6
    with Stages(tmp_path, 1):
        pass
    grown(2, 0)
    assert not list(tmp_path.iterdir())


def test_files_of_another_computation_are_refused(tmp_path):
    Counted.most = 10**6
    with Stages(tmp_path, 0):
        grown(1, 0)
    with (
        pytest.raises(ValueError, match=r"00001.pt is of another computation than told"),
        Stages(tmp_path, 0),
    ):
        told(1)


class Harmful:
    def __reduce__(self):
        return os.mkdir, ("harm",)


@pytest.mark.parametrize("content", [b"", b"no archive", Harmful(), {"stage": "grown", "result": Path()}])
def test_files_that_cannot_be_read_are_refused(content, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "00001.pt"
    file.write_bytes(content) if isinstance(content, bytes) else torch.save(content, file)
    with pytest.raises(ValueError, match=r"00001.pt cannot be read") as error, Stages(tmp_path, 0):
        grown(1, 0)
    assert "\n" not in str(error.value) and not (tmp_path / "harm").exists()


def test_a_file_that_may_not_grow_is_named(tmp_path):
    """`torch.save` itself has an error of its own for it, which says nothing."""
    Counted.most = 10**6
    with limited(500), pytest.raises(OSError, match="File too large") as error, Stages(tmp_path, 2):
        grown(1, 0)
    assert Path(error.value.filename).parent == tmp_path and not list(tmp_path.iterdir())
