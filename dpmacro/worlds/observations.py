"""What a world shows, by LeRobot's keys: where in an observation each is, and what every one must be."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from dpmacro.worlds.base import WorldError

__all__ = ["ObservationMap", "usual_key"]

PREFIX, IMAGE, STATE = "observation.", "observation.image", "observation.state"
USUAL = {"pixels": IMAGE, "agent_pos": STATE, "environment_state": "observation.environment_state"}
NUMBERS = "biuf"  # kinds of numpy's types
Place = tuple[str, ...]  # names from the outermost dictionary inwards; () for an observation that is an array


def usual_key(place: Place) -> str:
    """LeRobot's key of what stands at a place.

    `pixels` is observation.image, one of several by its camera observation.images.<camera>, and `agent_pos`
    is observation.state; others have `observation.` before their name.
    """
    name = ".".join(place)
    if name.startswith("pixels."):
        return f"observation.images.{name.removeprefix('pixels.')}"
    return USUAL.get(name) or (name if name.startswith(PREFIX) else PREFIX + name)


@dataclass(frozen=True)
class ObservationMap:
    """Where in a world's observations every input is.

    Attributes:
        world: its id, for messages.
        places: by LeRobot's keys.
        shapes: of what stands there: height, width and 3 of a picture, else the size of a vector.
    """

    world: str
    places: Mapping[str, Place]
    shapes: Mapping[str, tuple[int, ...]]

    @classmethod
    def fit(
        cls,
        world: str,
        space: gym.Space,
        wanted: Mapping[str, tuple[int, ...]] | None = None,
        names: Mapping[str, str] | None = None,
    ) -> "ObservationMap":
        """The map for a world.

        An input stands where `names` says, else under its own key, else under what LeRobot reads as that key
        (`usual_key`). A single picture is the camera that is wanted, whatever its name, and a single vector
        the only vector.

        Args:
            world: its id.
            space: of its observations, a Box or a Dict, which may hold others.
            wanted: shapes of the inputs by LeRobot's keys; None for everything that there is.
            names: the world's own names, those of a Dict within a Dict joined by dots, by LeRobot's keys.

        Raises WorldError where an input is missing, has another shape, or holds no numbers.
        """
        boxes = dict(_boxes(world, space))
        given = dict(names or {})
        if wanted is None and not given:
            found = {usual_key(place): place for place in boxes} if () not in boxes else _only(boxes)
            return cls(world, found, {key: _shape(boxes[place]) for key, place in found.items()})
        if wanted is None:
            wanted = {key: _shape(boxes[_named(world, key, name, boxes)]) for key, name in given.items()}
        strange = sorted(set(given) - set(wanted))
        if strange:
            raise WorldError(
                f"--world.observations names {strange[0]}, which the policy does not see: it sees "
                f"{', '.join(wanted)}"
            )
        found = {}
        for key, shape in wanted.items():
            named = _named(world, key, given[key], boxes) if key in given else None
            place = _place(key, shape, boxes, wanted) if named is None else named
            if place is None:
                raise WorldError(
                    f"the world {world} shows no {key}, which the policy sees: it shows {_told(boxes)}; say "
                    f"which is meant by --world.observations='[{key}=<name>]'"
                )
            has = _shape(boxes[place])
            if has != shape:
                raise WorldError(
                    f"the world {world} shows {'.'.join(place) or 'an array'} of shape {has}, and the policy "
                    f"was trained with {key} of shape {shape}: give the options of the demonstrations, or "
                    "another world"
                )
            if len(shape) == 3 and boxes[place].dtype != np.uint8:
                raise WorldError(
                    f"the world {world} shows pictures of type {boxes[place].dtype} as {'.'.join(place)}: "
                    "wrap it so that they are uint8, 0 to 255"
                )
            found[key] = place
        return cls(world, found, dict(wanted))

    def of(self, raw: Any, when: str) -> dict[str, np.ndarray]:
        """The inputs in one observation, pictures uint8, vectors float32.

        Raises WorldError, which says `when`, for what is missing, of another shape or type, or not finite.
        """
        found = {}
        for key, place in self.places.items():
            name, value = ".".join(place) or "its observation", raw
            for part in place:
                if not isinstance(value, Mapping) or part not in value:
                    raise WorldError(
                        f"the world {self.world} shows no {name} {when}: its observation_space has it; "
                        "correct the world"
                    )
                value = value[part]
            try:
                value = np.asarray(value)
            except (ValueError, TypeError, RuntimeError) as error:  # lists of other lengths, GPUs' tensors
                raise WorldError(
                    f"the world {self.world} shows {name} that is no array {when} "
                    f"({' '.join(str(error).split())}): correct the world"
                ) from error
            picture = len(self.shapes[key]) == 3
            value = value if picture else value.reshape(-1)
            sound = value.dtype == np.uint8 if picture else value.dtype.kind in NUMBERS
            if value.shape != self.shapes[key] or not sound:
                raise WorldError(
                    f"the world {self.world} shows {name} of shape {value.shape} and type {value.dtype} "
                    f"{when}, not {self.shapes[key]} as its observation_space says: correct the world"
                )
            if not picture:
                with np.errstate(over="ignore"):  # then infinite, which is told below
                    value = value.astype(np.float32)
                wrong = np.flatnonzero(~np.isfinite(value))
                if len(wrong):
                    raise WorldError(
                        f"the world {self.world} shows {name} with {value[wrong[0]]} as number {wrong[0]} "
                        f"{when}: correct the world, a policy needs finite numbers"
                    )
            found[key] = value
        return found

    def told(self) -> list[str]:
        """The inputs whose key is not the world's own name, as `key from name`."""
        pairs = {key: ".".join(place) for key, place in self.places.items()}
        return [f"{key} from {name or 'the array'}" for key, name in pairs.items() if name != key]


