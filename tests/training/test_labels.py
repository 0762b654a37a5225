"""train.py with a file of labels: kept as a person said them, the rest cut anew; one line for a mistake."""

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from lerobot_files import build
from safetensors.torch import load_file

import train
from dpmacro.annotation.correction_files import FORMAT
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.policy.policy import MacroPolicy
from dpmacro.training import trainer as training
from dpmacro.training.labels import labelled
from dpmacro.training.options import DatasetOptions, PlannerOptions, TrainOptions
from dpmacro.training.run_folder import RunFolder
from tests.estimator.test_given import LENGTH, TRAJECTORIES, three_rules
from tests.training.test_train import call, no_pictures  # noqa: F401  a fixture

TINY = [
    "--planner.rounds=12",
    "--planner.restarts=4",
    "--planner.switch_rounds=8",
    "--planner.rectangles=30",
    "--planner.shrinkage=0.3",
]
NAMES = ("reach", "carry")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A dataset of vectors whose actions follow three rules in turn."""
    features, actions, lengths, _ = three_rules(vectors=True)
    columns = {"observation.state": features, "action": actions.astype(np.float32)}
    root = tmp_path_factory.mktemp("data") / "three_rules"
    return build(root, columns, lengths=tuple(lengths.tolist()), images=False)


def cut(number, *ends, labels=(0, 1), frames=LENGTH):
    """An episode of the page's JSON."""
    starts = (0, *ends)
    segments = [
        {"start": start, "end": end, "label": label}
        for start, end, label in zip(starts, (*ends, frames), labels, strict=True)
    ]
    return {"episode": number, "frames": frames, "segments": segments}


def page(folder, *episodes, names=NAMES):
    path = folder / "corrections.json"
    told = {
        "format": FORMAT,
        "dataset": "three_rules",
        "fps": 10,
        "names": list(names),
        "renamed": [[k, k] for k in range(len(names))],
        "episodes": list(episodes),
    }
    path.write_text(json.dumps(told))
    return path


def table(folder, *rows, sources=True):
    """Lines of episode, first frame, end, stage and who said it."""
    path = folder / "corrections.csv"
    columns = ["episode", "start_frame", "end_frame", "label", "source"][: None if sources else 4]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([columns, *(row[: len(columns)] for row in rows)])
    return path


def labels_of(run):
    found = load_file(run / "checkpoints/last/training_state/segmentation.safetensors")
    return [part.numpy() for part in found["labels"].split(found["lengths"].tolist())]


