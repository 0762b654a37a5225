import csv
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from dpmacro.annotation.exports.dataset import write_labels


def test_a_line_for_every_segment(stored, stages, tmp_path):
    named = replace(stages, names=('say "go", then wait', "carry it", "verlaß den Tisch"))
    write_labels(stored, tmp_path / "out", named, ["csv"])
    table = pd.read_csv(tmp_path / "out/labels.csv")
    expected = [(e, s, t, label) for e, part in enumerate(named.segments) for label, s, t in part]
    found = zip(table.episode, table.start_frame, table.end_frame, table.label, strict=True)
    assert [(e, s, t, named.names.index(name)) for e, s, t, name in found] == expected
    assert table.start_s[:4].tolist() == [0.0, 0.4, 0.9, 0.0]
    assert table.end_s[:3].tolist() == [0.4, 0.9, pytest.approx(1.2)]
    assert table.source[2:7].tolist() == ["dpmacro", "person", "person", "person", "dpmacro"]
    assert table.confidence[0] == pytest.approx(named.confidence[:4].mean(), abs=1e-4)
    with (tmp_path / "out/labels.csv").open(newline="", encoding="utf-8") as file:
        head = next(csv.reader(file))
    assert head[:6] == ["episode", "start_frame", "end_frame", "start_s", "end_s", "label"]


def test_a_segment_that_a_person_said_in_part_is_ours(stored, stages, tmp_path):
    corrected = np.zeros(33, bool)
    corrected[:3] = True  # of the first segment's four frames
    write_labels(stored, tmp_path / "out", replace(stages, corrected=corrected), ["csv"])
    assert pd.read_csv(tmp_path / "out/labels.csv").source[0] == "dpmacro"
