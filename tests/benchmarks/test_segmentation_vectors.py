"""Segmentations where actions are vectors: their sources, the peers that are made for them, mean ranks."""

import itertools
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

from bench_segmentation import COLUMNS, METHODS, BenchOptions, dpmacro, main  # noqa: E402
from segmentation_finch import weighted_clusters  # noqa: E402
from segmentation_grid import ALL, Setting, named, settings  # noqa: E402
from segmentation_heuristics import fewest_lines, line_errors, slowest  # noqa: E402
from segmentation_peers import PEERS  # noqa: E402
from segmentation_ranks import distances, ranks  # noqa: E402
from segmentation_sources import NotApplicableError, Source, standardised, vector_columns  # noqa: E402
from segmentation_vectors import cr5, metaworld, mocap6, read  # noqa: E402

from dpmacro.metrics import segmentation_scores  # noqa: E402

CUTTING = ("gripper", "slow", "gripper or slow", "AWE", "TW-FINCH")
INSTALLED = {
    "GaussianHMM": "hmmlearn",
    "KernelCPD": "ruptures",
    "AR-HMM": "dynamax",
    "regression HMM": "dynamax",
}


def planted(kind):
    """Six trajectories of three segments, each its own macro-action, told apart by one thing alone.

    "rest": the hand stands still between them. "gripper": the gripper opens and closes. "lines": the hand
    goes straight to another place. "rule": the action is another linear function of the state. "means": the
    state and the action are elsewhere.
    """
    rng = np.random.default_rng(0)
    lengths = np.arange(60, 90, 5)
    cuts = [(n // 4 + k, n // 2 + k) for k, n in enumerate(lengths)]
    truth = [np.searchsorted(cut, np.arange(n), "right") for cut, n in zip(cuts, lengths, strict=True)]
    labels = np.concatenate(truth)
    states = rng.normal(size=(len(labels), 3))
    actions = rng.normal(size=(len(labels), 4))
    if kind == "rest":
        paths = []
        for (one, other), n in zip(cuts, lengths, strict=True):
            speed = 1 + 0.1 * rng.random((n, 1))
            for cut in (one, other):
                speed[cut - 1 : cut + 2] = [[0.2], [0.01], [0.2]]
            paths.append((speed * [1, 0.5, -1]).cumsum(0))
        states = np.concatenate(paths)
    if kind == "gripper":
        actions[:, 3] = labels == 1
    if kind == "lines":
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1.0]])
        paths = []
        for (one, other), n in zip(cuts, lengths, strict=True):
            times = [0, one, other, n - 1]
            paths.append(
                np.column_stack([np.interp(np.arange(n), times, corners[:, column]) for column in range(3)])
            )
        states = np.concatenate(paths) + 0.005 * rng.normal(size=(len(labels), 3))
    if kind == "rule":
        rules = rng.normal(size=(3, 3, 4))
        actions = np.einsum("ni,nij->nj", states, rules[labels]) + 0.05 * actions
    if kind == "means":
        states += 8 * np.eye(3)[labels]
        actions += 8 * np.eye(3, 4)[labels]
    parts = states.astype(np.float32), actions.astype(np.float32), lengths, labels.astype(np.int64)
    return Source("cr5", kind, *parts, gripper=3)


def scores(source, labels):
    return segmentation_scores(labels, source.truth, source.lengths, 2)


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("method", "kind"),
    [
        ("gripper", "gripper"),
        ("slow", "rest"),
        ("gripper or slow", "rest"),
        ("gripper or slow", "gripper"),
        ("AWE", "lines"),
        ("TW-FINCH", "means"),
        ("KernelCPD", "means"),
        ("k-means", "means"),
        ("GaussianHMM", "means"),
        ("AR-HMM", "means"),
        ("regression HMM", "rule"),
    ],
)
def test_a_peer_finds_what_it_is_made_for(method, kind):
    pytest.importorskip(INSTALLED.get(method, "sklearn"))
    source = planted(kind)
    if kind == "rest":
        source.actions[:, 3] = 0  # a gripper that is never used
    found = PEERS[method](source, 0, True)
    assert found.labels.dtype == np.int64 and found.setting
    assert scores(source, found.labels).accuracy > 0.95, found.setting
    assert scores(source, found.labels).boundary_f1 > 0.9, found.setting


