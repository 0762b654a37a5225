"""The smallest LeRobot datasets, v3 or v2, written without LeRobot: every part of them can be odd."""

import json
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

__all__ = [
    "CAMERA",
    "DATA",
    "EPISODES",
    "LENGTHS",
    "NUMBERS",
    "VIDEO",
    "as_v2",
    "build",
    "edit_feature",
    "edit_info",
    "edit_rows",
    "edit_table",
    "film",
    "grey",
    "levels",
    "png",
    "vector",
    "write_rows",
    "write_table",
]

CAMERA = "observation.images.top"
DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
VIDEO = f"videos/{CAMERA}/chunk-000/file-000.mp4"
LENGTHS = (5, 6)
HEIGHT, WIDTH = 48, 64
NUMBERS = {
    name: {"dtype": "int64", "shape": [1], "names": None}
    for name in ("episode_index", "frame_index", "index", "task_index")
}


def grey(number: Any) -> Any:
    """The level of the image of a frame, by its number in the dataset."""
    return 8 + 20 * number % 240


def levels(images: Any) -> np.ndarray:
    """The numbers of the frames that images show; they are flat, and video keeps the level roughly."""
    means = np.asarray(images).reshape(len(images), -1).mean(axis=1)
    return np.abs(means[:, None] - grey(np.arange(12))).argmin(axis=1)


def png(level: int, dtype: Any = np.uint8, shape: tuple[int, ...] = (HEIGHT, WIDTH, 3)) -> bytes:
    """The bytes of a PNG file, all of one level."""
    return cv2.imencode(".png", np.full(shape, level, dtype))[1].tobytes()


def vector(size: int, dtype: str = "float32", names: Any = None) -> dict[str, Any]:
    """What info.json says of a feature of `size` numbers."""
    return {"dtype": dtype, "shape": [size], "names": names}


def build(
    root: str | Path,
    columns: Mapping[str, Any] | None = None,
    features: Mapping[str, Any] | None = None,
    video: Mapping[str, Any] | None = None,
    lengths: Sequence[int] = LENGTHS,
    fps: float = 10,
    state: bool = True,
    images: bool = True,
) -> Path:
    """A dataset of a camera, a state of two numbers and actions of three.

    Args:
        root: folder, new.
        columns: of the table, in place of its own or beside them; None drops one.
        features: of info.json likewise.
        video: arguments of `film` where the camera's images are a video.
        lengths: frames of the episodes.
        fps: of info.json and the timestamps.
        state: whether there is one.
        images: whether there are any.
    """
    root, n = Path(root), sum(lengths)
    frame = np.concatenate([np.arange(length) for length in lengths])
    rng = np.random.default_rng(0)
    table: dict[str, Any] = {
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "frame_index": frame,
        "index": np.arange(n),
        "timestamp": (frame / fps).astype(np.float32),
        "task_index": np.zeros(n, np.int64),
        "action": rng.normal(size=(n, 3)).astype(np.float32),
    }
    named: dict[str, Any] = {**NUMBERS, "timestamp": vector(1), "action": vector(3, names=["x", "y", "z"])}
    if state:
        table["observation.state"] = rng.normal(size=(n, 2)).astype(np.float32)
        named["observation.state"] = vector(2, names={"motors": ["shoulder", "elbow"]})
    if images:
        named[CAMERA] = {"dtype": "video" if video is not None else "image", "shape": [HEIGHT, WIDTH, 3]}
        named[CAMERA]["names"] = ["height", "width", "channels"]
        if video is None:
            table[CAMERA] = [{"bytes": png(grey(k)), "path": f"frame-{k}.png"} for k in range(n)]
        else:
            film(root / VIDEO, **{"count": n, "fps": fps, **video})
    write_table(root / DATA, {**table, **(columns or {})})
    starts = np.cumsum([0, *lengths])
    rows = [
        {
            "episode_index": episode,
            "tasks": ["stack"],
            "length": length,
            **{
                f"{of}/{part}_index": 0
                for of in ("data", f"videos/{CAMERA}", "meta/episodes")
                for part in ("chunk", "file")
            },
            "dataset_from_index": int(starts[episode]),
            "dataset_to_index": int(starts[episode + 1]),
            f"videos/{CAMERA}/from_timestamp": starts[episode] / fps,
            f"videos/{CAMERA}/to_timestamp": starts[episode + 1] / fps,
        }
        for episode, length in enumerate(lengths)
    ]
    write_rows(root / EPISODES, rows)
    write_rows(root / "meta/tasks.parquet", [{"task_index": 0, "task": "stack"}])
    info = {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": len(lengths),
        "total_frames": n,
        "total_tasks": 1,
        "chunks_size": 1000,
        "fps": fps,
        "splits": {"train": f"0:{len(lengths)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": {k: v for k, v in {**named, **(features or {})}.items() if v is not None},
    }
    (root / "meta/info.json").write_text(json.dumps(info))
    (root / "meta/stats.json").write_text("{}")
    return root


def write_table(path: Path, columns: Mapping[str, Any]) -> None:
    """A parquet file of the columns; rows of an array are lists in it, and None is no column."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {
        name: values
        if isinstance(values, pa.Array)
        else pa.array(values.tolist() if _kind(values) else values, _kind(values))
        for name, values in columns.items()
        if values is not None
    }
    pq.write_table(pa.table(arrays), path)


def _kind(values: Any) -> Any:
    if not isinstance(values, np.ndarray) or values.ndim < 2:
        return None
    kind = pa.from_numpy_dtype(values.dtype)
    for _ in values.shape[1:]:
        kind = pa.list_(kind)
    return kind


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """A parquet file of the rows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows), path)


