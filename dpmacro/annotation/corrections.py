"""What people corrected: it overrides a segmentation, and training holds it fixed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64

from dpmacro.annotation.correction_files import CorrectedEpisode, CorrectionFile, read_corrections
from dpmacro.annotation.stages import Stages
from dpmacro.metrics import segments
from dpmacro.segmentation.given import FREE

__all__ = ["Corrections"]


@dataclass(frozen=True)
class Corrections:
    """Corrections of a segmentation, from the page's JSON or a table (see `load`).

    Attributes:
        path: of the file, for messages.
        file: what it says.
    """

    path: Path
    file: CorrectionFile

    @classmethod
    def load(cls, path: str | Path) -> "Corrections":
        """Read the JSON that the page saves, or a table *.csv or *.tsv as the export `csv` writes it.

        The JSON holds the demonstrations that a person changed, and what became of the others' stages. A
        table has a line for every segment, in the columns episode, start_frame, end_frame (excluded), label
        and perhaps start_s and source, in any order; others are not read. Its lines may stand in any order.

        Raises ValueError where the file is wrong, in a line that names the place, and OSError where it cannot
        be read.
        """
        return cls(Path(path), read_corrections(Path(path)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the stages that the file's segments have, as they are to be."""
        return self.file.names

    def apply(self, stages: Stages) -> Stages:
        """The stages with what a person said in place of what they were.

        Demonstrations that the page's JSON lists are corrected: of confidence 1. The others keep their cuts,
        their stages renamed or merged as the file says. Of a table, those demonstrations are corrected that
        differ from the stages, and those whose lines all have the source `person`. Where it lists all
        demonstrations, and all segments of a stage whose cuts are as they were have one new name, the stage
        is renamed and nothing corrected. Stages that nothing has any more are left out of a table's.

        Raises ValueError naming the place in the file where it does not fit the stages: a demonstration that
        they do not have, or of another length, or stages of another number; and where a table's line has
        frames as before and other seconds, since its seconds are not read.
        """
        names, renamed, changed = self._of(stages)
        frames = dict(zip(stages.episodes, _parts(stages.lengths), strict=True))
        labels = np.array(renamed, np.int64)[stages.labels]
        confidence, corrected = stages.confidence.copy(), stages.corrected.copy()
        for episode, own in changed.items():
            part = frames[episode]
            labels[part], confidence[part], corrected[part] = own, 1, True
        if self.file.renamed is None:
            used, labels = np.unique(labels, return_inverse=True)
            names = tuple(names[k] for k in used.tolist())
        return replace(
            stages, labels=labels.astype(np.int64), confidence=confidence, corrected=corrected, names=names
        )

    def of_stages(self, stages: Stages) -> dict[str, Any]:
        """What `apply` does to the stages as the page saves it, to go on from there.

        The names, what became of every stage, and the demonstrations that are corrected. A stage that nothing
        has any more keeps its name, since a correction may be taken back. Errors are those of `apply`.
        """
        names, renamed, changed = self._of(stages)
        return {
            "fps": stages.fps,
            "names": list(names),
            "renamed": [[old, new] for old, new in enumerate(renamed)],
            "episodes": [
                {
                    "episode": episode,
                    "frames": len(own),
                    "segments": [
                        {"start": start, "end": end, "label": label}
                        for label, start, end in segments(own, np.array([len(own)]))[0].tolist()
                    ],
                }
                for episode, own in changed.items()
            ],
        }

    def _of(
        self, stages: Stages
    ) -> tuple[tuple[str, ...], tuple[int, ...], dict[int, Int64[np.ndarray, " _"]]]:
        """Names, the place of every stage in them, and the labels of demonstrations that are corrected."""
        self.check(stages.episodes, stages.lengths, stages.fps)
        frames = dict(zip(stages.episodes, _parts(stages.lengths), strict=True))
        was = dict(zip(stages.episodes, segments(stages.labels, stages.lengths), strict=True))
        if self.file.renamed is None:
            names, renamed = self._of_table(stages.names, was)
        else:
            names, renamed = self.names, self.file.renamed
            if len(renamed) != len(stages.names):
                raise ValueError(
                    f"{self.path}, renamed is of {len(renamed)} stages: there are {len(stages.names)} here; "
                    "annotate with the options with which the page was made"
                )
        places = np.array([names.index(name) for name in self.names], np.int64)
        now, changed = np.array(renamed, np.int64), {}
        for one in self.file.episodes:
            part, own = frames[one.episode], places[_labels(one)]
            if one.ends == tuple(was[one.episode][:, 2].tolist()):
                self._check_seconds(one, stages.timestamps[part], stages.fps)
            if one.by_person or not np.array_equal(now[stages.labels[part]], own):
                changed[one.episode] = own
        return names, renamed, changed

    def given(
        self, episodes: Sequence[int], lengths: Int64[np.ndarray, " demonstrations"]
    ) -> Int64[np.ndarray, " frames"]:
        """What training is to hold fixed: of every frame the place of its stage in `names`, or -1.

        All demonstrations of the page's JSON, and of a table without the column source. Of a table with it,
        those whose lines all have the source `person`.

        Args:
            episodes: numbers of the demonstrations that are learned from.
            lengths: frames of each.

        Raises ValueError as `apply` does, and for a table in which no demonstration is a person's.
        """
        self.check(episodes, lengths)
        table = self.file.renamed is None
        held = [one for one in self.file.episodes if one.by_person or (table and not self.file.has_sources)]
        if table and not held:
            raise ValueError(
                f"{self.path}: no episode has the source 'person' in all its lines; write it there where you "
                "corrected, or leave the column source out to hold all"
            )
        frames = dict(zip(episodes, _parts(lengths), strict=True))
        labels = np.full(int(lengths.sum()), FREE, np.int64)
        for one in held:
            labels[frames[one.episode]] = _labels(one)
        return labels

    def check(
        self, episodes: Sequence[int], lengths: Int64[np.ndarray, " demonstrations"], fps: float | None = None
    ) -> None:
        """Raise ValueError for the first demonstration of the file that is not there or of another length.

        Args:
            episodes: numbers of the demonstrations that there are.
            lengths: frames of each.
            fps: frames a second, which are compared with the file's where both are known.
        """
        frames = dict(zip(episodes, lengths.tolist(), strict=True))
        for one in self.file.episodes:
            if one.episode not in frames:
                raise ValueError(
                    f"{one.places[0]}: there is no episode {one.episode} among the {len(frames)} read, "
                    f"{min(frames)} to {max(frames)}; give the dataset's own corrections, and read all of it"
                )
            if one.ends[-1] != frames[one.episode]:
                raise ValueError(
                    f"{one.places[-1]}: ends episode {one.episode} at {one.ends[-1]}, and it has "
                    f"{frames[one.episode]} frames; give the dataset's own corrections"
                )
        if fps is not None and self.file.fps is not None and abs(self.file.fps - fps) > 1e-3 * fps:
            raise ValueError(
                f"{self.path}, fps is {self.file.fps:g}: the dataset has {fps:g}; give the dataset's "
                "own corrections"
            )

    def _of_table(
        self, old: tuple[str, ...], was: dict[int, Int64[np.ndarray, "segments 3"]]
    ) -> tuple[tuple[str, ...], tuple[int, ...]]:
        """Names with what a table adds, and the place of every stage in them, some of which it renames."""
        new: list[set[str]] = [set() for _ in old]
        if len(self.file.episodes) == len(was):
            for one in self.file.episodes:
                stages, _, ends = was[one.episode].T.tolist()
                if one.ends == tuple(ends):
                    for stage, label in zip(stages, one.labels, strict=True):
                        new[stage].add(self.names[label])
        now = [found.pop() if len(found) == 1 else name for name, found in zip(old, new, strict=True)]
        names = tuple(dict.fromkeys([*now, *self.names]))
        return names, tuple(names.index(name) for name in now)

    def _check_seconds(self, one: CorrectedEpisode, timestamps: np.ndarray, fps: float) -> None:
        """Raise ValueError where a line of a table that changes nothing has other seconds than its frame."""
        for start, second, place in zip(one.starts, one.seconds, one.places, strict=True):
            if second is not None and not abs(second - timestamps[start]) <= 0.5 / fps:
                raise ValueError(
                    f"{place}: start_s is {second:g} and frame {start} is at {timestamps[start]:g} s; change "
                    "start_frame and end_frame, the seconds are not read"
                )


def _labels(one: CorrectedEpisode) -> Int64[np.ndarray, " frames"]:
    """Label of every frame, once the number of frames is known to be right."""
    return np.repeat(np.array(one.labels, np.int64), np.diff([0, *one.ends]))


def _parts(lengths: Int64[np.ndarray, " demonstrations"]) -> list[slice]:
    ends = np.cumsum(lengths).tolist()
    return [slice(end - length, end) for end, length in zip(ends, lengths.tolist(), strict=True)]
