"""A policy of dpmacro in LeRobot's own Meta-World, by stock lerobot-eval.

    python benchmarks/lerobot_metaworld.py --demonstrations=5 --episodes=2

LeRobot's environment shows pictures of 480x480 and four numbers, of the hand and the gripper. It
does not show the state of the objects. Its scripted expert knows that state, and is recorded in it. train.py
learns from what the environment shows, and lerobot-eval runs the policy. What exists in `output_dir` is used
again, so that a stopped run goes on. Pictures take most of the time: up to half a second a step on a CPU.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import trange

from dpmacro.data.lerobot.compat import create_dataset, quiet
from dpmacro.utils import cli

REPOSITORY = Path(__file__).parents[1]
FPS = 80
MAX_STEPS = 500
TRIES = 5  # runs per wanted demonstration before giving up


@dataclass
class Options:
    """Options of this comparison."""

    output_dir: Path = Path("outputs/lerobot_metaworld")
    """Folder for demonstrations, training and evaluation."""
    task: str = "pick-place-v3"
    """Name of the task in Meta-World."""
    demonstrations: int = 5
    """Successful runs of the expert to learn from."""
    episodes: int = 2
    """Runs of the policy."""
    seed: int = 1000
    """Seed of the first run of the policy; LeRobot 0.4 places the objects by no seed."""
    macros: int = 3
    """Number of macro-actions."""
    rounds: int = 300
    """Boosting rounds of the action classifiers."""

    def __post_init__(self) -> None:
        for name in ("demonstrations", "episodes", "macros", "rounds"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name}={getattr(self, name)}: it must be at least 1")


def main(options: Options) -> None:
    """Record, train and evaluate; print what LeRobot counted."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    demonstrations, training = options.output_dir / "demonstrations", options.output_dir / "train"
    if not (demonstrations / "complete").exists():
        record(demonstrations, options)
    if not (training / "checkpoints/last").exists():
        planner = [f"--planner.macros={options.macros}", f"--planner.rounds={options.rounds}"]
        run("train.py", f"--dataset.root={demonstrations}", *planner, f"--output_dir={training}")
    command = Path(sys.executable).with_name("lerobot-eval")
    evaluation = options.output_dir / f"eval/{options.episodes}-from-{options.seed}"
    run(
        str(command),
        f"--policy.path={training / 'checkpoints/last/pretrained_model'}",
        "--env.discover_packages_path=dpmacro.policy.lerobot",
        "--env.type=metaworld",
        f"--env.task={options.task}",
        f"--eval.n_episodes={options.episodes}",
        "--eval.batch_size=1",
        f"--seed={options.seed}",
        f"--output_dir={evaluation}",
    )
    overall = json.loads((evaluation / "eval_info.json").read_text())["overall"]
    print(json.dumps(overall, indent=2))


def run(script: str, *arguments: str) -> None:
    """Run a script of this repository, or a command. Raises ValueError where it fails."""
    path = REPOSITORY / script
    done = subprocess.run([sys.executable, str(path), *arguments], check=False)
    if done.returncode:
        raise ValueError(f"{path.name} {' '.join(arguments)} ended with {done.returncode}: see above")


def record(root: Path, options: Options) -> None:
    """Write the expert's successful runs as a LeRobot dataset, keyed as lerobot-eval keys observations."""
    env, raw = watched(options.task)
    dataset: Any = None
    try:
        features: dict[str, dict[str, Any]] = {
            "observation.image": {
                "dtype": "image",
                "shape": (480, 480, 3),
                "names": ["height", "width", "channels"],
            },
            "observation.state": {"dtype": "float32", "shape": (4,), "names": ["x", "y", "z", "gripper"]},
            "action": {"dtype": "float32", "shape": (4,), "names": ["x", "y", "z", "gripper"]},
        }
        dataset = create_dataset(root, FPS, features)
        kept = 0
        for tried in trange(TRIES * options.demonstrations, desc="Runs of the expert"):
            frames = expert_run(env, raw, tried, options.task)
            for frame in frames:
                dataset.add_frame(frame)
            if frames:
                with quiet():
                    dataset.save_episode()
                kept += 1
            if kept == options.demonstrations:
                break
        else:
            raise ValueError(f"only {kept} of {tried + 1} runs of the expert succeeded: take another --task")
    finally:
        env.close()
        if dataset is not None:
            dataset.finalize()
    (root / "complete").touch()


def watched(task: str) -> tuple[Any, list[np.ndarray]]:
    """LeRobot's environment, and a list whose last entry is the whole state, which the expert needs."""
    from lerobot.envs.metaworld import MetaworldEnv

    env, raw = MetaworldEnv(task, obs_type="pixels_agent_pos"), list[np.ndarray]()
    env.reset(seed=0)  # version 0.6 builds what is inside here
    inside = env._env
    for name in ("reset", "step"):
        setattr(inside, name, noting(getattr(inside, name), raw))
    return env, raw


def noting(function: Any, raw: list[np.ndarray]) -> Any:
    """The function, whose result begins with a state that is noted."""

    def noted(*given: Any, **named: Any) -> Any:
        result = function(*given, **named)
        raw[:] = [result[0]]
        return result

    return noted


def expert_run(env: Any, raw: list[np.ndarray], seed: int, task: str) -> list[dict[str, Any]]:
    """The frames of one run, none where it does not succeed."""
    observation, _ = env.reset(seed=seed)
    frames: list[dict[str, Any]] = []
    for _ in range(MAX_STEPS):
        action = np.clip(env.expert_policy.get_action(raw[-1]), -1, 1).astype(np.float32)
        shown = {"image": observation["pixels"], "state": np.float32(observation["agent_pos"])}
        frames.append(
            {
                **{f"observation.{name}": value for name, value in shown.items()},
                "action": action,
                "task": task,
            }
        )
        observation, _, ended, truncated, info = env.step(action)
        if info["is_success"]:
            return frames
        if ended or truncated:
            break
    return []


if __name__ == "__main__":
    cli.run(main, Options)
