"""The benchmark of damaged datasets in small: what it damages, and how it judges."""

import json
import shutil

import annotate_corruptions as module
import numpy as np
import pytest


@pytest.mark.benchmark
def test_every_damaged_dataset_is_one_line_or_right(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(module, "SEARCH", (*module.SEARCH, "--planner.rectangles=32"))
    module.main(module.CorruptionOptions(runs=12, seed=5))
    last = capsys.readouterr().out.splitlines()[-1].split()
    assert last[0] == "all" and int(last[1]) + int(last[2]) == 12 and last[3:] == ["0", "0", "0"]


@pytest.mark.parametrize("damage", module.DAMAGES, ids=lambda one: one.__name__)
def test_a_damage_changes_the_file(damage, tmp_path):
    content = {"fps": 10, "features": {"action": {"dtype": "float32"}, "state": {"dtype": "float32"}}}
    changed = 0
    for seed in range(5):
        path = tmp_path / f"{seed}.json"
        path.write_text(json.dumps(content))
        damage(path, np.random.default_rng(seed))
        changed += not path.is_file() or path.read_text(errors="replace") != json.dumps(content)
    assert changed >= 4


def test_a_traceback_a_slow_run_and_what_is_written_to_are_told(tmp_path, monkeypatch):
    whole = tmp_path / "whole"
    whole.mkdir()
    (whole / "info.json").write_text('{"a": 1, "b": 2}')

    def outcome(call):
        monkeypatch.setattr(module, "call", call)
        shutil.rmtree(tmp_path / "run", ignore_errors=True)
        found = module.outcome(None, whole, tmp_path, tmp_path / "run", np.random.default_rng(1))
        return found.what

    def broken(*_):
        raise KeyError("a bug")

    def late(*_):
        raise TimeoutError

    def written_to(*_):
        (tmp_path / "run/in/new").touch()
        return 2, "error: a line"

    assert outcome(broken) == "traceback"
    assert outcome(late) == "slow"
    assert outcome(written_to) == "wrong"
    assert outcome(lambda *_: (2, "error: a line")) == "line"
    assert outcome(lambda *_: (2, "error: one\nerror: two")) == "wrong"
    assert outcome(lambda *_: (130, "interrupted")) == "wrong"
