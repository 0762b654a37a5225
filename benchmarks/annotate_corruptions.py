"""Damage a small dataset at random, annotate it, and count what comes of it: one line, or a right dataset.

    python benchmarks/annotate_corruptions.py --runs=100

Every run damages one file of a copy: bytes are flipped, it is cut, removed or replaced, a value of its JSON
or a cell, column or row of its table is changed. What datasets/annotate.py then does is one of

- `line`: exit status 2, one line that says what is wrong, and no new dataset;
- `right`: a new dataset with everything the damaged one has, and the labels of every frame;
- `wrong`: a new dataset that lacks something, one beside an error, or a damaged one that was written to;
- `traceback`: an error that is no message for users; `slow`: no end within a minute.
"""

import contextlib
import importlib.util
import io
import json
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from tqdm import tqdm

from dpmacro.annotation.exports.labelling import read_labels
from dpmacro.data.lerobot.compat import create_dataset, quiet
from dpmacro.utils import cli

SCRIPT = Path(__file__).resolve().parents[1] / "datasets/annotate.py"
LENGTHS = (14, 9, 12)
FPS = 10
SECONDS = 60  # that a run may take
IMAGE: dict[str, Any] = {"shape": (48, 64, 3), "names": ["height", "width", "channels"]}
FEATURES: dict[str, dict[str, Any]] = {
    "observation.images.front": {"dtype": "video", **IMAGE},
    "observation.images.top": {"dtype": "image", **IMAGE},
    "observation.state": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
    "action": {"dtype": "float32", "shape": (3,), "names": ["dx", "dy", "grip"]},
}
INPUTS = "[observation.state, observation.images.front, observation.images.top]"
SEARCH = ("--planner.macros=2", "--planner.rounds=3", "--planner.switch_rounds=3", "--planner.restarts=1")
ODD: tuple[Any, ...] = (None, "", "x", -1, 0, 2**70, 1e308, float("nan"), [], {}, [None], {"a": 1}, True)
ODD_CELLS: tuple[Any, ...] = (None, 0, -1, 10**6, 2**62, float("nan"), "x")
Damage = Callable[[Path, np.random.Generator], None]


@dataclass(frozen=True)
class CorruptionOptions:
    """How many datasets are damaged."""

    runs: int = 100
    """Number of damaged datasets."""
    seed: int = 0
    """Seed of the first; each has its own."""

    def __post_init__(self) -> None:
        if self.runs < 1 or self.seed < 0:
            raise ValueError(
                f"runs={self.runs}, seed={self.seed}: give 1 run or more, and a seed of 0 or more"
            )


@dataclass(frozen=True)
class Outcome:
    """What came of one damaged dataset: how it was damaged, one of the five words above, and the message."""

    damage: str
    file: str
    what: str
    message: str


