"""Labels that a person corrected, for a training that keeps them and cuts the other demonstrations anew."""

from dataclasses import replace

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.annotation.corrections import Corrections
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.segmentation.given import FREE, GivenLabels
from dpmacro.training.options import TrainOptions
from dpmacro.utils.tensors import ArrayLike

__all__ = ["labelled"]


def labelled(
    options: TrainOptions, demonstrations: Demonstrations
) -> tuple[TrainOptions, Int64[Tensor, " frames"] | None]:
    """The options with the number of macro-actions, and the labels that `dataset.labels` gives.

    Of every frame the place of its stage among the names of the file, -1 in demonstrations that nobody
    corrected; None without a file. Where the number of macro-actions was left out it is that of the names.
    Where the data is to choose the order and the labels are in no chain, it is free.

    Args:
        options: of the training.
        demonstrations: what they say is to be learned from.

    Raises ValueError where the file is wrong or is that of other demonstrations, where nothing in it is
    corrected, where it has more names than there are to be macro-actions, or where no segmentation under the
    bound or in the order keeps to its labels; and OSError where it cannot be read.
    """
    path, planner = options.dataset.labels, options.planner
    if path is None:
        return options, None
    corrections = Corrections.load(path)
    named = len(corrections.names)
    macros = named if planner.macros is None else planner.macros
    assert isinstance(macros, int), "the options refuse auto beside labels"
    if macros < named:
        raise ValueError(
            f"planner.macros is {macros} and {path} names {named} stages: give {named} or leave it out"
        )
    labels = torch.from_numpy(corrections.given(demonstrations.episodes, demonstrations.lengths))
    if bool((labels == FREE).all()):
        raise ValueError(f"{path} corrects no episode: correct some, or leave dataset.labels out")
    if macros == 1:
        raise ValueError(f"{path} names one stage, so that nothing is cut: name more, or give planner.macros")
    bound = macros - 1 if planner.max_transitions is None else planner.max_transitions
    if bound == 0:
        raise ValueError(
            "planner.max_transitions is 0 beside dataset.labels: give 1 or more, or leave it out"
        )
    given, order = (labels, demonstrations.lengths, macros), planner.order
    if order == "auto" and not _in_a_chain(*given):
        order = "free"
    searched = "free" if order == "auto" else order
    try:
        kept = GivenLabels.of(*given, bound, searched, demonstrations.episodes)
    except ValueError as error:
        raise ValueError(f"{path}, {error}") from error
    return replace(options, planner=replace(planner, macros=macros, order=order)), kept.labels


def _in_a_chain(labels: Int64[Tensor, " frames"], lengths: ArrayLike, macros: int) -> bool:
    """Whether some chain 0, 1, ... of all macro-actions has these labels."""
    try:
        GivenLabels.of(labels, lengths, macros, macros - 1, "chain")
    except ValueError:
        return False
    return True
