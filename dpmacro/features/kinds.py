"""The encoders by name: made anew for what a dataset shows, or read back from a file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from dpmacro.features.base import Encoder, Observation
from dpmacro.features.encoders.concat import Concat
from dpmacro.features.encoders.pixels import Pixels
from dpmacro.features.encoders.rectangles import Rectangles
from dpmacro.features.encoders.state import State
from dpmacro.features.encoders.task import Task
from dpmacro.utils.checks import as_choice, as_entries, shown

__all__ = [
    "FEATURES",
    "CameraSpec",
    "ObservationSpec",
    "StateSpec",
    "TaskSpec",
    "blank_observation",
    "encoder_from",
    "make_encoder",
    "make_features",
]

FEATURES = {"rectangles": Rectangles, "pixels": Pixels}  # of images
ENCODERS = {**FEATURES, "state": State, "task": Task}


@dataclass(frozen=True)
class CameraSpec:
    """Images, in pixels."""

    height: int
    width: int


@dataclass(frozen=True)
class StateSpec:
    """A vector of numbers: the names of its dimensions, and which of them vary; None for all."""

    dimensions: tuple[str, ...]
    kept: tuple[int, ...] | None = None


@dataclass(frozen=True)
class TaskSpec:
    """The number of a task, 0..count-1."""

    count: int


ObservationSpec = Mapping[str, CameraSpec | StateSpec | TaskSpec]  # by key


def make_encoder(
    observations: ObservationSpec,
    kind: str,
    rectangles: int,
    window: int,
    pairs: int,
    generator: torch.Generator,
) -> Encoder:
    """The columns of all cameras, then of all states, then of the task, each in the order of the keys.

    Args:
        observations: what a frame shows.
        kind: what columns of images are, "rectangles" or "pixels".
        rectangles: number of random rectangles, divided evenly among the cameras.
        window: frames of a state's longer change, 2 at least.
        pairs: at most so many differences of two dimensions of a state.
        generator: draws rectangles and differences.

    Raises ValueError where nothing is seen or varies, for another kind, for fewer rectangles than cameras,
    and as `State.make` and `Task.all` do.
    """
    if kind not in FEATURES:
        raise ValueError(f"features are {kind!r}: choose one of {', '.join(FEATURES)}")
    cameras = [(key, spec) for key, spec in observations.items() if isinstance(spec, CameraSpec)]
    if kind == "rectangles" and rectangles < len(cameras):
        least = "1 at least" if len(cameras) == 1 else f"{len(cameras)} at least, one for each camera"
        raise ValueError(f"the number of rectangles is {rectangles}: draw {least}")
    parts: list[Encoder] = []
    for number, (key, spec) in enumerate(cameras):
        count = (rectangles + len(cameras) - 1 - number) // len(cameras)
        parts.append(make_features(kind, spec.height, spec.width, count, generator, key))
    for key, one in observations.items():
        if isinstance(one, StateSpec):
            parts.append(State.make(key, one.dimensions, window, pairs, generator, one.kept))
    parts += [Task.all(one.count, key) for key, one in observations.items() if isinstance(one, TaskSpec)]
    if not parts:
        raise ValueError("nothing is seen: give a camera, a state or a task at least")
    encoder = Concat.of(parts)
    if encoder.count == 0:
        raise ValueError(f"nothing varies in {', '.join(observations)}: give more to look at")
    return encoder


def make_features(
    kind: str,
    height: int,
    width: int,
    count: int,
    generator: torch.Generator,
    camera: str = "observation.image",
) -> Encoder:
    """The columns of one camera: "pixels", or "rectangles" with `count` of them drawn by `generator`.

    Raises ValueError for another name and for fewer than one rectangle.
    """
    if kind not in FEATURES:
        raise ValueError(f"features are {kind!r}: choose one of {', '.join(FEATURES)}")
    if kind == "pixels":
        return Pixels.all(camera, height, width)
    if count < 1:
        raise ValueError(f"the number of rectangles is {count}: draw 1 at least")
    return Rectangles.draw(camera, height, width, count, generator)


def encoder_from(spec: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> Encoder:
    """The encoder that `Encoder.spec` and `Encoder.tensors` described, on the device of the tensors.

    Raises ValueError for a kind that does not exist and for a spec or tensors that are not the kind's.
    """
    kind = as_entries("an encoder", spec, kind=Mapping).get("kind")
    if kind == "concat":
        specs = as_entries("the parts of an encoder", spec.get("parts"))
        if any(isinstance(own, Mapping) and own.get("kind") == "concat" for own in specs):
            raise ValueError("an encoder has a concat among its parts: list the parts of that")
        return Concat(tuple(_parts(specs, tensors)))
    as_choice("the kind of an encoder", kind, ENCODERS)
    values = {name: value for name, value in spec.items() if name != "kind"}
    if kind == "state" and "dimensions" in values:
        values["dimensions"] = tuple(as_entries("the dimensions of a state", values["dimensions"]))
    try:
        return ENCODERS[kind](**values, **tensors)
    except TypeError as error:
        given = shown(sorted(map(str, [*values, *tensors])))
        raise ValueError(f"an encoder of {kind} cannot be made of {given}: train the policy again") from error


def blank_observation(encoder: Encoder, batch: int, device: str | torch.device = "cpu") -> Observation:
    """Black images, states of 0 and task 0, all that an encoder of these kinds looks at."""
    found: dict[str, Tensor] = {}
    for part in encoder.parts if isinstance(encoder, Concat) else (encoder,):
        if isinstance(part, Rectangles | Pixels):
            size, dtype = [batch, part.height, part.width, 3], torch.uint8
        elif isinstance(part, State):
            size, dtype = [batch, len(part.dimensions)], torch.float32
        else:
            size, dtype = [batch], torch.int64
        found[part.keys[0]] = torch.zeros(size, dtype=dtype, device=device)
    return found


def _parts(specs: Sequence[Mapping[str, Any]], tensors: Mapping[str, Tensor]) -> list[Encoder]:
    """The parts of a `Concat`, whose tensors have a part's number before their names."""
    own: list[dict[str, Tensor]] = [{} for _ in specs]
    known = set(map(str, range(len(specs))))
    for name, tensor in tensors.items():
        number, _, rest = name.partition(".")
        if number not in known:
            raise ValueError(f"tensor {shown(name)} is of no part: there are {len(specs)}")
        own[int(number)][rest] = tensor
    return [encoder_from(spec, part) for spec, part in zip(specs, own, strict=True)]
