"""What a cell of Table I needs: demonstrations, a policy and its runs, made where they are not there yet.

<folder>/data/random_0/                               demonstrations; cells learn from the first of them
<folder>/train/random_0_dpboost-2_20/                 a policy
<folder>/eval/random_0_dpboost-2_20/10000-10049/      its runs in some worlds

What is there stays, whatever the commit that made it: where the method has changed, remove what it made.
Where two trainings end in the same policy, bit for bit, as they do where macro-actions that do not pay are
merged away, the runs of one are those of the other.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from table_cells import PLANNERS, Cell
from table_jobs import Job, forget, read_stamp, run
from tqdm import tqdm

from dpmacro.data.lerobot.reader import WORLD_FILE
from dpmacro.worlds.two_flags.env import PIXELS

__all__ = ["CHUNK", "Runs", "chunks", "work"]

CHUNK = 50  # runs that an interrupt loses at most


@dataclass
class Runs:
    """Cells' runs in a folder.

    Attributes:
        folder: holds data/, train/ and eval/.
        workers: processes that record and run.
        threads: of every script.
        commit: of the code, for stamps.
        needed: dataset -> its demonstrations.
        bar: moves on by an episode for every run and for every demonstration recorded or trained on.
    """

    folder: Path
    workers: int
    threads: int
    commit: str
    needed: dict[str, int]
    bar: tqdm
    recorded: set[str] = field(default_factory=set)

    def outcomes(self, cell: Cell) -> tuple[dict[int, str], list[dict[str, Any]]]:
        """World -> outcome for all worlds of the cell, and the stamps of its training and of its runs.

        Raises ChildProcessError with one line where a script fails, ValueError where the folder's
        demonstrations are not the cell's.
        """
        trained = []
        if cell.train_seed is not None:
            self._record(cell)
            trained = [self._train(cell)]
        self._evaluate(cell)
        found, stamps = self._found(cell)
        return {seed: found[seed] for seed in cell.worlds}, [*trained, *stamps]

    def _record(self, cell: Cell) -> None:
        if cell.data in self.recorded:
            return
        root, count = self.folder / "data" / cell.data, self.needed[cell.data]
        held = _demonstrations(root, cell)
        if held < count:
            if held:
                tqdm.write(f"{root} holds {held} demonstrations of {count}: all are recorded anew")
            options = (*cell.record_options, f"--episodes={count}")
            others = (f"--root={root}", f"--workers={self.workers}")
            self._run(Job(f"recording {cell.data}", "datasets/record.py", root, options, others, count))
        else:
            self.bar.update(count)
        self.recorded.add(cell.data)

    def _train(self, cell: Cell) -> dict[str, Any]:
        folder, options = self.folder / "train" / cell.policy, cell.train_options
        stamp = read_stamp(folder)
        if stamp is not None and stamp["options"] == options:
            self.bar.update(cell.demonstrations)
            return stamp
        if stamp is not None:
            tqdm.write(f"{cell.policy} was trained by other options ({stamp['command']}): training it anew")
        shutil.rmtree(self.folder / "eval" / cell.policy, ignore_errors=True)  # runs of the policy that goes
        forget(folder)
        others = (f"--dataset.root={self.folder / 'data' / cell.data}", f"--output_dir={folder}")
        stamp = self._run(Job(f"training {cell.policy}", "train.py", folder, tuple(options), others))
        self.bar.update(cell.demonstrations)
        return stamp

    def _evaluate(self, cell: Cell) -> None:
        found, _ = self._found(cell)
        missing = [seed for seed in cell.worlds if seed not in found]
        self.bar.update(cell.episodes - len(missing))
        if cell.train_seed is None:
            planner = ["--policy.type=teacher", f"--world.flags={cell.flags}"]
            planner += ["--world.render_size=[{},{}]".format(*PIXELS)]
        else:
            policy = self.folder / "train" / cell.policy / "checkpoints/last/pretrained_model"
            planner = [f"--policy.path={policy}", *PLANNERS[cell.planner].run_options]
        for seeds in chunks(missing):
            folder = self._runs(cell, cell.policy) / f"{seeds[0]}-{seeds[-1]}"
            options = (*planner, f"--seed={seeds[0]}", f"--episodes={len(seeds)}")
            others = (f"--output_dir={folder}", f"--workers={self.workers}")
            self._run(Job(f"running {cell.name}", "eval.py", folder, options, others, len(seeds)))

    def _found(self, cell: Cell) -> tuple[dict[int, str], list[dict[str, Any]]]:
        """World -> outcome, for those of the cell's worlds that were run already; and these runs' stamps."""
        outcomes: dict[int, str] = {}
        stamps = []
        for info in (info for runs in self._twins(cell) for info in sorted(runs.glob("*/eval_info.json"))):
            stamp = read_stamp(info.parent)
            if stamp is not None:
                section = json.loads(info.read_text())["dpmacro"]
                ended = dict(zip(section["seeds"], section["outcomes"], strict=True))
                wanted = {seed: ended[seed] for seed in cell.worlds if seed in ended and seed not in outcomes}
                if wanted:
                    outcomes |= wanted
                    stamps.append(stamp)
        return outcomes, stamps

    def _twins(self, cell: Cell) -> list[Path]:
        """Where runs of the cell's policy are, its own folder first."""
        own = self._runs(cell, cell.policy)
        if cell.train_seed is None:
            return [own]
        policy = fingerprint(self.folder / "train" / cell.policy)
        others = (path for path in sorted((self.folder / "train").iterdir()) if path.is_dir())
        twins = [path.name for path in others if path.name != cell.policy and fingerprint(path) == policy]
        return [own, *(self._runs(cell, name) for name in twins)]

    def _runs(self, cell: Cell, policy: str) -> Path:
        """Where the policy's runs by the cell's planner are, those of other options of eval.py deeper."""
        folder = self.folder / "eval" / policy
        return folder / cell.planner if PLANNERS[cell.planner].run_options else folder

    def _run(self, job: Job) -> dict[str, Any]:
        self.bar.set_description(job.doing)
        start = self.bar.n
        stamp = run(job, self.commit, self.threads, lambda done: self._move_to(start + done))
        self._move_to(start + (job.episodes or 0))
        return stamp

    def _move_to(self, place: int) -> None:
        self.bar.update(place - self.bar.n)


