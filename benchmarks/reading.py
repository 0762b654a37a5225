"""How fast the videos of a dataset are read, beside PyAV that decodes the same files and keeps nothing.

    python benchmarks/reading.py --dataset.root=<LeRobot dataset>
    python benchmarks/reading.py --frames=3000 --cameras=2

Ours is `Demonstrations.load`: from the folder to shrunk RGB images in memory, tables included. PyAV is called
in three ways, of which the fastest counts: file after file with its own threads, and a thread or a process
per core with an equal part of every file. All take turns, each in a process of its own. Rates are frames of
the cameras a second.
"""

import importlib
import json
import multiprocessing
import shlex
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import av
from generated import Contents, generate
from measure import measure
from report import header

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.lerobot.layout import Video
from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.utils import cli
from dpmacro.utils.files import replacing

GOAL = 0.8  # of PyAV's rate
OURS = "dpmacro"
WAYS = {
    OURS: "reading.read",
    "PyAV, libav's threads": "reading.decode_files",
    "PyAV, threads": "reading.decode_in_threads",
    "PyAV, processes": "reading.decode_in_processes",
}

Part = tuple[str, int, int | None]  # of a file: its path, the first time stamp, and the first one beyond it


@dataclass(frozen=True)
class ReadOptions:
    """The dataset that is read."""

    root: Path | None = None
    """Folder of a LeRobot dataset with videos; by default one is generated."""
    episodes: list[int] | None = None
    """Episodes to read; PyAV decodes whole files all the same, so leave it out where ratios matter."""


