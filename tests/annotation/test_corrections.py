"""Corrections from files that the page or a spreadsheet writes, right ones and wrong ones."""

import csv
import io
import json
import os
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dpmacro.annotation.correction_files import FORMAT, LARGEST_FILE
from dpmacro.annotation.corrections import Corrections
from dpmacro.annotation.stages import Stages

NAMES = ("reach", "carry", "leave")
LENGTHS, EPISODES = np.array([10, 6, 8]), (4, 7, 5)
HEAD = ["episode", "start_frame", "end_frame", "start_s", "end_s", "label", "confidence", "source"]


def stages(labels=None, names=NAMES, lengths=LENGTHS, episodes=EPISODES, fps=10.0):
    n_frames = int(lengths.sum())
    if labels is None:
        labels = np.concatenate([np.arange(length) * 3 // length for length in lengths])
    seconds = np.concatenate([np.arange(length) / fps for length in lengths])
    idle = np.arange(n_frames) % 2 == 0
    sure = np.linspace(0.2, 0.9, n_frames)
    return Stages(labels, sure, idle, np.zeros(n_frames, bool), names, lengths, episodes, seconds, fps)


def episode(number=7, ends=(2, 6), labels=(0, 2)):
    starts = [0, *ends[:-1]]
    segments = [
        {"start": start, "end": end, "label": label}
        for start, end, label in zip(starts, ends, labels, strict=True)
    ]
    return {"episode": number, "frames": ends[-1], "segments": segments}


def page(**changes):
    whole = {
        "format": FORMAT,
        "dataset": "bananas",
        "fps": 10,
        "names": list(NAMES),
        "renamed": [[0, 0], [1, 1], [2, 2]],
        "episodes": [episode()],
    }
    return {name: value for name, value in {**whole, **changes}.items() if value is not ...}


def load(folder, found, name="corrections.json"):
    path = folder / name
    path.write_text(found if isinstance(found, str) else json.dumps(found), encoding="utf-8")
    return Corrections.load(path)


def rows_of(own, names=None):
    """The table that the export writes: a list of rows for every segment."""
    rows, first = [], 0
    for number, length in zip(own.episodes, own.lengths.tolist(), strict=True):
        part = own.labels[first : first + length]
        cuts = [0, *(np.flatnonzero(np.diff(part)) + 1).tolist(), length]
        for start, end in pairwise(cuts):
            name = (names or own.names)[part[start]]
            said = "person" if own.corrected[first + start : first + end].all() else "dpmacro"
            rows.append([number, start, end, start / own.fps, end / own.fps, name, 0.5, said])
        first += length
    return rows


def table(rows, head=HEAD, **more):
    file = io.StringIO()
    csv.writer(file, **more).writerows([head, *rows])
    return file.getvalue()


def same(one, other, *but):
    for name in vars(one).keys() - set(but):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_a_corrected_demonstration_overrides_and_the_others_stay(tmp_path):
    own = stages()
    found = load(tmp_path, page()).apply(own)
    assert found.labels[10:16].tolist() == [0, 0, 2, 2, 2, 2]
    assert found.corrected.tolist() == [False] * 10 + [True] * 6 + [False] * 8
    assert (found.confidence[10:16] == 1).all()
    rest = ~found.corrected
    assert np.array_equal(found.labels[rest], own.labels[rest])
    assert np.array_equal(found.confidence[rest], own.confidence[rest])
    same(found, own, "labels", "confidence", "corrected")
    assert own.corrected.sum() == 0, "the stages themselves are left alone"


def test_stages_are_renamed_merged_and_added_everywhere(tmp_path):
    new = page(
        names=["go", "away", "wait"], renamed=[[0, 0], [2, 1], [1, 0]], episodes=[episode(labels=(2, 1))]
    )
    found = load(tmp_path, new).apply(stages())
    assert found.names == ("go", "away", "wait")
    assert found.labels[:10].tolist() == [0] * 7 + [1] * 3
    assert found.labels[10:16].tolist() == [2, 2, 1, 1, 1, 1]


def test_what_was_corrected_before_stays_corrected(tmp_path):
    first = load(tmp_path, page()).apply(stages())
    again = load(tmp_path, page(episodes=[episode(5, (8,), (1,))])).apply(first)
    assert again.corrected.tolist() == [False] * 10 + [True] * 14


def test_given_labels_are_those_of_corrected_frames(tmp_path):
    found = load(tmp_path, page()).given(EPISODES, LENGTHS)
    assert found.tolist() == [-1] * 10 + [0, 0, 2, 2, 2, 2] + [-1] * 8
    assert load(tmp_path, page()).names == NAMES
    assert (load(tmp_path, page(episodes=[])).given(EPISODES, LENGTHS) == -1).all()


WRONG = [
    (page(format="dpmacro corrections 2"), r"format is 'dpmacro corrections 2': give a file of format"),
    (page(format=...), r"format is None"),
    ([], r"format is \[\]"),
    (page(names="reach"), r"names are 'reach': give a list"),
    (page(names=[]), r"names is \[\]: name one"),
    (page(names=["a", "b", "a"]), r"names\[2\] is 'a', as names\[0\]|names\[2\] is 'a', as .*names\[0\]"),
    (page(names=["a", "", "c"]), r"names\[1\] is ''"),
    (page(names=["a", "b\nb", "c"]), r"names\[1\] is 'b\\nb'"),
    (page(names=["a", "\ud800", "c"]), r"names\[1\] is '\\ud800'"),
    (page(dataset=3), r"dataset is 3"),
    (page(fps=0), r"fps is 0"),
    (page(fps="10"), r"fps is '10'"),
    (page(fps=True), r"fps is True"),
    (page(renamed=...), r"renamed is None"),
    (page(renamed=[]), r"renamed is \[\]"),
    (page(renamed=[[0, 0], [1, 1], [1, 2]]), r"renamed\[2\]\[0\] is 1: it is there twice"),
    (page(renamed=[[0, 0], [1, 1], [3, 2]]), r"renamed\[2\]\[0\] is 3: give a whole number, 0 to 2"),
    (page(renamed=[[0, 0], [1, 1], [2, 3]]), r"renamed\[2\]\[1\] is 3: give a whole number, 0 to 2"),
    (page(renamed=[[0, 0], [1, 1], [2]]), r"renamed\[2\] is \[2\]"),
    (page(renamed=[[0, 0], [1, 1], ["a", "b"]]), r"renamed\[2\]\[0\] is 'a'"),
    (page(episodes=...), r"episodes is None"),
    (page(episodes=[3]), r"episodes\[0\] is 3"),
    (page(episodes=[episode(), episode()]), r"episodes\[1\].episode is 7: it is there twice"),
    (page(episodes=[episode(-1)]), r"episodes\[0\].episode is -1"),
    (page(episodes=[episode(True)]), r"episodes\[0\].episode is True"),
    (page(episodes=[episode(7.0)]), r"episodes\[0\].episode is 7.0"),
    (page(episodes=[{**episode(), "frames": None}]), r"episodes\[0\].frames is None"),
    (page(episodes=[{**episode(), "frames": 5}]), r"segments\[1\].end is 6: the demonstration has 5"),
    (page(episodes=[{**episode(), "segments": []}]), r"episodes\[0\].segments is \[\]"),
    (page(episodes=[{**episode(), "segments": [4]}]), r"segments\[0\] is 4"),
    (page(episodes=[episode(labels=(0, 3))]), r"segments\[1\].label is 3: give a whole number, 0 to 2"),
    (page(episodes=[episode(labels=(0, -1))]), r"segments\[1\].label is -1"),
    (page(episodes=[episode(labels=(0, "carry"))]), r"segments\[1\].label is 'carry'"),
    (page(episodes=[episode(ends=(2, 2, 6), labels=(0, 1, 2))]), r"segments\[1\].end is 2: .* ends at 3"),
    (page(episodes=[episode(ends=(4, 2, 6), labels=(0, 1, 2))]), r"segments\[1\].end is 2: .* ends at 5"),
    (page(episodes=[episode(ends=(2.5, 6))]), r"segments\[0\].end is 2.5"),
    (page(episodes=[episode(ends=(2, 10**300))]), r"episodes\[0\].frames is 1000"),
]


@pytest.mark.parametrize(("found", "message"), WRONG)
def test_a_page_that_is_wrong_somewhere(tmp_path, found, message):
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path, found)
    assert str(caught.value).startswith(str(tmp_path / "corrections.json")) and "\n" not in str(caught.value)
    str(caught.value).encode()


@pytest.mark.parametrize(
    ("start", "kind"), [(3, "a gap"), (1, "an overlap"), (0, "an overlap"), (10**12, "a gap")]
)
def test_gaps_and_overlaps(tmp_path, start, kind):
    wrong = episode()
    wrong["segments"][1]["start"] = start
    message = rf"episodes\[0\].segments\[1\].start is {start}: that leaves {kind}, .* give 2"
    with pytest.raises(ValueError, match=message):
        load(tmp_path, page(episodes=[wrong]))
    wrong = episode()
    wrong["segments"][0]["start"] = 1
    with pytest.raises(ValueError, match=r"segments\[0\].start is 1: that leaves a gap, .* give 0"):
        load(tmp_path, page(episodes=[wrong]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"is no JSON \("),
        ("episode,start", r"is no JSON \("),
        ('{"format": "dpmacro corrections 1"', r"is no JSON \("),
        ('{"fps": NaN}', r"is no JSON \(NaN is no number"),
        ('{"fps": -Infinity}', r"is no JSON \(-Infinity is no number"),
        ('{"fps": 1, "fps": 2}', r"is no JSON \(an object has a key twice, among \['fps', 'fps'\]"),
        ("[" * 100_000, r"is no JSON \("),
        ('{"fps": ' + "9" * 5000 + "}", r"is no JSON \("),
        (json.dumps(page()).replace('"fps": 10', '"fps": 1e999'), r"fps is inf"),
    ],
)
def test_a_text_that_is_no_such_json(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path, text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_files_that_are_none(tmp_path):
    with pytest.raises(OSError, match=r"gone.json"):
        Corrections.load(tmp_path / "gone.json")
    with pytest.raises(ValueError, match=r"^\S+: is no file; give"):
        Corrections.load(tmp_path)
    os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(ValueError, match=r"^\S+pipe.json: is no file"):
        Corrections.load(tmp_path / "pipe.json")
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate(LARGEST_FILE + 1)
    with pytest.raises(ValueError, match=r"^\S+large.json: has more than 16,777,216 bytes; "):
        Corrections.load(large)
    for name, remedy in (("odd.csv", "save it as CSV UTF-8"), ("odd.json", "from the page again")):
        (tmp_path / name).write_bytes(b"episode,\xff\xfe")
        with pytest.raises(ValueError, match=rf"{name}: byte 8 is no UTF-8; .*{remedy}"):
            Corrections.load(tmp_path / name)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (
            page(episodes=[episode(9)]),
            r"episodes\[0\].segments\[0\]: there is no episode 9 among the 3 read, 4 to 7",
        ),
        (page(episodes=[episode(5)]), r"segments\[1\]: ends episode 5 at 6, and it has 8 frames"),
        (page(episodes=[episode(5, (2, 10**12))]), r"ends episode 5 at 1000000000000, and it has 8 frames"),
    ],
)
def test_corrections_of_another_dataset(tmp_path, found, message):
    corrections = load(tmp_path, found)
    for use in (lambda: corrections.apply(stages()), lambda: corrections.given(EPISODES, LENGTHS)):
        with pytest.raises(ValueError, match=message) as caught:
            use()
        assert "\n" not in str(caught.value)


