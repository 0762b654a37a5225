"""LeRobot's ACT beside dpmacro: its data, its training, its runs, and the script as a user starts it."""

import json
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from noise import ACTIONS, LENGTHS, random_episodes, write

from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.features.encoders.pixels import Pixels
from dpmacro.features.quantising import Quantiser
from dpmacro.metrics.success import wilson_interval
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils import cli
from dpmacro.worlds.two_flags.diagnosis import OUTCOMES

ROOT = Path(__file__).parents[2]
WORLD = {"id": "TwoFlags-v0", "flags": "fixed", "layout_seed": 3, "max_steps": 12, "render_size": [64, 48]}
COLOURS = 255 * np.eye(3, dtype=np.uint8)
CHUNK = 4
STEPS = 25


@pytest.fixture(scope="module", autouse=True)
def modules():
    """Importable as the script imports them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        yield


@pytest.fixture(scope="module")
def coloured(tmp_path_factory):
    """A dataset in which an episode shows one colour, red, green or blue, and holds one action."""
    episodes = list(random_episodes())
    for action, episode in zip((0, 1, 2, 2), episodes, strict=True):
        episode["actions"][:], episode["images"][:] = action, COLOURS[action]
    return write(tmp_path_factory.mktemp("coloured") / "two_flags", episodes, WORLD)


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A policy of dpmacro that acts at random stumps' word."""
    generator = torch.Generator().manual_seed(0)
    stumps = StumpClassifier(
        torch.randint(18432, (4, 1), generator=generator),
        torch.randint(256, (4, 1), generator=generator).to(torch.uint8),
        torch.randn(4, 1, 2, 3, generator=generator),
    )
    pixels, inputs = Pixels.all("observation.image", 48, 64), {"observation.image": InputConfig((48, 64, 3))}
    config = PolicyConfig("baseline", 1, (0,), inputs, pixels.spec(), ACTIONS, 3, world=WORLD)
    cuts = torch.arange(255, dtype=torch.int32).repeat(18432, 1)
    folder = tmp_path_factory.mktemp("policy")
    MacroPolicy.compact(config, pixels, Quantiser(cuts), stumps, None).save(folder)
    return folder


def call(monkeypatch, *options):
    import act_peer

    monkeypatch.setattr(sys, "argv", ["act_peer.py", *map(str, options)])
    cli.run(act_peer.main, act_peer.PeerOptions)


@pytest.fixture(scope="module")
def trained(coloured, policy, tmp_path_factory):
    """The folder of an ACT that can tell the colours, and the results of it and a policy of dpmacro."""
    output = tmp_path_factory.mktemp("act")
    training = [f"--steps={STEPS}", "--train.dim_model=64", f"--train.chunk_size={CHUNK}"]
    runs = ["--episodes=3", "--validation=1", "--workers=1", "--seed=7", "--timed=5", f"--policy={policy}"]
    files = [f"--dataset={coloured}", f"--output_dir={output}", f"--output={output / 'act.json'}"]
    with pytest.MonkeyPatch.context() as patch:
        call(patch, *training, *runs, *files)
    return output / "pretrained_model", json.loads((output / "act.json").read_text())


def test_chunks_are_what_lerobots_dataset_gives(recorded):
    from act_chunks import ACTION, IMAGE, PADDED, Chunks
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    deltas = {ACTION: [step / 30 for step in range(CHUNK)]}
    dataset = LeRobotDataset("two_flags", root=recorded, delta_timestamps=deltas)
    chunks = Chunks(Demonstrations.load(recorded), CHUNK)
    assert len(chunks) == len(dataset) == sum(LENGTHS)
    batch = chunks.batch(torch.arange(len(chunks)))
    for frame in range(len(dataset)):
        item = dataset[frame]
        for name in (IMAGE, ACTION, PADDED):
            assert torch.equal(batch[name][frame], item[name]), (name, frame)


