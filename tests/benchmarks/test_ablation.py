"""The ablation: that every part is really taken out, its plan, its differences, and one cell."""

import importlib
import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

import ablation  # noqa: E402
from ablated import PARTS, apply  # noqa: E402
from ablation import SOURCES, AblationOptions, Cell, Runs, variants  # noqa: E402
from ablation_report import differences, dots, table  # noqa: E402

from dpmacro.training.options import PlannerOptions  # noqa: E402


@pytest.fixture
def put_back():
    """Modules are as they were after the test."""
    places = {(module, name) for part in PARTS.values() for module, name, _ in part.patches}
    kept = {place: getattr(importlib.import_module(place[0]), place[1]) for place in places}
    yield kept
    for (module, name), value in kept.items():
        setattr(importlib.import_module(module), name, value)


@pytest.mark.parametrize("name", [name for name, part in PARTS.items() if part.patches])
def test_a_part_is_replaced_where_the_package_uses_it(name, put_back):
    apply([name])
    for module, attribute, _ in PARTS[name].patches:
        assert getattr(importlib.import_module(module), attribute) is not put_back[module, attribute]


def test_settings_are_the_others_when_parts_are_out(put_back):
    apply(["starts", "joint-cut", "focused", "calibration", "peaks", "merging", "rare"])
    from dpmacro.discovery import search
    from dpmacro.estimator import dpboost, recipes
    from dpmacro.switching import training

    options = {"recipe": "dpmacro", "switch_weight": 1.0}
    found = dpboost.search_of(options)
    assert (found.starts, found.switch_weight, found.criterion) == ("random", 0.0, "left_out")
    switches = recipes.switches_of(
        {**options, "switch_rounds": 9, "switch_window": 3, "early_stopping": False}
    )
    assert (switches.focused, switches.calibrated, switches.cues, switches.rounds) == (False, False, True, 9)
    assert search.feature_peaks(None, torch.tensor([4, 5]), 3).shape == (0, 9)
    assert search.simplified(["a"], None, None) == ["a"]
    assert isinstance(importlib.import_module("dpmacro.training.trainer").SwitchSettings, partial)
    assert training.best_threshold([], torch.zeros(0), 0, ["some other segment"]) == 0.0


def test_options_of_parts_are_options_of_train_py():
    given = [option for part in PARTS.values() for option in part.options]
    names = {option.split("=")[0] for option in given} - {"--dataset.symmetric"}
    assert names == {"--planner.features", "--planner.switch_weight"}
    assert all(hasattr(PlannerOptions(), name.removeprefix("--planner.")) for name in names)


def test_variants_leave_out_one_or_all_others():
    found = variants(["cues", "merging", "rare"], only=True)
    assert found["all"] == ()
    assert found["without merging"] == ("merging",)
    assert found["only merging"] == ("cues", "rare")
    assert found["none"] == ("cues", "merging", "rare")
    assert list(variants(["cues"], only=False)) == ["all", "without cues"]


def test_sources_have_the_parts_that_can_matter_there():
    assert "recovery" in SOURCES["two-flags"].parts and "mirror" in SOURCES["two-flags"].parts
    assert not {"recovery", "cues", "rectangles"} & set(SOURCES["pick-place-v3"].parts)
    assert "joint-cut" in SOURCES["digits"].parts and "recovery" not in SOURCES["digits"].parts


def rows():
    made = []
    for seed in (0, 1):
        for variant, values in {
            "all": [1, 1, 0, 1],
            "without cues": [1, 0, 0, 1],
            "none": [0, 0, 0, 0],
        }.items():
            made.append({"source": "two-flags", "variant": variant, "train_seed": seed, "values": values})
    return [*made, {"source": "digits", "variant": "none", "train_seed": 0, "values": [0.5]}]


def test_differences_are_paired_by_run_and_seed():
    one, other = differences(rows())
    assert (one.variant, one.mean) == ("without cues", -25.0)
    assert one.half == pytest.approx(1.96 * np.std([0, -100, 0, 0] * 2, ddof=1) / 8**0.5)
    assert (other.variant, other.mean) == ("none", -75.0), "digits lack what they would be compared with"
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table(rows())]
    assert cells[0] == ["%", "two-flags", "digits"]
    assert cells[2] == ["all", "75.0", ""]
    assert cells[-1] == ["none", "0.0 (-75.0, +-32.1)", "50.0"]
    [axis] = dots(rows()).axes
    assert [label.get_text() for label in axis.get_yticklabels()] == ["without cues", "none"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"sources": ["chess"]}, "sources has 'chess': choose from two-flags"),
        ({"train_seeds": [7]}, "train_seeds has 7: give 0 to 4"),
        ({"episodes": 0}, "episodes is 0: give 1 to 1000"),
    ],
)
def test_bad_options_are_named(options, said):
    with pytest.raises(ValueError, match=said):
        AblationOptions(**options)


def test_a_cell_trains_without_its_parts_and_runs_in_validation_worlds(tmp_path, monkeypatch):
    done = []

    def run(job, commit, threads, moved):
        done.append(job)
        job.folder.mkdir(parents=True)
        stamp = {"options": list(job.options), "command": job.script, "commit": commit, "seconds": 1.0}
        job.folder.with_name(job.folder.name + ".json").write_text(json.dumps(stamp))
        found = {"dpmacro": {"outcomes": ["success", "red_first"]}}
        (job.folder / "eval_info.json").write_text(json.dumps(found))
        segmented = [{"metric": "accuracy", "value": 0.75}, {"metric": "edit", "value": 1.0}]
        (job.folder / "rows.json").write_text(json.dumps(segmented))
        return stamp

    class Bar:
        def set_description(self, text):
            pass

    monkeypatch.setattr(ablation, "run", run)
    runs = Runs(AblationOptions(output_dir=tmp_path), "abc", Bar())
    made = runs.row(Cell("two-flags", "only joint-cut", 2))
    assert made["values"] == [1.0, 0.0]
    recorded, trained, ran = (job.options for job in done)
    assert recorded[0] == "--seed=2000"
    assert "--without=cues" in trained and "--without=joint-cut" not in trained
    assert trained[-4:] == (
        "--planner.macros=2",
        "--planner.features=pixels",
        "--dataset.symmetric=false",
        "--seed=2",
    )
    assert ran == ("--seed=5000", "--episodes=100", "--policy.recovery=false")
    assert runs.row(Cell("digits", "without merging", 0))["values"] == [0.75]
    assert done[-1].options[:2] == ("--without=merging", "benchmarks/bench_segmentation.py")


def test_a_script_that_is_not_there_is_refused():
    command = [sys.executable, str(ROOT / "benchmarks/ablated.py"), "--without=cues"]
    told = subprocess.run([*command, "none.py"], capture_output=True, text=True)
    assert told.returncode == 2 and "script is none.py: give one of this project" in told.stderr
    told = subprocess.run([*command, "train.py", "--seed=-1"], capture_output=True, text=True)
    assert told.returncode == 2 and told.stderr.count("\n") == 1
