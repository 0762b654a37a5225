"""Demonstrations of any length that look like an arm's: vectors as actions, a state, cameras that move.

An arm of seven numbers reaches, carries and leaves, again and again. A camera shows a part of one textured
picture, which the arm's first two numbers move and the third scales: all pixels change at every frame.
Videos have the settings of LeRobot's own encoder, so decoding takes as long as that of what LeRobot records.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from lerobot_files import NUMBERS, vector, write_rows, write_table

__all__ = ["Contents", "generate"]

DIMS = 7
FPS = 30
STAGES = (0.4, 0.4, 0.2)  # of an episode: reach, carry, leave
EPISODES_A_FILE = 25  # of a video: LeRobot fills files of about 200 MB
ENCODERS: dict[str, dict[str, str]] = {  # key frames and quality as LeRobot sets them, the fastest presets
    "libsvtav1": {"g": "2", "crf": "30", "preset": "12"},
    "h264": {"g": "2", "crf": "30", "preset": "ultrafast"},
}
MADE = "generated.json"  # what a folder holds, written last


@dataclass(frozen=True)
class Contents:
    """What a generated dataset holds.

    Attributes:
        frames: of all episodes together.
        cameras: number of them.
        width: of the pictures, in pixels.
        height: likewise.
        codec: that encodes the videos, a key of ENCODERS.
        length: frames an episode, the last one's up to half as many more.
        seed: of the targets that the arm moves to, and of the picture.
    """

    frames: int
    cameras: int = 2
    width: int = 640
    height: int = 480
    codec: str = "libsvtav1"
    length: int = 300
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in {"frames": 4, "cameras": 0, "width": 16, "height": 16, "length": 4}.items():
            if getattr(self, name) < least:
                raise ValueError(f"{name} is {getattr(self, name)}: give {least} or more")
        if self.width % 2 or self.height % 2:
            raise ValueError(f"pictures are {self.width}x{self.height}: give even numbers of pixels")
        if self.codec not in ENCODERS:
            raise ValueError(f"codec is {self.codec!r}: choose from {', '.join(ENCODERS)}")

    @property
    def folder(self) -> Path:
        """Where it lies unless another folder is given."""
        what = (self.frames, self.cameras, f"{self.width}x{self.height}", self.codec, self.length)
        return Path("outputs") / "_".join(map(str, ("generated", *what)))

    @property
    def lengths(self) -> list[int]:
        """Frames of every episode."""
        count = max(round(self.frames / self.length), 1)
        ends = [round(self.frames * k / count) for k in range(count + 1)]
        return [end - start for start, end in pairwise(ends)]


def generate(root: Path, contents: Contents) -> Path:
    """The dataset in the folder `root`, made unless it is there already.

    Raises ValueError where the folder holds anything else.
    """
    if root.exists():
        made = root / MADE
        holds = json.loads(made.read_text()) if made.is_file() else "another dataset, or none"
        if holds != asdict(contents):
            raise ValueError(f"{root} holds {holds}, asked for is {asdict(contents)}: give a new folder")
        return root
    os.environ.setdefault("SVT_LOG", "1")  # errors only
    with _new_folder(root) as folder:
        states, actions = _moves(contents)
        _write_tables(folder, contents, states, actions)
        for camera in range(contents.cameras):
            _write_videos(folder, contents, camera, states)
        (folder / MADE).write_text(json.dumps(asdict(contents)) + "\n")
    return root


@contextmanager
def _new_folder(root: Path) -> Iterator[Path]:
    """A folder beside `root` that gets its name on leaving, and goes where the body raises."""
    folder = root.with_name(f".{root.name}-{os.getpid()}")
    folder.mkdir(parents=True)
    try:
        yield folder
        folder.rename(root)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _moves(
    contents: Contents,
) -> tuple[Float64[np.ndarray, "frames dims"], Float64[np.ndarray, "frames dims"]]:
    """States, each number from 0 to 1, and actions, which are velocities towards the stage's target."""
    rng = np.random.default_rng(contents.seed)
    states, actions = [], []
    state = rng.uniform(0.2, 0.8, DIMS)
    for length in contents.lengths:
        targets = rng.uniform(0.1, 0.9, (len(STAGES), DIMS))
        targets[:, -1] = [0.9, 0.1, 0.9]  # the gripper closes on the way
        stage = np.searchsorted(np.cumsum(STAGES)[:-1] * length, np.arange(length), "right")
        for target in targets[stage]:
            action = 0.06 * (target - state) + rng.normal(0, 0.002, DIMS)
            states.append(state)
            actions.append(action)
            state = np.clip(state + action, 0, 1)
    return np.array(states), np.array(actions)