def test_corrections_of_another_segmentation(tmp_path):
    with pytest.raises(
        ValueError, match=r"renamed is of 3 stages: there are 2 here; annotate with the options"
    ):
        load(tmp_path, page()).apply(stages(np.zeros(24, np.int64), NAMES[:2]))
    with pytest.raises(ValueError, match=r"fps is 10: the dataset has 30; give"):
        load(tmp_path, page()).apply(stages(fps=30.0))


def test_a_table_as_it_was_written_changes_nothing(tmp_path):
    own = stages()
    for more in ({}, {"delimiter": ";"}, {"delimiter": "\t", "quoting": csv.QUOTE_ALL}):
        text = table(rows_of(own), **more)
        same(load(tmp_path, "\ufeff" + text, "labels.csv").apply(own), own)
    shuffled = [rows_of(own)[k] for k in np.random.default_rng(0).permutation(9)]
    head = [name.replace("_", " ").upper() for name in HEAD]
    same(load(tmp_path, table([*shuffled, [], [""] * 8], head), "labels.csv").apply(own), own)


def test_edited_lines_of_a_table_are_corrections(tmp_path):
    own, rows = stages(), rows_of(stages())
    rows[3][2] = rows[4][1] = 3  # a cut of episode 7
    rows[5][5] = "drop"
    found = load(tmp_path, table(rows), "labels.csv").apply(own)
    assert found.names == (*NAMES, "drop")
    assert found.labels[10:16].tolist() == [0, 0, 0, 1, 3, 3]
    assert found.corrected.tolist() == [False] * 10 + [True] * 6 + [False] * 8
    assert (found.confidence[10:16] == 1).all()
    same(found, own, "labels", "confidence", "corrected", "names")


