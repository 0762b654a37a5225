"""What a training shows while it runs: a progress bar for every stage, and TensorBoard scalars."""

import functools
import sys
import time

import torch
from jaxtyping import Int64
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from dpmacro.boosting import Round
from dpmacro.demonstrations import Demonstrations
from dpmacro.metrics import frame_accuracy
from dpmacro.segmentation import transition_counts

__all__ = ["Monitor"]

STAGES = {  # names on the bars
    "discover": "Segmenting",
    "validate": "Boosting, some left out",
    "judge": "Judging segmentations",
    "recognise": "Recognising changes",
    "fit": "Boosting",
    "switch": "Switch functions",
}


class Monitor:
    """Turns the rounds of a training into a progress bar and TensorBoard scalars."""

    def __init__(self, writer: SummaryWriter, demonstrations: Demonstrations, macros: int) -> None:
        self._writer = writer
        self._demonstrations = demonstrations
        self._macros = macros
        self._bar: tqdm | None = None
        self._clock = time.perf_counter()

    def on_round(self, report: Round) -> None:
        """Log one boosting round of DPBoost."""
        self._advance(report.stage, report.number, report.total, report.loss)
        if report.labels is not None:
            self._log_segmentation(report.stage, report.number, report.labels.cpu())
            changes = f"segmentation/{report.stage}/label_changes"
            self._writer.add_scalar(changes, report.label_changes, report.number)
        self._writer.add_scalar(f"accuracy/{report.stage}", report.accuracy, report.number)
        for problem in report.ended:
            name = "switch function" if report.stage == "switch" else "macro-action"
            stage = STAGES[report.stage]
            line = f"{stage}: {name} {problem} ends in round {report.number}, nothing beats chance"
            self._writer.add_text(f"boosting/{report.stage}", line, report.number)
            tqdm.write(line, file=sys.stderr)

    def _log_segmentation(self, stage: str, number: int, labels: Int64[Tensor, " frames"]) -> None:
        lengths = torch.from_numpy(self._demonstrations.lengths)
        log = functools.partial(self._writer.add_scalar, global_step=number)
        n_segments = int(transition_counts(labels, lengths).sum()) + len(lengths)
        log(f"segmentation/{stage}/mean_segment_frames", len(labels) / n_segments)
        for macro in range(self._macros):
            share = float((labels == macro).float().mean())
            log(f"segmentation/{stage}/occupancy_{macro}", share)
        if self._demonstrations.truth is not None:
            agreement = frame_accuracy(labels.numpy(), self._demonstrations.truth)
            log(f"segmentation/{stage}/agreement_with_truth", agreement)

    def close(self) -> None:
        """Finish the bar."""
        if self._bar is not None:
            self._bar.close()

    def _advance(self, stage: str, number: int, total: int, loss: float) -> None:
        if number == 1:
            self.close()
            self._bar = tqdm(desc=STAGES[stage], total=total, unit="round")
            self._clock = time.perf_counter()
        now = time.perf_counter()
        self._writer.add_scalar(f"loss/{stage}", loss, number)
        self._writer.add_scalar(f"time/{stage}_seconds_per_round", now - self._clock, number)
        self._clock = now
        assert self._bar is not None
        self._bar.set_postfix_str(f"loss {loss:.4f}")
        self._bar.update()
