"""datasets/annotate.py as a user runs it."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lerobot_files import build
from noise import AVATAR, random_episodes, write
from odd_changes import one_frame_more
from segmented import random_policy

from dpmacro.annotation.annotate import annotate
from dpmacro.annotation.exports.labelling import read_labels
from dpmacro.boosting import crossfit
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils import cli
from dpmacro.worlds.two_flags.env import ACTIONS

SCRIPT = Path(__file__).parents[2] / "datasets" / "annotate.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("annotate_script", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policy")
    random_policy("pixels", 2, (48, 64), ACTIONS, (AVATAR,)).save(folder)
    return folder


def call(script, monkeypatch, *options):
    monkeypatch.setattr(sys, "argv", ["annotate.py", *map(str, options)])
    cli.run(script.main, script.AnnotateOptions)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--dataset.root=x"], "dataset x: no such folder"),
        (["--dataset.root=x", "--page.frames=0"], "page.frames is 0: give 1 or more"),
        (["--dataset.root=x", "--formats=[csv]"], "formats are of a new dataset: give --output"),
        (["--dataset.root=x", "--output=y", "--formats=[xml]"], "formats hold 'xml': choose from"),
        (["--dataset.root=x", "--names=[reach, reach]"], "give every stage a name of its own"),
        (["--dataset.root=x", "--corrections=y.json"], "y.json"),
        (["--dataset.root=x", "--output=x/y"], "x/y"),
        (
            ["--dataset.root=x", "--output=y", "--dataset.episodes=[1]"],
            "leave dataset.episodes and dataset.task",
        ),
        (["--policy.path=x"], "no demonstrations: give --dataset.root"),
        (["--policy.path=x", "--dataset.root=y"], "x holds no config.json"),
        (["--policy.path=x", "--dataset.root=y", "--tolerance=-1"], "--tolerance=-1: it must be at least 0"),
        (["--policy.path=x", "--dataset.root=y", "--seed=-1"], "--seed=-1: it must be at least 0"),
        *(
            (["--policy.path=x", "--dataset.root=y", option], f"unknown option {option.split('=')[0]}")
            for option in ("--episodes=5", "--policy.recovery=true")
        ),
        (
            ["--policy.path=x", "--dataset.root=y", "--dataset.image_size=[8,6]"],
            "dataset.image_size is (8, 6), and a policy is given, which decides that",
        ),
        (
            ["--policy.path=x", "--dataset.root=y", "--planner.macros=3"],
            "planner.macros is 3, and a policy is given, which decides that",
        ),
    ],
)
def test_bad_options_are_one_line_and_status_2(options, message, script, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *options, f"--output_dir={tmp_path / 'out'}")
    error = capsys.readouterr().err
    assert exit_.value.code == 2
    assert error.startswith("error: ") and error.count("\n") == 1 and message in error
    assert not (tmp_path / "out").exists()


def refused(script, monkeypatch, capsys, *options):
    """The one line with which a call is refused."""
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *options)
    error = capsys.readouterr().err
    last = error.replace("\r", "\n").splitlines()[-1]  # below progress bars
    assert exit_.value.code == 2 and error.count("error: ") == 1 and last.startswith("error: ")
    return last


@pytest.mark.parametrize(
    ("page", "output", "message"),
    [
        (
            "in/page",
            None,
            "--output_dir={0}/in/page: lies in the dataset {0}/in; give a folder that does not",
        ),
        ("link/page", None, "lies in the dataset {0}/in"),
        ("out/page", "out", "lies in the dataset {0}/out"),
        ("out", "out", "lies in the dataset {0}/out"),
        ("file/page", None, "--output_dir={0}/file/page: {0}/file is no folder; give a place in one"),
        ("page", "file/out", "--output={0}/file/out: {0}/file is no folder; give a place in one"),
        ("shut/page", None, "--output_dir={0}/shut/page: {0}/shut cannot be written to; give a folder that"),
        ("page", "shut/a/out", "--output={0}/shut/a/out: {0}/shut cannot be written to; give a folder that"),
    ],
)
def test_places_that_cannot_be_are_refused_before_a_search(
    page, output, message, script, recorded, tmp_path, monkeypatch, capsys
):
    shutil.copytree(recorded, tmp_path / "in")
    (tmp_path / "link").symlink_to(tmp_path / "in")
    (tmp_path / "file").touch()
    (tmp_path / "shut").mkdir()
    before = sorted(tmp_path.rglob("*"))
    allowed = os.access  # root may write everywhere
    monkeypatch.setattr(os, "access", lambda path, mode: path.name != "shut" and allowed(path, mode))
    monkeypatch.setattr(script, "trained", lambda *_: pytest.fail("searched"))
    options = [f"--dataset.root={tmp_path / 'in'}", f"--output_dir={tmp_path / page}"]
    options += [f"--output={tmp_path / output}"] if output else []
    assert message.format(tmp_path) in refused(script, monkeypatch, capsys, *options)
    assert sorted(tmp_path.rglob("*")) == before


def test_corrections_of_another_dataset_are_refused_before_a_search(
    script, recorded, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(script, "Trainer", lambda *_: pytest.fail("searched"))
    path = tmp_path / "labels.csv"
    path.write_text("episode,start_frame,end_frame,label\n9,0,12,a\n")
    options = [f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'page'}"]
    line = refused(script, monkeypatch, capsys, *options, f"--corrections={path}")
    assert "labels.csv, line 2: there is no episode 9 among the 4 read" in line
    line = refused(script, monkeypatch, capsys, *options, f"--corrections={tmp_path / 'nowhere.json'}")
    assert "nowhere.json: no such file; give the one that the page saved" in line
    assert not (tmp_path / "page").exists()


def test_a_run_that_is_stopped_before_the_page_is_there_goes_on(
    script, policy, recorded, tmp_path, monkeypatch, capsys
):
    """The dataset has no name before the page is complete: nothing looks finished, and nothing is refused."""
    options = [f"--policy.path={policy}", f"--dataset.root={recorded}", "--names=[a, b]"]
    options += [f"--output={tmp_path / 'out'}", f"--output_dir={tmp_path / 'page'}"]
    monkeypatch.setattr(script, "pictures", lambda *_: iter(()))

    def stopped(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("dpmacro.annotation.report.write_page", stopped)
        with pytest.raises(SystemExit) as exit_:
            call(script, patched, *options)
    assert exit_.value.code == cli.INTERRUPTED
    assert {path.name for path in tmp_path.iterdir()} == {".out.partial", "page"}
    written = next((tmp_path / ".out.partial/dataset/data").rglob("*.parquet"))
    before = written.stat()
    call(script, monkeypatch, *options)
    assert {path.name for path in tmp_path.iterdir()} == {"out", "page"}
    after = next((tmp_path / "out/data").rglob("*.parquet")).stat()
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns), (
        "nothing is written twice"
    )
    assert (tmp_path / "page/segmentation.html").exists() and (tmp_path / "page/segmentation.json").exists()


def test_a_folder_by_date_ends_in_the_datasets_name(script):
    assert script.default_output_dir(Path("data/100%Flags")).name.endswith("_100%Flags")


def test_a_segmentation_as_a_command(policy, recorded, tmp_path):
    options = [f"--policy.path={policy}", f"--dataset.root={recorded}", f"--output_dir={tmp_path}"]
    command = [sys.executable, str(SCRIPT), *options, "--tolerance=1"]
    if importlib.util.find_spec("rerun"):
        command.append("--rerun=true")
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    if "--rerun=true" in command:
        folder = tmp_path / "rerun"
        assert f"recordings  {folder}" in done.stdout and "Recordings: 100%" in done.stderr
        assert {path.name for path in folder.iterdir()} == {f"two_flags_episode_{k}.rrd" for k in range(4)}
    assert "Images of avatar: 100%" in done.stderr
    assert "uniform cuts" in done.stdout and "frames that agree" in done.stdout
    assert str(tmp_path / "segmentation.html") in done.stdout and "Pictures: 100%" in done.stderr
    numbers = json.loads((tmp_path / "segmentation.json").read_text())
    assert [row["frames"] for row in numbers["demonstrations"]] == [12, 7, 2, 9]
    assert (numbers["truth"], numbers["tolerance"]) == ("phase", 1)
    assert 0 <= numbers["scores"]["policy"]["accuracy"] <= 1
    assert {f"demonstration_{k:03d}.png" for k in range(4)} <= {
        path.name for path in (tmp_path / "figures").iterdir()
    }
    assert "data:image/png;base64," in (tmp_path / "segmentation.html").read_text()


def test_without_rerun_nothing_is_begun(script, recorded, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setattr(script, "trained", lambda *_: pytest.fail("searched"))
    with pytest.raises(SystemExit) as exit_:
        call(
            script,
            monkeypatch,
            f"--dataset.root={recorded}",
            "--rerun=true",
            f"--output_dir={tmp_path / 'out'}",
        )
    error = capsys.readouterr().err
    assert exit_.value.code == 2 and error.count("\n") == 1 and "pip install 'rerun-sdk" in error
    assert not (tmp_path / "out").exists()


def test_a_segmentation_of_some_episodes(script, policy, recorded, tmp_path, monkeypatch, capsys):
    options = [f"--policy.path={policy}", f"--dataset.root={recorded}"]
    call(script, monkeypatch, *options, "--dataset.episodes=[3,1]", f"--output_dir={tmp_path / 'some'}")
    numbers = json.loads((tmp_path / "some" / "segmentation.json").read_text())
    assert [row["episode"] for row in numbers["demonstrations"]] == [3, 1]
    capsys.readouterr()
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *options, f"--output_dir={tmp_path / 'some'}")
    assert exit_.value.code == 2 and "already holds a segmentation.json" in capsys.readouterr().err


def test_a_dataset_of_another_size_is_refused(script, policy, tmp_path, monkeypatch, capsys):
    write(tmp_path / "small", random_episodes(shape=(24, 32, 3)), {})
    with pytest.raises(SystemExit) as exit_:
        options = [f"--policy.path={policy}", f"--dataset.root={tmp_path / 'small'}"]
        call(script, monkeypatch, *options, f"--output_dir={tmp_path / 'out'}")
    error = capsys.readouterr().err
    assert exit_.value.code == 2 and "images are 32x24, the policy was trained on 64x48" in error
    assert error.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.fixture
def quick_search(monkeypatch):
    """A few rounds of everything: the tests look at what is connected to what."""
    for name in ("CLASSES", "VECTORS"):
        monkeypatch.setattr(crossfit, name, replace(getattr(crossfit, name), shared=3, own=3))


SMALL = ["--planner.macros=2", "--planner.rounds=5", "--planner.switch_rounds=5", "--planner.restarts=2"]


def test_stages_are_found_written_corrected_and_written_again(
    script, quick_search, recorded, tmp_path, monkeypatch, capsys
):
    """From a dataset to a new one, a person's correction, and another one: only the correction differs."""
    options = [f"--dataset.root={recorded}", *SMALL, "--planner.rectangles=32", "--names=[first, second]"]
    first, second = tmp_path / "first", tmp_path / "second"
    call(script, monkeypatch, *options, f"--output={first}", f"--output_dir={tmp_path / 'page'}")
    told, bars = capsys.readouterr()
    assert "Dataset: 100%" in bars
    assert "stage 0     first" in told and f"dataset     {first}" in told and "idle " in told
    stages = read_labels(first)
    assert stages.names == ("first", "second") and not stages.corrected.any()
    policy = tmp_path / "page/training/checkpoints/last/pretrained_model"
    again = annotate(MacroPolicy.load(policy), Demonstrations.load(recorded))
    assert stages.labels.tolist() == again.labels.tolist(), "what the policy says of the same demonstrations"
    corrections = tmp_path / "corrections.json"
    corrections.write_text(
        json.dumps(
            {
                "format": "dpmacro corrections 1",
                "dataset": recorded.name,
                "fps": stages.fps,
                "names": ["reach", "leave"],
                "renamed": [[0, 0], [1, 1]],
                "episodes": [
                    {
                        "episode": 1,
                        "frames": 7,
                        "segments": [{"start": 0, "end": 3, "label": 1}, {"start": 3, "end": 7, "label": 0}],
                    }
                ],
            }
        )
    )
    options = [f"--dataset.root={recorded}", f"--policy.path={policy}", f"--corrections={corrections}"]
    call(script, monkeypatch, *options, f"--output={second}", f"--output_dir={tmp_path / 'again'}")
    assert "corrected   1 demonstration by a person" in capsys.readouterr().out
    corrected = read_labels(second)
    part = corrected.trajectories[1]
    assert corrected.names == ("reach", "leave")
    assert corrected.labels[part].tolist() == [1] * 3 + [0] * 4 and bool(corrected.corrected[part].all())
    others = np.delete(np.arange(len(stages.labels)), np.r_[part])
    assert corrected.labels[others].tolist() == stages.labels[others].tolist()
    assert not corrected.corrected[others].any() and bool((corrected.confidence[part] == 1).all())
    rows = (second / "labels.csv").read_text().splitlines()
    assert len(rows) == 1 + sum(map(len, corrected.segments)) and sum("person" in row for row in rows) == 2


