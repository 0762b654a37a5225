"""What a training shows: pictures in TensorBoard and as PNG, and what left-out demonstrations said."""

from pathlib import Path

from matplotlib.figure import Figure
from torch.utils.tensorboard import SummaryWriter

from dpmacro import figures
from dpmacro.annotation.pictures import chosen_pixels, mean_images
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.estimator.result import DPBoostResult
from dpmacro.policy.policy import MacroPolicy

__all__ = ["TrainingPictures"]

SHOWN = 6  # restarts in the picture of the objective, the best ones


class TrainingPictures:
    """Puts pictures of a training into its TensorBoard and its folder of figures."""

    def __init__(self, writer: SummaryWriter, folder: Path) -> None:
        self._writer = writer
        self._folder = folder

    def add(self, name: str, figure: Figure) -> None:
        """Put one figure there."""
        figures.save(figure, self._folder / f"{name}.png")
        self._writer.add_image(f"figures/{name}", figures.to_image(figure), dataformats="HWC")

    def show(
        self,
        demonstrations: Demonstrations,
        policy: MacroPolicy,
        found: DPBoostResult,
    ) -> None:
        """All that a finished training has to show."""
        labels, sure = found.labels.numpy(), found.confidence.numpy()
        first = slice(0, int(demonstrations.lengths[0]))
        truth, names = demonstrations.truth, (demonstrations.truth_name, demonstrations.truth_classes)
        timeline = figures.timeline(
            demonstrations.images[first],
            labels[first],
            demonstrations.actions[first],
            None if truth is None else truth[first],
            f"Demonstration 0: {found.macros} macro-actions",
            demonstrations.action_names,
            *names,
            sure[first],
        )
        self.add("timeline", timeline)
        self.add("objective", figures.curves(_loss_panels(found), "Objective per frame"))
        title = "All demonstrations"
        every = figures.timelines(labels, demonstrations.lengths, truth, title, *names, sure)
        self.add("segmentation", every)
        self.add("transitions", figures.transition_graph(labels, demonstrations.lengths))
        weights = chosen_pixels(policy)
        if weights is not None:
            means = mean_images(demonstrations.images, labels, found.macros)
            self.add("pixels", figures.heat_maps(means, weights, title="Pixels that stumps look at"))
        self._candidates(found)
        switches = found.switches
        for (source, target), share in zip(switches.pairs, switches.recognised.tolist(), strict=True):
            self._writer.add_scalar(f"switch/recognised_{source}_to_{target}", share)

    def _candidates(self, found: DPBoostResult) -> None:
        """The cost by bound of the final segmentation, and the scores of every candidate."""
        if found.final is not None:
            cost, used = found.final.cost_by_bound.numpy(), found.final.max_transitions
            self.add("elbow", figures.elbow(cost, used, "Left-out data"))
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
