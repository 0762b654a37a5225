"""The pictures of a camera, wherever a dataset keeps them, into the places of a buffer."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Int64

from dpmacro.data.images import DatasetError, FrameBuffer
from dpmacro.data.lerobot.decoding import (
    Clip,
    Picture,
    decode_image,
    decode_videos,
    in_threads,
    probe_image,
    probe_video,
    scan_video,
)
from dpmacro.data.lerobot.headers import MOST_PIXELS, stated_size
from dpmacro.data.lerobot.layout import StoredEpisode, Video
from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.data.lerobot.rows import Rows
from dpmacro.data.lerobot.tables import is_file, read_batches, read_table, to_cells, to_pixels
from dpmacro.parallel import ALONE, Ranks

__all__ = ["TOLERANCE", "fill", "is_depth", "picture"]

TOLERANCE = 1e-4  # seconds between a wanted time and the nearest frame's, LeRobot's own
SHOWN = 100  # letters of a file that is missing
BLOCK = 64  # images that a thread decodes at a time: few enough to balance, enough to hide the hand-over


def is_depth(feature: dict[str, Any]) -> bool:
    """Whether a feature is declared to be a depth map, by any of LeRobot's ways to say so."""
    said = [feature, *(feature.get(key) for key in ("info", "video_info"))]
    return any(
        isinstance(one, dict) and (one.get("is_depth_map") or one.get("video.is_depth_map")) for one in said
    )


def picture(store: StoredDataset, camera: str, episodes: Sequence[StoredEpisode], rows: Rows) -> Picture:
    """How the camera's pictures are stored, by the first; DatasetError where that cannot be read."""
    if store.features[camera]["dtype"] == "video":
        return probe_video(_video(store, camera, episodes[0]).path)
    part = next(part for part in rows.parts if (part.places == 0).any())
    row = part.rows[part.places == 0]
    cell = _cells(read_table(part.path, [camera], row), camera, part.path)[0]
    found = probe_image(_content(cell, store.root, part.path))
    if found is None:
        raise _no_image(f"dataset {store.root}, {camera}", 0, cell)
    return found


def fill(
    buffer: FrameBuffer,
    store: StoredDataset,
    camera: str,
    episodes: Sequence[StoredEpisode],
    rows: Rows,
    tolerance: float = TOLERANCE,
    ranks: Ranks = ALONE,
) -> None:
    """Put the frames of a camera into their places; of ranks each decodes a share, and all have all.

    The frame of a video is the one nearest to the episode's start in it plus the frame's `timestamp`, as in
    LeRobot. Raises DatasetError where that is not within `tolerance` seconds, where a picture is missing or
    damaged, and what `FrameBuffer.put` raises.
    """
    with ranks.together():
        if store.features[camera]["dtype"] == "video":
            clips = _clips(store, camera, episodes, rows, tolerance)
            runs = [run for clip in clips for run in clip.runs()]
            decode_videos(ranks.share_of(runs), buffer.put, buffer.sized)
        else:
            _read_images(buffer, store.root, camera, rows, ranks)
    if ranks.size > 1:
        buffer.share(ranks)


def _read_images(buffer: FrameBuffer, root: Path, camera: str, rows: Rows, ranks: Ranks) -> None:
    for part in rows.parts:
        for some, table in read_batches(part.path, [camera], part.rows):
            cells = _cells(table, camera, part.path)
            _put_images(buffer, root, part.path, cells, part.places[some], ranks)
            del cells, table
        pa.default_memory_pool().release_unused()  # Arrow would keep the memory of the encoded ones


def _put_images(
    buffer: FrameBuffer,
    root: Path,
    table: Path,
    cells: list[Any],
    places: Int64[np.ndarray, " frames"],
    ranks: Ranks,
) -> None:
    def put(start: int) -> None:
        for place in range(start, min(start + BLOCK, len(cells))):
            image = decode_image(_content(cells[place], root, table))
            if image is None:
                raise _no_image(buffer.name, int(places[place]), cells[place])
            buffer.put(int(places[place]), image)

    in_threads(put, ranks.share_of(range(0, len(cells), BLOCK)))


def _clips(
    store: StoredDataset, camera: str, episodes: Sequence[StoredEpisode], rows: Rows, tolerance: float
) -> list[Clip]:
    """The frames wanted of every file, all within the tolerance."""
    stamps = store.stamps(episodes, rows)
    ends = np.cumsum(rows.lengths)
    wanted: dict[Path, list[np.ndarray]] = {}
    for episode, end, length in zip(episodes, ends, rows.lengths, strict=True):
        video, places = _video(store, camera, episode), np.arange(end - length, end)
        seconds = video.start + stamps[places]
        wanted.setdefault(video.path, []).append(np.stack([seconds, places]))
    clips = []
    for path, pieces in wanted.items():
        seconds, numbered = np.concatenate(pieces, 1)
        places, film = numbered.astype(np.int64), scan_video(path)
        numbers = film.nearest(seconds)
        off = np.abs(film.seconds[numbers] - seconds)
        # LeRobot compares times of 32 bits, which differ by more than its tolerance after half an hour.
        far = np.flatnonzero(off >= np.maximum(tolerance, np.spacing(np.abs(seconds).astype(np.float32))))
        if far.size:
            place = places[far[0]]
            row = int(np.searchsorted(ends, place, "right"))
            raise DatasetError(
                f"{path}: frame {place - ends[row] + rows.lengths[row]} of episode "
                f"{episodes[row].index} is wanted "
                f"at {seconds[far[0]]:.6g} s, the nearest is at {film.seconds[numbers[far[0]]]:.6g} s "
                f"({far.size} frames are {off[far].max():.3g} s off or less, LeRobot's "
                "FrameTimestampError): correct "
                "timestamp or from_timestamp, or allow more by tolerance_s"
            )
        order = np.argsort(numbers, kind="stable")
        clips.append(Clip(film, numbers[order], places[order]))
    return clips


def _video(store: StoredDataset, camera: str, episode: StoredEpisode) -> Video:
    video = episode.videos[camera]
    if isinstance(video, str):
        raise DatasetError(video)
    return video


def _cells(table: pa.Table, camera: str, path: Path) -> list[Any]:
    try:
        return to_cells(table[camera])
    except DatasetError as error:
        raise DatasetError(f"{path}: {camera} {error}") from error


def _content(cell: Any, root: Path, table: Path) -> Any:
    """The bytes of an image, or its pixels, none where there are none.

    A path is of the dataset, or beside the table.
    """
    if isinstance(cell, str):
        files = [folder / cell for folder in (root, table.parent) if is_file(folder / cell)]
        return files[0].read_bytes() if files else b""
    if isinstance(cell, pa.Scalar):
        return to_pixels(cell)
    return b"" if cell is None else cell


def _no_image(name: str, place: int, cell: Any) -> DatasetError:
    what = (
        f"damaged or missing (no file {' '.join(cell.split())[:SHOWN]})"
        if isinstance(cell, str)
        else "damaged"
    )
    if isinstance(cell, pa.Buffer) and (size := stated_size(cell)) and size[0] * size[1] > MOST_PIXELS:
        what = f"{size[0]}x{size[1]} by its header, and {MOST_PIXELS} pixels are read at most"
    return DatasetError(f"{name}: the image of frame {place} is {what}; record the dataset again")