def test_what_cannot_be_written_is_said_and_the_policy_stays(
    script, quick_search, recorded, tmp_path, monkeypatch, capsys
):
    options = [f"--dataset.root={recorded}", *SMALL, "--planner.rectangles=32", "--names=[one, two, three]"]
    with pytest.raises(SystemExit) as exit_:
        call(
            script, monkeypatch, *options, f"--output={tmp_path / 'new'}", f"--output_dir={tmp_path / 'page'}"
        )
    told = capsys.readouterr()
    assert exit_.value.code == 2 and "give one for each stage" in told.err.splitlines()[-1]
    assert not (tmp_path / "new").exists() and not (tmp_path / "page/segmentation.html").exists()
    assert "policy      " in told.out
    assert (tmp_path / "page/training/checkpoints/last/pretrained_model/config.json").exists()


def test_a_dataset_into_which_nothing_can_be_written_is_refused_before_a_search(
    script, recorded, tmp_path, monkeypatch, capsys
):
    root = tmp_path / "old"
    shutil.copytree(recorded, root)
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps({**info, "codebase_version": "v2.1"}))
    monkeypatch.setattr(script, "trained", lambda *_: pytest.fail("searched"))
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, f"--dataset.root={root}", f"--output={tmp_path / 'new'}")
    assert exit_.value.code == 2 and "v2.1" in capsys.readouterr().err