def chunks(seeds: Sequence[int]) -> Iterator[list[int]]:
    """Rising seeds in runs of consecutive ones, each within 50 from a multiple of 50 on."""
    chunk: list[int] = []
    for seed in seeds:
        if chunk and (seed != chunk[-1] + 1 or seed % CHUNK == 0):
            yield chunk
            chunk = []
        chunk.append(seed)
    if chunk:
        yield chunk


# What only cuts demonstrations.
NO_SAY_IN_RUNS = ("max_transitions", "switch_weight", "change_log_odds")


def fingerprint(training: Path) -> str | None:
    """Of all that decides what a policy does in its world; None where the training has left none."""
    policy = training / "checkpoints/last/pretrained_model"
    if read_stamp(training) is None:
        return None
    config = json.loads((policy / "config.json").read_text())
    planner = config.get("planner", config)  # policies of earlier versions hold nothing else
    told = {name: value for name, value in planner.items() if name not in NO_SAY_IN_RUNS}
    return hashlib.sha256(
        json.dumps(told, sort_keys=True).encode() + (policy / "model.safetensors").read_bytes()
    ).hexdigest()


def work(plan: Sequence[Cell], needed: dict[str, int]) -> int:
    """Total of the bar: runs, and demonstrations recorded and trained on."""
    return sum(needed.values()) + sum(cell.demonstrations + cell.episodes for cell in plan)


def _demonstrations(root: Path, cell: Cell) -> int:
    """How many demonstrations a dataset holds; 0 where there is none.

    Raises ValueError where they are of another world.
    """
    info = root / "meta/info.json"
    if not info.exists():
        return 0
    world = json.loads((root / WORLD_FILE).read_text())["world"]
    for name, value in (("flags", cell.flags), ("render_size", list(cell.render_size))):
        if world[name] != value:
            raise ValueError(f"{root} was recorded with {name}={world[name]}, not {value}: remove it")
    return json.loads(info.read_text())["total_episodes"]
