"""What a search found of a dataset's stages, kept beside its policy, so that nobody searches twice."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from dpmacro.annotation.annotate import Annotation
from dpmacro.annotation.exports.folders import files_of
from dpmacro.utils.files import replacing

__all__ = ["Kept", "KeptSearch", "dataset_digest"]

ASKED, FOUND = "search.json", "found.safetensors"
TOLD = "found"  # the only key of the metadata: of several the order would be drawn anew for every file
TENSORS = {"labels": (("I64",), 1), "confidence": (("F32",), 1), "cost_by_bound": (("F32", "F64"), 2)}


@dataclass(frozen=True)
class Kept:
    """What was found.

    Attributes:
        annotation: labels of all frames, their confidence, the loss under every bound.
        notes: on the data and the search, for people.
    """

    annotation: Annotation
    notes: tuple[str, ...]


class KeptSearch:
    """A search and what it found, in a folder: `search.json` says what was asked, `training/` holds the rest.

    Attributes:
        training: the folder of the training.

    Args:
        folder: of the page.
        options: all that the search depends on, in groups, as JSON holds them.
        root: the dataset's folder.
        labels: a file that the search depends on as well; None for none.

    Raises ValueError, one line, where the folder's search is another one.
    """

    def __init__(self, folder: Path, options: Mapping[str, Any], root: Path, labels: Path | None) -> None:
        self.training = folder / "training"
        self._place = folder / ASKED
        self._asked = dict(_flat(json.loads(json.dumps(options))))
        self._asked["content of dataset.root"] = dataset_digest(root) if root.is_dir() else None
        if labels is not None and labels.is_file():
            self._asked["content of dataset.labels"] = hashlib.sha256(labels.read_bytes()).hexdigest()
        if self._place.exists():
            self._refuse_other()

    @property
    def pretrained(self) -> Path:
        """Folder of the policy, once the search is complete."""
        return self.training / "checkpoints/last/pretrained_model"

    @property
    def begun(self) -> bool:
        """Whether this very search was begun and not completed."""
        return self._place.exists() and self.training.exists() and not (self.training / FOUND).exists()

    def found(self, frames: int, trajectories: int) -> Kept | None:
        """What the search found of so many frames; None where it is still to be made.

        Raises ValueError, one line, where the file is damaged.
        """
        path = self.training / FOUND
        if not (self._place.exists() and path.exists()):
            return None
        try:
            with safe_open(path, "pt") as file:
                told = json.loads(file.metadata()[TOLD])
                digest, notes = told["digest"], told["notes"]
                for name, (kinds, dims) in TENSORS.items():
                    part = file.get_slice(name)
                    sizes = part.get_shape()
                    wanted = trajectories if name == "cost_by_bound" else frames
                    if len(sizes) != dims or sizes[0] != wanted or part.get_dtype() not in kinds:
                        raise ValueError(f"{name} has the shape {sizes}")
            if not isinstance(notes, list) or not all(isinstance(note, str) for note in notes):
                raise ValueError("its notes are no texts")
            annotation = Annotation(**load_file(path))
            if _digest(annotation) != digest:
                raise ValueError("its numbers are not those that were written")
            return Kept(annotation, tuple(notes))
        except (RecursionError, SafetensorError, LookupError, TypeError, ValueError, OSError) as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{path} cannot be read ({reason}): give another --output_dir") from error

    def begin(self) -> None:
        """Say what is asked."""
        with replacing(self._place) as path:
            path.write_text(json.dumps(self._asked, indent=2) + "\n")

    def keep(self, kept: Kept) -> None:
        """Write what was found; the search is complete once this returns."""
        found = kept.annotation
        tensors = {name: getattr(found, name).cpu().contiguous() for name in TENSORS}
        with replacing(self.training / FOUND) as path:
            save_file(tensors, path, {TOLD: json.dumps({"digest": _digest(found), "notes": kept.notes})})

    def _refuse_other(self) -> None:
        try:
            then = json.loads(self._place.read_text())
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{self._place} is no JSON: give another --output_dir") from error
        if then == self._asked:
            return
        known = then if isinstance(then, dict) else {}
        names = [name for name in {**known, **self._asked} if known.get(name) != self._asked.get(name)]
        raise ValueError(
            f"{self._place}: the search in this folder was begun with another {' and '.join(names)}; run the "
            "command that it was begun with, or give another --output_dir"
        )


def _flat(groups: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The options of all groups, by names like planner.macros."""
    for name, value in groups.items():
        if isinstance(value, dict):
            yield from ((f"{name}.{one}", own) for one, own in value.items())
        else:
            yield name, value


def _digest(found: Annotation) -> str:
    digest = hashlib.sha256()
    for name in TENSORS:
        digest.update(getattr(found, name).cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def dataset_digest(root: Path) -> str:
    """Alike where a dataset's files have the names, sizes and times of their last change that they had."""
    seen = [(name, path.stat()) for name, path in sorted(files_of(root).items())]
    told = [(name, status.st_size, status.st_mtime_ns) for name, status in seen]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()