def test_a_dataset_with_an_episode_that_cannot_be_cut_is_refused_before_a_search(
    script, tmp_path, monkeypatch, capsys
):
    plain = tmp_path / "plain"
    build(plain)
    one_frame_more(plain)
    monkeypatch.setattr(script, "Trainer", lambda *_: pytest.fail("searched"))
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, f"--dataset.root={plain}", f"--output={tmp_path / 'new'}")
    told = capsys.readouterr().err
    assert exit_.value.code == 2 and "has 3 episodes, and 1 of them have no labels (episode 2 first)" in told
    assert not (tmp_path / "new").exists()


class Killed(BaseException):
    """What a test raises in place of a kill: nothing catches it."""


def test_a_run_that_is_stopped_after_the_search_does_not_search_again(
    script, quick_search, recorded, tmp_path, monkeypatch, capsys
):
    """With other names for the same search, too; with another search it is refused in a line."""
    options = [f"--dataset.root={recorded}", *SMALL, "--planner.rectangles=32"]

    def page(name, *more):
        return [*options, f"--output={tmp_path / name}", f"--output_dir={tmp_path / f'{name}_page'}", *more]

    with monkeypatch.context() as patched:
        patched.setattr(script, "Summary", lambda *_: (_ for _ in ()).throw(Killed))
        with pytest.raises(Killed):
            call(script, patched, *page("b"))
    with monkeypatch.context() as patched:
        patched.setattr(script, "Trainer", lambda *_: pytest.fail("searched"))
        line = refused(script, patched, capsys, *page("b", "--planner.rectangles=33", "--seed=2"))
        assert "search in this folder was begun with another planner.rectangles and seed; run" in line
        call(script, patched, *page("b"))
    assert "goes on     with the stages that were found in" in capsys.readouterr().out
    call(script, monkeypatch, *page("a"))
    undisturbed, gone_on = (read_labels(tmp_path / name) for name in "ab")
    for name in ("labels", "confidence", "idle"):
        assert np.array_equal(getattr(undisturbed, name), getattr(gone_on, name)), name
    assert (tmp_path / "a/labels.csv").read_bytes() == (tmp_path / "b/labels.csv").read_bytes()
    pages = [(tmp_path / f"{name}_page/segmentation.json").read_text() for name in "ab"]
    assert pages[0].replace("a_page", "b_page") == pages[1]
    assert not list(tmp_path.glob("*/.unfinished")) and not list(tmp_path.glob(".*"))


