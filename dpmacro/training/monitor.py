"""What a training shows while it runs: a progress bar for every stage, and TensorBoard scalars."""

import sys
import time

import torch
from jaxtyping import Int64
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from dpmacro.boosting.loop import Round
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.metrics import frame_accuracy
from dpmacro.segmentation.segments import transition_counts

__all__ = ["Monitor"]

STAGES = {  # names on the bars
    "discover": "Segmenting",
    "validate": "Boosting, some left out",
    "score": "Scoring segmentations",
    "recognise": "Recognising changes",
    "fit": "Boosting",
    "switch": "Switch functions",
}


class Monitor:
    """Turns the rounds of a training into a progress bar and TensorBoard scalars; without a writer into none.

    Where several numbers of macro-actions are tried, `setting` names one in tags and on the bar: "Q3_S2".
    """

    def __init__(
        self, writer: SummaryWriter | None, demonstrations: Demonstrations, macros: int, setting: str = ""
    ) -> None:
        self._writer = writer
        self._setting = setting
        self._demonstrations = demonstrations
        self._macros = macros
        self._bar: tqdm | None = None
        self._clock = time.perf_counter()
        self._before: dict[str, int] = {}  # rounds of a stage in its earlier turns
        self._steps: dict[str, int] = {}
        self._told: set[tuple[str, int]] = set()  # stages and problems that were told to have ended

    def on_round(self, report: Round) -> None:
        """Log one boosting round of DPBoost."""
        if self._writer is None:
            return
        stage = f"{report.stage}_{self._setting}" if self._setting else report.stage
        if report.number == 1:
            self._before[stage] = self._steps.get(stage, 0)
            self._start_bar(report)
        step = self._steps[stage] = self._before[stage] + report.number
        now = time.perf_counter()
        scalars = {
            f"loss/{stage}": report.loss,
            f"accuracy/{stage}": report.accuracy,
            f"time/{stage}_seconds_per_round": now - self._clock,
        }
        if report.labels is not None:
            scalars.update(self._segmentation(stage, report.labels.cpu()))
            scalars[f"segmentation/{stage}/label_changes"] = report.label_changes
        for name, value in scalars.items():
            self._writer.add_scalar(name, value, step)
        for problem in report.ended:
            if (stage, problem) in self._told:
                continue
            self._told.add((stage, problem))
            name = "switch function" if report.stage == "switch" else "macro-action"
            line = f"{STAGES[report.stage]}: {name} {problem} ends in round {report.number}, "
            line += "nothing beats chance"
            self._writer.add_text(f"boosting/{stage}", line, step)
            tqdm.write(line, file=sys.stderr)
        self._clock = now
        assert self._bar is not None
        self._bar.set_postfix_str(f"loss {report.loss:.4f}")
        self._bar.update()

    def close(self) -> None:
        """Finish the bar."""
        if self._bar is not None:
            self._bar.close()

    def _start_bar(self, report: Round) -> None:
        self.close()
        name = f"{STAGES[report.stage]} {self._setting.replace('_', ' ')}".rstrip()
        self._bar = tqdm(desc=name, total=report.total, unit="round")
        self._clock = time.perf_counter()

    def _segmentation(self, stage: str, labels: Int64[Tensor, " frames"]) -> dict[str, float]:
        lengths = torch.from_numpy(self._demonstrations.lengths)
        n_segments = int(transition_counts(labels, lengths).sum()) + len(lengths)
        values = {"mean_segment_frames": len(labels) / n_segments}
        for macro in range(self._macros):
            values[f"occupancy_{macro}"] = float((labels == macro).float().mean())
        if self._demonstrations.truth is not None:
            values["agreement_with_truth"] = frame_accuracy(labels.numpy(), self._demonstrations.truth)
        return {f"segmentation/{stage}/{name}": value for name, value in values.items()}
