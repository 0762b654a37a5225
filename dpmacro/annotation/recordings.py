"""Recordings for Rerun, the viewer that LeRobot's `lerobot-dataset-viz` uses: one of each demonstration."""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any
from uuid import uuid4

import cv2
import numpy as np
from jaxtyping import Float, Int, Int64, UInt8
from tqdm import tqdm

from dpmacro.annotation.page.shown import Images
from dpmacro.annotation.page.sprites import QUALITIES, chosen_frames, resized
from dpmacro.annotation.stages import Stages
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.utils import interrupts

__all__ = ["require_rerun", "write_recordings"]

STATE = "observation.state"  # which LeRobot shows under the name `state`
DIMENSIONS = 64  # numbers shown of a vector at most
BUDGET = 60_000_000  # bytes of all images
AS_WEBP = 3  # times as many bytes as WebP of a like image has
VERSIONS = ">=0.24,<0.34"  # of rerun-sdk, as LeRobot 0.6.1 takes them


def require_rerun() -> ModuleType:
    """The package that writes the recordings. Raises ValueError, one line, where it cannot be imported."""
    try:
        import rerun
    except ImportError as error:
        raise ValueError(
            f"Rerun cannot be imported ({' '.join(str(error).split())}): pip install 'rerun-sdk{VERSIONS}', "
            "or leave --rerun out"
        ) from error
    return rerun