def unusual():
    """Sources that nothing can be said of, or little."""
    source = planted("means")
    still = replace(source, frames=np.ones_like(source.frames), actions=np.zeros_like(source.actions))
    one = replace(source, truth=np.zeros_like(source.truth))
    lengths = np.array([2, 3, 2, 4])
    short = Source(
        "mocap6",
        "short",
        source.frames[:11],
        source.actions[:11],
        lengths,
        np.array([0, 1, 0, 1, 2, 1, 1, 0, 1, 0, 1]),
        gripper=0,
    )
    constant = replace(source, actions=np.zeros_like(source.actions))
    return {"still": still, "one macro-action": one, "short": short, "constant actions": constant}


@pytest.mark.benchmark
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("method", PEERS)
@pytest.mark.parametrize("kind", unusual())
def test_a_peer_bears_what_is_unusual(method, kind):
    pytest.importorskip(INSTALLED.get(method, "sklearn"))
    source = unusual()[kind]
    found = PEERS[method](source, 0, True)
    assert found.labels.shape == source.truth.shape
    segmentation_scores(found.labels, source.truth, source.lengths, 1)


@pytest.mark.benchmark
def test_with_a_floor_actions_may_be_an_exact_function_and_columns_equal():
    pytest.importorskip("dynamax")
    from segmentation_dynamax import linear_regression

    source = planted("rule")
    rules = np.random.default_rng(1).normal(size=(3, 3, 2))
    exact = np.einsum("ni,nij->nj", source.frames.astype(float), rules[source.truth])
    exact = np.column_stack([exact, source.truth == 1])  # constant in every macro-action
    twice = np.hstack([source.frames, source.frames]).astype(float)
    sticky = np.where(np.eye(3, dtype=bool), 0.96, 0.02)
    given = twice, exact, source.lengths, [source.truth], sticky, 3
    found = linear_regression(*given, floor=0.01)
    assert found is not None and scores(source, found).accuracy > 0.99
    assert linear_regression(*given, floor=0.0) is None


@pytest.mark.parametrize("method", CUTTING[:4])
def test_what_cuts_vectors_has_no_answer_for_classes(method):
    source = planted("means")
    classes = replace(source, actions=source.truth, gripper=None)
    with pytest.raises(NotApplicableError, match=r"^actions are classes$"):
        PEERS[method](classes, 0, True)


@pytest.mark.parametrize("method", ["gripper", "gripper or slow"])
def test_without_a_gripper_there_is_no_answer(method):
    with pytest.raises(NotApplicableError, match=r"^no gripper is seen$"):
        PEERS[method](replace(planted("gripper"), gripper=None), 0, True)


def test_ours_learns_vectors():
    source = planted("rule")
    found = dpmacro(source, 0, True)
    assert len(found.labels) == len(source.truth) and len(np.unique(found.labels)) <= source.macros


def straight(states, one, other):
    """Largest distance of the states between two from the line between them, the slow way."""
    line = states[other] - states[one]
    apart = [0.0]
    for state in states[one : other + 1]:
        share = np.clip((state - states[one]) @ line / max(line @ line, 1e-300), 0, 1)
        apart.append(np.linalg.norm(state - states[one] - share * line))
    return max(apart)


@pytest.mark.parametrize("seed", range(4))
def test_waypoints_leave_the_smallest_largest_error(seed):
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(9, 2)).cumsum(0)
    errors = line_errors(states)
    for one, other in itertools.combinations(range(9), 2):
        assert errors[one, other] == pytest.approx(straight(states, one, other), abs=1e-6)
    for count in range(4):
        found = fewest_lines(states, count)
        assert len(set(found)) == count and (np.diff(found) > 0).all()

        def worst(points):
            return max(straight(states, *pair) for pair in itertools.pairwise([0, *points, 8]))

        best = min(worst(points) for points in itertools.combinations(range(1, 8), count))
        assert worst(found) == pytest.approx(best)


