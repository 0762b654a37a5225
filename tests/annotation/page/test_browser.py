"""A person at the page: keys pressed and cuts dragged in a browser, and the file that is saved."""

import json
import random
from itertools import pairwise

import numpy as np
import pytest

from dpmacro.annotation.page.shown import Curves, Shown, Truth
from dpmacro.annotation.page.write import write_page
from tests.annotation.page.conftest import settle
from tests.annotation.page.reading import coloured, some_stages
from tests.annotation.page.test_write import HOSTILE

NAMES = ("reach", "grasp", "carry")
EPISODES = (4, 7, 5)  # of 60, 40 and 50 frames; the last is the least sure and comes first


def some_shown(stages, **more):
    n_frames = len(stages.labels)
    lines = np.random.default_rng(0).normal(size=(n_frames, 3)).astype(np.float32)
    truth = Truth(stages.labels, tuple(f"true {name}" for name in stages.names), "phase")
    return Shown(truth, (Curves(lines, ("x", "y", "gripper")),), {"front": coloured, "top": coloured}, **more)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "page.html"
    stages = some_stages(names=NAMES, episodes=EPISODES)
    write_page(path, stages, "some set", some_shown(stages, facts={"policy": "a run"}))
    return path


def press(tab, *keys):
    for key in keys:
        tab.keyboard.press(key)
    settle(tab)


def saved(tab):
    """What the page saves, and under which name."""
    with tab.expect_download() as download:
        tab.keyboard.press("Control+s")
    found = json.loads(download.value.path().read_text(encoding="utf-8"))
    assert found["format"] == "dpmacro corrections 1"
    return found, download.value.suggested_filename


def status(tab):
    return tab.locator("#status").text_content()


def told(tab):
    return tab.locator("#strip").get_attribute("aria-valuetext")


def segments(*edges):
    """Of (first frame, label) and at the end the number of frames."""
    *runs, frames = edges
    ends = [start for start, _ in runs[1:]] + [frames]
    return [
        {"start": start, "end": end, "label": label} for (start, label), end in zip(runs, ends, strict=True)
    ]


def x_of(tab, frame, frames):
    box = tab.locator("#strip").bounding_box()
    return box["x"] + frame / frames * box["width"], box["y"] + 45


def test_a_page_opens_from_disk_with_what_needs_a_look_first(page, opened):
    with opened(page) as tab:
        assert tab.title() == "Stages of some set"
        rows = tab.locator(".demonstration")
        assert rows.locator(".number").all_text_contents() == ["5", "7", "4"]
        assert tab.locator("#editor-heading").text_content() == "Demonstration 5"
        assert told(tab) == "frame 0 of 50, 0.00 s, reach"
        tab.locator("#order").select_option("dataset")
        settle(tab)
        assert rows.locator(".number").all_text_contents() == ["4", "7", "5"]
        assert rows.nth(0).get_attribute("aria-selected") == "true"
        assert rows.nth(1).get_attribute("aria-label") == (
            "Demonstration 7, 40 frames, 3 parts, confidence 0.75"
        )
        assert tab.locator("#report").locator("dt, dd").all_text_contents() == ["policy", "a run"]


def test_keys_edit_and_the_file_says_what_was_edited(page, opened):
    with opened(page) as tab:
        press(
            tab, "n", "Enter", "ArrowRight", "ArrowRight", "Shift+ArrowRight", "Enter"
        )  # the cut at 17 to 29
        press(tab, "ArrowRight", "ArrowRight")
        assert told(tab) == "frame 31 of 50, 3.10 s, grasp"
        press(tab, "End", "Shift+ArrowLeft", "a", "2")  # a cut at 39, whose right part is grasp
        press(tab, "j", "n", "d")  # in demonstration 7 reach goes on over grasp
        found, name = saved(tab)
        assert name == "some_set-corrections.json"
        assert (found["dataset"], found["fps"], found["names"]) == ("some set", 10, list(NAMES))
        assert found["renamed"] == [[0, 0], [1, 1], [2, 2]]
        assert found["episodes"] == [
            {"episode": 7, "frames": 40, "segments": segments((0, 0), (27, 2), 40)},
            {"episode": 5, "frames": 50, "segments": segments((0, 0), (29, 1), (34, 2), (39, 1), 50)},
        ]
        assert tab.locator("#save").text_content() == "Save corrections (2)"
        assert "Saved some_set-corrections.json: 2 edited demonstrations" in status(tab)


