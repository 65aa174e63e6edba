"""Commands that are stopped, killed or run twice, disks that take nothing, a clock that is set back."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from hypothesis import settings
from sampling import sampled

from attack.flight_table import hover
from attack.logs import ulog
from attack.seeds import SCENARIO
from quadftc_bags.bag import read_bag
from quadftc_cli.commands import BAD_INPUT, CHECK_FAILED, GOOD, INTERNAL, INTERRUPTED, NOT_ENOUGH

TRIALS = max(1, settings().max_examples // 40)  # of each command; with --examples 400 ten
PATIENCE, SOON = 120.0, 30.0  # s; until a command is done, until one that is stopped has ended
LONGEST = 6.0  # s until a command is stopped
ENDS = (GOOD, CHECK_FAILED, NOT_ENOUGH, INTERRUPTED)
COMMANDS = {
    "run": ["run", "s.yaml", "--out", "out"],
    "run in real time": ["run", "s.yaml", "--mode", "realtime", "--set", "duration=20 s", "--out", "out"],
    "check": ["check", "s.yaml"],
    "diagnose": ["diagnose", "log.ulg", "--out", "out"],
    "campaign": ["campaign", "c.yaml", "--out", "out", "--workers", "2"],
    "serve": ["serve", "--folder", "served", "--no-browser", "--port", "0"],
    "live": ["live", "--no-browser", "--port", "0"],
    "watch": ["watch"],
    "list": ["list", "faults"],
    "tune": ["tune", "c.yaml", "--out", "tuned.yaml"],
    "doctor": ["doctor"],  # 1 where something is missing
}
CAMPAIGN = b"""\
name: tiny_campaign
description: three chunks of short flights
scenario: tiny.yaml
flights: 90
schemes: [conventional]
vary: {faults.0.value: {uniform: [0.5 deg, 5 deg], sign: random}}
tune: {gains: [controller.k_c2], cost: {tracking_rmse_deg: 1}, flights: 2, steps: 2, rate: 0.05, held_out: 2}
"""
EACH = """
import sys
from quadftc_cli.main import guarded
for command in sys.argv[1:]:
    print(f"{command}: {guarded([*command.split(), '--out', 'disk/out'])}")
