import os
import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from dpmacro.utils import interrupts


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupt_acts_when_the_block_is_left():
    handler = signal.getsignal(signal.SIGINT)
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.held_back():
        interrupt()
        interrupt()
        done.append("all of it")
    assert done and signal.getsignal(signal.SIGINT) is handler


def test_an_error_is_not_hidden_by_an_interrupt():
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="mine"), interrupts.held_back():
        interrupt()
        raise ValueError("mine")
    assert signal.getsignal(signal.SIGINT) is handler


def test_blocks_may_be_nested():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.held_back():
        with interrupts.held_back():
            interrupt()
        done.append("the outer one")
    assert done


@pytest.fixture
def unhandled():
    """SIGTERM as a new process has it, whatever tests before have left."""
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGTERM, before)


def test_a_signal_that_ends_is_held_back_and_raised_likewise(unhandled):
    done = []
    with pytest.raises(KeyboardInterrupt) as caught, interrupts.terminating():
        with interrupts.held_back():
            os.kill(os.getpid(), signal.SIGTERM)
            done.append("all of it")
        done.append("not reached")
    assert done == ["all of it"] and caught.value.number == signal.SIGTERM and str(caught.value) == "SIGTERM"
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_signal_that_something_else_handles_is_left_to_it():
    told = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: told.append(number))
    try:
        with interrupts.terminating():
            os.kill(os.getpid(), signal.SIGTERM)
        assert told == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)


def test_other_threads_pass_through():
    def hold():
        with interrupts.held_back():
            return signal.getsignal(signal.SIGINT)

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(hold).result() is signal.getsignal(signal.SIGINT)