def test_a_cut_is_dragged_no_farther_than_its_segments_reach(page, opened):
    with opened(page) as tab:
        x, y = x_of(tab, 17, 50)
        tab.mouse.move(x + 2, y)
        tab.mouse.down()
        tab.mouse.move(*x_of(tab, 10, 50), steps=5)
        settle(tab)
        assert told(tab).startswith("frame 10 of 50")
        tab.mouse.move(*x_of(tab, 12.2, 50), steps=3)
        tab.mouse.up()
        settle(tab)
        assert status(tab) == "Cut before frame 12."
        assert saved(tab)[0]["episodes"][0]["segments"] == segments((0, 0), (12, 1), (34, 2), 50)
        tab.mouse.move(*x_of(tab, 34, 50))
        tab.mouse.down()
        tab.mouse.move(*x_of(tab, 3, 50), steps=4)
        tab.mouse.up()
        settle(tab)
        assert saved(tab)[0]["episodes"][0]["segments"] == segments((0, 0), (12, 1), (13, 2), 50)
        press(tab, "u", "u")
        press(tab, "Control+s")
        assert status(tab) == "Nothing has been changed yet."


def test_undo_and_redo_go_step_by_step_and_a_held_cut_in_one(page, opened):
    with opened(page) as tab:
        press(tab, "n", "Enter", *["ArrowLeft"] * 5, "Enter", "j", "n", "d")
        press(tab, "u")
        assert tab.locator("#editor-heading").text_content() == "Demonstration 7"
        press(tab, "k", "j", "j", "u")
        assert tab.locator("#editor-heading").text_content() == "Demonstration 5", "what changes is shown"
        assert tab.locator("#undo").is_disabled() and not tab.locator("#redo").is_disabled()
        press(tab, "Control+y", "Shift+U")
        assert [row["episode"] for row in saved(tab)[0]["episodes"]] == [7, 5]
        press(tab, "Control+z", "Control+z", "Control+z")
        assert status(tab) == "There is nothing to undo."
        press(tab, "Home", "n", "Enter", "ArrowRight", "ArrowRight", "Escape")
        assert tab.locator("#redo").is_disabled(), "what was put back was never done"
        assert status(tab) == "Cut put back." and told(tab) == "frame 17 of 50, 1.70 s, grasp, at a cut"
        press(tab, "Control+s")
        assert status(tab) == "Nothing has been changed yet."


def test_stages_are_renamed_merged_and_added_everywhere(page, opened):
    with opened(page) as tab:
        field = tab.get_by_label("Name of stage 2")
        field.fill("close the gripper")
        field.press("Enter")
        found = saved(tab)[0]
        assert found["names"] == ["reach", "close the gripper", "carry"] and found["episodes"] == []
        field = tab.get_by_label("Name of stage 3")
        for refused, message in (
            ("reach", "Stage 1 is called reach already"),
            ("  ", "A stage needs a name."),
        ):
            field.fill(refused)
            field.press("Enter")
            settle(tab)
            assert message in status(tab) and field.input_value() == "carry"
        press(tab, "n", "d")
        tab.get_by_role("button", name="Merge reach into another stage").click()
        assert tab.locator("#merge-into option").all_text_contents() == ["2 close the gripper", "3 carry"]
        tab.locator("#merge-into").select_option("2")
        tab.get_by_role("button", name="Merge", exact=True).click()
        settle(tab)
        found = saved(tab)[0]
        assert found["names"] == ["close the gripper", "carry"]
        assert found["renamed"] == [[0, 1], [1, 0], [2, 1]]
        assert found["episodes"] == [{"episode": 5, "frames": 50, "segments": segments((0, 1), 50)}]
        tab.get_by_role("button", name="Add stage").click()
        tab.keyboard.type("wait")
        tab.keyboard.press("Enter")
        settle(tab)
        press(tab, "Home", "ArrowRight", "ArrowRight", "a", "3")
        found = saved(tab)[0]
        assert found["names"] == ["close the gripper", "carry", "wait"]
        assert found["renamed"] == [[0, 1], [1, 0], [2, 1]]
        assert found["episodes"][0]["segments"] == segments((0, 1), (2, 2), 50)
        press(tab, *["u"] * 7)
        press(tab, "Control+s")
        assert status(tab) == "Nothing has been changed yet."


