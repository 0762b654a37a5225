"""train.py as torchrun starts it: any number of ranks trains the same policy, and one that dies ends all."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.training.test_train import TINY

SCRIPT = Path(__file__).with_name("quick_train.py")
LAST = "checkpoints/last/pretrained_model"
FOUND = ("model.safetensors", "config.json", "../training_state/segmentation.safetensors")


def started(size, **faults):
    """The command that starts so many ranks, but for their arguments, and its environment."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc_per_node={size}"]
    # Ranks meet on this machine's loopback: its host name may be known to nobody.
    loopback = next(name for _, name in socket.if_nameindex() if name.startswith("lo"))
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": loopback}
    environment |= {name.upper(): str(value) for name, value in faults.items()}
    return [*command, str(SCRIPT)], environment


def torchrun(size, *arguments, **faults):
    """What so many ranks print on stdout and stderr, their exit status, and the seconds they took."""
    command, environment = started(size, **faults)
    began = time.monotonic()
    done = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, env=environment, timeout=300
    )
    return done.stdout, done.stderr, done.returncode, time.monotonic() - began


def found(run):
    return [(run / LAST / name).read_bytes() for name in FOUND]


@pytest.fixture(scope="module")
def options(recorded):
    return [f"--dataset.root={recorded}", *TINY, "--dataset.image_size=[32,24]", "--save_freq=3"]


@pytest.fixture(scope="module")
def one(options, tmp_path_factory):
    """The run of one rank."""
    run = tmp_path_factory.mktemp("runs") / "one"
    _, error, status, _ = torchrun(1, *options, f"--output_dir={run}")
    assert status == 0, error
    return run


def test_ranks_train_the_policy_of_one(options, one, tmp_path):
    out, error, status, _ = torchrun(3, *options, f"--output_dir={tmp_path / 'three'}")
    assert status == 0, error
    assert found(tmp_path / "three") == found(one)
    assert out.count("objective ") == 1 and "3 ranks, " in out


def test_a_rank_that_dies_ends_all_and_others_go_on(options, one, tmp_path):
    run = tmp_path / "run"
    _, error, status, seconds = torchrun(2, *options, f"--output_dir={run}", dies=1)
    assert status != 0 and seconds < 60
    told = [line for line in error.splitlines() if line.startswith(("error: rank 0", "ended by"))]
    assert len(told) == 1, error
    assert list((run / "checkpoints/000000/training_state/stages").glob("*.pt"))
    going_on = [f"--config_path={run / LAST / 'train_config.json'}", "--resume=true"]
    _, error, status, _ = torchrun(3, *going_on)
    assert status == 0, error
    assert found(run) == found(one)


def test_a_rank_that_is_stopped_ends_all(options, tmp_path):
    command, environment = started(2, stops=f"1:{tmp_path / 'pid'}")
    run = tmp_path / "run"
    with subprocess.Popen(
        [*command, *options, f"--output_dir={run}"], stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        told = next(line for line in iter(process.stderr.readline, "") if line.startswith("error: rank"))
        os.kill(int((tmp_path / "pid").read_text()), signal.SIGCONT)  # which torchrun has told to end
        process.communicate(timeout=100)
    assert process.returncode != 0
    assert told == (
        "error: rank 0 of 2 ends since rank 1 has not been heard of for 4 s: it is stopped, or its machine "
        "is; train.py goes on by --resume=true\n"
    )
    assert list((run / "checkpoints/000000/training_state/stages").glob("*.pt"))


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ("--dataset.root=nowhere", "error: dataset nowhere: no such folder"),
        ("--planner.macros=9999", "error: planner.macros is 9999"),
    ],
)
def test_what_is_wrong_is_said_once(options, wrong, line, tmp_path):
    _, error, status, _ = torchrun(2, *options, f"--output_dir={tmp_path / 'run'}", wrong)
    assert status != 0
    said = [one for one in error.splitlines() if one.startswith("error: ") and "another rank" not in one]
    assert len(said) == 1 and said[0].startswith(line), error
    assert not (tmp_path / "run").exists()
