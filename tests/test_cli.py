"""The scripts' front door: LeRobot-style options in, one line and status 2 for a mistake."""

import sys
from dataclasses import dataclass, field

import pytest

from dpmacro import cli


@dataclass
class Inner:
    """A group of options."""

    size: tuple[int, int] = (1, 2)
    count: int = 1

    def __post_init__(self):
        if self.count < 1:
            raise ValueError(f"inner.count is {self.count}: give 1 or more")


@dataclass
class Options:
    """Options of a script."""

    inner: Inner = field(default_factory=Inner)
    name: str | None = None
    fast: bool = False


def test_options_come_as_lerobot_has_them(tmp_path):
    file = tmp_path / "options.json"
    file.write_text('{"inner": {"count": 5}, "name": "file"}')
    assert cli.parse(Options, []) == Options()
    assert cli.parse(Options, ["--inner.size=[3,4]", "--fast=true"]) == Options(Inner((3, 4)), fast=True)
    assert cli.parse(Options, [f"--config_path={file}", "--name=flag"]) == Options(Inner(count=5), "flag")


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("--inner.cont=3", "unknown option --inner.cont: did you mean --inner.count?"),
        ("--inner.coun=3", "did you mean --inner.count?"),
        ("--zzzz=3", "unknown option --zzzz: see --help"),
        ("stray", "unknown option stray"),
        ("--inner.count=x", "`inner.count`: Couldn't parse 'x' into an int"),
        ("--inner.count=0", "inner.count is 0: give 1 or more"),
        ("--inner.size=[3]", "Expected 2 items, got 1"),
        ("--inner.count", "expected one argument"),
        ("--config_path=/no/such/file.json", "/no/such/file.json"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(monkeypatch, capsys, argument, message):
    monkeypatch.setattr(sys, "argv", ["script.py", argument])
    with pytest.raises(SystemExit) as stop:
        cli.run(lambda options: None, Options)
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert len(error.strip().splitlines()) == 1
    assert message in error


@pytest.mark.parametrize(
    ("error", "status"), [(ValueError("a\n  b"), 2), (FileNotFoundError("c"), 2), (KeyboardInterrupt(), 130)]
)
def test_what_main_raises_becomes_one_line(monkeypatch, capsys, error, status):
    def main(options):
        raise error

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(SystemExit) as stop:
        cli.run(main, Options)
    assert stop.value.code == status
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_bug_keeps_its_traceback(monkeypatch):
    def main(options):
        raise KeyError("bug")

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(KeyError):
        cli.run(main, Options)
