"""Where a classifier goes for the red flag, and where it passes it by: a map of a room with fixed flags.

    python benchmarks/avenue_map.py --policies='[outputs/table_flags/train/flags-0_baseline_0, \
        outputs/table_flags/train/still-0_baseline_0]' --output=docs/avenue.png

At every place of a grid the avatar is put down facing the red flag, as at the start of an episode, and the
policy is asked what it does: forward, which is towards red, or a turn, which looks for something else. With
flags in fixed places a classifier without memory may learn that red is to be touched from the avenue between
blue and red and not from elsewhere. Lines are the paths of the teacher. A place where red is hidden, or that
is not free, stays white.
"""

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

from dpmacro import figures
from dpmacro.evaluation.rollouts import PlannerSource, one_thread, run_episodes
from dpmacro.evaluation.stage import Stage
from dpmacro.figures.style import INK, bare
from dpmacro.utils import cli
from dpmacro.worlds.two_flags.env import FORWARD

CLOSEST = 0.75  # metres from a flag or a wall
POLICY = "checkpoints/last/pretrained_model"
FLAGS = {"blue": "#1f4fd8", "red": "#d62728"}


@dataclass(frozen=True)
class MapOptions:
    """Which policies, and how fine a map."""

    policies: list[str] = field(default_factory=list)
    """Folders of trainings by train.py, in rooms with two flags in fixed places; a map for each."""
    titles: list[str] = field(default_factory=list)
    """A title for every map; by default the folders' names."""
    cells: int = 28
    """Places along each side of the room."""
    textures: int = 3
    """Episodes whose textures are tried at every place."""
    paths: int = 20
    """Runs of the teacher whose paths are drawn."""
    seed: int = 5000
    """Seed of the first episode."""
    output: Path = Path("docs/avenue.png")
    """The picture, a PNG."""

    def __post_init__(self) -> None:
        if not self.policies:
            raise ValueError("policies is empty: give folders of trainings")
        if self.titles and len(self.titles) != len(self.policies):
            raise ValueError(f"titles has {len(self.titles)} and policies {len(self.policies)}: give as many")
        for name, most in (("cells", 200), ("textures", 100), ("paths", 1000)):
            if not 1 <= getattr(self, name) <= most:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 to {most}")


@dataclass(frozen=True)
class Map:
    """What a policy does on seeing red: the share of looks that go forward, NaN where there was no look."""

    forward: np.ndarray  # [cells, cells], rows from south to north
    side: float  # metres
    flags: Mapping[str, tuple[float, float]]
    paths: Sequence[np.ndarray]


def main(options: MapOptions) -> None:
    """Draw the maps; print the share of the places from which each policy goes for red."""
    folders = [Path(name) for name in options.policies]
    titles = options.titles or [folder.name for folder in folders]
    maps = [map_of(folder, options) for folder in tqdm(folders, unit="map")]
    figures.save(drawn(maps, titles), options.output)
    for title, found in zip(titles, maps, strict=True):
        looks = found.forward[~np.isnan(found.forward)]
        print(f"{title:<30} goes for red in {looks.mean():.1%} of {looks.size} places")
    print(f"picture  {options.output}")


def map_of(folder: Path, options: MapOptions) -> Map:
    """The map of a training's policy, asked in the world of its demonstrations."""
    policy = folder / POLICY
    world = world_of(policy)
    seeds = range(options.seed, options.seed + max(options.paths, options.textures))
    paths = [
        one.positions
        for one in run_episodes(PlannerSource("teacher"), world, seeds[: options.paths])
        if one.positions is not None
    ]
    planner = PlannerSource("policy", policy, recovery=False).planner(world["id"])
    with one_thread(), closing(Stage(planner, world)) as stage:
        env: Any = stage.env.unwrapped
        env.reset(seed=options.seed)
        layout = env.layout
        flags = {"blue": layout.blue, "red": layout.red}
        centres = (np.arange(options.cells) + 0.5) / options.cells * layout.side - layout.side / 2
        forward = np.full((options.cells, options.cells), np.nan)
        for row, y in enumerate(centres):
            for column, x in enumerate(centres):
                near = min(math.dist((x, y), place) for place in flags.values())
                if min(near, layout.side / 2 - max(abs(x), abs(y))) >= CLOSEST:
                    forward[row, column] = looks(stage, env, (x, y), layout, seeds[: options.textures])
    return Map(forward, layout.side, flags, paths)


def looks(stage: Stage, env: Any, place: tuple[float, float], layout: Any, seeds: Sequence[int]) -> float:
    """The share of looks at red from a place after which the policy goes forward; NaN if red is hidden."""
    heading = math.atan2(layout.red[1] - place[1], layout.red[0] - place[0])
    found = []
    for seed in seeds:
        observation, info = env.reset(seed=seed, options={"layout": layout, "start": (*place, heading)})
        if not env.scene.visible("red"):
            return math.nan
        stage.planner.reset(env)
        found.append(stage.planner.act(stage.shown(observation, "on the map"), info) == FORWARD)
    return float(np.mean(found))


def world_of(policy: Path) -> dict[str, Any]:
    """The world that a policy learned in. Raises ValueError where its flags are not two in fixed places."""
    config = json.loads((policy / "config.json").read_text())
    world = dict(config["planner"].get("world") or {})
    if world.get("id") != "TwoFlags-v0" or world.get("flags") != "fixed":
        raise ValueError(
            f"{policy} learned in {world or 'no known world'}: give one of TwoFlags, flags fixed"
        )
    return world


def drawn(maps: Sequence[Map], titles: Sequence[str]) -> Figure:
    """The maps side by side: red where the policy goes for red, grey where it turns away."""
    figure = Figure(figsize=(5.2 * len(maps), 5.6), layout="constrained")
    axes = figure.subplots(1, len(maps), squeeze=False)[0]
    for axis, found, title in zip(axes, maps, titles, strict=True):
        draw(axis, found, title)
    figure.suptitle("Facing the red flag: red squares, the classifier goes for it; grey squares, it turns")
    return figure


def draw(axis: Axes, found: Map, title: str) -> None:
    """One map."""
    half = found.side / 2
    bare(axis)
    colours = np.ones((*found.forward.shape, 3))
    known = ~np.isnan(found.forward)
    share = found.forward[known][:, None]
    colours[known] = share * [0.92, 0.45, 0.42] + (1 - share) * [0.78, 0.80, 0.82]
    axis.imshow(colours, extent=(-half, half, -half, half), origin="lower", interpolation="nearest")
    for path in found.paths:
        axis.plot(path[:, 0], path[:, 1], color=INK, linewidth=0.7, alpha=0.6)
    for name, place in found.flags.items():
        axis.scatter(*place, s=160, color=FLAGS[name], edgecolors="white", zorder=5)
    axis.set_xlim(-half, half)
    axis.set_ylim(-half, half)
    axis.set_aspect("equal")
    axis.set_title(title)


if __name__ == "__main__":
    cli.run(main, MapOptions)