"""
SHIM = Path(__file__).parent / "support" / "attack" / "clock_shim.c"


@pytest.fixture
def work(tmp_path):
    for name, data in (("s.yaml", SCENARIO), ("tiny.yaml", SCENARIO), ("c.yaml", CAMPAIGN)):
        (tmp_path / name).write_bytes(data)
    (tmp_path / "log.ulg").write_bytes(ulog(hover()))
    return tmp_path


def start(work: Path, arguments: list[str], **more) -> subprocess.Popen:
    """Start ``quadftc`` with temporary files of its own, as the leader of a group."""
    temporary = work / "temporary"
    temporary.mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "quadftc_cli.main", *arguments],
        cwd=work,
        env=os.environ | {"TMPDIR": str(temporary)} | more.pop("env", {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        **more,
    )


def descendants(process: subprocess.Popen) -> list[psutil.Process]:
    return psutil.Process(process.pid).children(recursive=True)


@pytest.mark.parametrize("name", sampled(COMMANDS, every=5))
def test_command_interrupted_twice_ends_and_leaves_nothing(name, work):
    chance = random.Random(name)
    for _ in range(TRIALS):
        for old in ("out", "served", "tuned.yaml"):
            path = work / old
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
        after, between = chance.uniform(0.0, LONGEST), chance.choice((0.0, 0.01, 0.2, 1.0))
        with start(work, COMMANDS[name]) as process:
            time.sleep(after)
            children = descendants(process) if process.poll() is None else []
            for _ in range(2):  # as a terminal does: to all of the group
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGINT)
                    time.sleep(between)
            said, _ = process.communicate(timeout=SOON)
        how = f"{name}: twice after {after:.2f} s, {between} s apart: {process.returncode}\n{said[-2000:]}"
        starting = process.returncode == -signal.SIGINT or "Could not import runpy" in said
        if not starting:  # else Python itself was still starting, and says so
            assert process.returncode in ENDS, how
            assert "Traceback" not in said, how
        psutil.wait_procs(children, timeout=10.0)
        assert [child for child in children if child.is_running() and child.status() != "zombie"] == [], how
        assert list((work / "temporary").iterdir()) == [], how


def finish(work: Path, arguments: list[str], **more) -> tuple[int, str]:
    with start(work, arguments, **more) as process:
        said, _ = process.communicate(timeout=2 * PATIENCE)
    assert "Traceback" not in said
    return process.returncode, said


FLOWN = ["campaign", "c.yaml", "--workers", "2", "--out"]


@pytest.mark.thorough
def test_worker_that_is_killed_costs_no_flight(work):
    assert finish(work, [*FLOWN, "whole"])[0] in (GOOD, CHECK_FAILED)
    expected = (work / "whole" / "flights.parquet").read_bytes()
    killed = 0
    for trial in range(TRIALS):
        out = work / f"killed{trial}"
        with start(work, [*FLOWN, out.name]) as process:
            deadline = time.monotonic() + PATIENCE
            while time.monotonic() < deadline and process.poll() is None and killed <= trial:
                workers = [each for each in descendants(process) if is_worker(each)]
                if workers and (out / "chunks").is_dir():
                    random.Random(trial).choice(workers).kill()
                    killed += 1
                time.sleep(0.05)
            said, _ = process.communicate(timeout=2 * PATIENCE)
        assert "Traceback" not in said
        if process.returncode not in (GOOD, CHECK_FAILED):  # said so; what was flown is kept
            assert process.returncode == INTERNAL, said
            assert finish(work, [*FLOWN, out.name, "--resume"])[0] in (GOOD, CHECK_FAILED)
        assert (out / "flights.parquet").read_bytes() == expected
    assert killed == TRIALS, "no worker was there to be killed"


def is_worker(process: psutil.Process) -> bool:
    try:
        return "multiprocessing" in " ".join(process.cmdline()) and "spawn_main" in " ".join(
            process.cmdline()
        )
    except psutil.Error:
        return False


@pytest.mark.thorough
def test_second_campaign_in_a_folder_is_refused_while_the_first_flies(work):
    assert finish(work, [*FLOWN, "whole"])[0] in (GOOD, CHECK_FAILED)
    with start(work, [*FLOWN, "out"]) as first:
        deadline = time.monotonic() + PATIENCE
        while not (work / "out" / "campaign.json").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        for more in ([], ["--resume"]):
            code, said = finish(work, [*FLOWN, "out", *more])
            assert code == BAD_INPUT, said
            assert "out: " in said
        assert first.wait(PATIENCE) in (GOOD, CHECK_FAILED)
    whole, flown = (work / name / "flights.parquet" for name in ("whole", "out"))
    assert flown.read_bytes() == whole.read_bytes()


def test_disk_that_can_only_be_read_is_said_in_a_line(work):
    probe = subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False)
    if probe.returncode:
        pytest.skip("only root can mount a disk")
    disk = work / "disk"
    disk.mkdir()
    commands = ["run s.yaml", "diagnose log.ulg", "campaign c.yaml"]
    mount = f'mount -t tmpfs -o ro none "{disk}" && exec "$@"'
    command = ["unshare", "-m", "sh", "-c", mount, "-", sys.executable, "-c", EACH, *commands]
    done = subprocess.run(command, cwd=work, capture_output=True, text=True, check=False)
    wanted = [f"{each}: {BAD_INPUT}" for each in commands]
    assert [line for line in done.stdout.splitlines() if line.startswith((*commands,))] == wanted, done
    assert "Traceback" not in done.stderr
    said = done.stderr.splitlines()
    assert sum(each.startswith("error: ") and "Read-only file system" in each for each in said) == 3, said
    assert len(said) < 9


@pytest.mark.thorough
def test_clock_that_is_set_back_by_an_hour_in_flight_changes_nothing(work):
    if (compiler := shutil.which("cc") or shutil.which("gcc")) is None:
        pytest.skip("there is no compiler for the clock that is set back")
    shim, when = work / "shim.so", work / "set_back"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", SHIM, "-o", shim, "-ldl"], check=True)
    env = {"LD_PRELOAD": str(shim), "QUADFTC_SET_BACK": str(when)}
    flight = ["run", "s.yaml", "--scheme", "conventional", "--mode", "realtime", "--out", "out"]
    flight += ["--set", "duration=6 s"]
    with start(work, flight, env=env) as process:
        bags = work / "out"
        deadline = time.monotonic() + PATIENCE
        while not list(bags.rglob("*.mcap")) and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.05)
        time.sleep(3.0)
        when.touch()
        said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode in (GOOD, CHECK_FAILED), said
    assert "Traceback" not in said
    bag = read_bag(next(iter(sorted(path.parent for path in bags.rglob("*.mcap")))), ["plant/attitude"])
    series = bag.series("plant/attitude")
    times = series.stamp_ns
    assert ((times[1:] - times[:-1]) > 0).all(), "stamps went back"
    assert len(times) > 0.9 * 6 * 250