def test_statistics_are_those_of_all_pixels_and_actions(recorded):
    from act_chunks import ACTION, IMAGE, Chunks

    chunks = Chunks(Demonstrations.load(recorded), CHUNK)
    found, pixels = chunks.statistics(), chunks.images.double() / 255
    assert found[IMAGE]["mean"].shape == (3, 1, 1)
    for name, value in (("mean", pixels.mean((0, 1, 2))), ("std", pixels.std((0, 1, 2)))):
        torch.testing.assert_close(found[IMAGE][name].flatten().double(), value, atol=1e-5, rtol=0)
    assert found[ACTION]["mean"].sum() == pytest.approx(1)


def test_every_frame_is_learned_from_once_before_any_is_again(recorded):
    from act_chunks import IMAGE, Chunks

    chunks = Chunks(Demonstrations.load(recorded), CHUNK)
    drawn = chunks.batches(8, torch.Generator().manual_seed(0))
    for _ in range(2):
        seen = torch.cat([next(drawn)[IMAGE] for _ in range(4)])  # 8, 8, 8 and 6 of 30
        assert len(seen) == len(seen.flatten(1).unique(dim=0)) == sum(LENGTHS)


@pytest.mark.benchmark
def test_training_learns_what_the_images_tell(trained):
    _, found = trained
    training = found["training"]
    assert training["errors"][-1] < 0.7 * training["errors"][0]
    assert training["agreement"] > 0.9  # no action's share is above 0.4
    assert (training["steps"], training["batch_size"], training["chunk_size"]) == (STEPS, 8, CHUNK)
    assert (training["demonstrations"], training["frames"]) == (len(LENGTHS), sum(LENGTHS))
    assert 0 < training["cpu_seconds"] < 1.1 * os.cpu_count() * training["seconds"] + 1
    assert training["steps_per_second"] == pytest.approx(STEPS / training["seconds"])


def test_training_ends_when_its_time_is_over(coloured):
    from act_training import ActOptions, train

    demonstrations = Demonstrations.load(coloured)
    options = ActOptions(chunk_size=CHUNK, dim_model=16)
    # The clock has run for 100 s already: the step under way is the last.
    facts = train(demonstrations, options, time.perf_counter() - 100, 100, None).facts
    assert facts["steps"] == 1 and facts["seconds"] > 100


@pytest.mark.benchmark
def test_results_hold_runs_and_times(trained):
    _, found = trained
    act, ours = found["planners"]
    assert found["seeds"] == [7, 9]
    for planner in (act, ours):
        assert len(planner["runs"]) == planner["n"] == 3
        assert list(planner["outcomes"]) == list(OUTCOMES) and sum(planner["outcomes"].values()) == 3
        assert all(planner["runs"].count(outcome) == count for outcome, count in planner["outcomes"].items())
        assert planner["interval"] == list(wilson_interval(planner["successes"], 3))
        assert planner["milliseconds"].keys() >= {"1 thread", "runs"}
        assert all(took["mean"] > 0 and took["p95"] > 0 for took in planner["milliseconds"].values())
    assert ours["planner"] == "dpmacro" and act["planner"].startswith("ACT")
    assert "look, 1 thread" in act["milliseconds"]
    assert found["training"]["parameters"] <= act["stored_numbers"]
    assert act["action_steps"] in (1, CHUNK)
    assert found["validation"]["successes"].keys() == {"1", str(CHUNK)}
    assert found["validation"]["seeds"] == [5000, 5000]


@pytest.mark.benchmark
def test_actions_come_from_the_last_look(trained):
    from act_chunks import IMAGE, STATE
    from act_training import ActPlanner

    folder, _ = trained
    images = np.broadcast_to(COLOURS[:, None, None], (3, 48, 64, 3)).copy()
    looking, resting = ActPlanner(folder, 1), ActPlanner(folder, CHUNK)
    looking.reset(None)
    resting.reset(None)
    assert [looking.act({"pixels": image}, {}) for image in images] == [0, 1, 2]  # colour k shows action k
    red = {IMAGE: torch.from_numpy(images[0]).movedim(-1, 0) / 255, STATE: torch.zeros(0)}
    predicted = resting.after(resting.policy.predict_action_chunk(resting.before(red)))[0].argmax(1).tolist()
    # Other colours are not looked at before the chunk is used up, or an episode begins.
    assert [resting.act({"pixels": images[k]}, {}) for k in (0, 1, 2, 1)] == predicted
    assert resting.act({"pixels": images[2]}, {}) == 2
    resting.reset(None)
    assert resting.act({"pixels": images[1]}, {}) == 1