def _boxes(world: str, space: gym.Space, place: Place = ()) -> Iterable[tuple[Place, gym.spaces.Box]]:
    """Every Box in a space, by its place; other spaces in a Dict are nothing that a policy sees."""
    if isinstance(space, gym.spaces.Dict):
        for name, inner in space.spaces.items():
            yield from _boxes(world, inner, (*place, str(name)))
    elif isinstance(space, gym.spaces.Box):
        yield place, space
    elif not place:
        raise WorldError(
            f"the world {world} shows a {type(space).__name__}, and a policy sees a Box, or a Dict of some: "
            "wrap the world"
        )


def _shape(box: gym.spaces.Box) -> tuple[int, ...]:
    return tuple(box.shape) if len(box.shape) == 3 else (int(np.prod(box.shape, dtype=int)),)


def _only(boxes: Mapping[Place, gym.spaces.Box]) -> dict[str, Place]:
    return {IMAGE if len(boxes[()].shape) == 3 else STATE: ()}


def _named(world: str, key: str, name: str, boxes: Mapping[Place, gym.spaces.Box]) -> Place:
    for place in boxes:
        if ".".join(place) == name:
            return place
    raise WorldError(
        f"--world.observations has {key}={name}, and the world {world} shows {_told(boxes)}: choose one of "
        "these"
    )


def _place(
    key: str,
    shape: tuple[int, ...],
    boxes: Mapping[Place, gym.spaces.Box],
    wanted: Mapping[str, tuple[int, ...]],
) -> Place | None:
    """Where an input is that nobody has named; None for nowhere."""
    for place in boxes:
        if place and ".".join(place) == key:
            return place
    for place in boxes:
        if place and usual_key(place) == key:
            return place
    alike = [place for place, box in boxes.items() if (len(box.shape) == 3) == (len(shape) == 3)]
    rivals = [other for other in wanted.values() if (len(other) == 3) == (len(shape) == 3)]
    return alike[0] if len(alike) == len(rivals) == 1 and shape else None


def _told(boxes: Mapping[Place, gym.spaces.Box]) -> str:
    return ", ".join(".".join(place) or "an array" for place in boxes) or "nothing that is a Box"
