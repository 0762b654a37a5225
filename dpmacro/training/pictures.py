"""What a training shows: pictures in TensorBoard and as PNG, and what left-out demonstrations said."""

from dataclasses import asdict
from pathlib import Path

from matplotlib.figure import Figure
from torch.utils.tensorboard import SummaryWriter

from dpmacro import figures
from dpmacro.annotation.pictures import chosen_pixels, mean_images
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.discovery.dpboost import DPBoostResult
from dpmacro.policy.policy import MacroPolicy
from dpmacro.switching.functions import SwitchFunctions

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
        discovery: DPBoostResult,
        switches: SwitchFunctions,
    ) -> None:
        """All that a finished training has to show."""
        labels, sure = discovery.labels.numpy(), discovery.confidence.numpy()
        first = slice(0, int(demonstrations.lengths[0]))
        truth, names = demonstrations.truth, (demonstrations.truth_name, demonstrations.truth_classes)
        timeline = figures.timeline(
            demonstrations.images[first],
            labels[first],
            demonstrations.actions[first],
            None if truth is None else truth[first],
            f"Demonstration 0: {discovery.macros} macro-actions",
            demonstrations.action_names,
            *names,
            sure[first],
        )
        self.add("timeline", timeline)
        self.add("objective", figures.curves(_loss_panels(discovery), "Objective per frame"))
        title = "All demonstrations"
        every = figures.timelines(labels, demonstrations.lengths, truth, title, *names, sure)
        self.add("segmentation", every)
        self.add("transitions", figures.transition_graph(labels, demonstrations.lengths))
        weights = chosen_pixels(policy)
        if weights is not None:
            means = mean_images(demonstrations.images, labels, discovery.macros)
            self.add("pixels", figures.heat_maps(means, weights, title="Pixels that stumps look at"))
        self._search(discovery)
        for (source, target), share in zip(switches.pairs, switches.detected.tolist(), strict=True):
            self._writer.add_scalar(f"switch/detected_{source}_to_{target}", share)

    def _search(self, discovery: DPBoostResult) -> None:
        """The elbow, and the verdict on every rival."""
        search = discovery.search
        if search is None:
            return
        elbow = figures.elbow(search.cost_by_bound.numpy(), search.max_transitions, "Left-out data")
        self.add("elbow", elbow)
        for rival, verdict in enumerate(search.verdicts):
            for name, value in asdict(verdict).items():
                self._writer.add_scalar(f"selection/{name}", value, rival)


def _loss_panels(discovery: DPBoostResult) -> dict[str, dict[str, list[float]]]:
    """The objective of the exact fit, and of the best restarts."""
    panels = {"exact fit": {"exact fit": discovery.loss.tolist()}}
    if discovery.search is not None:
        losses = discovery.search.candidates.loss
        best = losses[-1].argsort()[:SHOWN].tolist()
        panels["discovery"] = {f"restart {k}": losses[:, k].tolist() for k in best}
    return panels
