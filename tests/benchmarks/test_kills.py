"""Three kills of every script, at random moments: nothing is lost, nothing half is taken for whole."""

import random
from dataclasses import replace

import kills
import pytest
from forked import Forked

EPISODES = {"record": 12, "eval": 12, "annotate": 2}
QUICK = ("--planner.order=free", "--planner.rounds=5", "--planner.switch_rounds=3", "--planner.restarts=1")


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    """A folder whose dataset the annotations begin with."""
    folder = tmp_path_factory.mktemp("kills")
    work = kills.recording(folder, EPISODES["annotate"])
    running = Forked((*work.options, f"--root={folder / 'demonstrations'}"), folder)
    assert running.wait(100) == 0, folder.with_name(f"{folder.name}.log").read_text()
    return folder


@pytest.mark.parametrize("name", list(EPISODES))
def test_three_kills_change_nothing(demonstrations, name):
    work = kills.WORKS[name](demonstrations, EPISODES[name])
    if name == "annotate":
        work = replace(work, options=(*work.options, *QUICK))
    row = kills.killed(name, work, demonstrations / name, 3, random.Random(0), Forked)
    assert (row.kills, row.lost, row.half, row.different) == (3, 0, 0, 0), row
    assert row.completed >= 1 and row.calls >= 4


class Replayed:
    """A script of which every call does the next of some steps, and is killed unless it is the last."""

    def __init__(self, steps):
        self.steps = iter(steps)

    def __call__(self, options, folder):
        step, self.status = next(self.steps)
        step(folder)
        self.pid = 0
        return self

    def wait(self, timeout):
        return self.status


def put(text):
    return lambda folder: (folder / "file").write_text(text)


def work_of_a_file():
    def whole(folder):
        return {"file": (folder / "file").read_text()} if (folder / "file").exists() else {}

    return kills.Work(
        ("nothing.py",),
        lambda folder: {name: text for name, text in whole(folder).items() if text != "part"},
        lambda folder: len(list(folder.iterdir())),
    )


@pytest.mark.parametrize(
    ("steps", "found"),
    [
        ([(put("whole"), 0), (put("part"), None), (put("part"), 0)], (0, 0, 1)),
        ([(put("whole"), 0), (put("part"), None), (put("whole"), 0)], (0, 0, 0)),
        ([(put("whole"), 0), (put("wh"), None), (put("whole"), 0)], (0, 1, 1)),
        ([(put("whole"), 0), (put("part"), None), (put("other"), 0)], (0, 0, 1)),
        (
            [
                (put("whole"), 0),
                (put("part"), None),
                (lambda folder: (folder / "file").unlink(), None),
                (put("whole"), 0),
            ],
            (1, 0, 0),
        ),
    ],
)
def test_what_is_lost_half_or_different_is_counted(tmp_path, monkeypatch, steps, found):
    monkeypatch.setattr("os.killpg", lambda *_: None)
    row = kills.killed("it", work_of_a_file(), tmp_path, len(steps) - 2, random.Random(0), Replayed(steps))
    assert (row.lost, row.half, row.different) == found


def test_a_script_that_fails_is_no_kill(tmp_path):
    with pytest.raises(ValueError, match="it ended with status 2: see"):
        steps = [(put("whole"), 0), (lambda _: None, 2)]
        kills.killed("it", work_of_a_file(), tmp_path, 1, random.Random(0), Replayed(steps))


@pytest.mark.parametrize(
    ("options", "message"),
    [({"kills": 0}, "kills is 0: give 1 or more"), ({"only": ["fly"]}, "only has 'fly': choose from record")],
)
def test_options_are_checked(options, message):
    with pytest.raises(ValueError, match=message):
        kills.KillsOptions(**options)
