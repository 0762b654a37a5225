"""Command lines of every script, from a grammar over all its options: accepted, or one line and status 2.

`make fuzz CASES=n` tries n random command lines of each script; the suite has the same few every time.
"""

import functools
import importlib.util
import inspect
import json
import sys
import time
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dpmacro.utils import cli
from dpmacro.utils.option_files import option_types
from tests.fuzz.limits import CASES, cases

ROOT = Path(__file__).parents[2]
SLOWEST = 20  # seconds

# What is put in place of the work, by script; `stream` is for what is asked for one result after another.
SCRIPTS = {
    "train.py": ("TrainOptions", {"read_demonstrations": "now"}),
    "eval.py": ("EvalOptions", {"check": "nothing", "iter_episodes": "stream"}),
    "datasets/record.py": ("RecordConfig", {"expert_runs": "stream"}),
    "datasets/annotate.py": ("AnnotateOptions", {"trained": "now", "by_policy": "now"}),
}
REQUIRED = {  # options with which a command line is accepted, unless others spoil it
    "train.py": ["--dataset.root=folder"],
    "eval.py": ["--policy.type=teacher"],
    "datasets/record.py": ["--root=absent"],
    "datasets/annotate.py": ["--dataset.root=folder"],
}
PATHS = (
    "",
    ".",
    "..",
    "file",
    "folder",
    "folder/inside",
    "absent",
    "absent/deep/er",
    "file/below",
    "/dev/null",
)
PATHS += (
    "x" * 300,
    "x/" * 3000,
    "two\nlines",
    "007",
    "true",
    "[1]",
    "a: b",
    "\ud800",
    "*",
    "-",
    "null",
    "link",
)
NUMBERS = (
    "0",
    "1",
    "2",
    "-1",
    "5",
    "0.5",
    "-0",
    "1e3",
    "1e400",
    "-1e400",
    "nan",
    ".nan",
    ".inf",
    "-.inf",
    "0x10",
)
NUMBERS += ("9" * 18, "9" * 19, "9" * 40, "9" * 5000, "1_000", "1:30", "1.5", "1e-320", "٣")
WORDS = (
    "",
    " ",
    "x",
    "auto",
    "free",
    "chain",
    "teacher",
    "baseline",
    "paper",
    "pixels",
    "convnet",
    "true",
    "no",
)
WORDS += (
    "null",
    "~",
    "cpu",
    "cuda:99",
    "meta",
    "2024-01-01",
    "2024-13-45",
    "é🙂",
    "a=b",
    "--x",
    "$x$",
    "'",
    '"',
)
BRACKETS = (
    "[]",
    "{}",
    "[1,2]",
    "[1",
    "{a: 1}",
    "{a",
    "[0, 0]",
    "[-1, 5]",
    "[a, b]",
    "[[]]",
    "[1e400]",
    "1,2",
    "[~]",
)
ODD = (
    "!!python/object:os.system",
    "!x",
    "&a [*a]",
    "*a",
    "@x",
    "%",
    "|",
    ">",
    "- a",
    "? a",
    "a: b: c",
    "\t",
    "`",
)
VALUES = st.sampled_from((*PATHS, *NUMBERS, *WORDS, *BRACKETS, *ODD)) | st.text(max_size=5)


class ReachedError(Exception):
    """The work would begin."""


@functools.cache
def script_of(name):
    """A script as a module of its own, without its work."""
    spec = importlib.util.spec_from_file_location(f"fuzzed_{Path(name).stem}", ROOT / name)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    for work, kind in SCRIPTS[name][1].items():
        assert hasattr(module, work), f"{name} has no {work}: name what takes its place"
        setattr(module, work, {"now": reached, "stream": stream, "nothing": lambda *given: []}[kind])
    return module


def reached(*given, **options):
    raise ReachedError


def stream(*given, **options):
    raise ReachedError
    yield


def names(script):
    options = [f"--{name}" for name in option_types(getattr(script_of(script), SCRIPTS[script][0]))]
    groups = {option.split(".")[0] for option in options if "." in option}
    odd = [
        *groups,
        "--",
        "-",
        "--help_",
        "--seeds",
        "--planner.round",
        "--world.fog",
        "--world",
        "--.",
        "--=",
        "-x",
    ]
    return options, odd


