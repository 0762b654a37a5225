"""The page's data read back, and small stages to put on it."""

import json
import re
from base64 import b64decode

import cv2
import numpy as np

from dpmacro.annotation.stages import Stages

DATA = re.compile(r'<script type="application/json" id="data">(.*?)</script>', re.DOTALL)


def data_of(document):
    """What the script reads; fails unless there is one such element."""
    (text,) = DATA.findall(document)
    return json.loads(text)


def labels_of(runs, frames):
    """Labels frame by frame."""
    ends = [start for start, _ in runs[1:]] + [frames]
    return np.concatenate(
        [np.full(end - start, label) for (start, label), end in zip(runs, ends, strict=True)]
    )


def marked(stretches, frames):
    result = np.zeros(frames, bool)
    for start, end in stretches:
        assert 0 <= start < end <= frames
        result[start:end] = True
    return result


def numbers(base64, dtype=np.uint8):
    return np.frombuffer(b64decode(base64), dtype)


def picture(sheet, place):
    """One picture of a sheet, RGB."""
    kind, data = sheet["source"].split(",", 1)
    assert kind == "data:image/webp;base64"
    image = cv2.cvtColor(cv2.imdecode(np.frombuffer(b64decode(data), np.uint8), 1), cv2.COLOR_BGR2RGB)
    row, column = divmod(place, sheet["columns"])
    top, left = row * sheet["height"], column * sheet["width"]
    return image[top : top + sheet["height"], left : left + sheet["width"]]


def some_stages(lengths=(60, 40, 50), names=("reach", "grasp", "carry"), fps=10.0, seed=None, episodes=None):
    """Every demonstration in equal parts, one for each stage; the later demonstrations are less sure."""
    lengths = np.asarray(lengths, np.int64)
    n_frames = int(lengths.sum())
    labels = np.concatenate([np.arange(length) * len(names) // length for length in lengths])
    sure = np.repeat(np.linspace(1, 0.5, len(lengths)), lengths)
    idle, corrected = np.zeros(n_frames, bool), np.zeros(n_frames, bool)
    idle[5:15] = True
    corrected[: lengths[0] // 2] = True
    timestamps = np.concatenate([np.arange(length) / fps for length in lengths])
    if seed is not None:
        rng = np.random.default_rng(seed)
        labels, sure = rng.integers(0, len(names), n_frames), rng.random(n_frames)
        idle, corrected = rng.random((2, n_frames)) < 0.3
        timestamps = timestamps + rng.random(n_frames)
    episodes = tuple(range(len(lengths))) if episodes is None else episodes
    return Stages(labels, sure, idle, corrected, tuple(names), lengths, episodes, timestamps, fps)


def coloured(frames):
    """Images that tell their frame: red rises by frames, green by every tenth, blue is constant."""
    for frame in frames.tolist():
        yield np.full((24, 32, 3), (40 + 4 * (frame % 50), 200 - 3 * (frame // 10), 90), np.uint8)
