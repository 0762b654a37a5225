"""The scripts' front door: LeRobot-style options in, one line and status 2 for a mistake."""

import errno
import json
import sys
import threading
import warnings
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import pytest
from tqdm import tqdm

from dpmacro.utils import cli


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
    many: list[int] | None = None
    folder: Path = Path()


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
        ("--inner.count=true", "--inner.count=true is no number: give one, or leave it out"),
        ("--inner.count=No", "--inner.count=No is no number: give one, or leave it out"),
        ("--inner.size=[3]", "Expected 2 items, got 1"),
        ("--inner.count", "expected one argument"),
        ("--config_path=/no/such/file.json", "/no/such/file.json"),
        ("--config_path", "expected one argument"),
        ("--many=[0", "--many=[0 cannot be read (expected ',' or ']'"),
        ("--many=0,1", "write it in brackets, like '[0,1,2]'"),
        ("--name=a: b: c", "--name=a: b: c cannot be read (mapping values are not allowed here)"),
        ("--folder=", "folder is empty: give a path"),
        ("--inner=3", "`inner`: 3 is nothing that it can be"),
        (
            "--inner={}|--inner.count=1",
            "--inner is given beside --inner.count: give the options of inner one",
        ),
        ("--name=2024-13-45", "--name=2024-13-45 cannot be read (month must be in 1..12)"),
        ("--inner.size=3,4", "write it in brackets"),
        ("--inner.size=3", "write it in brackets"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(monkeypatch, capsys, argument, message):
    monkeypatch.setattr(sys, "argv", ["script.py", *argument.split("|")])
    with pytest.raises(SystemExit) as stop:
        cli.run(lambda options: None, Options)
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert len(error.strip().splitlines()) == 1
    assert message in error


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("o.md", "a: b: c", "cannot be read (mapping values are not allowed here): give a JSON file"),
        ("o.json", "{", "cannot be read (Expecting property name"),
        ("o.json", "[1]", "holds a list, no options"),
        ("o.yaml", "", "holds a NoneType, no options"),
    ],
)
def test_a_file_of_something_else_is_one_line(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError) as error:
        cli.parse(Options, [f"--config_path={tmp_path / name}"])
    assert f"--config_path={tmp_path / name} {message}" in str(error.value)


@pytest.mark.parametrize(("rank", "silent"), [(None, False), ("0", False), ("1", True)])
def test_of_several_ranks_the_first_says_a_mistake_before_another_ends(monkeypatch, capsys, rank, silent):
    """All are ended by torchrun as soon as one has ended."""
    waited = []
    monkeypatch.setattr(cli.time, "sleep", waited.append)
    monkeypatch.setattr(sys, "argv", ["script.py", "--inner.count=0"])
    monkeypatch.delenv("RANK", raising=False)
    if rank is not None:
        monkeypatch.setenv("RANK", rank)
    with pytest.raises(SystemExit) as ended:
        cli.run(lambda options: None, Options)
    assert ended.value.code == 2
    assert (capsys.readouterr().err == "") == silent
    assert waited == [cli.SAYING] * silent


def test_a_folder_may_begin_at_home(monkeypatch):
    monkeypatch.setenv("HOME", "/home/she")
    assert cli.parse(Options, ["--folder=~/runs"]).folder == Path("/home/she/runs")
    with pytest.raises(OSError, match=r"/home/she/none\.json"):
        cli.parse(Options, ["--config_path=~/none.json"])
    assert cli.parse(Options, ["--folder=~"]).folder == Path("/home/she")