@dataclass(frozen=True)
class ReadingOptions:
    """What to read, and how thoroughly to measure."""

    dataset: ReadOptions = field(default_factory=ReadOptions)
    generated: Path | None = None
    """Folder of the generated dataset; by default one in outputs, named by what it holds."""
    frames: int = 3000
    """Frames of the generated dataset, a picture of every camera at each."""
    cameras: int = 2
    """Cameras of the generated dataset."""
    size: tuple[int, int] = (640, 480)
    """Width and height of its pictures."""
    codec: str = "libsvtav1"
    """Its encoder, libsvtav1 or h264."""
    repeats: int = 5
    """Measurements of each that a median is over."""
    threads: int = 2
    """Cores that each may use."""
    output: Path = Path("outputs/reading.json")
    """Where the rows go."""

    def __post_init__(self) -> None:
        for name in ("repeats", "threads"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 or more")


def main(options: ReadingOptions) -> None:
    """Measure and print the table."""
    root = options.dataset.root
    if root is None:
        width, height = options.size
        contents = Contents(options.frames, options.cameras, width, height, options.codec)
        root = generate(options.generated or contents.folder, contents)
    files = videos(root)
    print("\n".join(header(shlex.join(["python", *sys.orig_argv[1:]]))), flush=True)
    found = rows(root, options.dataset.episodes, files, options.repeats, options.threads)
    with replacing(options.output) as temporary:
        temporary.write_text(json.dumps(found, indent=1) + "\n")
    print("\n".join(table(found)))


def rows(
    root: Path, episodes: Sequence[int] | None, files: Sequence[str], repeats: int, threads: int
) -> list[dict[str, Any]]:
    """For every way: its name, `rates` of all repeats in frames a second, `frames`, and the largest `gib`."""
    arguments: dict[str, dict[str, Any]] = {name: {"files": list(files)} for name in WAYS}
    arguments[OURS] = {"root": str(root), "episodes": episodes}
    results: dict[str, list[dict[str, Any]]] = {name: [] for name in WAYS}
    for _ in range(repeats):
        for name, function in WAYS.items():
            results[name].append(measure(function, {**arguments[name], "threads": threads}, threads))
    return [
        {
            "way": name,
            "rates": [one["frames"] / one["seconds"] for one in of_way],
            "frames": of_way[0]["frames"],
            "gib": max(one["gib"] for one in of_way),
        }
        for name, of_way in results.items()
    ]


def table(found: Sequence[dict[str, Any]]) -> list[str]:
    """A line for every way, and the ratio to the fastest of PyAV."""
    rates = {row["way"]: median(row["rates"]) for row in found}
    fastest = max((name for name in rates if name != OURS), key=rates.__getitem__)
    lines = [f"{'':<24} {'frames/s':>9} {'from':>7} {'to':>7} {'frames':>8} {'peak GiB':>9}"]
    lines += [
        f"{row['way']:<24} {rates[row['way']]:>9.0f} {min(row['rates']):>7.0f} {max(row['rates']):>7.0f} "
        f"{row['frames']:>8} {row['gib']:>9.2f}"
        for row in found
    ]
    of_fastest = next(row["rates"] for row in found if row["way"] == fastest)
    ours = next(row["rates"] for row in found if row["way"] == OURS)
    ratios = [one / other for one, other in zip(ours, of_fastest, strict=True)]
    lines.append(
        f"ratio to {fastest}: {median(ratios):.2f}, from {min(ratios):.2f} to {max(ratios):.2f} "
        f"({GOAL:.2f} is the goal)"
    )
    return lines


def videos(root: Path) -> list[str]:
    """The video files that the dataset's episodes lie in."""
    store = StoredDataset.open(root)
    found = [video for episode in store.episodes for video in episode.videos.values()]
    files = sorted({str(video.path) for video in found if isinstance(video, Video)})
    if not files:
        raise ValueError(f"dataset {root} has no video: give one that has, or none to have it generated")
    return files


def read(root: str, episodes: Sequence[int] | None, threads: int) -> dict[str, Any]:
    """Demonstrations of the dataset; `threads` is kept by the caller, who gives the process its cores."""
    importlib.import_module("pandas")  # which pyarrow imports when it first reads
    started = time.perf_counter()
    demonstrations = Demonstrations.load(root, episodes)
    seconds = time.perf_counter() - started
    return {
        "frames": sum(len(demonstrations.observations[one]) for one in demonstrations.cameras),
        "seconds": seconds,
    }


def decode_files(files: Sequence[str], threads: int) -> dict[str, Any]:
    """One file after the other, with libav's threads."""
    started, frames = time.perf_counter(), 0
    for path in files:
        with av.open(path) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            stream.codec_context.thread_count = threads
            frames += sum(1 for _ in container.decode(stream))
    return {"frames": frames, "seconds": time.perf_counter() - started}


def decode_in_threads(files: Sequence[str], threads: int) -> dict[str, Any]:
    """A thread for an equal part of every file."""
    with ThreadPoolExecutor(threads) as pool:
        return _decode_parts(pool, files, threads)


def decode_in_processes(files: Sequence[str], threads: int) -> dict[str, Any]:
    """A process likewise."""
    with ProcessPoolExecutor(threads, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(time.sleep, [0.5] * threads))  # all have started
        return _decode_parts(pool, files, threads)


def _decode_parts(pool: Executor, files: Sequence[str], threads: int) -> dict[str, Any]:
    parts = [part for path in files for part in _parts(path, threads)]
    started = time.perf_counter()
    frames = sum(pool.map(_decode_part, parts))
    return {"frames": frames, "seconds": time.perf_counter() - started}


def _parts(path: str, count: int) -> list[Part]:
    """The file cut at key frames."""
    with av.open(path) as container:
        stream = container.streams.video[0]
        keys = sorted({p.pts for p in container.demux(stream) if p.pts is not None and p.is_keyframe})
    starts = sorted({keys[len(keys) * k // count] for k in range(count)})
    ends: list[int | None] = [*starts[1:], None]
    return [(path, start, end) for start, end in zip(starts, ends, strict=True)]


def _decode_part(part: Part) -> int:
    path, start, end = part
    frames = 0
    with av.open(path) as container:
        stream = container.streams.video[0]
        stream.codec_context.thread_count = 1
        container.seek(start, stream=stream)
        for frame in container.decode(stream):
            if frame.pts is not None and end is not None and frame.pts >= end:
                break
            frames += frame.pts is None or frame.pts >= start
    return frames


if __name__ == "__main__":
    cli.run(main, ReadingOptions)