def _write_tables(folder: Path, contents: Contents, states: np.ndarray, actions: np.ndarray) -> None:
    lengths = np.array(contents.lengths)
    starts = np.cumsum(lengths) - lengths
    frame_index = np.arange(contents.frames) - np.repeat(starts, lengths)
    columns = {
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "frame_index": frame_index,
        "index": np.arange(contents.frames),
        "timestamp": (frame_index / FPS).astype(np.float32),
        "task_index": np.zeros(contents.frames, np.int64),
        "action": actions.astype(np.float32),
        "observation.state": states.astype(np.float32),
    }
    write_table(folder / "data/chunk-000/file-000.parquet", columns)
    rows = []
    for episode, (start, length) in enumerate(zip(starts.tolist(), lengths.tolist(), strict=True)):
        first = starts[episode - episode % EPISODES_A_FILE]
        row = {"episode_index": episode, "tasks": ["carry"], "length": length}
        row |= {"dataset_from_index": start, "dataset_to_index": start + length}
        row |= {f"{of}/{part}_index": 0 for of in ("data", "meta/episodes") for part in ("chunk", "file")}
        for camera in range(contents.cameras):
            of = f"videos/{_key(camera)}"
            row |= {f"{of}/chunk_index": 0, f"{of}/file_index": episode // EPISODES_A_FILE}
            row |= {f"{of}/from_timestamp": float(start - first) / FPS}
            row |= {f"{of}/to_timestamp": float(start - first + length) / FPS}
        rows.append(row)
    write_rows(folder / "meta/episodes/chunk-000/file-000.parquet", rows)
    write_rows(folder / "meta/tasks.parquet", [{"task_index": 0, "task": "carry"}])
    (folder / "meta/info.json").write_text(json.dumps(_info(contents)))
    (folder / "meta/stats.json").write_text("{}")


def _info(contents: Contents) -> dict[str, Any]:
    pictures = {
        "dtype": "video",
        "shape": [contents.height, contents.width, 3],
        "names": ["height", "width", "channels"],
    }
    joints = [f"joint_{k}" for k in range(DIMS - 1)] + ["gripper"]
    return {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": len(contents.lengths),
        "total_frames": contents.frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "fps": FPS,
        "splits": {"train": f"0:{len(contents.lengths)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": {
            **NUMBERS,
            "timestamp": vector(1),
            "action": vector(DIMS, names=joints),
            "observation.state": vector(DIMS, names=joints),
            **{_key(camera): pictures for camera in range(contents.cameras)},
        },
    }


def _write_videos(folder: Path, contents: Contents, camera: int, states: np.ndarray) -> None:
    """The camera's files, each of EPISODES_A_FILE episodes."""
    picture = _texture(contents, camera)
    ends = np.cumsum(contents.lengths)[EPISODES_A_FILE - 1 :: EPISODES_A_FILE].tolist()
    for number, part in enumerate(np.split(states, ends)):
        if not len(part):
            break
        path = folder / f"videos/{_key(camera)}/chunk-000/file-{number:03d}.mp4"
        path.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(path), "w") as container:
            stream: Any = container.add_stream(contents.codec, FPS, options=ENCODERS[contents.codec])
            stream.width, stream.height, stream.pix_fmt = contents.width, contents.height, "yuv420p"
            stream.time_base = Fraction(1, FPS)
            stream.codec_context.thread_count = 1
            for pts, state in enumerate(part):
                frame = av.VideoFrame.from_ndarray(_view(picture, state, contents), "rgb24")
                frame.pts, frame.time_base = pts, Fraction(1, FPS)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))


def _texture(contents: Contents, camera: int) -> UInt8[np.ndarray, "height width 3"]:
    """Patches of all sizes, twice as wide and high as what is seen of them."""
    rng = np.random.default_rng([contents.seed, camera])
    size = (2 * contents.width, 2 * contents.height)
    layers = [rng.uniform(0, 255, (4 * 3**k, 5 * 3**k, 3)).astype(np.float32) for k in range(4)]
    return np.mean(np.stack([cv2.resize(layer, size) for layer in layers]), axis=0).astype(np.uint8)


def _view(
    picture: UInt8[np.ndarray, "high wide 3"], state: np.ndarray, contents: Contents
) -> UInt8[np.ndarray, "height width 3"]:
    scale = 1 + 0.3 * state[2]
    width, height = int(contents.width * scale), int(contents.height * scale)
    left = int(state[0] * (picture.shape[1] - width))
    top = int(state[1] * (picture.shape[0] - height))
    part = picture[top : top + height, left : left + width]
    return cv2.resize(part, (contents.width, contents.height), interpolation=cv2.INTER_LINEAR)


def _key(camera: int) -> str:
    return f"observation.images.camera_{camera}"
