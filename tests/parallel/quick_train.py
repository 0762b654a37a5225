"""train.py as the tests run it: quick, and with a rank that dies if DIES names it.

One that STOPS names is stopped, as by Ctrl-Z, and writes its number to a file beforehand.
"""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

import train
from dpmacro.boosting import crossfit
from dpmacro.parallel import heartbeat
from dpmacro.training.options import TrainOptions
from dpmacro.training.pictures import TrainingPictures
from dpmacro.utils import cli
from dpmacro.utils.stages import Stages

DIES_AT = 3  # stages that are begun

computed = Stages.run


def dying(self, name, compute):
    if (
        self._number == DIES_AT - 1
        and self.rounds is None
        and os.environ.get("DIES", "") == os.environ.get("RANK")
    ):
        os.kill(os.getpid(), signal.SIGKILL)
    rank, _, file = os.environ.get("STOPS", "none:").partition(":")
    if rank == os.environ.get("RANK", "0") and self._number == DIES_AT - 1 and self.rounds is None:
        Path(file).write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGSTOP)
    return computed(self, name, compute)


if __name__ == "__main__":
    TrainingPictures.show = lambda *given: None
    crossfit.CLASSES = replace(crossfit.CLASSES, shared=12, own=12)
    crossfit.VECTORS = replace(crossfit.VECTORS, shared=12, own=12)
    Stages.run = dying
    if "STOPS" in os.environ:
        heartbeat.BEAT, heartbeat.SILENCE = 0.5, 4.0
    cli.run(train.main, TrainOptions)
