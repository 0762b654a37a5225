"""Options that one another forbid, and what the paper's recipe makes of them."""

import numpy as np
import pytest

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.training import trainer as training
from dpmacro.training.options import PAPER, DatasetOptions, PlannerOptions, TrainOptions
from dpmacro.training.run_folder import RunFolder


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"features": "rectangles"},  # the default
        {"features": "pixels"},
        {"shrinkage": 1.0, "switch_weight": 0.0},
        {"shrinkage": 0.1, "recovery": False},
        {"macros": 3, "rounds": 7, "restarts": 2, "switch_window": 5},  # what the recipe leaves open
    ],
)
def test_the_papers_recipe_fixes_what_the_paper_fixes(given):
    options = PlannerOptions(recipe="paper", **given)
    assert {name: getattr(options, name) for name in PAPER} == PAPER
    for name, value in given.items():
        assert name in PAPER or getattr(options, name) == value


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("shrinkage", 0.5),
        ("switch_shrinkage", 0.5),
        ("switch_weight", 0.5),
        ("learner", "convnet"),
        ("switch_learner", "convnet"),
        ("switch_drawn", 7),
        ("early_stopping", True),
        ("recovery", True),
    ],
)
def test_an_option_that_the_paper_has_otherwise_is_refused_by_name(name, value):
    message = (
        rf"^planner\.{name} is {value!r}, and planner\.recipe=paper has {PAPER[name]!r}: give one of the two$"
    )
    with pytest.raises(ValueError, match=message):
        PlannerOptions(recipe="paper", **{name: value})
    assert getattr(PlannerOptions(**{name: value}), name) == value


def test_an_unknown_recipe_is_named():
    with pytest.raises(ValueError, match=r"planner\.recipe is 'papers': choose one of dpmacro, paper"):
        PlannerOptions(recipe="papers")


def trainer(recorded, tmp_path, **options):
    demonstrations = Demonstrations.load(recorded)
    given = TrainOptions(DatasetOptions(root=recorded, symmetric=True), PlannerOptions(**options))
    return training.Trainer(demonstrations, given, RunFolder(tmp_path / "run"))


def test_switch_functions_of_the_paper_have_no_cues_no_thresholds_and_see_the_whole_past(recorded, tmp_path):
    settings = trainer(recorded, tmp_path, recipe="paper", switch_rounds=9, switch_window=4)._switch_settings
    assert (settings.rounds, settings.window, settings.shrinkage) == (9, 4, 1.0)
    assert settings.whole_past
    assert not (settings.focused or settings.calibrated or settings.cues or settings.aligned)
    ours = trainer(recorded, tmp_path, switch_rounds=9)._switch_settings
    assert not ours.whole_past and ours.focused and ours.calibrated and ours.cues and ours.aligned


def test_a_training_by_the_papers_recipe(recorded, tmp_path, monkeypatch):
    """No mirror images though the world is symmetric, thresholds of 0, no cues, no say in the cuts."""
    monkeypatch.setattr(training.TrainingPictures, "show", lambda *given: None)
    small = {"rounds": 4, "restarts": 2, "switch_rounds": 3}
    result = trainer(recorded, tmp_path, recipe="paper", **small).train()
    config = result.policy.config
    assert config.encoder["kind"] == "pixels" and config.switch_weight == 0.0 and not config.recovery
    assert config.switches and config.cues == () and not np.any(config.thresholds)
    assert result.found.terms is None and result.found.unsettled == 0
    assert len(result.found.discovery.candidates) == 1, "the training loss alone decides"
