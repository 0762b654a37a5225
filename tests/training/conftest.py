"""What the tests of trainings share: they look at what is connected to what, not at what is found."""

import functools
import inspect

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
        patch.setattr(crossfit, "SHARED_ROUNDS", 12)
        patch.setattr(crossfit, "OWN_ROUNDS", 12)
        yield