def test_a_state_that_returns_and_stands_still_has_waypoints():
    states = np.array([[0.0], [1], [2], [1], [0], [0], [0]])
    assert fewest_lines(states, 1).tolist() == [2]
    assert np.isfinite(line_errors(np.zeros((5, 2)))).all()
    assert len(fewest_lines(np.zeros((5, 2)), 3)) == 3


def test_slowest_moments_keep_apart_and_are_as_many_as_asked():
    speed = np.ones(30)
    speed[[0, 7, 8, 20, 29]] = [0, 0.1, 0.05, 0.3, 0]
    assert slowest(speed, 2, 5).tolist() == [8, 20]
    assert slowest(speed, 2, 1).tolist() == [8, 29]
    assert slowest(speed, 3, 5, (18,)).tolist() == [8, 13, 18]
    assert slowest(speed, 2, 5, (1, 2, 3)).tolist() == [1, 2, 3]
    assert slowest(speed[:6], 4, 20).tolist() == [1, 2, 3, 4]
    assert slowest(speed[:2], 1, 20).tolist() == [1]


def alike(values, time, frames, distance):
    """The weights of the paper, pair by pair."""
    weights = np.full((len(values), len(values)), np.inf)
    for i, j in itertools.permutations(range(len(values)), 2):
        cosine = values[i] @ values[j] / np.linalg.norm(values[i]) / np.linalg.norm(values[j])
        apart = 1 - cosine if distance == "cosine" else np.linalg.norm(values[i] - values[j])
        weights[i, j] = max(apart, 0) * abs(time[i] - time[j]) / frames
    return weights


@pytest.mark.parametrize("distance", ["cosine", "Euclidean"])
def test_a_first_partition_links_nearest_neighbours(distance):
    values = np.random.default_rng(3).normal(size=(20, 4))
    nearest = alike(values, np.arange(20), 20, distance).argmin(1)
    links = {i: {i} for i in range(20)}
    for i, j in enumerate(nearest):
        joined = links[i] | links[j]
        for k in joined:
            links[k] = joined
    expected = sorted(map(tuple, {frozenset(group) for group in links.values()}))
    labels = weighted_clusters(values, len(expected), distance)
    groups = {tuple(np.flatnonzero(labels == label).tolist()) for label in set(labels)}
    assert groups == {tuple(sorted(group)) for group in expected}


@pytest.mark.parametrize("distance", ["cosine", "Euclidean"])
def test_clusters_are_as_many_as_asked_and_numbered_as_they_begin(distance):
    values = np.random.default_rng(1).normal(size=(30, 3))
    for count in (1, 2, 3, 5, 7, 30, 40):
        labels = weighted_clusters(values, count, distance)
        assert set(labels) == set(range(min(count, 30)))
        firsts = [np.flatnonzero(labels == label)[0] for label in range(labels.max() + 1)]
        assert firsts == sorted(firsts)


def test_parts_are_named_by_their_means_and_in_order():
    source = planted("means")
    starts = np.cumsum(source.lengths) - source.lengths
    changed = np.diff(source.truth, prepend=-1) != 0
    changed[starts] = True
    parts = changed.cumsum()
    found = list(named(source, parts, 0, [Setting(ALL, 0.0)], "by hand"))
    assert [one.setting for one in found] == [
        "by hand; named by columns, actions 0",
        "by hand; named in order",
    ]
    for one in found:
        assert scores(source, one.labels).accuracy == 1
    assert (found[1].labels == source.truth).all()
    classes = replace(source, actions=source.truth)
    assert len(list(named(classes, parts, 0, [Setting(8, 0.0)], "by hand"))) == 1


def test_what_is_seen_is_the_state_and_its_change():
    source = planted("means")
    columns = vector_columns(source)
    assert columns.shape == (len(source.truth), 6) and columns.dtype == np.float32
    starts = np.cumsum(source.lengths) - source.lengths
    assert (columns[starts, 3:] == 0).all() and (columns[:, :3] == source.frames).all()
    assert np.array_equal(columns[1, 3:], source.frames[1] - source.frames[0])
    constant = np.column_stack([columns, np.full(len(columns), 5)])
    assert standardised(constant).shape == columns.shape
    assert standardised(columns).std(0) == pytest.approx(1)