def test_a_stage_that_a_table_renames_everywhere_is_renamed_and_not_corrected(tmp_path):
    own = stages()
    rows = rows_of(own, ("go", "go", "leave"))
    rows[3][2] = rows[4][1] = 3
    found = load(tmp_path, table(rows), "labels.csv").apply(own)
    assert found.names == ("go", "leave")
    assert found.corrected.tolist() == [False] * 24, "the cut that was moved lies within one stage now"
    rows[4][2] = rows[5][1] = 5
    found = load(tmp_path, table(rows), "labels.csv").apply(own)
    assert found.corrected.tolist() == [False] * 10 + [True] * 6 + [False] * 8
    some = load(tmp_path, table(rows_of(own, ("go", "carry", "leave"))[:3]), "labels.csv").apply(own)
    assert some.names == ("reach", "carry", "leave", "go"), "not renamed where others are not listed"
    assert some.corrected.tolist() == [True] * 10 + [False] * 14


def test_a_new_name_beside_a_moved_cut_is_no_renaming(tmp_path):
    own = stages(lengths=LENGTHS[:1], episodes=EPISODES[:1])
    rows = rows_of(own, ("reach", "hold", "leave"))
    rows[1][2] = rows[2][1] = 8
    found = load(tmp_path, table(rows), "labels.csv").apply(own)
    assert found.names == ("reach", "leave", "hold") and found.corrected.all()
    assert found.labels.tolist() == [0] * 4 + [2] * 4 + [1] * 2


