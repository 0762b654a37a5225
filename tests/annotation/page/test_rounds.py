"""Corrections of several rounds: what was corrected earlier is on the page, and in what it saves."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from noise import AVATAR
from segmented import random_policy

from dpmacro.annotation.corrections import Corrections
from dpmacro.annotation.exports.labelling import read_labels
from dpmacro.annotation.page.shown import Shown
from dpmacro.annotation.page.write import write_page
from dpmacro.utils import cli
from dpmacro.worlds.two_flags.env import ACTIONS
from tests.annotation.page.reading import some_stages
from tests.annotation.page.test_browser import NAMES, press, saved, segments, status, told

SCRIPT = Path(__file__).parents[3] / "datasets/annotate.py"
EPISODES = (4, 7, 5)  # of 60, 40 and 50 frames


def corrections(*episodes, names=NAMES, renamed=(0, 1, 2)):
    return {
        "format": "dpmacro corrections 1",
        "dataset": "some set",
        "fps": 10,
        "names": list(names),
        "renamed": [[old, new] for old, new in enumerate(renamed)],
        "episodes": list(episodes),
    }


def of_episode(number, *edges):
    return {"episode": number, "frames": edges[-1], "segments": segments(*edges)}


@pytest.fixture
def page(tmp_path):
    """A page with what a file says already."""

    def written(content, suffix=".json"):
        file, path = tmp_path / f"earlier{suffix}", tmp_path / "page.html"
        file.write_text(content if suffix == ".csv" else json.dumps(content))
        stages = some_stages(names=NAMES, episodes=EPISODES)
        earlier = Corrections.load(file).of_stages(stages)
        write_page(path, stages, "some set", Shown(corrections=earlier))
        return path

    return written


EARLIER = corrections(
    of_episode(5, (0, 1), (20, 0), 50),
    names=("approach", "grasp"),
    renamed=(0, 1, 0),  # carry was merged into reach, which was renamed
)


def test_a_page_opens_with_what_was_corrected_earlier_and_saves_it_again(page, opened):
    with opened(page(EARLIER)) as tab:
        assert tab.locator("#save").text_content() == "Save corrections (1)"
        rows = tab.locator(".demonstration")
        assert rows.locator(".number").all_text_contents() == ["7", "4", "5"], "it needs no look any more"
        assert rows.nth(2).locator(".meta").text_content() == "edited · 2 parts"
        assert saved(tab)[0] == EARLIER, "nothing is lost where nothing is added"
        press(tab, "n", "Enter", "ArrowRight", "Enter")  # in demonstration 7 the cut at 14 to 15
        found = saved(tab)[0]
        assert found == {
            **EARLIER,
            "episodes": [of_episode(7, (0, 0), (15, 1), (27, 0), 40), *EARLIER["episodes"]],
        }
        press(tab, "j", "j")
        assert told(tab) == "frame 0 of 50, 0.00 s, grasp"
        assert "a person, earlier" in tab.locator("#readout").text_content()
        press(tab, "n", "Enter", "ArrowRight", "Enter")
        assert "a person, earlier" not in tab.locator("#readout").text_content()
        assert saved(tab)[0]["episodes"][1] == of_episode(5, (0, 1), (21, 0), 50)


def test_what_was_corrected_earlier_can_be_taken_back(page, opened):
    with opened(page(EARLIER)) as tab:
        press(tab, "j", "j", "f")
        assert status(tab) == "Demonstration 5 is as it was found again."
        assert told(tab) == "frame 0 of 50, 0.00 s, approach"
        assert saved(tab)[0] == {**EARLIER, "episodes": []}, "names and mergers stay"
        press(tab, "f")
        assert status(tab) == "Demonstration 5 is as it was found."
        press(tab, "u")
        assert saved(tab)[0] == EARLIER
        press(tab, "u")
        assert status(tab).startswith("Undone: all corrections made earlier are left out.")
        assert saved(tab)[0] == corrections(), "a file that corrects nothing"
        press(tab, "u")
        assert status(tab) == "There is nothing to undo."
        press(tab, "U")
        assert saved(tab)[0] == EARLIER


def test_a_demonstration_that_is_right_as_it_was_found_stays_in_the_file(page, opened):
    """A policy that learned from corrections says the same by itself: they must not go for that."""
    earlier = corrections(of_episode(7, (0, 0), (14, 1), (27, 2), 40))
    with opened(page(earlier)) as tab:
        assert tab.locator("#save").text_content() == "Save corrections (1)"
        press(tab, "n", "d")
        found = [one["episode"] for one in saved(tab)[0]["episodes"]]
        assert found == [7, 5]


def test_a_table_becomes_part_of_the_file(page, opened):
    table = "episode,start_frame,end_frame,label\n7,0,30,carry\n7,30,40,wait\n"
    with opened(page(table, ".csv")) as tab:
        found = saved(tab)[0]
        assert found["names"] == [*NAMES, "wait"]
        assert found["episodes"] == [of_episode(7, (0, 2), (30, 3), 40)]


def test_merging_keeps_what_was_corrected_earlier(page, opened):
    earlier = corrections(of_episode(7, (0, 0), (14, 1), (27, 2), 40))
    with opened(page(earlier)) as tab:
        tab.get_by_role("button", name="Merge reach into another stage").click()
        tab.get_by_role("button", name="Merge", exact=True).click()
        found = saved(tab)[0]
        assert found["names"] == ["grasp", "carry"]
        assert found["episodes"] == [of_episode(7, (0, 0), (27, 1), 40)]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("annotate_rounds", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_two_rounds_of_corrections_are_in_the_third_dataset(script, recorded, tmp_path, monkeypatch, opened):
    """Annotate -> edit -> save -> annotate -> edit another one -> save -> annotate: both are as edited."""
    monkeypatch.setattr(script, "pictures", lambda *_: iter(()))
    random_policy("pixels", 2, (48, 64), ACTIONS, (AVATAR,)).save(tmp_path / "policy")

    def annotate(number, *more):
        out, pages = tmp_path / f"out{number}", tmp_path / f"page{number}"
        options = [f"--policy.path={tmp_path / 'policy'}", f"--dataset.root={recorded}", "--names=[a, b]"]
        options += [f"--output={out}", f"--output_dir={pages}", "--formats=[csv]", *more]
        monkeypatch.setattr(sys, "argv", ["annotate.py", *options])
        cli.run(script.main, script.AnnotateOptions)
        return read_labels(out), pages / "segmentation.html"

    def edited(path, episode, number):
        file = tmp_path / f"corrections{number}.json"
        with opened(path) as tab:
            tab.locator("#order").select_option("dataset")
            tab.locator("#strip").focus()
            press(tab, *["j"] * episode)
            for _ in range(20):  # one part, then two
                press(tab, "Home", "n", "d")
            press(tab, "Home", "ArrowRight", "ArrowRight", "ArrowRight", "a", "1", "Home", "2")
            file.write_text(json.dumps(saved(tab)[0]))
        return file

    first, path = annotate(1)
    file = edited(path, 0, 1)
    second, path = annotate(2, f"--corrections={file}")
    file = edited(path, 3, 2)
    assert [one["episode"] for one in json.loads(file.read_text())["episodes"]] == [0, 3]
    third, _ = annotate(3, f"--corrections={file}")
    for stages, by_person in ((second, (0,)), (third, (0, 3))):
        for episode, part in enumerate(stages.trajectories):
            length = part.stop - part.start
            wanted = [1] * 3 + [0] * (length - 3) if episode in by_person else first.labels[part].tolist()
            assert stages.labels[part].tolist() == wanted
            assert stages.corrected[part].tolist() == [episode in by_person] * length
            assert episode not in by_person or np.all(stages.confidence[part] == 1)