def test_a_matrix_shares_its_variance_as_asked():
    source = planted("means")
    values = Setting(ALL, 0.25).matrix(source, 0)
    assert values.shape[1] == 6 + 4
    assert [values[:, :6].var(0).sum(), values[:, 6:].var(0).sum()] == pytest.approx([0.75, 0.25])
    assert Setting(ALL, 0.0) in settings(source, False)
    assert Setting(ALL, 0.0) not in settings(replace(source, actions=source.truth), False)


def write(root, columns, names=None):
    """The least that is read of a LeRobot dataset, its rows in any order."""
    (root / "data/chunk-000").mkdir(parents=True)
    (root / "meta").mkdir()
    (root / "meta/info.json").write_text(json.dumps({"features": {"action": {"names": names}}}))
    pq.write_table(pa.table(columns), root / "data/chunk-000/file-000.parquet")
    return root


def episodes(lengths, actions, **more):
    frames = int(np.sum(lengths))
    states = np.arange(frames * 4, dtype=np.float32).reshape(frames, 4)
    return {
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "frame_index": np.concatenate([np.arange(n) for n in lengths]),
        "observation.state": list(states),
        "action": list(np.asarray(actions, np.float32)),
    } | more


def test_labels_of_people_may_be_text_and_rows_in_any_order(tmp_path):
    words = ["walk", "walk", "jump", "walk", "squat"]
    columns = episodes([3, 2], np.arange(10).reshape(5, 2), exercise=words)
    turned = {name: list(values)[::-1] for name, values in columns.items()}
    source = mocap6(write(tmp_path / "people", turned), None)
    assert source.truth.tolist() == [2, 2, 0, 2, 1] and source.lengths.tolist() == [3, 2]
    assert source.actions.tolist() == np.arange(10).reshape(5, 2).tolist()
    assert source.frames[:, 0].tolist() == [0, 4, 8, 12, 16]
    assert source.gripper is None and source.tolerance == 10 and source.vectors
    assert mocap6(tmp_path / "people", 1).truth.tolist() == [1, 1, 0]


def test_cr5_hides_its_gripper_and_keeps_episodes_with_two_changes(tmp_path):
    closed = [[0, 1, 1, 0, 0], [0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1], [0, 1, 0]]
    lengths = [len(one) for one in closed]
    actions = np.column_stack([np.arange(sum(lengths)), np.concatenate(closed), np.zeros(sum(lengths))])
    root = write(tmp_path / "arm", episodes(lengths, actions), names=["x", "gripper", "y"])
    source = cr5(root, None)
    assert source.lengths.tolist() == [5, 4, 3]
    assert source.truth.tolist() == [0, 1, 1, 2, 2, 0, 1, 1, 2, 0, 1, 2]
    assert source.actions[:, 0].tolist() == [0, 1, 2, 3, 4, 9, 10, 11, 12, 17, 18, 19]
    assert source.actions.shape[1] == 2 and source.macros == 3 and source.tolerance == 5
    assert cr5(root, 2).lengths.tolist() == [5, 4]


def test_metaworld_knows_its_hand_and_its_gripper(tmp_path):
    columns = episodes([3], np.zeros((3, 4)), stage=[0, 2, 2])
    source = metaworld(write(tmp_path / "hammer-v3", columns), None)
    assert (source.case, source.gripper, source.body, source.tolerance) == ("hammer-v3", 3, 3, 5)
    assert source.truth.tolist() == [0, 1, 1]


def test_a_column_that_is_not_there_is_one_line(tmp_path):
    root = write(tmp_path / "people", episodes([3], np.zeros((3, 2))))
    with pytest.raises(ValueError, match=r"^dataset .*people: cannot read .*exercise") as caught:
        read(root, "exercise", None)
    assert type(caught.value) is ValueError


def run(tmp_path, capsys, **options):
    shared = {"methods": ["uniform cuts", "gripper"], "seeds": [0], "output": tmp_path / "rows.json"}
    main(BenchOptions(**shared | options))
    return capsys.readouterr().out


