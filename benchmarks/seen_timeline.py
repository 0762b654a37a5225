"""A demonstration along time, with pictures that the training did not see above what it found.

python datasets/record.py --root=outputs/pick_place --world.id=Meta-World/pick-place-v3 \
        --world.pixels=true --world.image_size=192 --noise=0.1
python train.py --dataset.root=outputs/pick_place --dataset.inputs='[observation.state]' \
        --planner.macros=auto --output_dir=outputs/pick_place_training
python benchmarks/seen_timeline.py --dataset=outputs/pick_place --training=outputs/pick_place_training \
        --output=docs/metaworld_timeline.png
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

from dpmacro import figures
from dpmacro.annotation.dimensions import action_lines
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.images import ImageTransform
from dpmacro.utils import cli

SEGMENTATION = "checkpoints/last/training_state/segmentation.safetensors"


@dataclass(frozen=True)
class SeenOptions:
    """What to draw."""

    dataset: Path
    """The demonstrations, with a camera."""
    training: Path
    """Folder of a training by train.py on all of them."""
    output: Path
    """The picture, a PNG."""
    place: int = 0
    """Which of the demonstrations, from 0 on."""


def main(options: SeenOptions) -> None:
    """Draw the picture. Raises ValueError where dataset and training do not fit."""
    demonstrations = Demonstrations.load(options.dataset)
    if demonstrations.stored_shape is not None:  # they were shrunk, as policies see them
        height, width = demonstrations.stored_shape
        demonstrations = Demonstrations.load(options.dataset, transform=ImageTransform((width, height)))
    found = load_file(options.training / SEGMENTATION)
    if not np.array_equal(found["lengths"], demonstrations.lengths):
        raise ValueError(
            f"{options.training} learned from others than {options.dataset}: give its own dataset"
        )
    if not 0 <= options.place < len(demonstrations.lengths):
        raise ValueError(f"place is {options.place}: give 0 to {len(demonstrations.lengths) - 1}")
    frames, labels, truth = (
        demonstrations.trajectories[options.place],
        found["labels"],
        demonstrations.truth,
    )
    figure = figures.timeline(
        demonstrations.images[frames],
        labels[frames],
        [line.part(frames) for line in action_lines(demonstrations, labels)],
        None if truth is None else truth[frames],
        f"Demonstration {options.place}: {labels.max() + 1} macro-actions",
        demonstrations.action_names,
        demonstrations.truth_name,
        demonstrations.truth_classes,
    )
    figures.save(figure, options.output)
    print(f"picture  {options.output}")


if __name__ == "__main__":
    cli.run(main, SeenOptions)