def test_a_segment_of_a_person_is_corrected_and_given_though_it_is_as_it_was(tmp_path):
    first = load(tmp_path, page()).apply(stages())
    corrections = load(tmp_path, table(rows_of(first)), "labels.csv")
    plain = stages(first.labels)
    same(corrections.apply(plain), first, "confidence")
    wanted = np.where(first.corrected, first.labels, -1)
    found = corrections.given(EPISODES, LENGTHS)
    assert np.array_equal(np.array([*corrections.names, ""])[found], np.array([*NAMES, ""])[wanted])
    no_source = load(tmp_path, table([row[:7] for row in rows_of(first)], HEAD[:7]), "labels.csv")
    assert np.array_equal(no_source.given(EPISODES, LENGTHS), first.labels)
    nobody = load(tmp_path, table(rows_of(stages())), "labels.csv")
    with pytest.raises(
        ValueError, match=r"labels.csv: no episode has the source 'person' in all its lines; "
    ):
        nobody.given(EPISODES, LENGTHS)


def test_seconds_that_were_edited_instead_of_frames_are_not_passed_over(tmp_path):
    rows = rows_of(stages())
    rows[4][3] = 0.35
    with pytest.raises(
        ValueError, match=r"line 6: start_s is 0.35 and frame 2 is at 0.2 s; change start_frame"
    ):
        load(tmp_path, table(rows), "labels.csv").apply(stages())
    rows[4][5] = "carry on"
    with pytest.raises(ValueError, match=r"line 6: start_s is 0.35"):
        load(tmp_path, table(rows), "labels.csv").apply(stages())
    rows[3][2] = rows[4][1] = 3
    load(tmp_path, table(rows), "labels.csv").apply(stages())
    rows = [[*row[:3], str(row[3]).replace(".", ","), *row[4:]] for row in rows_of(stages())]
    same(load(tmp_path, table(rows, delimiter=";"), "labels.csv").apply(stages()), stages())