def opened_file(tab, found):
    content = found if isinstance(found, bytes) else json.dumps(found).encode()
    tab.locator("#file").set_input_files(
        {"name": "c.json", "mimeType": "application/json", "buffer": content}
    )
    tab.locator("#status", has_text="c.json").wait_for()
    settle(tab)


def test_a_saved_file_is_opened_to_go_on(page, opened):
    with opened(page) as tab:
        press(tab, "n", "n", "d", "j", "n", "Enter", "ArrowLeft", "Enter")
        tab.get_by_role("button", name="Merge reach into another stage").click()
        tab.get_by_role("button", name="Merge", exact=True).click()
        tab.get_by_role("button", name="Add stage").click()
        tab.keyboard.press("Enter")
        press(tab, "End", "ArrowLeft", "a", "3")
        before = saved(tab)[0]
        assert before["names"] == ["grasp", "carry", "stage 3"] and len(before["episodes"]) == 2
    with opened(page) as tab:
        opened_file(tab, before)
        assert saved(tab)[0] == before
        press(tab, "u", "Control+s")
        assert status(tab) == "Nothing has been changed yet."
        for spoiled, message in (
            (b"{", "c.json was not opened: "),
            ({**before, "format": "other"}, 'it is not of the format "dpmacro corrections 1".'),
            ({**before, "dataset": "other"}, "it is of the dataset other, this page of some set."),
            ({**before, "names": ["a", "a", "b"]}, "two of its stages have one name."),
            ({**before, "names": []}, "it has no names of stages."),
            ({**before, "renamed": [[0, 0]]}, "it is of 1 stages, this page of 3."),
            ({**before, "renamed": [[0, 0], [1, 1], [2, 9]]}, "its stages are not those of this page."),
            ({**before, "episodes": None}, "it has no list of episodes."),
            (
                {**before, "episodes": [{"episode": 99, "frames": 3, "segments": []}]},
                "its episode 99 is not of this page.",
            ),
            (
                {**before, "episodes": [{"episode": 5, "frames": 50, "segments": segments((1, 0), 50)}]},
                "its episode 5 is not covered by segments.",
            ),
        ):
            tab.evaluate("document.getElementById('status').textContent = ''")
            opened_file(tab, spoiled)
            assert message in status(tab)
            press(tab, "Control+s")
            assert status(tab) == "Nothing has been changed yet."


def test_the_merge_can_be_cancelled(page, opened):
    with opened(page) as tab:
        for way in ("Cancel", "Escape"):
            tab.get_by_role("button", name="Merge grasp into another stage").click()
            if way == "Cancel":
                tab.get_by_role("button", name="Cancel").click()
            else:
                tab.keyboard.press("Escape")
            press(tab, "Control+s")
            assert status(tab) == "Nothing has been changed yet."


def test_typing_a_name_is_no_command(page, opened):
    with opened(page) as tab:
        field = tab.get_by_label("Name of stage 1")
        field.fill("")
        field.press_sequentially("a dark 2 nap")
        field.press("Enter")
        found = saved(tab)[0]
        assert found["names"][0] == "a dark 2 nap" and found["episodes"] == []


