"""Work spread over real processes."""

import functools
import itertools
import os
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import closing

import pytest

from dpmacro.utils.processes import spread, stopped


def squared(number):
    return number * number


def failing(number):
    if number == 2:
        raise ValueError("two is not allowed")
    return number


def told(_):
    return os.getpid(), stopped()


def waited(seconds, number):
    time.sleep(seconds * (3 - number % 4))
    return number


def test_results_come_in_order():
    assert list(spread(functools.partial(waited, 0.02), range(8), 2)) == list(range(8))


def test_items_may_be_endless():
    with closing(spread(squared, itertools.count(), 2)) as results:
        assert list(itertools.islice(results, 5)) == [0, 1, 4, 9, 16]


def test_what_a_task_raises_is_raised_here():
    with pytest.raises(ValueError, match="two is not allowed"):
        list(spread(failing, range(4), 2))


def test_at_least_one_process():
    with pytest.raises(ValueError, match="workers is 0"):
        spread(squared, [1], 0)


def test_tasks_run_elsewhere_and_are_waited_for():
    [(process, over)] = spread(told, [None], 1)
    assert process != os.getpid()
    assert not over
    assert not stopped()


def test_workers_end_with_their_parent(tmp_path):
    script = tmp_path / "endless.py"
    script.write_text(
        textwrap.dedent(
            """
            import os, time
            from dpmacro.utils.processes import spread

            def named(_):
                return os.getpid()

            if __name__ == "__main__":
                print(*spread(named, range(4), 2), flush=True)
                for _ in spread(time.sleep, [60, 60], 2):
                    pass
            """
        )
    )
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    parent.stdout.readline()
    time.sleep(1)
    children = subprocess.run(["pgrep", "-P", str(parent.pid)], capture_output=True, text=True).stdout.split()
    assert children
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    deadline = time.monotonic() + 10
    while any(running(int(child)) for child in children):
        assert time.monotonic() < deadline, "a worker outlived its parent"
        time.sleep(0.1)


def running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True