@pytest.mark.parametrize(
    ("line", "column", "value", "message"),
    [
        (0, 2, "", r"line 2, end_frame is '': give a whole number"),
        (0, 2, "3.5", r"line 2, end_frame is '3.5'"),
        (0, 0, "-1", r"line 2, episode is '-1'"),
        (0, 0, "four", r"line 2, episode is 'four'"),
        (0, 1, "\u0663", r"line 2, start_frame is '\u0663': give a whole number"),
        (1, 1, "5", r"line 3, start_frame is 5: that leaves a gap, .* give 4"),
        (1, 1, "3", r"line 3, start_frame is 3: that leaves an overlap, .* give 4"),
        (1, 2, "4", r"line 3, end_frame is 4: a segment that starts at 4 ends at 5"),
        (1, 5, "", r"line 3: labels\[0\] is '': a name needs"),
        (1, 5, "x" * 81, r"line 3: labels\[0\] is .* of 81 characters"),
        (1, 5, "b\x07b", r"line 3: labels\[0\] is 'b\\x07b'"),
        (1, 5, "c" * 200_000, r"labels.csv: is no table \(field larger"),
        (2, 2, "9" * 16, r"line 4, end_frame is '9999"),
    ],
)
def test_a_table_that_is_wrong_somewhere(tmp_path, line, column, value, message):
    rows = rows_of(stages())
    rows[line][column] = value
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path, table(rows), "labels.csv")
    assert str(caught.value).startswith(str(tmp_path / "labels.csv")) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"line 1 is ''.*: give the columns episode, .*; episode is missing|line 1 is ''"),
        ("episode,start_frame,label\n1,2,a\n", r"end_frame is missing"),
        ("episode,start_frame,end_frame,label\n", r"has no line with a segment"),
        ('episode,start_frame,end_frame,label\n1,0,"2', r"is no table \("),
        ("episode,start_frame,end_frame,label\n1,0\n", r"line 2, end_frame is ''"),
        ("{}", r"line 1 is '{}'"),
    ],
)
def test_a_text_that_is_no_such_table(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path, text, "labels.CSV")
    assert "\n" not in str(caught.value)


def test_a_table_of_another_dataset(tmp_path):
    rows = rows_of(stages())
    rows[-1][2] = 9
    with pytest.raises(ValueError, match=r"line 10: ends episode 5 at 9, and it has 8 frames"):
        load(tmp_path, table(rows), "labels.csv").apply(stages())


@st.composite
def edits(draw):
    """Stages, and what they are after a person's edits of whole demonstrations."""
    lengths = np.array(draw(st.lists(st.integers(2, 9), min_size=1, max_size=4)))
    episodes = tuple(draw(st.permutations(range(0, 40, 7)))[: len(lengths)])
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    before, after = rng.integers(0, 3, (2, int(lengths.sum())))
    changed = np.array(draw(st.lists(st.booleans(), min_size=len(lengths), max_size=len(lengths))))
    return lengths, episodes, before, np.where(np.repeat(changed, lengths), after, before), changed


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits())
def test_both_files_bring_the_edits_back(tmp_path, problem):
    lengths, episodes, before, after, changed = problem
    own, edited = (stages(labels, lengths=lengths, episodes=episodes) for labels in (before, after))
    by_episode = {}
    for row in rows_of(edited):
        by_episode.setdefault(row[0], []).append(row)
    listed = [
        episode(
            number,
            [row[2] for row in by_episode[number]],
            [NAMES.index(row[5]) for row in by_episode[number]],
        )
        for number, one in zip(episodes, changed, strict=True)
        if one
    ]
    found = load(tmp_path, page(episodes=listed)).apply(own)
    assert np.array_equal(found.labels, after)
    assert np.array_equal(found.corrected, np.repeat(changed, lengths))
    held = load(tmp_path, page(episodes=listed)).given(episodes, lengths)
    assert np.array_equal(held, np.where(found.corrected, after, -1))
    found = load(tmp_path, table(rows_of(edited)), "labels.csv").apply(own)
    names = [found.names[label] for label in found.labels]
    assert names == [NAMES[label] for label in after]