def test_any_keys_leave_segments_that_cover_the_demonstration(page, opened):
    keys = [
        "n",
        "p",
        "a",
        "d",
        "1",
        "2",
        "3",
        "j",
        "k",
        "Enter",
        "Escape",
        "u",
        "Shift+U",
        "+",
        "-",
        "0",
        "l",
    ]
    keys += [f"{shift}{arrow}" for shift in ("", "Shift+") for arrow in ("ArrowLeft", "ArrowRight")] * 4
    draws = random.Random(0)
    with opened(page) as tab:
        tab.locator("#strip").focus()
        for _ in range(2):
            press(tab, *draws.choices(keys, k=120), "a", "3", "ArrowRight", "a", "1")
            found = saved(tab)[0]
            assert found["episodes"]
            for row in found["episodes"]:
                own = row["segments"]
                assert own[0]["start"] == 0 and own[-1]["end"] == row["frames"]
                for one, following in pairwise(own):
                    assert one["end"] == following["start"] and one["label"] != following["label"]
                assert all(one["start"] < one["end"] and 0 <= one["label"] < 3 for one in own)
        for _ in range(400):
            if status(tab) == "There is nothing to undo.":
                break
            tab.keyboard.press("u")
        press(tab, "Control+s")
        assert status(tab) == "Nothing has been changed yet."


def test_what_is_typed_in_names_stays_text(tmp_path, opened):
    stages, path = some_stages(names=HOSTILE), tmp_path / "page.html"
    write_page(path, stages, HOSTILE[0], some_shown(stages, reasons=HOSTILE, facts={HOSTILE[0]: HOSTILE[1]}))
    with opened(path) as tab:
        assert tab.title() == f"Stages of {HOSTILE[0]}"
        assert [tab.get_by_label(f"Name of stage {k}").input_value() for k in (1, 2, 3)] == list(HOSTILE)
        assert not tab.locator("img").count() and tab.locator("script").count() == 2
        press(tab, "n", "d")
        found, name = saved(tab)
        assert found["names"] == list(HOSTILE) and found["dataset"] == HOSTILE[0]
        assert "/" not in name and "<" not in name


def test_every_camera_shows_the_frame_under_the_cursor(page, opened):
    colour = """(canvas) => {
      const copy = new OffscreenCanvas(32, 24).getContext("2d", { willReadFrequently: true });
      copy.drawImage(canvas, 0, 0);
      return [...copy.getImageData(16, 12, 1, 1).data].slice(0, 3);
    }"""
    with opened(page) as tab:
        for keys, frame in (((), 100), (("PageDown",), 110), (("j", "End"), 99), (("k", "End"), 149)):
            tab.locator("#strip").focus()
            press(tab, *keys)
            tab.locator("#cameras canvas[width='32']").first.wait_for()
            tab.wait_for_timeout(100)  # a sheet is decoded
            settle(tab)
            (wanted,) = coloured(np.array([frame]))
            for canvas in tab.locator("#cameras canvas").all():
                assert np.abs(np.array(canvas.evaluate(colour)) - wanted[0, 0]).max() < 8
        assert tab.locator("#cameras figcaption").all_text_contents() == ["front, frame 49", "top, frame 49"]
        row = tab.locator("#row-0 canvas").bounding_box()  # the mouse shows other demonstrations' frames
        tab.mouse.move(row["x"] + row["width"] * 0.5, row["y"] + 5)
        settle(tab)
        assert tab.locator("#editor-heading").text_content() == "Demonstration 4"
        assert tab.locator("#readout").text_content().startswith("frame30 of 60")
        tab.mouse.click(row["x"] + row["width"] * 0.5, row["y"] + 5)
        settle(tab)
        assert told(tab) == "frame 30 of 60, 3.00 s, grasp"


def test_lines_are_drawn_on_demand(page, opened):
    with opened(page) as tab:
        assert not tab.locator("#plot").is_visible()
        press(tab, "l")
        assert tab.locator("#plot").bounding_box()["height"] == 3 * 38
        tab.get_by_label("gripper").uncheck()
        settle(tab)
        assert tab.locator("#plot").bounding_box()["height"] == 2 * 38
        assert tab.locator("#lines").get_attribute("aria-expanded") == "true"