@pytest.mark.parametrize(("successes", "best"), [((2, 1), 20), ((1, 2), 1), ((0, 0), 20)])
def test_more_successes_choose_and_equals_leave_lerobots_default(monkeypatch, successes, best):
    import act_peer
    from act_runs import Run

    def run_all(name, source, world, seeds, workers):
        count = dict(zip((20, 1), successes, strict=True))[source.action_steps]
        endings = ["success"] * count + ["red_first"] * (len(seeds) - count)
        return [Run(seed, ending, np.ones(1)) for seed, ending in zip(seeds, endings, strict=True)]

    monkeypatch.setattr(act_peer, "run_all", run_all)
    options = act_peer.PeerOptions(act=Path("somewhere"), validation=3)
    steps, told = act_peer.choose(Path("somewhere"), {"chunk_size": 20, "world": WORLD}, options)
    assert steps == best and told["successes"] == {20: successes[0], 1: successes[1]}


@pytest.mark.benchmark
def test_a_saved_act_runs_again_in_processes(trained, monkeypatch, tmp_path, capsys):
    folder, found = trained
    steps, output = found["planners"][0]["action_steps"], tmp_path / "made" / "again.json"
    what = [f"--act={folder}", f"--action_steps={steps}", f"--output={output}", "--timed=1"]
    call(monkeypatch, *what, "--episodes=3", "--workers=2", "--seed=7")
    again, printed = json.loads(output.read_text()), capsys.readouterr()
    (act,) = again["planners"]
    assert act["runs"] == found["planners"][0]["runs"] and again["training"] == found["training"]
    assert act["workers"] == 2 and act["milliseconds"]["runs"]["mean"] > 0
    assert printed.out.startswith("commit") and f"{act['successes']} of 3 succeed" in printed.out
    assert "3/3" in printed.err and "training" not in printed.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--minutes=0"], "minutes is 0.0: give more than 0"),
        (["--workers=0"], "workers is 0: give 1 or more"),
        (["--seed=-1"], "seed is -1: give 0 or more"),
        (["--train.batch_size=0"], "train.batch_size is 0: give 1 or more"),
        (["--train.dim_model=20"], "train.dim_model is 20: give a multiple of 16"),
        (["--action_steps=21"], "action_steps is 21: ACT predicts train.chunk_size=20"),
        (["--dataset=nowhere"], "nowhere"),
        (["--act=nowhere"], "nowhere holds no training.json"),
        (["--policy=nowhere"], "nowhere"),
    ],
)
def test_a_mistake_is_one_line(monkeypatch, tmp_path, capsys, options, message):
    with pytest.raises(SystemExit) as ended:
        call(monkeypatch, f"--output_dir={tmp_path}", *options)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and message in line


def test_a_trained_act_is_not_overwritten(monkeypatch, tmp_path, capsys):
    (tmp_path / "pretrained_model").mkdir()
    with pytest.raises(SystemExit):
        call(monkeypatch, f"--output_dir={tmp_path}")
    assert "already holds a pretrained_model: give another --output_dir, or --act=" in capsys.readouterr().err


@pytest.mark.benchmark
def test_more_actions_than_a_saved_act_predicts(trained, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        call(monkeypatch, f"--act={trained[0]}", f"--action_steps={CHUNK + 1}")
    assert f"action_steps is {CHUNK + 1}: {trained[0]} predicts {CHUNK}" in capsys.readouterr().err