def test_the_script_keeps_the_labels_of_a_page_and_cuts_the_others_by_them(data, tmp_path):
    """As a process. Both changes are as good, and one demonstration says that the late one is meant."""
    rule = three_rules(vectors=True)[-1].reshape(TRAJECTORIES, LENGTH)
    late = (rule >= 2).astype(int)
    path, run = page(tmp_path, cut(3, int(late[3].argmax()))), tmp_path / "run"
    options = [f"--dataset.root={data}", f"--dataset.labels={path}", f"--output_dir={run}", *TINY]
    done = subprocess.run(
        [sys.executable, "train.py", *options],
        cwd=Path(train.__file__).parent,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert f"labels of 1 of {TRAJECTORIES} demonstrations are kept as they were given" in done.stdout
    labels = np.stack(labels_of(run))
    assert np.array_equal(labels[3], late[3])
    assert (np.delete(labels, 3, 0) == np.delete(late, 3, 0)).mean() > 0.9
    options = json.loads((run / "checkpoints/last/pretrained_model/train_config.json").read_text())
    assert options["dataset"]["labels"] == str(path) and options["planner"]["macros"] == 2


@pytest.mark.parametrize("sources", [True, False])
def test_a_table_and_some_of_the_episodes(data, tmp_path, monkeypatch, no_pictures, sources):  # noqa: F811
    """Episodes by their numbers in the dataset, in the order asked for; as many macro-actions as names."""
    own = [(5, 0, 7, "a", "person"), (5, 7, 11, "b", "person"), (5, 11, LENGTH, "c", "person")]
    other = [(2, 0, LENGTH, "c", "dpmacro")]
    path, run = table(tmp_path, *own, *other, sources=sources), tmp_path / "run"
    given = [f"--dataset.root={data}", f"--dataset.labels={path}", "--dataset.episodes=[5,0,2,1]"]
    call(monkeypatch, *given, f"--output_dir={run}", "--planner.order=free", *TINY)
    labels = labels_of(run)
    assert np.array_equal(labels[0], np.repeat([0, 1, 2], [7, 4, LENGTH - 11]))
    assert sources or (labels[2] == 2).all(), "without the column all lines are a person's"
    assert MacroPolicy.load(run / "checkpoints/last/pretrained_model").config.macros == 3


def test_classes_and_images_in_the_order_of_a_chain(recorded, tmp_path, monkeypatch, no_pictures):  # noqa: F811
    path = page(tmp_path, cut(3, 2, frames=9), cut(0, 10, frames=12))
    path.write_text(path.read_text().replace('"fps": 10', '"fps": 30'))
    run = tmp_path / "run"
    options = [f"--dataset.root={recorded}", f"--dataset.labels={path}", f"--output_dir={run}"]
    call(monkeypatch, *options, "--planner.order=chain", *TINY)
    first, *_, last = labels_of(run)
    assert np.array_equal(first, [0] * 10 + [1] * 2) and np.array_equal(last, [0] * 2 + [1] * 7)


def test_without_a_file_there_are_two_macro_actions_as_ever(data):
    options = TrainOptions(DatasetOptions(root=data))
    assert options.planner.macros == 2
    demonstrations = Demonstrations.load(data, [4, 1])
    assert labelled(options, demonstrations) == (options, None)
    assert demonstrations.episodes == (4, 1)
    assert demonstrations.select([1]).episodes == (1,)
    assert demonstrations.joined(demonstrations).episodes == ()


@pytest.mark.parametrize(("labels", "order"), [((0, 1), "auto"), ((1, 0), "free")])
def test_the_data_chooses_an_order_only_where_the_labels_leave_it_open(data, tmp_path, labels, order):
    dataset = DatasetOptions(root=data, labels=page(tmp_path, cut(3, 9, labels=labels)))
    options = TrainOptions(dataset, PlannerOptions(order="auto"))
    assert labelled(options, Demonstrations.load(data))[0].planner.order == order


def test_a_trainer_asks_for_the_number_that_the_names_are(data, tmp_path):
    options = TrainOptions(DatasetOptions(root=data, labels=tmp_path / "labels.json"), PlannerOptions())
    with pytest.raises(ValueError, match=r"planner.macros is not given: give"):
        training.Trainer(Demonstrations.load(data), options, RunFolder(tmp_path / "run"))


MISTAKES = {
    "no file": ({}, ["--dataset.labels={tmp}/none.json"], "none.json"),
    "a folder": ({}, ["--dataset.labels={tmp}"], "."),
    "no json": ({"text": "labels"}, [], "corrections.json"),
    "dagger": ({}, ["--dagger.iterations=2"], r"beside dagger\.iterations=2: leave one of them out"),
    "a baseline": ({}, ["--planner.type=baseline"], r"beside planner\.type=baseline: leave one of them out"),
    "auto": ({}, ["--planner.macros=auto"], r"beside planner\.macros=auto: leave one of them out"),
    "fewer than names": (
        {"names": ("reach", "carry", "leave")},
        ["--planner.macros=2"],
        r"planner\.macros is 2 and .* names 3 stages: give 3 or leave it out",
    ),
    "nothing corrected": ({"episodes": []}, [], "corrects no episode: correct some"),
    "one stage": (
        {"names": ("all",), "episodes": [cut(1, labels=(0,))]},
        [],
        "names one stage, so that nothing is cut: name more",
    ),
    "no changes": ({}, ["--planner.max_transitions=0"], r"planner\.max_transitions is 0 beside"),
    "too many changes": (
        {"episodes": [cut(6, 9, 20, labels=(0, 1, 0))]},
        [],
        "demonstration 6: .* 2 transitions, max_transitions is 1: allow 2",
    ),
    "no chain": ({"episodes": [cut(6, 9, labels=(1, 0))]}, ["--planner.order=chain"], "demonstration 6: .*0"),
    "an episode that is not read": ({}, ["--dataset.episodes=[0,1]"], "there is no episode 3 among the 2"),
    "another length": ({"episodes": [cut(3, 9, frames=61)]}, [], "ends episode 3 at 61, and it has 60"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_gets_one_line_and_status_2(data, tmp_path, monkeypatch, capsys, case):
    told, options, message = MISTAKES[case]
    path = page(tmp_path, *told.get("episodes", [cut(3, 30)]), names=told.get("names", NAMES))
    if "text" in told:
        path.write_text(told["text"])
    options = [option.format(tmp=tmp_path) for option in options]
    with pytest.raises(SystemExit) as stop:
        call(
            monkeypatch,
            f"--dataset.root={data}",
            f"--dataset.labels={path}",
            f"--output_dir={tmp_path / 'run'}",
            *options,
        )
    [line] = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2 and line.startswith("error: ")
    assert re.search(message, line)
    assert not (tmp_path / "run").exists(), "nothing is left behind"