@pytest.mark.parametrize(
    "name", ["2024", "2024-11-23", "1.50", "007", "1_000", "true", "[1]", "@x", "a: b", "é"]
)
def test_a_folder_may_look_like_something_else(name):
    assert cli.parse(Options, [f"--folder={name}"]).folder == Path(name)
    assert cli.parse(Options, ["--folder", name, "--fast=true"]) == Options(folder=Path(name), fast=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inner": {"cont": 3}}, "holds inner.cont, which is no option: did you mean inner.count?"),
        ({"zzz": 3}, "holds zzz, which is no option: remove it; there are inner, name, fast, many, folder"),
        ({"inner": {"count": "x"}}, ": `inner.count`: Couldn't parse 'x' into an int"),
        ({"folder": ""}, "folder is empty: give a path"),
        ({"folder": True}, "folder is True: give a path"),
        ({"inner": 3}, ": `inner`: 3 is nothing that it can be, see --help"),
    ],
)
def test_a_mistake_in_a_file_names_the_file_or_the_option(tmp_path, options, message):
    (tmp_path / "o.json").write_text(json.dumps(options))
    with pytest.raises(ValueError) as error:
        cli.parse(Options, [f"--config_path={tmp_path / 'o.json'}"])
    told = str(error.value)
    assert message in told and "\n" not in told
    assert f"--config_path={tmp_path / 'o.json'}" in told or message.startswith("folder")


def test_a_file_with_an_option_of_any_name_says_where_those_go(tmp_path):
    (tmp_path / "o.json").write_text('{"room": {"fog": 1}}')
    with pytest.raises(ValueError, match=r"holds room.fog, which is no option: give it within room.options"):
        cli.parse(House, [f"--config_path={tmp_path / 'o.json'}"])
    (tmp_path / "o.json").write_text('{"room": {"options": {"fog": 1}}}')
    assert cli.parse(House, [f"--config_path={tmp_path / 'o.json'}"]).room == Room(options={"fog": 1})


def test_what_is_held_is_left_when_main_ends(monkeypatch):
    left = []

    @contextmanager
    def held():
        try:
            yield 5
        finally:
            left.append("left")

    def main(options):
        assert cli.hold(held()) == 5 and not left
        raise KeyError("bug")

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(KeyError):
        cli.run(main, Options)
    assert left == ["left"]
    with pytest.raises(RuntimeError, match="call this within the `main`"):
        cli.hold(held())


@pytest.mark.parametrize("place", ["run/model.safetensors", None])
def test_a_full_disk_is_a_line_with_the_file_and_a_remedy(monkeypatch, capsys, place):
    def main(options):
        raise OSError(errno.ENOSPC, "No space left on device", place)

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(SystemExit) as stop:
        cli.run(main, Options)
    told = "cannot be written (No space left on device); free some space there and run it again"
    assert stop.value.code == 2 and capsys.readouterr().err == f"error: {place or 'a file'}: {told}\n"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EACCES])
def test_a_thread_that_finds_the_disk_full_says_so_in_a_line(monkeypatch, capsys, number):
    def fails():
        raise OSError(number, "no room")

    def main(options):
        thread = threading.Thread(target=fails)
        thread.start()
        thread.join()

    monkeypatch.setattr(sys, "argv", ["script.py"])
    monkeypatch.setattr(threading, "excepthook", lambda given: print("others", file=sys.stderr))
    cli.run(main, Options)
    told = (
        "warning: TensorBoard's events: cannot be written (no room); free some space there and run it again"
    )
    assert capsys.readouterr().err == (f"{told}\n" if number == errno.ENOSPC else "others\n")


@pytest.mark.parametrize(
    ("error", "status"),
    [(ValueError("a\n  b\x1b\ud800"), 2), (FileNotFoundError("c"), 2), (KeyboardInterrupt(), 130)],
)
def test_what_main_raises_becomes_one_line(monkeypatch, capsys, error, status):
    def main(options):
        raise error

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(SystemExit) as stop:
        cli.run(main, Options)
    assert stop.value.code == status
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_an_error_has_a_line_of_its_own_though_a_progress_bar_is_open(monkeypatch, capsys):
    def main(options):
        bars.append(tqdm(total=5))
        bars[0].update()
        raise ValueError("no more")

    bars = []
    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(SystemExit):
        cli.run(main, Options)
    error = capsys.readouterr().err
    bars[0].close()
    assert "error: no more" in error.replace("\r", "\n").splitlines()