AS_WRITTEN = table(rows_of(stages()))
STRANGE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)


@st.composite
def spoiled(draw):
    """A right file with a value, or a few bytes, that are something else."""
    if draw(st.booleans()):
        whole = page()
        keys = [(whole, key) for key in whole] + [
            (whole["renamed"], 1),
            (whole["renamed"][0], 1),
            (whole["names"], 0),
        ]
        keys += [(whole["episodes"], 0), *((whole["episodes"][0], key) for key in episode())]
        keys += [(one, key) for one in whole["episodes"][0]["segments"] for key in one]
        holder, key = draw(st.sampled_from(keys))
        holder[key] = draw(STRANGE)
        return ".json", json.dumps(whole).encode()
    name = draw(st.sampled_from([".json", ".csv"]))
    content = bytearray((json.dumps(page()) if name == ".json" else AS_WRITTEN).encode())
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(content)))
        content[start : start + draw(st.integers(0, 4))] = draw(st.binary(max_size=3))
    return name, bytes(content)


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(spoiled())
def test_a_spoiled_file_is_one_line_or_makes_sense(tmp_path, found):
    name, content = found
    path = tmp_path / f"spoiled{name}"
    path.write_bytes(content)
    own = stages()
    for use in (lambda one: one.apply(own), lambda one: one.given(EPISODES, LENGTHS)):
        try:
            result = use(Corrections.load(path))
        except ValueError as error:
            line = str(error)
            assert type(error) is ValueError and line.startswith(str(path)) and "\n" not in line
            line.encode()
        else:
            labels = result.labels if isinstance(result, Stages) else result
            assert labels.dtype == np.int64 and labels.shape == own.labels.shape and labels.min() >= -1


def by_name(own):
    return [own.names[label] for label in own.labels]


def assert_alike(one, two):
    """Names frame by frame, not their numbers: a stage that nothing has may be there or not."""
    assert by_name(one) == by_name(two)
    assert np.array_equal(one.corrected, two.corrected) and np.array_equal(one.confidence, two.confidence)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), as_table=st.booleans())
def test_what_a_page_is_told_of_corrections_says_the_same_again(data, as_table, tmp_path):
    """A file -> what the page opens with -> the file that it saves: frames are called and marked alike."""
    labels = data.draw(st.lists(st.integers(0, 2), min_size=24, max_size=24))
    own = stages(np.array(labels, np.int64))
    if as_table:
        rows = rows_of(own)
        for row in rows:
            row[5] = data.draw(st.sampled_from([row[5], *NAMES, "wait"]))
            row[7] = data.draw(st.sampled_from(["person", "dpmacro"]))
        corrections = load(tmp_path, table(rows), "labels.csv")
    else:
        now = data.draw(st.lists(st.integers(0, 2), min_size=3, max_size=3))
        corrections = load(tmp_path, page(renamed=[[old, new] for old, new in enumerate(now)]))
    told = {**corrections.of_stages(own), "format": FORMAT, "dataset": "bananas"}
    again = load(tmp_path, told, "again.json")
    assert_alike(again.apply(own), corrections.apply(own))
    assert again.of_stages(own) == corrections.of_stages(own)


def test_a_demonstration_of_another_dataset_is_refused_before_anything_is_known_of_stages(tmp_path):
    corrections = load(tmp_path, page())
    corrections.check(EPISODES, LENGTHS, 10.0)
    corrections.check(EPISODES, LENGTHS)
    for changes, message in (
        ({"episodes": (4, 8, 5)}, "there is no episode 7"),
        ({"lengths": np.array([10, 7, 8])}, "ends episode 7 at 6, and it has 7 frames"),
        ({"fps": 30.0}, "fps is 10: the dataset has 30"),
    ):
        with pytest.raises(ValueError, match=message):
            corrections.check(**{"episodes": EPISODES, "lengths": LENGTHS, "fps": 10.0, **changes})
