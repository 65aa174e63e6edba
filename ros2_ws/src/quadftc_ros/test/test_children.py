"""Processes of a launcher: all of them end, none but them, and the worst exit code counts."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from node_bench import PATIENCE
from quadftc_ros.children import Children

# says that it runs by making a file, after being deaf for a moment as one that is still importing
GOOD = """
import signal, sys, time
from pathlib import Path
time.sleep(0.2)
signal.signal(signal.SIGINT, lambda *_: sys.exit({code}))
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
Path({file!r}).touch()
time.sleep(60)
"""


def python(text):
    return [sys.executable, "-c", text]


def wait_for(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "nothing happened in time"
        time.sleep(0.01)


def alive(pid):
    """Whether a process runs; one that has ended but was not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def children():
    made = Children()
    yield made
    made.stop(0.0)


def test_all_end_by_the_signal_and_the_worst_exit_code_counts(children, tmp_path):
    files = {code: tmp_path / str(code) for code in (0, 3, 1)}
    children.start({str(c): python(GOOD.format(code=c, file=str(file))) for c, file in files.items()})
    wait_for(lambda: all(file.exists() for file in files.values()))
    assert children.ended() == {}
    assert children.stop() == 3
    assert children.ended() == {"0": 0, "3": 3, "1": 1}


def test_signal_is_not_lost_on_one_that_cannot_hear_yet(children, tmp_path):
    children.start({"late": python(GOOD.format(code=5, file=str(tmp_path / "late")))})
    assert children.stop() == 5  # by its own handler


def test_one_that_does_not_listen_is_killed(children):
    children.start({"deaf": python("import time; time.sleep(60)")})  # signals stay blocked in it
    assert children.stop(0.1) == 128 + signal.SIGKILL


def test_one_that_ended_before_keeps_its_exit_code(children):
    children.start({"short": python("raise SystemExit(2)")})
    wait_for(children.ended)
    assert children.ended() == {"short": 2}
    assert children.stop() == 2


def test_one_that_a_signal_ended_counts_as_shells_count(children):
    children.start({"killed": python("import os, signal; os.kill(os.getpid(), signal.SIGKILL)")})
    wait_for(children.ended)
    assert children.stop() == 128 + 9


def test_processes_of_others_are_left_alone(children, tmp_path):
    with subprocess.Popen(python("import time; time.sleep(60)")) as other:
        children.start({"own": python(GOOD.format(code=0, file=str(tmp_path / "own")))})
        children.stop()
        assert other.poll() is None
        other.kill()


def test_program_that_is_not_there_leaves_the_others_to_be_stopped(children, tmp_path):
    with pytest.raises(FileNotFoundError):
        children.start({"good": python("import time; time.sleep(60)"), "bad": ["/nowhere/node"]})
    pid = children.process_ids()["good"]
    assert children.stop(0.1) == 128 + signal.SIGKILL
    assert not alive(pid)


def test_starting_leaves_the_signals_of_this_process_as_they_were(children, tmp_path):
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    children.start({"one": python("pass")})
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before
