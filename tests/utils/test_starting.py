"""Signals while a script's libraries are imported, while it works, and while it starts processes."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = ("train.py", "eval.py", "datasets/record.py", "datasets/annotate.py")


def run(tmp_path, name, code, **more):
    """A process in front, as a terminal has it, that has printed "there"."""
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(textwrap.dedent(code))
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    process = subprocess.Popen(
        [sys.executable, *more.pop("arguments", [path])], env=environment, **pipes, **more
    )
    assert process.stdout is not None and process.stdout.readline() == "there\n"
    return process


@pytest.mark.parametrize("script", SCRIPTS)
def test_an_interrupt_while_libraries_are_imported_is_one_line(tmp_path, script):
    slow = """
        import time
        print("there", flush=True)
        try:
            time.sleep(100)
        except KeyboardInterrupt as error:  # as some libraries do
            raise ImportError("cannot be imported") from error
        """
    process = run(tmp_path, "numpy/__init__.py", slow, arguments=[ROOT / script])
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=20) == ("", "interrupted\n")
    assert process.returncode == 130


WORKS = """
    if __name__ == "__main__":
        import dpmacro.utils.starting
    import time
    from dataclasses import dataclass
    from pathlib import Path
    from dpmacro.utils import cli
    from dpmacro.utils.claims import claimed
    from dpmacro.utils.files import replacing
    @dataclass
    class Options:
        pass
    def main(options):
        cli.hold(claimed(Path("run")))
        with replacing(Path("run/half.txt")) as path:
            path.write_text("half")
            print("there", flush=True)
            time.sleep(100)
    if __name__ == "__main__":
        cli.run(main, Options)
    """


@pytest.mark.parametrize(
    ("number", "status", "line"),
    [
        (signal.SIGINT, 130, "interrupted"),
        (signal.SIGTERM, 143, "ended by SIGTERM"),
        (signal.SIGHUP, 129, "ended by SIGHUP"),
    ],
)
def test_signals_clean_up_alike(tmp_path, number, status, line):
    heeding = {"preexec_fn": lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL)}  # under nohup, too
    process = run(tmp_path, "script/script.py", WORKS, cwd=tmp_path, **heeding)
    assert [path.name[:5] for path in (tmp_path / "run").iterdir() if path.suffix == ".txt"] == [".half"]
    process.send_signal(number)
    assert process.communicate(timeout=20) == ("", f"{line}\n")
    assert process.returncode == status and not (tmp_path / "run").exists()


def test_what_ignores_hangups_goes_on_ignoring_them(tmp_path):
    ignoring = {"preexec_fn": lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)}
    process = run(tmp_path, "script/script.py", WORKS, cwd=tmp_path, **ignoring)
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=20)[1] == "ended by SIGTERM\n"


def test_an_interrupt_of_all_processes_while_workers_start_is_one_line(tmp_path):
    code = """
        if __name__ in ("__main__", "__mp_main__"):
            import dpmacro.utils.starting
        import time
        from dataclasses import dataclass
        from dpmacro.utils import cli
        from dpmacro.utils.processes import spread
        if __name__ == "__mp_main__":
            open("starts", "a").write("x")
            time.sleep(1)
        @dataclass
        class Options:
            pass
        def main(options):
            print("there", flush=True)
            for _ in spread(abs, range(9), 2):
                pass
        if __name__ == "__main__":
            cli.run(main, Options)
        """
    process = run(tmp_path, "script.py", code, cwd=tmp_path, start_new_session=True)
    while not (tmp_path / "starts").exists():
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=30) == ("", "interrupted\n")
    assert process.returncode == 130