def test_the_view_zooms_and_follows_the_cursor(page, opened):
    with opened(page) as tab:
        before = tab.locator("#strip").screenshot()
        press(tab, "n", "+", "+", "End")
        x, y = x_of(tab, 49, 50)
        tab.mouse.click(x - 5, y)
        settle(tab)
        assert told(tab).startswith("frame 49 "), "the end is in view"
        press(tab, "0", "p", "p", "Home")
        tab.mouse.move(5, 5)
        tab.evaluate("document.activeElement.blur()")
        settle(tab)
        tab.locator("#strip").focus()
        press(tab, "Home")
        tab.evaluate("document.activeElement.blur()")
        settle(tab)
        assert tab.locator("#strip").screenshot() == before


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [320, 360, 1280])
def test_nothing_is_wider_than_the_screen(scheme, width, page, opened):
    with opened(page, width, 640, color_scheme=scheme) as tab:
        press(tab, "n", "l")
        for opening, closing in (("Shift+?", "Escape"), (None, None)):
            if opening:
                press(tab, opening)
                assert tab.locator("#keys").is_visible()
            assert tab.evaluate("document.documentElement.scrollWidth") <= width
            if closing:
                press(tab, closing)
        ground = tab.evaluate("getComputedStyle(document.body).backgroundColor")
        dark = sum(map(int, ground[4:-1].split(","))) < 3 * 64
        assert dark == (scheme == "dark")
        for name in ("#save", "#add-cut", "#delete-cut", "#undo"):
            box = tab.locator(name).bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= width


def test_a_theme_that_changes_is_drawn_anew(page, opened):
    with opened(page, color_scheme="light") as tab:
        light = tab.locator("#strip").screenshot()
        tab.emulate_media(color_scheme="dark")
        settle(tab)
        assert tab.locator("#strip").screenshot() != light


def test_the_focus_is_seen_and_the_keys_are_reached_without_a_mouse(page, opened):
    with opened(page) as tab:
        reached = []
        for _ in range(40):
            press(tab, "Tab")
            seen = tab.evaluate(
                "[document.activeElement.id, getComputedStyle(document.activeElement).outlineStyle]"
            )
            if tab.evaluate("document.activeElement === document.body"):
                break
            assert seen[1] != "none", seen
            reached.append(seen[0])
        assert {"save", "strip", "list", "order", "add-cut"} <= set(reached)
        assert tab.locator("#strip").get_attribute("role") == "slider"
        assert tab.locator("#status").get_attribute("aria-live") == "polite"
        tab.locator("#list").focus()
        press(tab, "ArrowDown")
        assert tab.locator("#list").get_attribute("aria-activedescendant") == "row-1"
        press(tab, "?")
        tab.get_by_label("Single keys act wherever").uncheck()
        press(tab, "Escape", "Tab")
        tab.evaluate("document.activeElement.blur()")
        press(tab, "n", "d", "Control+s")
        assert status(tab) == "Nothing has been changed yet."


def test_leaving_with_unsaved_changes_asks(page, opened):
    with opened(page) as tab:
        asked = []
        tab.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.accept()))
        tab.reload()
        assert not asked
        press(tab, "n", "d")
        tab.reload()
        assert asked == ["beforeunload"]
        press(tab, "n", "d")
        saved(tab)
        tab.reload()
        assert asked == ["beforeunload"]


@pytest.mark.parametrize("lengths", [[300] * 100, [20_000], [30] * 3000], ids=["many", "long", "very many"])
def test_much_data_is_drawn_at_once(lengths, tmp_path, opened):
    path, stages = tmp_path / "page.html", some_stages(lengths, NAMES)
    lines = np.random.default_rng(0).normal(size=(len(stages.labels), 6))
    truth = Truth(stages.labels, NAMES)
    write_page(path, stages, "much", Shown(truth, (Curves(lines, tuple("abcdef")),)))
    with opened(path) as tab:
        press(tab, "l", "n", "Enter")
        assert 0 < tab.locator(".demonstration").count() < 20, "rows out of sight do not exist"
        taken = tab.evaluate(
            """async () => {
              const begun = performance.now();
              for (let k = 0; k < 20; k++) {
                const key = new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true });
                document.activeElement.dispatchEvent(key);
                await new Promise(requestAnimationFrame);
              }
              return (performance.now() - begun) / 20;
            }"""
        )
        assert taken < 250, "milliseconds a key, on a slow and busy machine"
        assert len(saved(tab)[0]["episodes"]) == 1
        tab.locator("#list").evaluate("(list) => { list.scrollTop = list.scrollHeight / 2; }")
        settle(tab)
        assert tab.locator(".demonstration").count() < 20
