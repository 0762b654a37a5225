"""What a number of runs amounts to: text, LeRobot's eval_info.json, TensorBoard scalars."""

from dataclasses import replace

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from dpmacro.evaluation.summary import clipped_share, eval_info, run_notes, run_text, write_scalars
from dpmacro.metrics.success import success_summary
from dpmacro.worlds.base import NO_PHASE, Episode

OUTCOMES = ["success", "red_first", "red_never_reached", "red_first"]
CAUSES = ["", "red_in_the_way", "change_missed", "red_in_the_way"]


def episodes():
    """Four runs; those that got past blue were rewarded on step 1, the first one changed on step 2."""
    return [
        Episode(
            seed=10 + number,
            outcome=outcome,
            actions=np.zeros(3, np.uint8),
            phases=np.array([0, 0, blue], np.int8),
            macros=np.array([0, 0, number == 0], np.int8),
            rewards=np.array([0, blue, outcome == "success"], np.float32),
            loop=2 * (outcome == "red_never_reached"),
        )
        for number, (outcome, blue) in enumerate(zip(OUTCOMES, [1, 0, 1, 0], strict=True))
    ]


def test_the_text_counts_endings_causes_and_loops():
    summary = success_summary(OUTCOMES, [1, 0, 1, 0], [1, 0, 0, -1])
    lines = [" ".join(line.split()) for line in run_text(summary, 8.0, CAUSES, 1).splitlines()]
    assert lines == [
        "successes 1 of 4 runs",
        "rate 25.0%, 95% Wilson interval 4.6% to 69.9%",
        "time 8.0 s, 2.00 s a run",
        "failures 3",
        *lines[4:7],
        "causes",
        "2 red in the way",
        "1 change missed",
        "loops 1 of the failures repeat themselves for ever",
    ]
    assert sorted(lines[4:7]) == [
        "1 red first in phase 0",
        "1 red first in phase 0, macro-action 0",
        "1 red never reached in phase 1, macro-action 0",
    ]


def test_without_a_failure_no_cause_is_told():
    text = run_text(success_summary(["success"], [1], [1]), 1.0, [""], 0)
    assert "causes" not in text and "loops" not in text and "failures    0" in text


def test_a_world_without_phases_has_none_in_the_text():
    summary = success_summary(["out_of_time", "ended"], [NO_PHASE, NO_PHASE], [2, -1])
    text = run_text(summary, 1.0, ["no_motion", "ended"], 0)
    assert "phase" not in text
    assert "      1     out of time         , macro-action 2\n      1     ended\ncauses" in text


def test_notes_say_what_told_success_and_how_much_was_clipped():
    classes = episodes()
    assert run_notes(classes) == []
    signs = ['info["success"]', "rewards of 3 or more in sum"]
    vectors = [
        replace(episode, actions=np.zeros((3, 2), np.float32), clipped=clipped, success_by=sign)
        for episode, clipped, sign in zip(classes[:2], (0, 2), signs, strict=True)
    ]
    assert clipped_share(vectors) == 2 / 6
    assert run_notes(vectors) == [
        'told by     info["success"] and rewards of 3 or more in sum',
        "clipped     33.3% of steps had an action beyond what the world takes",
    ]


def test_the_information_is_lerobots_with_a_section_of_our_own():
    summary = success_summary(OUTCOMES, [1, 0, 1, 0], [1, 0, 0, 0])
    info = eval_info(
        "World-v0", episodes(), summary, CAUSES, {"blue_steps": [1, None, 1, None]}, 8.0, ["a.mp4"]
    )
    assert info["overall"] == {
        "avg_sum_reward": 0.75,
        "avg_max_reward": 0.5,
        "pc_success": 25.0,
        "n_episodes": 4,
        "video_paths": ["a.mp4"],
        "eval_s": 8.0,
        "eval_ep_s": 2.0,
    }
    assert info["per_task"][0]["task_group"] == "World-v0" and list(info["per_group"]) == ["World-v0"]
    assert info["per_task"][0]["metrics"]["successes"] == [True, False, False, False]
    ours = info["dpmacro"]
    assert ours["seeds"] == [10, 11, 12, 13] and ours["causes"] == CAUSES
    assert ours["blue_steps"] == [1, None, 1, None] and ours["first_changes"] == [2, None, None, None]
    assert ours["loops"] == [0, 0, 2, 0] and ours["last_macros"] == [1, 0, 0, 0]


def test_the_overall_numbers_become_scalars(tmp_path):
    write_scalars({"pc_success": 25.0, "n_episodes": 4, "video_paths": ["a.mp4"]}, tmp_path)
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    assert sorted(events.Tags()["scalars"]) == ["eval/n_episodes", "eval/pc_success"]
    assert events.Scalars("eval/pc_success")[0].value == 25.0
