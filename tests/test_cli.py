"""The quadftc command: what it writes, what it says, and how it exits."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
import yaml

from command_bench import Done, call_quadftc, installed_command, run_installed
from quadftc_bags.bag import read_bag
from quadftc_cli.main import guarded

SCENARIO = """\
name: tiny
description: half a second with a fault
duration: 0.5 s
rate: 250 Hz
seed: 3
vehicle: qball_x4
sensors: {grade: ideal}
faults:
  - {kind: bias, channel: attitude, axes: roll, value: 1 deg, start: 0.2 s}
schemes:
  proposed:
    observer: sliding_mode
    disturbance_observer: exosystem
    controller: ismc
    checks:
      - {metric: tracking_rmse_deg, below: 0.1}
  conventional:
    observer: none
    disturbance_observer: none
    controller: smc
    checks:
      - {metric: tracking_max_deg, axis: roll, below: 0.01}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The present directory, with a scenario."""
    (tmp_path / "tiny.yaml").write_text(SCENARIO, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> tuple[Path, Done]:
    """A folder with a run by the installed command, and what that said."""
    folder = tmp_path_factory.mktemp("flown")
    (folder / "tiny.yaml").write_text(SCENARIO, encoding="utf-8")
    return folder, run_installed("run", folder / "tiny.yaml", "--out", folder / "out")


def test_run_writes_bag_and_summary_and_exits_with_0(flown):
    folder, done = flown
    assert done.returncode == 0, done.stderr
    assert not done.stdout.startswith("\n"), "an empty line first"
    run = folder / "out" / "tiny-proposed"
    topics = read_bag(run).topics
    assert topics["/imu/data"].count == 125
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    assert summary["passed"] is True
    assert summary["seed"] == 3
    metrics = summary["metrics"]
    for name in (
        "tracking_rmse_deg",
        "tracking_max_deg",
        "fault_estimate_rmse_inside_deg",
        "fault_estimate_max_inside_deg",
        "fault_estimate_rmse_outside_deg",
        "fault_estimate_max_outside_deg",
        "torque_rms",
        "torque_total_variation",
        "saturation_share",
    ):
        assert metrics[name].keys() == {"roll", "pitch", "yaw"}, name
    assert metrics["fault_windows"][0]["fault_estimate_settling_s"]["roll"] < 0.2
    assert summary["wall_time_s"] > 0.0
    assert summary["real_time_factor"] > 0.0
    recorded = sum(topic.count for topic in topics.values())
    assert summary["recorded"] == {"messages": recorded, "dropped": {}}
    assert "tiny" in done.stdout


def test_run_exits_with_1_and_names_the_check_that_failed(folder: Path):
    done = call_quadftc("run", "tiny.yaml", "--scheme", "conventional", "--out", "out")
    assert done.returncode == 1
    assert re.search(r"tiny-conventional: tracking_max_deg roll = [\d.]+, required below 0.01", done.stdout)


def test_options_reach_the_nodes(folder: Path):
    options = ("--controller", "pid", "--observer", "none", "--rate", "125", "--seed", "9")
    done = call_quadftc("run", "tiny.yaml", *options, "--set", "faults.0.value=2 deg", "--out", "out")
    assert done.returncode in (0, 1), done.stderr  # the check is not made for these
    run = folder / "out" / "tiny-proposed-none-pid"  # by what differs
    nodes = yaml.safe_load((run / "parameters.yaml").read_text(encoding="utf-8"))
    plant, controller, observer = (
        nodes[f"/{name}"]["ros__parameters"] for name in ("plant", "controller", "fault_observer")
    )
    assert (plant["rate"], plant["seed"]) == (125.0, 9)
    assert (controller["controller"], observer["observer"]) == ("pid", "none")
    fault = read_bag(run).series("fault/injected")["vector"]
    assert max(fault[:, 0]) == pytest.approx(0.0349, abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "nowhere.yaml"), ("nowhere.yaml",)),
        (("run", "no_such_scenario"), ("no_such_scenario", "paper_faults")),
        (("run", "wrong.yaml"), ("wrong.yaml:9", "faults[0].value", "deg")),
        (("run", "tiny.yaml", "--scheme", "best"), ("best", "proposed")),
        (("run", "tiny.yaml", "--observer", "psychic"), ("psychic", "sliding_mode")),
        (("run", "tiny.yaml", "--set", "sede=1"), ("sede", "seed")),
        (("run", "tiny.yaml", "--rate", "fast"), ("rate", "fast")),
        (("run", "tiny.yaml", "--mode", "dream"), ("dream", "lockstep")),
        (("run", "tiny.yaml", "--label", "a/b"), ("label 'a/b'", "letters")),
        (("run",), ("scenarios",)),
        (("run", "./"), (".: a directory; expected a file",)),
        (("campaign", "empty.yaml"), ("empty.yaml:1: empty; expected a mapping",)),
        (("check", "binary.yaml"), ("binary.yaml: no text in UTF-8, from byte 4 on",)),
        (("export", "tiny.yaml", "--log", "x", "--out", "y"), ("Invalid value for '--log': 'x' is not",)),
        (("sitl", "tiny.yaml"), ("error: Missing option '--autopilot'. Choose from: ardupilot, px4\n",)),
        (("fly",), ("fly",)),
        (("list", "unicorns"), ("unicorns", "controllers")),
        (("run", "tiny.yaml", "--wait", "poll"), ("lock-step",)),
        (("run", "tiny.yaml", "--mode", "realtime", "--core", "4096"), ("core 4096",)),
    ],
)
def test_wrong_input_exits_with_2_and_says_what_was_expected(
    folder: Path, arguments: tuple[str, ...], words: tuple[str, ...]
):
    (folder / "wrong.yaml").write_text(SCENARIO.replace("1 deg", "1 dge"), encoding="utf-8")
    (folder / "empty.yaml").touch()
    (folder / "binary.yaml").write_bytes(b"name\xff")
    done = call_quadftc(*arguments)
    assert done.returncode == 2
    assert all(word in done.stderr for word in words), done.stderr


def test_earlier_run_is_kept_unless_forced(flown, folder: Path):
    shutil.copytree(flown[0] / "out", "out")
    refused = call_quadftc("run", "tiny.yaml", "--out", "out")
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert call_quadftc("run", "tiny.yaml", "--out", "out", "--force").returncode == 0


def test_force_replaces_only_runs(folder: Path):
    precious = folder / "out" / "tiny-proposed" / "thesis.txt"
    precious.parent.mkdir(parents=True)
    precious.write_text("years of work", encoding="utf-8")
    assert call_quadftc("run", "tiny.yaml", "--out", "out", "--force").returncode == 2
    assert precious.read_text(encoding="utf-8") == "years of work"


@pytest.mark.parametrize(
    ("options", "number"),
    [((), signal.SIGINT), (("--scheme", "all", "--jobs", "2"), signal.SIGTERM)],
    ids=("alone", "side by side"),
)
def test_interrupted_run_leaves_a_bag_that_can_be_read(folder: Path, options, number: signal.Signals):
    """The signal goes to all processes of the command, as from a terminal or a supervisor."""
    command = installed_command("run", "tiny.yaml", "--out", "out", "--set", "duration=120 s", *options)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, **pipes, start_new_session=True)
    bag = folder / "out" / "tiny-proposed" / "tiny-proposed_0.mcap"
    end = time.monotonic() + 60.0
    while not (bag.exists() and bag.stat().st_size > 100_000) and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.1)
    os.killpg(process.pid, number)
    _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "error" not in errors
    assert read_bag(bag.parent).topics["/imu/data"].count > 100


@pytest.mark.parametrize(
    "kind",
    [
        "observers",
        "controllers",
        "position_controllers",
        "trajectories",
        "faults",
        "winds",
        "sensors",
        "vehicles",
        "scenarios",
    ],
)
def test_list_shows_what_there_is(folder: Path, kind: str):
    done = call_quadftc("list", kind)
    assert done.returncode == 0, done.stderr
    names = {
        "observers": ("sliding_mode", "epsilon_s", "rad"),
        "controllers": ("ismc", "smc", "pid", "k_c3"),
        "faults": ("bias", "drift", "sine", "scale", "noise", "stuck", "spikes", "nan", "duration"),
        "winds": ("constant", "gust", "dryden", "m/s"),
        "position_controllers": ("geometric", "pid_cascade", "1/s^2"),
        "trajectories": ("circle", "figure_eight", "hover", "waypoints", "m/s"),
        "sensors": ("ideal", "mems", "ahrs", "tactical", "attitude_wander"),
        "vehicles": ("qball_x4", "crazyflie_2x", "x500"),
        "scenarios": ("paper_faults", "mems_faults", "250 Hz"),
    }
    assert [name for name in names[kind] if name not in done.stdout] == []
    assert "`" not in done.stdout


def test_doctor_finds_this_installation_well(folder: Path):
    done = run_installed("doctor")
    assert done.returncode == 0, done.stdout
    assert {line.split()[0] for line in done.stdout.splitlines()} == {"good"}


def test_run_on_a_full_disk_flies_on_and_ends_with_what_is_there(folder: Path):
    """No file may grow beyond 100 kB, which is what a disk that is full looks like to the one that writes."""
    limit = "import os, resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000));"
    tool = installed_command("run", "tiny.yaml", "--set", "duration=3 s", "--out", "out")
    command = [sys.executable, "-c", f"{limit} os.execv(sys.argv[1], sys.argv[1:])", *tool]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    bag = folder / "out" / "tiny-proposed"
    assert done.returncode == 3
    assert done.stderr.count("recording has stopped: ") == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    found = re.fullmatch(
        rf"error: {bag}/tiny-proposed_0.mcap: File too large: the recording stopped, the flight went on;"
        r" (\d+) messages are in the bag, (\d+) are lost; run quadftc repair out/tiny-proposed",
        line,
    )
    assert found is not None, line
    kept, lost = map(int, found.groups())
    assert kept > 100
    assert lost > 1000  # those of the rest of the flight
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "tiny-proposed_0.mcap"]
    repaired = call_quadftc("repair", str(bag))
    assert repaired.returncode == 0, repaired.stderr
    assert f"kept: {kept} messages" in repaired.stdout
    assert sum(topic.count for topic in read_bag(f"{bag}-repaired").topics.values()) == kept


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_disk_that_takes_no_more_is_said_in_a_line(number, capfd):
    app = typer.Typer()

    @app.command()
    def fill() -> None:
        raise OSError(number, os.strerror(number), "out/report.html")

    assert guarded(["--"], app) == 2
    assert capfd.readouterr().err == f"error: out/report.html: {os.strerror(number)}\n"
