"""Stock lerobot-eval counts the successes that eval.py counts."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from lerobot.scripts.lerobot_eval import eval_main

from tests.policy.lerobot.walking import WORLD, walking_policy

REPOSITORY = Path(__file__).parents[3]
SEED, EPISODES = 60, 10


def options(policy, output, world, **changes):
    """Of `lerobot-eval`."""
    world = {
        f"env.{name}": json.dumps(value) if isinstance(value, list) else value
        for name, value in world.items()
    }
    given = {
        "policy.path": policy,
        "env.discover_packages_path": "dpmacro.policy.lerobot",
        "env.type": "two_flags",
        **world,
        "eval.n_episodes": EPISODES,
        "eval.batch_size": 5,
        "eval.use_async_envs": "false",
        "seed": SEED,
        "output_dir": output,
        **changes,
    }
    return [f"--{name}={value}" for name, value in given.items()]


def results(output):
    info = json.loads((output / "eval_info.json").read_text())
    (task,) = info["per_task"]
    return info["overall"], task["metrics"]


def command(*words):
    quiet = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=300, check=False, env=quiet
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_successes_are_those_of_eval(tmp_path):
    """Both as commands; LeRobot discovers the policy and the world by one option."""
    policy = tmp_path / "policy"
    walking_policy().save(policy)
    command(Path(sys.executable).with_name("lerobot-eval"), *options(policy, tmp_path / "theirs", WORLD))
    given = [f"--policy.path={policy}", f"--episodes={EPISODES}", f"--seed={SEED}"]
    command(REPOSITORY / "eval.py", *given, f"--output_dir={tmp_path / 'ours'}")
    (overall, theirs), (_, ours) = results(tmp_path / "theirs"), results(tmp_path / "ours")
    assert theirs["successes"] == ours["successes"] and theirs["sum_rewards"] == ours["sum_rewards"]
    assert overall["pc_success"] == pytest.approx(100 * sum(ours["successes"]) / EPISODES)
    assert 0 < sum(ours["successes"]) < EPISODES and len(set(ours["sum_rewards"])) == 3


def test_a_policy_that_cannot_succeed_scores_nothing(tmp_path, monkeypatch):
    walking_policy(walks=False).save(tmp_path / "policy")
    short = {**WORLD, "max_steps": 6}
    given = options(
        tmp_path / "policy", tmp_path / "out", short, **{"eval.n_episodes": 3, "eval.batch_size": 2}
    )
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", *given])
    eval_main()
    overall, metrics = results(tmp_path / "out")
    assert metrics["successes"] == [False] * 3 and overall["pc_success"] == 0.0


def test_an_observation_that_the_policy_lacks_is_named(tmp_path, monkeypatch):
    """By its one line, which LeRobot lets through."""
    walking_policy().save(tmp_path / "policy")
    given = options(tmp_path / "policy", tmp_path / "out", {**WORLD, "max_steps": 6})
    rename = """--rename_map={"observation.images.avatar": "observation.images.top"}"""
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", *given, rename])
    with pytest.raises(
        ValueError, match=r"the policy sees observation\.images\.avatar, which is not among the "
    ):
        eval_main()
