"""Boosting on several ranks, in small: every layout finds the same policy."""

import re

import pytest
import ranks

pytestmark = pytest.mark.benchmark


def test_layouts_find_the_same_policy(capsys, monkeypatch):
    monkeypatch.setenv("GLOO_SOCKET_IFNAME", "lo")
    ranks.main(ranks.RanksOptions(2_000, 40, rounds=1, layouts=["1x1", "2x1"]))
    out = capsys.readouterr().out
    rows = re.findall(r"^\| ([12]x1) .*\| ([0-9a-f]{12}) \|$", out, re.MULTILINE)
    assert [layout for layout, _ in rows] == ["1x1", "2x1"] and rows[0][1] == rows[1][1]
    assert "model: 10,000,000 frames x 40 columns on 8 machines" in out


@pytest.mark.parametrize("wrong", [{"layouts": ["2"]}, {"layouts": ["0x1"]}, {"frames": 0}])
def test_wrong_options_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ranks.RanksOptions(**wrong)
