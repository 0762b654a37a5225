"""The finished runs of a recording, kept on disk one by one until the dataset is complete.

A LeRobot dataset cannot be read before it is complete: its tables have their index at the end. So every run
is kept beside the dataset in a file of its own, and a recording that was stopped writes its dataset anew from
them.
"""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from safetensors import SafetensorError
from safetensors.numpy import load, save

from dpmacro.data.lerobot.reader import WORLD_FILE
from dpmacro.evaluation.journal import Journal
from dpmacro.evaluation.recording import Run
from dpmacro.utils.files import replacing

__all__ = ["KeptRuns", "keeping_runs"]

LARGEST, RATIO = 2**30, 1024  # bytes of a run, or so many times those of its file
OBSERVATION, TRUTH = "observations/", "truth/"


@contextmanager
def keeping_runs(root: Path, about: Mapping[str, Any]) -> Iterator["KeptRuns"]:
    """The runs of a recording into `root` that were kept by an earlier call, in a hidden folder beside it.

    The folder goes once the block is left without an error, and where it holds no run. Otherwise it stays.

    Args:
        root: the dataset's folder.
        about: what the runs depend on: the world, the seed and the like, as JSON holds it.

    Raises ValueError, one line, where runs are kept that depend on something else, or are damaged.
    """
    root = root.absolute()
    folder = root.with_name(f".{root.name}.recording")
    if (root / WORLD_FILE).exists():  # a recording that was stopped after its last step
        shutil.rmtree(folder, ignore_errors=True)
    kept = KeptRuns(folder, about)
    try:
        yield kept
    except BaseException:
        if kept.episodes == 0:
            kept.remove()
        raise
    kept.remove()


class KeptRuns:
    """Runs of one seed after the other, in a folder.

    Attributes:
        folder: theirs.
        tried: number of runs, failed ones counted in.
        episodes: number of those that succeeded and have two frames or more.
        building: a folder in it, in which the dataset may be built.
    """

    def __init__(self, folder: Path, about: Mapping[str, Any]) -> None:
        self.folder = folder
        self._remedy = f"remove the folder {folder} to begin anew"
        self._journal = Journal(folder / "runs.jsonl", about, self._remedy)
        self.building = folder / "building"
        shutil.rmtree(self.building, ignore_errors=True)

    @property
    def tried(self) -> int:
        """Number of runs."""
        return len(self._journal.lines)

    @property
    def episodes(self) -> int:
        """Number of runs that succeeded, of those with two frames or more."""
        return sum(line.get("frames") not in (0, 1) for line in self._journal.lines)

    def runs(self) -> Iterator[Run | None]:
        """Those there are, in their order; None for each that failed.

        Raises ValueError, one line, for one that cannot be read.
        """
        for place, line in enumerate(list(self._journal.lines)):
            yield self._read(self._file(place)) if line.get("frames") else None

    def add(self, run: Run | None) -> None:
        """Keep the run of the next seed, None for one that failed; it is on disk when this returns."""
        if run is not None:
            _write(self._file(self.tried), run)
        self._journal.add({"frames": 0 if run is None else len(run.actions)})

    def remove(self) -> None:
        """Remove the folder and what it holds: no run is kept any more."""
        self._journal.lines.clear()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _file(self, place: int) -> Path:
        return self.folder / f"{place:06d}.safetensors.zst"

    def _read(self, path: Path) -> Run:
        try:
            limit = max(LARGEST, RATIO * path.stat().st_size)
            with pa.input_stream(str(path), compression="zstd") as stream:
                data = b"".join(_chunks(stream, limit))
            parts = load(data)
            told = bytes(parts.pop("task")).decode(), bool(parts.pop("success")[0])
            return Run(
                _group(parts, OBSERVATION),
                parts["actions"],
                _group(parts, TRUTH),
                parts["rewards"],
                told[0],
                parts.get("views"),
                told[1],
            )
        except (OSError, SafetensorError, LookupError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{path}: cannot be read ({reason}); {self._remedy}") from error


def _write(path: Path, run: Run) -> None:
    parts = {**_numbered(OBSERVATION, run.observations), **_numbered(TRUTH, run.truth)}
    parts |= {"actions": run.actions, "rewards": run.rewards}
    parts |= {} if run.views is None else {"views": run.views}
    parts |= {"task": np.array(bytearray(run.task.encode())), "success": np.array([run.success])}
    data = save({name: np.ascontiguousarray(values) for name, values in parts.items()})
    with replacing(path) as temporary, pa.output_stream(str(temporary), compression="zstd") as stream:
        stream.write(data)


def _numbered(prefix: str, group: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """By names that keep their order, which that of a dataset's columns depends on."""
    return {f"{prefix}{place:03d}/{name}": values for place, (name, values) in enumerate(group.items())}


def _group(parts: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    names = sorted(name for name in parts if name.startswith(prefix))
    return {name[len(prefix) + 4 :]: parts[name] for name in names}


def _chunks(stream: Any, limit: int) -> Iterator[bytes]:
    size = 0
    while chunk := stream.read(2**24):
        size += len(chunk)
        if size > limit:
            raise ValueError(f"it unpacks to more than {limit:,} bytes")
        yield chunk