def test_a_search_that_was_stopped_goes_on(script, quick_search, recorded, tmp_path, monkeypatch, capsys):
    options = [f"--dataset.root={recorded}", *SMALL, "--planner.rectangles=32", f"--output_dir={tmp_path}"]
    with monkeypatch.context() as patched:
        patched.setattr(script.Trainer, "_save", lambda *_: (_ for _ in ()).throw(Killed))
        with pytest.raises(Killed):
            call(script, patched, *options)
    stages = tmp_path / "training/checkpoints/000000/training_state/stages"
    kept = {one.name: one.stat().st_mtime_ns for one in stages.iterdir()}
    assert kept
    with monkeypatch.context() as patched:
        patched.setattr(script.KeptSearch, "keep", lambda *_: (_ for _ in ()).throw(Killed))
        with pytest.raises(Killed):
            call(script, patched, *options)
    assert {one.name: one.stat().st_mtime_ns for one in stages.iterdir()} == kept
    call(script, monkeypatch, *options)
    assert "goes on     with the search in" in capsys.readouterr().out
    assert not stages.exists() and (tmp_path / "segmentation.json").exists()


@pytest.mark.parametrize("rerun", [False, True])
@pytest.mark.parametrize("place", ["before the numbers", "after them"])
def test_wherever_the_end_is_stopped_the_same_command_completes_it(
    script, policy, recorded, tmp_path, monkeypatch, place, rerun
):
    """Before the numbers are there, and between them and the end, whatever is written beside the page."""
    options = [f"--policy.path={policy}", f"--dataset.root={recorded}", f"--output={tmp_path / 'out'}"]
    options += [f"--output_dir={tmp_path / 'page'}"]
    if rerun:
        pytest.importorskip("rerun")
        options.append("--rerun=true")
    monkeypatch.setattr(script, "pictures", lambda *_: iter(()))
    written = script.write_report

    def stopped(*given, **named):
        if place == "after them":
            written(*given, **named)
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(script, "write_report", stopped)
        with pytest.raises(Killed):
            call(script, patched, *options)
    assert not (tmp_path / "out").exists()
    call(script, monkeypatch, *options)
    assert {path.name for path in tmp_path.iterdir()} == {"out", "page"}
    assert {path.name for path in (tmp_path / "page").iterdir()} == {
        "segmentation.html",
        "segmentation.json",
        "tensorboard",
        *(["rerun"] if rerun else []),
    }