def main(options: CorruptionOptions) -> None:
    """Damage, annotate, count."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        root, script = place / "whole", load_script()
        record(root)
        policy = train(script, root, place / "policy")
        found = []
        for seed in tqdm(range(options.seed, options.seed + options.runs), "Runs", unit="run"):
            found.append(outcome(script, root, policy, place / "run", np.random.default_rng(seed)))
            shutil.rmtree(place / "run")
            if found[-1].what not in ("line", "right"):
                one = found[-1]
                tqdm.write(f"seed {seed}: {one.damage} {one.file}: {one.what}\n{one.message}")
    print("\n".join(table(found)))


def table(found: list[Outcome]) -> list[str]:
    """A line for every way of damage with how often each outcome came of it."""
    whats = ("line", "right", "wrong", "traceback", "slow")
    lines = [f"{'damage':<22}" + "".join(f"{what:>10}" for what in whats)]
    for damage in [*sorted({one.damage for one in found}), "all"]:
        counts = Counter(one.what for one in found if damage in (one.damage, "all"))
        lines.append(f"{damage:<22}" + "".join(f"{counts[what]:>10}" for what in whats))
    return lines


def load_script() -> ModuleType:
    """The script datasets/annotate.py as a module; the pictures of its report are left out."""
    spec = importlib.util.spec_from_file_location("annotate_of_corruptions", SCRIPT)
    assert spec is not None and spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = script
    spec.loader.exec_module(script)
    vars(script)["pictures"] = lambda *_: iter(())
    return script


def record(root: Path) -> None:
    """A dataset of a video, images, a state and actions, as LeRobot itself writes it."""
    rng = np.random.default_rng(0)
    with quiet():
        dataset = create_dataset(root, FPS, FEATURES)
        for length in LENGTHS:
            for frame in range(length):
                late = frame >= length // 2
                images = {
                    name: np.full((48, 64, 3), 40 + 120 * late + 3 * frame, np.uint8)
                    for name in FEATURES
                    if "images" in name
                }
                values = {
                    "observation.state": rng.normal(size=2).astype(np.float32),
                    "action": (rng.normal(size=3) + 4 * late).astype(np.float32),
                }
                dataset.add_frame({**images, **values, "task": "bring it"})
            dataset.save_episode()
        dataset.finalize()


def train(script: ModuleType, root: Path, folder: Path) -> Path:
    """A policy that cuts the dataset in two."""
    options = (f"--dataset.root={root}", f"--dataset.inputs={INPUTS}", f"--output_dir={folder}", *SEARCH)
    status, text = call(script, *options)
    if status:
        raise ValueError(f"the whole dataset cannot be annotated: {text}")
    return folder / "training/checkpoints/last/pretrained_model"


def outcome(script: ModuleType, whole: Path, policy: Path, folder: Path, rng: np.random.Generator) -> Outcome:
    """Damage a copy of the dataset in `folder` and annotate it."""
    root, output = folder / "in", folder / "out"
    shutil.copytree(whole, root)
    files = sorted(path for path in root.rglob("*") if path.is_file())
    damage, file = DAMAGES[rng.integers(len(DAMAGES))], files[rng.integers(len(files))]
    damage(file, rng)
    before = contents(root)
    options = (f"--policy.path={policy}", f"--output={output}", f"--output_dir={folder / 'page'}")
    what, message = "traceback", ""
    try:
        with time_limit():
            status, message = call(script, f"--dataset.root={root}", *options)
            if status:
                one = status == cli.USAGE_ERROR and message.count("error: ") == 1 and not output.exists()
                what = "line" if one else "wrong"
            else:
                missing = lacking(root, output)
                what, message = ("wrong", missing) if missing else ("right", "")
    except TimeoutError:
        what = "slow"
    except Exception:
        message = traceback.format_exc()
    if what in ("line", "right") and contents(root) != before:
        what, message = "wrong", "the damaged dataset was written to"
    return Outcome(damage.__name__, file.relative_to(root).as_posix(), what, message)


@contextlib.contextmanager
def time_limit() -> Iterator[None]:
    """Raise TimeoutError in the block after so many seconds."""

    def late(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"no end in {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def call(script: ModuleType, *options: str) -> tuple[int, str]:
    """Exit status of the script, 0 for success, and the last line of what it wrote on stderr."""
    errors, arguments, status = io.StringIO(), sys.argv, 0
    sys.argv = [str(SCRIPT), *options]
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            cli.run(script.main, script.AnnotateOptions)
    except SystemExit as left:
        status = int(left.code or 0)
    finally:
        sys.argv = arguments
    lines = errors.getvalue().replace("\r", "\n").splitlines()
    return status, "\n".join(line for line in lines if line.startswith("error: "))


def contents(root: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {str(path): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def lacking(root: Path, output: Path) -> str:
    """What a new dataset lacks of the old one, or of its labels; "" for nothing."""
    stages = read_labels(output)
    if len(stages.labels) != sum(LENGTHS) or tuple(stages.lengths.tolist()) != LENGTHS:
        return f"labels of {stages.lengths.tolist()} frames for {list(LENGTHS)}"
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if not path.is_file() or name in ("meta/info.json", "meta/stats.json"):
            continue
        other = output / name
        if path.suffix == ".parquet" and name.startswith(("data/", "meta/episodes/")):
            old = pq.read_table(path)
            new = pq.read_table(other, columns=old.column_names)
            if str(old.to_pylist()) != str(new.to_pylist()):  # as text: NaN does not equal itself
                return f"{name} has other values"
        elif path.read_bytes() != other.read_bytes():
            return f"{name} has other bytes"
    return ""


def flip_bytes(path: Path, rng: np.random.Generator) -> None:
    content = bytearray(path.read_bytes())
    for place in rng.integers(0, len(content), rng.integers(1, 20)):
        content[place] ^= int(rng.integers(1, 256))
    path.write_bytes(content)


def zero_a_block(path: Path, rng: np.random.Generator) -> None:
    """What a file system leaves of a block that was never written."""
    content = bytearray(path.read_bytes())
    start = int(rng.integers(0, len(content)))
    end = min(len(content), start + int(rng.integers(1, 4096)))
    content[start:end] = bytes(end - start)
    path.write_bytes(content)


def cut_short(path: Path, rng: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(0, len(content))])


def empty(path: Path, rng: np.random.Generator) -> None:
    path.write_bytes(b"")


def remove(path: Path, rng: np.random.Generator) -> None:
    path.unlink()


def replace_by_folder(path: Path, rng: np.random.Generator) -> None:
    path.unlink()
    path.mkdir()


def replace_by_broken_link(path: Path, rng: np.random.Generator) -> None:
    path.unlink()
    path.symlink_to(path.parent / "nowhere")


def change_a_value(path: Path, rng: np.random.Generator) -> None:
    """A value of a JSON file, or a cell of a table, becomes an odd one; other files have bytes flipped."""
    if path.suffix == ".json":
        content = json.loads(path.read_text())
        at = content
        while isinstance(at, dict) and at:
            key = sorted(at)[rng.integers(len(at))]
            if not isinstance(at[key], dict) or rng.random() < 0.3:
                at[key] = ODD[rng.integers(len(ODD))]
                break
            at = at[key]
        path.write_text(json.dumps(content))
    elif path.suffix == ".parquet":
        table = pq.read_table(path)
        column = int(rng.integers(table.num_columns))
        values = table.column(column).to_pylist()
        values[rng.integers(len(values))] = ODD_CELLS[rng.integers(len(ODD_CELLS))]
        try:
            table = table.set_column(column, table.schema.field(column), [values])
        except (TypeError, ValueError):  # the type takes no such value
            table = table.remove_column(column)
        pq.write_table(table, path)
    else:
        flip_bytes(path, rng)


def drop_a_key_or_column(path: Path, rng: np.random.Generator) -> None:
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        pq.write_table(table.remove_column(int(rng.integers(table.num_columns))), path)
    elif path.suffix == ".json":
        at = content = json.loads(path.read_text())
        while rng.random() < 0.5 and any(isinstance(value, dict) and value for value in at.values()):
            inner = [value for _, value in sorted(at.items()) if isinstance(value, dict) and value]
            at = inner[rng.integers(len(inner))]
        del at[sorted(at)[rng.integers(len(at))]]
        path.write_text(json.dumps(content))
    else:
        cut_short(path, rng)


def change_rows(path: Path, rng: np.random.Generator) -> None:
    """Rows of a table are left out, come twice, or change places."""
    if path.suffix != ".parquet":
        return flip_bytes(path, rng)
    table = pq.read_table(path)
    count = max(len(table) + int(rng.integers(-2, 3)), 0)
    return pq.write_table(table.take(rng.integers(0, len(table), count)), path)


DAMAGES: tuple[Damage, ...] = (
    flip_bytes,
    flip_bytes,
    zero_a_block,
    cut_short,
    empty,
    remove,
    replace_by_folder,
    replace_by_broken_link,
    change_a_value,
    change_a_value,
    change_a_value,
    drop_a_key_or_column,
    change_rows,
)


if __name__ == "__main__":
    cli.run(main, CorruptionOptions)
