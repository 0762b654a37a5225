"""What a training shows: pictures in TensorBoard and as PNG, and what left-out demonstrations said."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure
from torch.utils.tensorboard import SummaryWriter

from dpmacro import figures
from dpmacro.annotation.dimensions import action_lines
from dpmacro.annotation.pictures import (
    chosen_columns,
    chosen_pixels,
    demonstration_timeline,
    mean_images,
    pixels_name,
)
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.estimator.result import DPBoostResult
from dpmacro.policy.policy import MacroPolicy

__all__ = ["TrainingPictures"]

ACCURACY = (
    "Actions are vectors: accuracy is the share of their variance that is explained, 0 to 1. That of switch "
    "functions (recognise, switch) is a share of frames."
)
SHOWN = 6  # restarts in the picture of the objective, the best ones


class TrainingPictures:
    """Puts pictures of a training into its TensorBoard and its folder of figures.

    One that fails is a warning, and the others are made.
    """

    def __init__(self, writer: SummaryWriter, folder: Path) -> None:
        self._writer = writer
        self._folder = folder

    def add(self, name: str, figure: Figure) -> None:
        """Put one figure there."""
        self._draw(name, lambda: figure)

    def show(
        self,
        demonstrations: Demonstrations,
        policy: MacroPolicy,
        found: DPBoostResult,
    ) -> None:
        """All that a finished training has to show."""
        labels, sure = found.labels.numpy(), found.confidence.numpy()
        truth, names = demonstrations.truth, (demonstrations.truth_name, demonstrations.truth_classes)
        lines = action_lines(demonstrations, labels) if demonstrations.vector else []
        title = f"Demonstration 0: {found.macros} macro-actions"
        self._draw("timeline", lambda: demonstration_timeline(demonstrations, 0, labels, sure, lines, title))
        self._draw("objective", lambda: figures.curves(_loss_panels(found), "Objective per frame"))
        every = labels, demonstrations.lengths, truth, "All demonstrations", *names, sure
        self._draw("segmentation", lambda: figures.timelines(*every))
        self._draw("transitions", lambda: figures.transition_graph(labels, demonstrations.lengths))
        if columns := chosen_columns(policy):
            self._draw("columns", lambda: figures.column_bars(columns, title="What stumps look at"))
        for camera, weights in chosen_pixels(policy).items():
            means = mean_images(demonstrations.observations[camera], labels, found.macros)
            maps = means, weights, (), "Pixels that stumps look at"
            self._draw(pixels_name(policy, camera), partial(figures.heat_maps, *maps))
        if demonstrations.vector:
            self._writer.add_text("accuracy", ACCURACY)
        self._candidates(found)
        switches = found.switches
        for (source, target), share in zip(switches.pairs, switches.recognised.tolist(), strict=True):
            self._writer.add_scalar(f"switch/recognised_{source}_to_{target}", share)

    def _draw(self, name: str, draw: Callable[[], Figure]) -> None:
        with figures.surviving(name):
            figure = draw()
            figures.save(figure, self._folder / f"{name}.png")
            self._writer.add_image(f"figures/{name}", figures.to_image(figure), dataformats="HWC")

    def _candidates(self, found: DPBoostResult) -> None:
        """The cost by bound of the final segmentation, and the scores of every candidate."""
        if found.final is not None and found.order == "free":  # a chain has one number of transitions
            cost, used = found.final.cost_by_bound.numpy(), found.final.max_transitions
            self._draw("elbow", lambda: figures.elbow(cost, used, "Left-out data"))
        if found.discovery is None:
            return
        for place, scores in enumerate(found.discovery.scores):
            for name, value in scores.scalars().items():
                self._writer.add_scalar(f"selection/{name}", value, place)


def _loss_panels(found: DPBoostResult) -> dict[str, dict[str, list[float]]]:
    """The objective of the final fit, and of the best restarts."""
    panels = {"final fit": {"final fit": found.loss.tolist()}}
    if found.discovery is not None:
        losses = found.discovery.alternated.loss
        best = losses[-1].argsort()[:SHOWN].tolist()
        panels["discovery"] = {f"restart {k}": losses[:, k].tolist() for k in best}
    return panels