def values_of(kind):
    """Values that an option of this type may have, and others."""
    own = VALUES
    for part, fitting in ((Path, PATHS), (int, NUMBERS), (float, NUMBERS), (list, BRACKETS), (str, WORDS)):
        if str(getattr(part, "__name__", part)) in str(kind):
            own = own | st.sampled_from(fitting)
    return own


@st.composite
def written(draw, script):
    """An option with its value, as one argument or two, or without any."""
    options, odd = names(script)
    kinds = option_types(getattr(script_of(script), SCRIPTS[script][0]))
    name = draw(st.sampled_from(options) | st.sampled_from(options) | st.sampled_from(odd))
    value = draw(values_of(kinds.get(name.removeprefix("--"))))
    form = draw(st.integers(0, 9))
    if form == 9:
        return [name]
    return [name, value] if form == 8 else [f"{name}={value}"]


@st.composite
def files(draw, script):
    """A file of options: a JSON object of some of them, or of something else."""
    if draw(st.integers(0, 4)) == 0:
        return draw(
            st.sampled_from(("", "{", "[]", "null", "3", '"x"', "a: 1", "[" * 500, '{"seed": 1e999}', "\0"))
        )
    jsons = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
    jsons = st.recursive(
        jsons, lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=3), inner)
    )
    options, odd = names(script)
    content = {}
    for name in draw(st.lists(st.sampled_from([*options, *odd]), max_size=3)):
        place, *rest = content, *name.removeprefix("--").split(".")
        for part in rest[:-1]:
            place = place.setdefault(part, {})
            if not isinstance(place, dict):
                break
        else:
            place[rest[-1]] = draw(jsons)
    return json.dumps(content)


@st.composite
def command_lines(draw, script):
    """Arguments, and what the file of options holds where they name one."""
    arguments = list(REQUIRED[script]) if draw(st.integers(0, 5)) else []
    for more in draw(st.lists(written(script), max_size=3)):
        arguments += more
    content = None
    if draw(st.integers(0, 3)) == 0:
        content = draw(files(script))
        arguments.insert(draw(st.integers(0, len(arguments))), "--config_path=options.json")
    if draw(st.integers(0, 19)) == 0:
        arguments.append(f"--config_path={draw(st.sampled_from(PATHS))}")
    return arguments, content


def tree():
    return sorted((str(path), path.is_dir()) for path in Path().rglob("*"))


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder to work in, with sources read once: the parser reads them for every option in every call."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(inspect, "getsource", functools.cache(inspect.getsource))
    Path("file").write_text("x")
    Path("folder").mkdir()
    Path("folder/inside").write_text("x")
    Path("link").symlink_to("nowhere")


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_command_line_is_accepted_or_refused_in_a_line(script, place, monkeypatch, capsys):
    module = script_of(script)
    counts = {"accepted": 0, "refused": 0, "help": 0}

    @cases(25)
    @given(command_lines(script))
    @example((REQUIRED[script], None))
    @example((["--help_"], None))
    def check(given_):
        arguments, content = given_
        if content is not None:
            Path("options.json").write_text(content)
        before, start = tree(), time.monotonic()
        monkeypatch.setattr(sys, "argv", [script, *arguments])
        capsys.readouterr()
        try:
            cli.run(module.main, getattr(module, SCRIPTS[script][0]))
        except ReachedError:
            counts["accepted"] += 1
        except SystemExit as stop:
            error = capsys.readouterr().err.replace("\r", "\n")
            lines = [
                line
                for line in error.splitlines()
                if line.strip() and "%|" not in line and "it/s" not in line
            ]
            if stop.code == 0:
                counts["help"] += 1
            else:
                counts["refused"] += 1
                assert stop.code == 2 and [line.partition(" ")[0] for line in lines] == ["error:"], lines
                assert 8 < len(lines[0]) < 1500, lines[0]
        else:
            raise AssertionError("the work was done")
        assert time.monotonic() - start < SLOWEST
        assert tree() == before

    check()
    with capsys.disabled():
        if CASES:
            print(f"\n{script}: {counts}")
    assert counts["accepted"] and counts["refused"]
