"""Which ranks are given up: those that do not count any more, and none that is busy or has left."""

import os
import time
from contextlib import ExitStack
from datetime import timedelta

import pytest
import torch.distributed as dist

from dpmacro.parallel import heartbeat

QUICK = 0.02  # seconds from one count to the next


@pytest.fixture
def store(monkeypatch):
    """Where ranks of this process meet."""
    store = dist.TCPStore("127.0.0.1", 0, is_master=True, timeout=timedelta(seconds=10))
    monkeypatch.setenv("MASTER_ADDR", "127.0.0.1")
    monkeypatch.setenv("MASTER_PORT", str(store.port))
    monkeypatch.setattr(heartbeat, "BEAT", QUICK)
    monkeypatch.setattr(heartbeat, "SILENCE", 15 * QUICK)
    return store


@pytest.fixture
def ended(monkeypatch):
    """Why ranks have ended, in place of their end."""
    why = []

    def end(heart, told):
        why.append((heart._rank, told))
        heart.leaves.set()

    monkeypatch.setattr(heartbeat._Heart, "_end", end)
    return why


def heard(rank, size=2):
    return heartbeat.heard_of(rank, size, lambda: None)


def waits(until, seconds=10.0):
    end = time.monotonic() + seconds
    while not until() and time.monotonic() < end:
        time.sleep(QUICK)
    return until()


def test_ranks_that_count_are_not_given_up(store, ended):
    with ExitStack() as stack:
        for rank in range(3):
            stack.enter_context(heard(rank, 3))
        end, total = time.monotonic() + 60 * QUICK, 0
        while time.monotonic() < end:  # busy with Python, which other threads interrupt
            total += 1
    assert not ended


def test_a_rank_that_counts_no_more_is_given_up_by_all_others(store, ended):
    with heard(0, 3), heard(1, 3):
        assert waits(lambda: len(ended) == 2)
    told = "rank 2 has not been heard of for 0.3 s"
    assert sorted(ended) == [(0, told), (1, told)]


def test_a_rank_that_leaves_is_not_waited_for(store, ended):
    with heard(0):
        with heard(1):
            time.sleep(5 * QUICK)
        time.sleep(60 * QUICK)
    assert not ended


def test_a_place_to_meet_that_does_not_answer_is_given_up(store, ended, monkeypatch):
    monkeypatch.setattr(dist.TCPStore, "add", lambda *given: time.sleep(100 * QUICK) or 1)
    with heard(0):
        assert waits(lambda: ended)
    assert ended[0] == (0, "the process in which ranks meet has not answered for 0.3 s")


def test_a_place_to_meet_that_has_ended_ends_no_rank(store, ended, monkeypatch):
    def lost(*given):
        raise RuntimeError("Connection reset by peer")

    monkeypatch.setattr(dist.TCPStore, "add", lost)
    with heard(0):
        time.sleep(40 * QUICK)
    assert not ended


def test_the_process_ends_with_a_line(store, monkeypatch, capfd):
    """It cleans up before."""
    done = []
    monkeypatch.setattr(os, "_exit", done.append)
    heart = heartbeat._Heart(1, 4, store, lambda: done.append("cleaned"))
    heart._end("rank 2 has not been heard of for 120 s")
    assert done == ["cleaned", 2]
    assert capfd.readouterr().err == (
        "\nerror: rank 1 of 4 ends since rank 2 has not been heard of for 120 s: it is stopped, or its "
        "machine is; train.py goes on by --resume=true\n"
    )