def test_what_has_no_answer_is_skipped_with_a_reason_and_a_run_resumed(tmp_path, capsys):
    people = write(tmp_path / "people", episodes([4, 4], np.zeros((8, 2)), exercise=[0, 0, 1, 1] * 2))
    out = run(tmp_path, capsys, sources=["mocap6", "cr5"], mocap=people)
    assert "skipped gripper on mocap6: no gripper is seen\n" in out
    assert "skipped cr5: give the folder of the dataset as --cr5=FOLDER\n" in out
    assert re.search(r"^uniform cuts +1 +1\.000 ", out, re.MULTILINE)
    written = tmp_path / "rows.json"
    rows = json.loads(written.read_text())
    assert {(row["method"], row["tolerance"]) for row in rows} == {("uniform cuts", 10)}
    written.write_text(json.dumps([row | {"value": 0.125} for row in rows]))
    out = run(tmp_path, capsys, sources=["mocap6"], mocap=people)
    assert re.search(r"^uniform cuts +1 +0\.125 ", out, re.MULTILINE)


@pytest.mark.parametrize(
    ("source", "option", "remedy"),
    [
        ("metaworld", "metaworld", "`make bench-segmentation` records it"),
        ("mocap6", "mocap", "give --mocap"),
        ("cr5", "cr5", "give --cr5"),
    ],
)
def test_a_folder_without_a_dataset_is_one_line(tmp_path, source, option, remedy):
    options = BenchOptions(sources=[source], **{option: tmp_path / "none"})
    with pytest.raises(ValueError, match=rf"^{source} is not in .*/none: {remedy}$"):
        main(options)


def test_three_seeds_and_all_sources_by_default():
    options = BenchOptions()
    assert options.seeds == [0, 1, 2] and options.methods == list(METHODS)
    assert options.sources == ["digits", "two_flags", "babyai", "metaworld", "mocap6", "cr5"]


def rows(values):
    """Rows of every ranked metric: (source, method) -> a value for every seed."""
    return [
        {"source": source, "case": "a", "method": method, "seed": seed, "metric": metric, "value": value}
        for (source, method), seeds in values.items()
        for seed, value in enumerate(seeds)
        for metric in ("accuracy", "edit", "f1_10", "f1_25", "f1_50", "boundary_f1", "nmi")
    ]


def test_ranks_are_of_means_over_seeds_and_equals_share_them():
    lines = ranks(
        rows(
            {
                ("cr5", "dpmacro"): [0.9, 0.5],
                ("cr5", "AWE"): [0.6, 0.6],
                ("cr5", "slow"): [0.5, 0.7],
                ("mocap6", "AWE"): [0.1],
                ("mocap6", "dpmacro"): [0.2],
            }
        ),
        COLUMNS,
    )
    cells = {line[:15].strip(): line[15:].split() for line in lines[3:]}
    assert list(cells) == ["dpmacro", "AWE", "slow"]
    assert cells["dpmacro"] == ["2", *["1.0"] * 7]
    assert cells["AWE"] == ["2", *["2.2"] * 7]  # (2.5 + 2) / 2
    assert cells["slow"] == ["1", *["2.5"] * 7]
    assert lines[2].split() == [
        "method",
        "n",
        "accuracy",
        "edit",
        "F1@10",
        "F1@25",
        "F1@50",
        "boundary",
        "F1",
        "all",
    ]
    assert ranks([], COLUMNS) == []


def test_distances_are_to_the_best_peer_with_and_without_those_told_the_labels():
    lines = distances(
        rows(
            {
                ("cr5", "dpmacro"): [0.5],
                ("cr5", "uniform cuts"): [0.75],
                ("cr5", "AWE"): [0.25],
                ("mocap6", "AWE"): [0.1],
            }
        )
    )
    assert len(lines) == 3
    assert lines[2].split() == ["cr5", "a", "0.500", "-0.250", "uniform", "cuts", "+0.250", "AWE"]
    assert distances(rows({("cr5", "AWE"): [1.0]})) == []


def test_the_makefile_records_tasks_that_there_are():
    from dpmacro.worlds.metaworld import TASKS

    line = re.search(r"^TASKS := .*,(.*)\)$", (ROOT / "Makefile").read_text(), re.MULTILINE)[1]
    assert {f"{name}-v3" for name in line.split()} <= set(TASKS)
