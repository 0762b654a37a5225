"""What a search found is there again, or refused in one line."""

import json
import shutil

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import save_file

from dpmacro.annotation.annotate import Annotation
from dpmacro.annotation.kept_search import Kept, KeptSearch, dataset_digest

OPTIONS = {"planner": {"macros": 2, "order": "free"}, "seed": 1}
FRAMES, TRAJECTORIES = 9, 2


def some_kept():
    generator = torch.Generator().manual_seed(0)
    labels = torch.randint(2, (FRAMES,), generator=generator)
    bounds = torch.rand(TRAJECTORIES, 3, generator=generator, dtype=torch.float64)
    return Kept(Annotation(labels, torch.rand(FRAMES, generator=generator), bounds), ("a note", "ein Wört"))


@pytest.fixture
def root(tmp_path):
    (tmp_path / "data/meta").mkdir(parents=True)
    (tmp_path / "data/meta/info.json").write_text("{}")
    return tmp_path / "data"


@pytest.fixture
def complete(tmp_path, root):
    """A search that is complete, and its folder."""
    search = KeptSearch(tmp_path / "page", OPTIONS, root, None)
    search.begin()
    search.training.mkdir()
    search.keep(some_kept())
    return tmp_path / "page"


def test_what_was_found_is_there_again(complete, root):
    search = KeptSearch(complete, OPTIONS, root, None)
    assert not search.begun
    kept, wanted = search.found(FRAMES, TRAJECTORIES), some_kept()
    assert kept.notes == wanted.notes
    for name, values in vars(wanted.annotation).items():
        again = getattr(kept.annotation, name)
        assert again.dtype == values.dtype and torch.equal(again, values), name


def test_what_was_found_is_the_same_bytes_in_every_run(tmp_path, root):
    files = set()
    for turn in range(8):  # safetensors draws the order of its metadata's keys anew for every file
        search = KeptSearch(tmp_path / str(turn), OPTIONS, root, None)
        search.begin()
        search.training.mkdir()
        search.keep(some_kept())
        files.add((search.training / "found.safetensors").read_bytes())
    assert len(files) == 1


def test_a_search_is_begun_or_not(tmp_path, root):
    search = KeptSearch(tmp_path / "page", OPTIONS, root, None)
    assert not search.begun and search.found(FRAMES, TRAJECTORIES) is None
    search.begin()
    search.training.mkdir()
    again = KeptSearch(tmp_path / "page", OPTIONS, root, None)
    assert again.begun and again.found(FRAMES, TRAJECTORIES) is None
    again.begin()
    assert again.begun and again.training.exists()


def test_a_folder_that_is_not_of_a_search_is_left_alone(tmp_path, root):
    (tmp_path / "page/training").mkdir(parents=True)
    search = KeptSearch(tmp_path / "page", OPTIONS, root, None)
    assert not search.begun
    search.begin()
    assert search.training.exists()


def test_another_search_is_refused(complete, root, tmp_path):
    labels = tmp_path / "labels.csv"
    labels.write_text("episode\n")
    for options, file, what in (
        ({**OPTIONS, "seed": 2}, None, "another seed;"),
        (
            {**OPTIONS, "planner": {"macros": 3, "order": "chain"}},
            None,
            r"planner\.macros and planner\.order;",
        ),
        (OPTIONS, labels, r"another content of dataset\.labels;"),
    ):
        with pytest.raises(ValueError, match=what) as raised:
            KeptSearch(complete, options, root, file)
        assert "\n" not in str(raised.value) and "give another --output_dir" in str(raised.value)
    (root / "meta/info.json").write_text("{ }")
    with pytest.raises(ValueError, match=r"another content of dataset\.root; run"):
        KeptSearch(complete, OPTIONS, root, None)


@pytest.mark.parametrize("text", ["", "[1", "[" * 100_000, "null", "[]", "\0"])
def test_a_damaged_note_of_what_was_asked_is_refused(complete, root, text):
    (complete / "search.json").write_text(text)
    with pytest.raises(ValueError, match=r"search\.json.*give another --output_dir"):
        KeptSearch(complete, OPTIONS, root, None)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
@given(cut=st.integers(0, 600), flips=st.dictionaries(st.integers(0, 599), st.integers(1, 255), max_size=3))
def test_a_damaged_file_is_refused_or_tells_the_same_numbers(complete, root, cut, flips):
    search = KeptSearch(complete, OPTIONS, root, None)
    search.keep(some_kept())
    path = search.training / "found.safetensors"
    data = bytearray(path.read_bytes())
    for place, change in flips.items():
        data[place % len(data)] ^= change
    path.write_bytes(data[:cut] if cut < 300 else data)
    try:
        kept = search.found(FRAMES, TRAJECTORIES)
    except ValueError as error:
        assert "\n" not in str(error) and "give another --output_dir" in str(error)
    else:
        for name, values in vars(some_kept().annotation).items():
            assert torch.equal(getattr(kept.annotation, name), values), name


@pytest.mark.parametrize(
    ("tensors", "notes"),
    [
        ({"labels": torch.zeros(FRAMES + 1).long()}, "[]"),
        ({"labels": torch.zeros(FRAMES, 1).long()}, "[]"),
        ({"labels": torch.zeros(FRAMES)}, "[]"),
        ({"confidence": torch.zeros(FRAMES).half()}, "[]"),
        ({"cost_by_bound": torch.zeros(TRAJECTORIES + 1, 3)}, "[]"),
        ({"more": torch.zeros(1)}, "[]"),
        ({}, "3"),
        ({}, "[3]"),
        ({}, "["),
    ],
)
def test_other_tensors_and_notes_are_refused(complete, root, tensors, notes):
    search = KeptSearch(complete, OPTIONS, root, None)
    whole = {**vars(some_kept().annotation), **tensors}
    with safe_open(search.training / "found.safetensors", "pt") as file:
        digest = json.loads(file.metadata()["found"])["digest"]
    save_file(
        whole, search.training / "found.safetensors", {"found": f'{{"digest": "{digest}", "notes": {notes}}}'}
    )
    with pytest.raises(ValueError, match=r"found\.safetensors cannot be read"):
        search.found(FRAMES, TRAJECTORIES)


def test_a_digest_tells_whether_files_changed(root, tmp_path):
    before = dataset_digest(root)
    shutil.copytree(root, tmp_path / "copy")
    assert dataset_digest(root) == before == dataset_digest(tmp_path / "copy"), "copies keep their times"
    (root / "more").write_text(json.dumps(1))
    assert dataset_digest(root) != before
