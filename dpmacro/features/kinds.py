"""The kinds of feature columns by name: made anew for training, or read back from a file."""

import torch
from torch import Tensor

from dpmacro.features.base import Encoder
from dpmacro.features.pixels import Pixels
from dpmacro.features.rectangles import Rectangles

__all__ = ["FEATURES", "features_from", "make_features"]

FEATURES = {"rectangles": Rectangles, "pixels": Pixels}


def make_features(kind: str, height: int, width: int, count: int, generator: torch.Generator) -> Encoder:
    """The encoder of that name: "pixels", or "rectangles" with `count` of them drawn by `generator`.

    Raises ValueError for another name and for fewer than one rectangle.
    """
    if kind not in FEATURES:
        raise ValueError(f"features are {kind!r}: choose one of {', '.join(FEATURES)}")
    if kind == "pixels":
        return Pixels.all(height, width)
    if count < 1:
        raise ValueError(f"the number of rectangles is {count}: draw 1 at least")
    return Rectangles.draw(height, width, count, generator)


def features_from(kind: str, height: int, width: int, tensors: dict[str, Tensor]) -> Encoder:
    """The encoder that `Encoder.tensors` described."""
    return FEATURES[kind](height, width, **tensors)
