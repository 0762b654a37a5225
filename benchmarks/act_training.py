"""LeRobot's ACT policy, trained on demonstrations against the clock; saved, and read back as a planner.

LeRobot's own classes do it all: configuration, network, loss, optimiser preset and gradient clipping,
normalisation. Kept are its defaults, but for these:

- `chunk_size` 20 instead of 100, 0.7 s instead of 3.3: nine in ten straight walks of the teacher end within a
  second.
- `optimizer_lr` and `optimizer_lr_backbone` 1e-4 instead of 1e-5, since minutes on a CPU are some thousand
  steps, not LeRobot's 100,000.
- The backbone starts from random numbers, `pretrained_backbone_weights` None. LeRobot starts from ImageNet's
  where it can download them; give their name where there is a network. Without, its batch norms are
  identities, since LeRobot freezes them.
- Images alone go in. ACT then still looks up the state's device, so that a state of no numbers comes along.
"""

import io
import json
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from act_chunks import ACTION, IMAGE, STATE, Chunks, as_seen, of_state
from jaxtyping import Float, Float32, UInt8
from torch import Tensor
from tqdm import tqdm

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.utils.files import replacing

__all__ = ["ActOptions", "ActPlanner", "StateActPlanner", "Trained", "facts_of", "train"]

FACTS = "training.json"
LOSSES = 10
FRAMES_AT_ONCE = 64


@dataclass(frozen=True)
class ActOptions:
    """What of ACT and of its training can be chosen."""

    chunk_size: int = 20
    """Actions that ACT predicts at a look."""
    dim_model: int = 512
    """Width of its transformer."""
    use_vae: bool = True
    """Train with its variational encoder."""
    learning_rate: float = 1e-4
    """Step size, of the backbone too."""
    backbone_weights: str | None = None
    """Weights that the ResNet starts from, like ResNet18_Weights.IMAGENET1K_V1, which is downloaded."""
    batch_size: int = 8
    """Frames a step."""
    seed: int = 1000
    """Seed of weights, batches and dropout."""

    def __post_init__(self) -> None:
        for name, least in (("chunk_size", 1), ("dim_model", 16), ("batch_size", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"train.{name} is {getattr(self, name)}: give {least} or more")
        if self.dim_model % 16:
            raise ValueError(f"train.dim_model is {self.dim_model}: give a multiple of 16, for its 8 heads")
        if not 0 < self.learning_rate < 1:
            raise ValueError(f"train.learning_rate is {self.learning_rate}: give one between 0 and 1")


@dataclass(frozen=True)
class Trained:
    """A policy with what goes before and after it, and the facts of its training, ready for JSON."""

    policy: Any
    before: Any
    after: Any
    facts: dict[str, Any]

    def save(self, folder: Path) -> None:
        """Write what LeRobot reads, and the facts beside it."""
        for part in (self.policy, self.before, self.after):
            part.save_pretrained(folder)
        with replacing(folder / FACTS) as temporary:
            temporary.write_text(json.dumps(self.facts, indent=2) + "\n")


def train(
    demonstrations: Demonstrations,
    options: ActOptions,
    started: float,
    seconds: float,
    steps: int | None,
    chunks: Chunks | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Trained:
    """Train until `seconds` have passed since `started` by the clock, or `steps` are done.

    `chunks` is what ACT is given of the demonstrations, by default images and classes.
    """
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    worked = time.process_time()
    torch.manual_seed(options.seed)  # ACT draws its weights, dropout and latents from the global generator
    if chunks is None:
        chunks = Chunks(demonstrations, options.chunk_size)
    config = _config(options, chunks.features(), chunks.actions.shape[1])
    policy = ACTPolicy(config)
    before, after = make_pre_post_processors(config, dataset_stats=chunks.statistics())
    preset = config.get_optimizer_preset()
    optimizer = preset.build(policy.get_optim_params())
    policy.train()
    errors: list[float] = []
    drawn = chunks.batches(options.batch_size, torch.Generator().manual_seed(options.seed))
    bar_format = "{desc}: {percentage:3.0f}%|{bar}| {n:.0f} of {total:.0f} s{postfix}"
    with tqdm(total=seconds, desc="training", bar_format=bar_format) as bar:
        for batch in drawn:
            loss, parts = policy.forward(before(batch))
            loss.backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), preset.grad_clip_norm)
            optimizer.step()
            optimizer.zero_grad()
            errors.append(parts["l1_loss"])
            passed = clock() - started
            bar.set_postfix_str(f"step {len(errors)}, error {np.mean(errors[-50:]):.3f}", refresh=False)
            bar.update(min(passed, seconds) - bar.n)
            if passed >= seconds or len(errors) == steps:
                break
    facts = asdict(options) | {
        "dataset": str(demonstrations.root),
        "demonstrations": len(demonstrations.lengths),
        "frames": len(chunks),
        "world": demonstrations.world,
        "seconds": passed,
        "cpu_seconds": time.process_time() - worked,
        "steps": len(errors),
        "steps_per_second": len(errors) / passed,
        "threads": torch.get_num_threads(),
        "parameters": sum(parameter.numel() for parameter in policy.parameters()),
        "errors": [float(part.mean()) for part in np.array_split(errors, min(LOSSES, len(errors)))],
    }
    return Trained(policy, before, after, facts | {"agreement": _agreement(policy, before, after, chunks)})


