"""The finished runs of an evaluation, kept on disk one by one."""

import hashlib
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from dpmacro.evaluation.journal import Journal
from dpmacro.evaluation.run_lines import episode_of, line_of
from dpmacro.worlds.base import Episode

__all__ = ["RUNS", "KeptEpisodes", "policy_digest"]

RUNS = "runs.jsonl"
"""The file's name, beside eval_info.json."""


class KeptEpisodes:
    """The runs of an evaluation: those that an earlier call has finished, and those of this one.

    Attributes:
        path: the file.
        episodes: runs of the first seeds, in the order of `seeds`.
        earlier: how many of them were there at the start.
        seconds: that all of them took.
        unwritten: what went wrong where a run could not be kept; runs after it are kept in memory alone.

    Args:
        folder: of the evaluation.
        about: what decides how runs end: the policy, the world, the seeds.
        seeds: of all runs.

    Raises ValueError, one line, where the folder's runs are those of another evaluation, or damaged.
    """

    def __init__(self, folder: Path, about: Mapping[str, Any], seeds: Sequence[int]) -> None:
        remedy = "give another --output_dir"
        self.path = folder / RUNS
        self.unwritten: OSError | None = None
        self.episodes: list[Episode] = []
        self.seconds = 0.0
        self._journal = Journal(self.path, about, remedy)
        for number, line in enumerate(self._journal.lines, 2):
            try:
                self.episodes.append(episode_of(line))
                self.seconds += _seconds(line)
            except ValueError as error:
                raise ValueError(f"{self.path}, line {number}: {error}; {remedy}") from error
        if [episode.seed for episode in self.episodes] != list(seeds[: len(self.episodes)]):
            raise ValueError(f"{self.path}: its seeds are not one after the other; {remedy}")
        self.earlier = len(self.episodes)
        self._since = time.perf_counter()

    def add(self, episode: Episode) -> None:
        """Keep a run, the one of the next seed. A full disk ends the keeping, and not the evaluation."""
        seconds = time.perf_counter() - self._since
        self._since += seconds
        self.seconds += seconds
        self.episodes.append(episode)
        if self.unwritten is None:
            try:
                self._journal.add(line_of(episode) | {"seconds": seconds})
            except OSError as error:
                self.unwritten = error

    def drop_if_empty(self) -> None:
        """Remove the file where it holds no run, and its folder where that holds nothing else."""
        if not self.episodes:
            with suppress(OSError):  # the folder holds something
                self.path.unlink(missing_ok=True)
                self.path.parent.rmdir()


def policy_digest(folder: Path | None) -> str | None:
    """Alike for saved policies that act alike, wherever they lie; None for no policy."""
    if folder is None:
        return None
    from dpmacro.policy.files import CONFIG_NAME
    from dpmacro.policy.policy import WEIGHTS_NAME

    digest = hashlib.sha256()
    for name in (CONFIG_NAME, WEIGHTS_NAME):
        with (folder / name).open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


def _seconds(line: Mapping[str, Any]) -> float:
    seconds = line.get("seconds")
    if type(seconds) is not float or not 0 <= seconds < 1e9:
        raise ValueError(f"seconds is {str(seconds)[:60]!r}: a number from 0 on was written")
    return seconds
