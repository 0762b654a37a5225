"""How feature columns are held in the memory there is.

A level takes a byte a column and frame, its place in the sorted order four more. Where sorted columns do not
fit, levels alone are held and boosting sorts as many random columns as fit, drawn anew every few rounds;
where the levels of all columns do not fit either, random columns are left out. Switch functions take more
where they learn from mirror images: the levels once more, and those of the mirror images.
"""

import math
from dataclasses import dataclass

__all__ = ["DRAWN", "GATHERED", "GIB", "LEAST_COLUMNS", "LIBRARIES", "SAMPLED", "VALUES", "Demand", "Plan"]

GIB = 2**30  # bytes
LIBRARIES = 0.65 * GIB  # what a process holds before it has seen a frame
VALUES = 2**26  # feature values that are computed and quantised at a time
GATHERED = 2**29  # bytes of observations that are copied at a time to compute values
SAMPLED = 20_000  # frames that choose the cuts, evenly spaced, where there are more
SORTED = 4  # bytes of a frame's place in a column's order
DRAWN = SORTED + 1  # bytes of a frame in a column that is sorted when it is drawn, from a copy of its levels
LEAST_COLUMNS = 512  # as many as judging a segmentation searches


@dataclass(frozen=True)
class Demand:
    """What training asks of memory.

    Attributes:
        n_frames: number of frames in all demonstrations.
        frame_bytes: bytes of one frame of everything seen.
        n_columns: number of feature columns.
        table_bytes: bytes that scores, losses and weights of one frame take while classifiers are boosted.
        copies: mirror images of every frame whose columns switch functions learn from, too; 0 or 1.
        switch_bytes: bytes of one frame while switch functions are boosted, after the classifiers: scores,
            losses, weights, sorted columns and mirror images.
        always: number of columns that are never left out, those without pixels.
        inputs: number of keys that are seen.
        ranks: number of processes that hold a share of the columns each.
    """

    n_frames: int
    frame_bytes: int
    n_columns: int
    table_bytes: int
    copies: int = 0
    switch_bytes: int = 0
    always: int = 0
    inputs: int = 1
    ranks: int = 1

    @property
    def remedies(self) -> str:
        """What else makes it less, as the end of a sentence."""
        found = ["leave out some --dataset.inputs"] if self.inputs > 1 else []
        if self.always < self.n_columns:
            found.append("shrink images by --dataset.image_size")
        return ", ".join([*found, "or take fewer --dataset.episodes"])


@dataclass(frozen=True)
class Plan:
    """How the feature columns are held.

    Attributes:
        columns: number of columns that are kept.
        of: number of columns that there were to choose from.
        drawn: number of columns that a boosting round searches at most; 0 for all, which are held sorted.
        gibibytes: estimated peak of the memory that training takes, in GiB; that of every rank.
    """

    columns: int
    of: int
    drawn: int
    gibibytes: float

    @classmethod
    def fitting(cls, demand: Demand, limit: float) -> "Plan":
        """The richest plan within `limit` GiB: first all columns sorted, then all columns, then most of them.

        At least `LEAST_COLUMNS` are kept, and all that are never left out. Raises ValueError with the least
        limit, and what else would do, where there is no room for these.
        """
        n_frames, n_columns = demand.n_frames, demand.n_columns
        fixed = LIBRARIES + n_frames * demand.frame_bytes
        gathered = min(2 * min(n_frames, SAMPLED) * demand.frame_bytes, GATHERED)
        quantising = gathered + 4 * min(VALUES, n_columns * n_frames)
        ranks = demand.ranks
        boosting = n_frames * demand.table_bytes
        switching = n_frames * demand.switch_bytes
        copied = 1 + demand.copies if demand.copies else 0  # the frames' own levels are copied, too

        def most(columns: int, drawn: int) -> float:
            """Of the plan; all columns are sorted where `drawn` is 0."""
            columns, drawn = math.ceil(columns / ranks), math.ceil(drawn / ranks)
            order = 0 if drawn else SORTED * columns
            then = boosting + DRAWN * drawn * n_frames, switching + copied * columns * n_frames
            return (fixed + columns * n_frames + max(quantising, order * n_frames + max(then))) / GIB

        if (whole := most(n_columns, 0)) <= limit:
            return cls(n_columns, n_columns, 0, whole)
        least = min(LEAST_COLUMNS, n_columns)
        fewest = max(least, demand.always)
        if most(fewest, least) > limit:
            raise ValueError(
                f"memory_limit is {limit:g} GiB: {n_frames} frames need {most(fewest, least):.2f} GiB at "
                f"least: give that, {demand.remedies}"
            )
        room = limit * GIB - fixed
        kept = (
            int(
                ranks * (room - max(quantising, boosting + DRAWN * -(-least // ranks) * n_frames)) / n_frames
            ),
            int(ranks * (room - switching) / ((1 + copied) * n_frames)),
        )
        columns = min(max(min(kept), fewest), n_columns)
        drawn = int((ranks * (room - boosting) - columns * n_frames) / (DRAWN * n_frames))
        drawn = min(max(drawn, least), columns)
        return cls(columns, n_columns, drawn, most(columns, drawn))