def facts_of(folder: Path) -> dict[str, Any]:
    """The facts of a saved training. Raises ValueError where the folder holds none."""
    path = folder / FACTS
    if not path.exists():
        raise ValueError(f"{folder} holds no {FACTS}: give the folder that a training by act_peer.py wrote")
    return dict(json.loads(path.read_text()))


class ActPlanner:
    """A saved ACT in one running environment; it sees the observation's `pixels` and nothing else.

    The action taken is the largest entry of the predicted vector. ACT looks again when it has taken the first
    `action_steps` actions of its last prediction.
    """

    def __init__(self, folder: Path, action_steps: int):
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.act.modeling_act import ACTPolicy
        from lerobot.policies.factory import make_pre_post_processors

        config = PreTrainedConfig.from_pretrained(folder)
        config.device, config.pretrained_backbone_weights = "cpu", None  # they come from the folder
        config.n_action_steps = action_steps
        with redirect_stdout(io.StringIO()):  # LeRobot prints where the weights come from
            self.policy = ACTPolicy.from_pretrained(folder, config=config)
        self.before, self.after = make_pre_post_processors(config, pretrained_path=str(folder))

    def reset(self, env: Any) -> None:
        """Begin an episode."""
        self.policy.reset()

    def act(self, observation: dict[str, UInt8[np.ndarray, "height width 3"]], info: dict[str, Any]) -> Any:
        """The action, a class, for the frame that the environment shows now."""
        batch = {IMAGE: as_seen(torch.from_numpy(observation["pixels"])), STATE: torch.zeros(0)}
        return int(self.next_action(batch).argmax())

    def next_action(self, batch: dict[str, Tensor]) -> Float[Tensor, " M"]:
        """The vector that ACT predicts, in the actions' units."""
        with torch.inference_mode():
            return self.after(self.policy.select_action(self.before(batch)))[0]


class StateActPlanner(ActPlanner):
    """Likewise for a world of vectors: it sees `observation.state`, and acts by the predicted vector."""

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> Float32[np.ndarray, " M"]:
        own = self.policy.config.robot_state_feature.shape[0]
        state = torch.from_numpy(np.asarray(observation[STATE], np.float32))
        return self.next_action(of_state(state[None], own)).numpy()


def _config(options: ActOptions, seen: dict[str, Any], actions: int) -> Any:
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig

    return ACTConfig(
        input_features=seen,
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (actions,))},
        chunk_size=options.chunk_size,
        n_action_steps=options.chunk_size,
        dim_model=options.dim_model,
        use_vae=options.use_vae,
        pretrained_backbone_weights=options.backbone_weights,
        optimizer_lr=options.learning_rate,
        optimizer_lr_backbone=options.learning_rate,
        device="cpu",
        push_to_hub=False,
    )


@torch.inference_mode()
def _agreement(policy: Any, before: Any, after: Any, chunks: Chunks) -> float:
    """How well the first predicted action is the one taken, at some thousand frames."""
    frames = torch.arange(0, len(chunks), max(1, len(chunks) // 1000))
    policy.eval()
    predicted, taken = [], []
    for some in frames.split(FRAMES_AT_ONCE):
        batch = chunks.batch(some)
        taken.append(batch.pop(ACTION)[:, 0])
        predicted.append(after(policy.predict_action_chunk(before(batch)))[:, 0])
    return chunks.agreement(torch.cat(predicted), torch.cat(taken))