def write_recordings(
    folder: Path,
    demonstrations: Demonstrations,
    stages: Stages,
    frames: int | None = None,
    cameras: Mapping[str, Images] | None = None,
    budget: int = BUDGET,
) -> None:
    """Write `<dataset>_episode_<number>.rrd` of every demonstration into a new folder.

    A recording names what it shows as `lerobot-dataset-viz` does: images by the camera's key, `action`,
    `state`, the timelines `frame_index` and `timestamp`. Other vectors have their own keys. The stages are
    `macro_action`, their number, and `subtask`, their name where they begin; beside them are `confidence`,
    `idle` and `corrected`. The folder is there complete or not at all.

    Args:
        folder: where they go; it must not exist.
        demonstrations: what is shown; the first `DIMENSIONS` numbers of each vector.
        stages: of all of the demonstrations, in their order.
        frames: images of a demonstration and camera at most; see `chosen_frames` for the default.
        cameras: by their keys, where the images come from; those in memory by default.
        budget: bytes of all images together, which are JPEG.

    Raises ValueError where `folder` exists, Rerun cannot be imported, or the parts do not fit together.
    """
    rerun = require_rerun()
    if not np.array_equal(demonstrations.lengths, stages.lengths):
        raise ValueError(
            f"stages of {len(stages.lengths)} demonstrations with {int(stages.lengths.sum())} frames: give "
            f"those of the {len(demonstrations.lengths)} with {int(demonstrations.lengths.sum())}"
        )
    if cameras is None:
        cameras = {key: _held(demonstrations.observations[key]) for key in demonstrations.cameras}
    chosen = chosen_frames(stages.lengths, stages.fps, len(cameras), frames, budget)
    pictures = {
        key: _pictures(images, stages.lengths, chosen, budget // len(cameras), key)
        for key, images in cameras.items()
    }
    name = demonstrations.root.resolve().name
    vectors = _vectors(demonstrations)
    with _complete(folder) as partial:
        shown = zip(stages.episodes, stages.trajectories, strict=True)
        for episode, part in tqdm(shown, "Recordings", len(stages.lengths), unit="demonstration"):
            with interrupts.held_back():  # of one half made Rerun complains
                recording = rerun.RecordingStream(name, recording_id=uuid4().hex)
            recording.save(
                partial / f"{name}_episode_{episode}.rrd",
                default_blueprint=_blueprint(rerun, list(cameras), list(vectors)),
            )
            recording.send_recording_name(f"episode {episode}")
            log = _Log(rerun, recording, stages.timestamps[part])
            for key, (values, names) in vectors.items():
                log.numbers(key, values[part], names)
            for key, made in pictures.items():
                log.images(key, next(made))
            log.stages(stages, part)
            recording.flush()
            recording.disconnect()


class _Log:
    """What is written into the recording of one demonstration.

    Args:
        rerun: the package.
        recording: its stream.
        seconds: of every frame since the demonstration began.
    """

    def __init__(self, rerun: ModuleType, recording: Any, seconds: Float[np.ndarray, " frames"]) -> None:
        self._rerun, self._recording, self._seconds = rerun, recording, seconds

    def numbers(self, name: str, values: Any, names: tuple[str, ...] | None = None) -> None:
        """A number of every frame, or a vector with names."""
        path = self._path(name)
        if names is not None:
            self._recording.log(path, self._rerun.SeriesLines(names=list(names)), static=True)
        scalars = self._rerun.Scalars.columns(scalars=np.asarray(values, np.float64))
        self._send(path, np.arange(len(values)), scalars)

    def images(self, name: str, pictures: tuple[Int64[np.ndarray, " shown"], list[bytes]]) -> None:
        """Images of some frames, as JPEG."""
        frames, encoded = pictures
        if encoded:
            kinds = ["image/jpeg"] * len(encoded)
            columns = self._rerun.EncodedImage.columns(blob=encoded, media_type=kinds)
            self._send(self._path(name), frames, columns)

    def stages(self, stages: Stages, part: slice) -> None:
        """The stage of every frame, its name where it begins, and how sure it is."""
        labels = stages.labels[part]
        for name, values in (
            ("macro_action", labels),
            ("confidence", stages.confidence[part]),
            ("idle", stages.idle[part]),
            ("corrected", stages.corrected[part]),
        ):
            self.numbers(name, values)
        starts = np.flatnonzero(np.diff(labels, prepend=-1))
        texts = [stages.names[labels[start]] for start in starts]
        self._send(self._path("subtask"), starts, self._rerun.TextLog.columns(text=texts))

    def _path(self, name: str) -> str:
        return _path_of(self._rerun, name)

    def _send(self, path: str, frames: Int[np.ndarray, " shown"], columns: Any) -> None:
        times = [
            self._rerun.TimeColumn("frame_index", sequence=frames),
            self._rerun.TimeColumn("timestamp", timestamp=self._seconds[frames].astype(np.float64)),
        ]
        self._recording.send_columns(path, indexes=times, columns=columns)


def _path_of(rerun: ModuleType, name: str) -> str:
    """A name, whatever characters it has, as the path of an entity at the top."""
    return rerun.new_entity_path([name])


def _blueprint(rerun: ModuleType, cameras: list[str], vectors: list[str]) -> Any:
    """A view of everything, as `lerobot-dataset-viz` lays them out."""
    views = rerun.blueprint
    paths = {name: _path_of(rerun, name) for name in (*cameras, *vectors)}
    shown = [views.Spatial2DView(origin=paths[name], name=name) for name in cameras]
    shown += [
        views.TimeSeriesView(origin=paths.get(name, name), name=name)
        for name in (*vectors, "macro_action", "confidence")
    ]
    shown.append(views.TextLogView(origin="subtask", name="subtask"))
    return views.Blueprint(views.Grid(*shown))


def _vectors(demonstrations: Demonstrations) -> dict[str, tuple[np.ndarray, tuple[str, ...] | None]]:
    """Actions and states by the names that LeRobot shows them under, with names of their numbers."""
    names: tuple[str, ...] | None = None
    if demonstrations.vector:
        names = demonstrations.action_names[:DIMENSIONS]
    found = {"action": (_first(demonstrations.actions), names)}
    for key, own in demonstrations.state_names.items():
        values = demonstrations.observations[key]
        found["state" if key == STATE else key] = _first(values), own[:DIMENSIONS]
    return found


def _first(values: np.ndarray) -> np.ndarray:
    return values[:, :DIMENSIONS] if values.ndim > 1 else values


def _held(values: UInt8[np.ndarray, "frames height width 3"]) -> Images:
    return lambda frames: (values[frame] for frame in frames)


def _pictures(
    images: Images,
    lengths: Int[np.ndarray, " demonstrations"],
    chosen: list[Int64[np.ndarray, " _"]],
    budget: int,
    camera: str,
) -> Iterator[tuple[Int64[np.ndarray, " shown"], list[bytes]]]:
    """Of every demonstration the frames shown, and their images as JPEG, `budget` bytes at most in all."""
    starts = np.cumsum(lengths) - lengths
    wanted = np.concatenate([start + frames for start, frames in zip(starts, chosen, strict=True)])
    small = resized(images, wanted.astype(np.int64), budget // AS_WEBP, camera)
    rest = len(wanted)
    for frames in chosen:
        kept, encoded = [], []
        for frame in frames.tolist():
            image = _jpeg(next(small), budget // rest)
            rest -= 1
            if image is not None:
                budget -= len(image)
                kept.append(frame)
                encoded.append(image)
        yield np.array(kept, np.int64), encoded


def _jpeg(image: UInt8[np.ndarray, "height width 3"], most: int) -> bytes | None:
    """The best JPEG of so many bytes at most; None where the poorest has more."""
    for quality in QUALITIES:
        settings = [cv2.IMWRITE_JPEG_QUALITY, quality]
        done, encoded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)
        if done and len(encoded) <= most:
            return encoded.tobytes()
    return None


@contextmanager
def _complete(folder: Path) -> Iterator[Path]:
    """A hidden folder that gets the name of `folder` once the block is left; it goes where that raises."""
    if folder.exists() or folder.is_symlink():
        raise ValueError(f"{folder}: exists already; remove it or give another --output_dir")
    partial = folder.with_name(f".{folder.name}-{os.getpid()}")
    partial.mkdir(parents=True)
    try:
        yield partial
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
