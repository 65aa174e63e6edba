"""``quadftc diagnose`` as a user calls it: which log of a file, tables, files that are no logs."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from command_bench import call_quadftc, complaints

MAPPING = """
[time]
column = "t"
[[signal]]
quantity = "gyro"
columns = ["x", "y", "z"]
unit = "rad/s"
"""


@pytest.fixture
def archive(tmp_path):
    """Two tables in an archive; in the second the gyro has a step about x at 15 s."""
    (tmp_path / "mapping.toml").write_text(MAPPING)
    path, rng = tmp_path / "logs.zip", np.random.default_rng(1)
    with zipfile.ZipFile(path, "w") as target:
        for number in (1, 2):
            rates = rng.normal(scale=0.01, size=(3000, 3))
            rates[1500:, 0] += 0.5 * (number - 1)
            rows = "".join(f"{0.01 * k:.2f},{x},{y},{z}\n" for k, (x, y, z) in enumerate(rates))
            target.writestr(f"flight{number}.csv", f"t,x,y,z\n{rows}")
    return path


def test_log_of_an_archive_is_chosen(archive, tmp_path):
    options = ("--mapping", tmp_path / "mapping.toml", "--no-report", "--out", tmp_path / "out")
    asked = call_quadftc("diagnose", archive, *options)
    assert asked.returncode == 2
    assert asked.stderr.endswith(
        "2 logs in the archive; choose one with --log: 1 flight1.csv, 2 flight2.csv\n"
    )
    for number in (1, 2):
        done = call_quadftc("diagnose", archive, "--log", f"{number}", *options)
        assert done.returncode != 2, done.stderr
        verdict = json.loads((tmp_path / "out/verdict.json").read_text())
        assert verdict["log"] == "logs.zip"
        assert f"flight{number}.csv in the archive" in verdict["notes"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"z"', '"w"', "mapping.toml: signal 1 (gyro): no column 'w' in logs.zip; columns there: t, x, y, z"),
        ('"rad/s"', '"rpm"', "mapping.toml: signal 1: unit 'rpm' of gyro; expected rad/s, deg/s, mrad/s"),
    ],
)
def test_mapping_that_is_wrong_says_where(archive, tmp_path, old, new, words):
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(MAPPING.replace(old, new))
    done = call_quadftc("diagnose", archive, "--log", "1", "--mapping", mapping)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"error: {tmp_path}/{words}\n"


def test_reason_is_given_once(archive, tmp_path):
    options = ("--mapping", tmp_path / "mapping.toml", "--log", "1", "--out", tmp_path / "out", "--no-report")
    done = call_quadftc("diagnose", archive, *options)
    assert done.stdout.count("no voltage is logged") == 1, done.stdout
    found = call_quadftc("diagnose", archive, *options, "--fault", "stuck channel=gyro start=10s")
    assert found.returncode == 1
    assert "not judged: battery: no voltage is logged\n" in found.stdout, "no sentence says so of a fault"


@pytest.mark.parametrize("command", ["diagnose", "replay"])
def test_log_that_is_not_there_is_named_before_what_reads_logs_is_imported(command):
    code = "import sys\nfrom quadftc_cli.main import guarded\ncode = guarded(sys.argv[1:])\n"
    code += "print(code, *(name for name in ('numpy', 'scipy') if name in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code, command, "nowhere"], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("2\n", "error: nowhere: No such file or directory\n")


def test_fault_that_begins_too_late_is_quoted_as_it_was_given(archive, tmp_path):
    fault = "bias channel=gyro axis=x value=3deg/s start=60min"
    options = ("--mapping", tmp_path / "mapping.toml", "--log", "1", "--fault", fault)
    done = call_quadftc("diagnose", archive, *options)
    assert complaints(done)[0].startswith(f"error: fault '{fault}': start = 3600 s: must be before the end")


def test_file_that_is_no_log_is_named(tmp_path):
    path = tmp_path / "plot.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n")
    done = call_quadftc("diagnose", path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {path}: a PNG picture; expected a log of one of the formats")


def test_name_of_a_file_cannot_steer_the_terminal(tmp_path):
    path = tmp_path / "\x1b[31mcrash\udcff.bin"
    path.touch()
    done = call_quadftc("diagnose", path)
    assert done.stderr.startswith(rf"error: {tmp_path}/\x1b[31mcrash\udcff.bin: an empty file")


def test_level_that_no_flight_supports_is_refused(archive, tmp_path):
    options = ("--mapping", tmp_path / "mapping.toml", "--log", "1", "--out", tmp_path / "out")
    done = call_quadftc("diagnose", archive, *options, "--false-alarms", "1/10h")
    assert done.returncode == 2
    assert "no calibration flights logged as CSV; there are: ArduPilot, PX4" in done.stderr