def test_a_long_value_is_shortened_in_the_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["script.py", f"--name={'9' * 5000}"])
    with pytest.raises(SystemExit):
        cli.run(lambda options: None, Options)
    error = capsys.readouterr().err
    assert error.startswith("error: --name=999") and "…999" in error and len(error) < 800


def test_a_bug_keeps_its_traceback(monkeypatch):
    def main(options):
        raise KeyError("bug")

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(KeyError):
        cli.run(main, Options)


@pytest.mark.parametrize("category", [UserWarning, RuntimeWarning])
@pytest.mark.parametrize("where", [cli.__file__, __file__])
def test_a_warning_of_our_own_is_one_line(monkeypatch, capsys, category, where):
    def main(options):
        warnings.warn_explicit("the objective\n  rose", category, where, 1)

    monkeypatch.setattr(sys, "argv", ["script.py"])
    before = warnings.showwarning
    cli.run(main, Options)
    assert capsys.readouterr().err == "warning: the objective rose\n"
    assert warnings.showwarning is before


@pytest.mark.parametrize(
    ("category", "where"), [(UserWarning, json.__file__), (DeprecationWarning, cli.__file__)]
)
def test_other_warnings_stay_as_they_are(monkeypatch, capsys, category, where):
    def main(options):
        warnings.warn_explicit("something else", category, where, 1)

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.warns(category, match="something else"):
        cli.run(main, Options)
    assert capsys.readouterr().err == ""


def test_a_warning_and_a_mistake_are_a_line_each(monkeypatch, capsys):
    def main(options):
        warnings.warn("careful", UserWarning, stacklevel=1)
        raise ValueError("too late")

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(SystemExit):
        cli.run(main, Options)
    assert capsys.readouterr().err.splitlines() == ["warning: careful", "error: too late"]


@dataclass(frozen=True)
class Room:
    """A group that takes options of any name."""

    OTHERS: ClassVar[str] = "options"
    size: int = 1
    """Size of the room."""
    import_: str | None = None
    """A word of Python."""
    options: dict[str, Any] = field(default_factory=dict)
    """What else there is."""


@dataclass(frozen=True)
class House:
    """Options with such a group."""

    room: Room = field(default_factory=Room)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], Room()),
        (["--room.size=3", "--room.import=a.b"], Room(3, "a.b")),
        (["--room.fog=0.5", "--room.size=2"], Room(2, None, {"fog": 0.5})),
        (["--room.wall", "brick", "--room.tiles=[1, 2]"], Room(1, None, {"wall": "brick", "tiles": [1, 2]})),
        (["--room.options={fog: 1, sun: 2}", "--room.fog=3"], Room(1, None, {"fog": 3, "sun": 2})),
        (["--room.rate=1e-3", "--room.up=True"], Room(1, None, {"rate": 0.001, "up": True})),
        (["--room.name=e3", "--room.path=a=b"], Room(1, None, {"name": "e3", "path": "a=b"})),
    ],
)
def test_a_group_may_take_options_of_any_name(arguments, expected):
    assert cli.parse(House, arguments).room == expected


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--room.fog"], "--room.fog has no value: give one, like --room.fog=1"),
        (["--room.fog", "--room.size=1"], "--room.fog has no value"),
        (["--rooms.fog=1"], "unknown option --rooms.fog"),
        (["--room.fog=[1"], "cannot be read"),
    ],
)
def test_options_of_any_name_need_a_group_and_a_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        cli.parse(House, arguments)


def test_a_field_that_ends_in_an_underscore_is_told_without_it(capsys):
    with pytest.raises(SystemExit):
        cli.parse(House, ["--help"])
    told = capsys.readouterr().out
    assert "--room.import " in told and "import_" not in told
