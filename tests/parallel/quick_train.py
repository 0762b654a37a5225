"""train.py as the tests run it under torchrun: quick, and with a rank that dies if DIES names it."""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

import train
from dpmacro.boosting import crossfit
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
    return computed(self, name, compute)


if __name__ == "__main__":
    TrainingPictures.show = lambda *given: None
    crossfit.CLASSES = replace(crossfit.CLASSES, shared=12, own=12)
    crossfit.VECTORS = replace(crossfit.VECTORS, shared=12, own=12)
    Stages.run = dying
    cli.run(train.main, TrainOptions)