def edit_rows(root: Path, change: Callable[[list[dict[str, Any]]], Any], path: str = EPISODES) -> None:
    """Rewrite the rows of a parquet file: `change` edits the list of them."""
    rows = pq.read_table(root / path).to_pylist()
    change(rows)
    write_rows(root / path, rows)


def edit_table(root: Path, path: str = DATA, **columns: Any) -> None:
    """Replace columns of a parquet file, or add them; None drops one."""
    table = pq.read_table(root / path)
    write_table(
        root / path, {**{name: table[name].combine_chunks() for name in table.column_names}, **columns}
    )


def edit_info(root: Path, **changes: Any) -> None:
    """Change what info.json says."""
    path = root / "meta/info.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def edit_feature(root: Path, name: str, **changes: Any) -> None:
    """Change what info.json says of a feature, or add one; "drop" as the value of a key drops it."""
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features[name] = {k: v for k, v in (features.get(name, {}) | changes).items() if v != "drop"}
    edit_info(root, features=features)


def film(
    path: Path,
    count: int,
    fps: float,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    first: int = 0,
    step: int = 1,
    shown: Sequence[int] | None = None,
    options: dict[str, str] | None = None,
) -> None:
    """A video whose frame number k shows `grey(shown[k])`; `first` frames late, at `step` times the rate."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rate = Fraction(fps * step).limit_denominator(100_000)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=rate, options=options or {})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixels
        stream.time_base = 1 / rate
        for number in range(count * step):
            level = grey(number // step if shown is None else shown[number])
            if pixels.startswith("gray1"):
                frame = av.VideoFrame.from_ndarray(
                    np.full((HEIGHT, WIDTH), 256 * level, np.uint16), "gray16le"
                )
                frame = frame.reformat(format=pixels)
            else:
                frame = av.VideoFrame.from_ndarray(np.full((HEIGHT, WIDTH, 3), level, np.uint8), "rgb24")
            frame.pts, frame.time_base = number + first, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def as_v2(root: Path, version: str = "v2.1") -> Path:
    """Rewrite a dataset of `build` in LeRobot's older layout: an episode a file, metadata in JSON lines."""
    table, rows = pq.read_table(root / DATA), pq.read_table(root / EPISODES).to_pylist()
    (root / DATA).unlink()
    (root / EPISODES).unlink()
    info = json.loads((root / "meta/info.json").read_text())
    start = 0
    for row in rows:
        index = row["episode_index"]
        pq.write_table(
            table.slice(start, row["length"]), root / f"data/chunk-000/episode_{index:06d}.parquet"
        )
        if info["features"].get(CAMERA, {}).get("dtype") == "video":
            path = root / f"videos/chunk-000/{CAMERA}/episode_{index:06d}.mp4"
            film(path, row["length"], info["fps"], shown=list(range(start, start + row["length"])))
        start += row["length"]
    lines = [{key: row[key] for key in ("episode_index", "tasks", "length")} for row in rows]
    (root / "meta/episodes.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (root / "meta/tasks.parquet").unlink()
    (root / "meta/tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": "stack"}) + "\n")
    edit_info(
        root,
        codebase_version=version,
        data_path="data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        video_path="videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    )
    return root
