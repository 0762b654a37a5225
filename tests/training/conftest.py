"""What the tests of trainings share: they look at what is connected to what, not at what is found."""

import functools
import inspect
from dataclasses import replace

import pytest

from dpmacro.boosting import crossfit


@pytest.fixture(scope="package", autouse=True)
def sources_are_read_once():
    """The parser of options reads the source of their classes for every option, in every call of a script."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inspect, "getsource", functools.cache(inspect.getsource))
        yield


@pytest.fixture(scope="package", autouse=True)
def candidates_are_scored_quickly():
    """Most of a small training's time goes into the left-out scores of its candidates."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("CLASSES", "VECTORS"):
            quick = replace(getattr(crossfit, name), shared=12, own=12)
            patch.setattr(crossfit, name, quick)
        yield
